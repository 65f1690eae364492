"""Timed runs: alone, one after the other, and several times in turn, so that a busy moment hits all alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np

from sim.studies.cost.trace import Case, Trace, run

MORE, ENOUGH = 3, 500.0
"""Times that a short run is repeated more often, at most, until all its repeats took so long together
[ms]."""


class Timed:
    """A run and what its repeats took; the first, which warms caches, counts only where there is no other.

    Attributes:
        trace: Of the first time; the others are the same to the bit.
        ms: Of each time, (k,) milliseconds since the look before.
        phases: Of each time, by phase.
    """

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self.ms = [trace.ms]
        self.phases = [trace.phases]

    def add(self, again: Trace) -> None:
        """Take in a repeat, which may be shorter."""
        self.ms.append(again.ms)
        self.phases.append(again.phases)

    def repeats(self, look: int) -> list[float]:
        """Milliseconds per simulated second up to a look, of each time."""
        return [self.trace.per_second(ms, look) for ms in self.ms[1:] or self.ms]

    def phase_medians(self, look: int) -> dict[str, float]:
        """Milliseconds per simulated second up to a look by phase, medians of all times."""
        names = self.phases[0]
        return {
            name: median(
                self.trace.per_second(p.get(name, np.zeros(look + 1)), look)
                for p in self.phases[1:] or self.phases
            )
            for name in names
        }


def measure(cases: Sequence[Case], told: Callable[[int], None]) -> list[Timed]:
    """Make every run once; `told` is told of how many are done."""
    found = []
    for i, case in enumerate(cases):
        told(i)
        found.append(Timed(run(case)))
    return found


def repeat(cases: Sequence[Case], timed: Sequence[Timed], times: int, told: Callable[[float], bool]) -> None:
    """Make runs again in turn, those that did not fail, until `told`, who knows what part is done, says no.

    Every one is made once at least. Short runs are made up to MORE times as often as the others.
    """
    left = [_times(t, times) for t in timed]
    total, done = sum(left), 0
    while any(left):
        for i, case in enumerate(cases):
            if not left[i]:
                continue
            if not told(done / total) and done >= len(cases):
                return
            timed[i].add(run(case))
            left[i], done = left[i] - 1, done + 1


def _times(t: Timed, times: int) -> int:
    """How often to repeat a run."""
    if t.trace.stopped:
        return 0
    return min(MORE * times, max(times, math.ceil(ENOUGH / max(float(t.trace.ms.sum()), 1.0))))
