"""The bench: what a step costs, how exact it is, and what other simulators of cloth need for the same.

`plan` says which cases there are; each is measured in a process of its own (`sim.bench.case`), so that
memory, threads and start-up are its own; `sim.bench.tables` makes a `sim.studies.Result` of what they found.

This module imports no numba and no peer.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sim.bench.peers import EXTRA, MUSLIN, MUSLIN_AS_PEER, PEERS, Peer
from sim.bench.sheet import KINDS
from sim.studies import Progress, watched

SIZES = (1024, 4096, 10000, 40000)
"""Vertices of the sheets that Muslin steps."""

PEER_SIZE = 4096
"""The largest of them that peers step, too [vertices]."""

STEPS = 120
"""Steps of Muslin for each sheet; two seconds."""

SECONDS = 6.0
"""Time for the frames of a case [s]."""

STEPS_SHARE, ACCURACY_SHARE = 1.5, 4.0
"""Time for Muslin's steps, and for all runs of an accuracy, over that of a case of frames."""

Measured = dict[str, Any]
"""What a case found, as its process printed it."""


@dataclass(frozen=True)
class Case:
    """Something to measure in a process of its own.

    Attributes:
        measure: "steps" of Muslin with errors, "frames" of any solver, or the "accuracy" of any solver.
        solver: A name out of `solvers()`.
        kind: Of the sheet, "hang" or "drape".
        size: Vertices.
        threads: That the process may use.
        steps: That are taken at most, where steps are measured.
        seconds: That stepping may take [s].
        setting: Which of the solver's settings to time.
    """

    measure: str
    solver: str
    kind: str
    size: int
    threads: int
    steps: int
    seconds: float
    setting: int = 0

    @property
    def words(self) -> str:
        """For whoever waits for it."""
        return f"{self.solver}, {self.kind}, {self.size:,} vertices: {self.measure}"

    def builtins(self) -> dict[str, Any]:
        """The same as plain data."""
        return asdict(self)


def solvers() -> dict[str, Peer]:
    """Muslin and its peers by name."""
    return {MUSLIN: MUSLIN_AS_PEER, **PEERS}


def check(
    sizes: Sequence[int], threads: Sequence[int], steps: int, seconds: float = SECONDS, fewest: int = 2
) -> None:
    """Raise ValueError, in one line, for what cannot be measured."""
    if not sizes:
        raise ValueError("--sizes: expected at least one size, got none")
    for size in sizes:
        if size < 16 or math.isqrt(size) ** 2 != size or size > 1_000_000:
            raise ValueError(f"--sizes: expected square numbers from 16 to 1,000,000, got {size}")
    cores = os.cpu_count() or 1
    if not threads:
        raise ValueError("--threads: expected at least one number, got none")
    for count in threads:
        if not 1 <= count <= cores:
            raise ValueError(f"--threads: expected 1 to {cores}, the cores of this computer, got {count}")
    check_steps(steps, fewest)
    if not 0.0 < seconds <= 3600.0:
        raise ValueError(f"--seconds: expected > 0 and ≤ 3600, got {seconds:g}")


def check_steps(steps: int, fewest: int) -> None:
    """Raise ValueError, in one line, for fewer steps than that, or for very many."""
    if not fewest <= steps <= 100_000:
        raise ValueError(f"--steps: expected {fewest} to 100,000, got {steps}")


def plan(
    sizes: Sequence[int],
    threads: Sequence[int],
    steps: int = STEPS,
    seconds: float = SECONDS,
    peers: bool = False,
) -> list[Case]:
    """All cases, in the order in which they are measured.

    Args:
        sizes: Vertices of Muslin's sheets; peers get those up to `PEER_SIZE`.
        threads: Each number of threads that Muslin's steps are measured with; everything else gets the most.
        steps: Of Muslin for each sheet.
        seconds: For the frames of a case [s].
        peers: Whether peers are measured.
    """
    sizes, threads = sorted(set(sizes)), sorted(set(threads))
    cases = [
        Case("steps", MUSLIN, kind, size, count, steps, STEPS_SHARE * seconds)
        for kind in KINDS
        for size in sizes
        for count in threads
    ]
    if not peers:
        return cases
    for size in [size for size in sizes if size <= PEER_SIZE]:
        for name, solver in solvers().items():
            cases += [
                Case("frames", name, kind, size, threads[-1], steps, seconds, setting)
                for kind in KINDS
                for setting in range(1 if solver.missing else solver.settings)
            ]
            cases.append(Case("accuracy", name, "hang", size, threads[-1], steps, ACCURACY_SHARE * seconds))
    return cases


def run(
    cases: Sequence[Case],
    progress: Progress | None = None,
    measure: Callable[[Case], Measured] | None = None,
) -> list[tuple[Case, Measured]]:
    """Measure `cases` one after another, each in a process of its own unless `measure` says otherwise.

    Ctrl-C ends it with what was found by then.
    """
    from sim.bench.process import measure_apart

    measure = measure or measure_apart
    found: list[tuple[Case, Measured]] = []
    with contextlib.suppress(KeyboardInterrupt):
        for case in watched(cases, progress, lambda case: case.words):
            found.append((case, _or_missing(case, measure)))
    return found


def _or_missing(case: Case, measure: Callable[[Case], Measured]) -> Measured:
    if solvers()[case.solver].missing:
        return {"missing": f"not installed: pip install 'muslin[{EXTRA}]'"}
    return measure(case)
