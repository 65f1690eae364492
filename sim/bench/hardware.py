"""The computer and the versions that numbers were measured with."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import sim
from sim.bench.peers import PEERS, version_of

CORE = ("numpy", "numba", "scipy", "pypardiso")
"""What a step is made of; the last one is an extra."""


def hardware() -> dict[str, str | int | float | None]:
    """Processor, cores, memory [GB], how busy it was before, and the system."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": _memory(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.system(),
    }


def versions() -> dict[str, str]:
    """Of Muslin, Python, and the packages that count, where they are installed."""
    names = [*CORE, *dict.fromkeys(package for peer in PEERS.values() for package in peer.packages)]
    found = {name: known for name in names if (known := version_of(name))}
    return {"muslin": sim.__version__, "python": platform.python_version(), **found}


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1)
    except (AttributeError, ValueError, OSError):
        return None
