"""A case in a process of its own, with a time limit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from sim.bench import Case, Measured

START_UP = 120.0
"""Time for imports and compilers, on top of what a case may step [s]."""

POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What other libraries read their number of threads from."""


def measure_apart(case: Case, start_up: float = START_UP) -> Measured:
    """What the case found; with "stopped" [s] where it ran out of time, with "failed" where it fell over."""
    command = [sys.executable, "-m", "sim.bench.case", json.dumps(case.builtins())]
    limit = case.seconds + start_up
    with tempfile.TemporaryDirectory() as folder:  # peers leave logs where they run
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env=_environment(case.threads),
                capture_output=True,
                timeout=limit,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            return {**_last(late.stdout), "stopped": limit}
    if done.returncode:
        lines = done.stderr.decode(errors="replace").split("\n")
        said = [line.strip() for line in lines if line.strip()]
        return {**_last(done.stdout), "failed": said[-1] if said else f"exit code {done.returncode}"}
    return _last(done.stdout)


def _environment(threads: int) -> dict[str, str]:
    ours = str(Path(__file__).parents[2])
    before = os.environ.get("PYTHONPATH")
    path = f"{ours}{os.pathsep}{before}" if before else ours
    return {**os.environ, **dict.fromkeys(POOLS, str(threads)), "PYTHONPATH": path}


def _last(output: bytes | None) -> Measured:
    """The last whole line of JSON."""
    for line in reversed((output or b"").decode(errors="replace").splitlines()):
        try:
            return json.loads(line)
        except ValueError:
            continue
    return {}
