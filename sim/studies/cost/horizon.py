"""How long two runs of a scene may be compared vertex by vertex.

Copies of a run whose vertices were moved by a hair at first drift apart, wherever the cloth may fall into one
fold or another. Once that hair has grown to what one would call an error, a difference of positions says
nothing of a method: observables, and their spread over seeded runs, are what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.studies.cost.measures import distances
from sim.studies.cost.report import Growth
from sim.studies.cost.trace import Trace

HAIR = 1e-8
"""By which vertices are moved, as part of the cloth's size."""

APART = 1e-3
"""Relative distance at which runs are no longer the same."""

NEWTON = 3
"""Newton iterations of these runs."""

GROWN = 10.0
"""Times its first size that a hair must have grown to speak of exponential growth."""


def growth_settings(dt: float, length: float) -> dict[str, Any]:
    """Settings of runs that drift apart: solves leave no more than the hair itself, or they would drive it.

    Args:
        dt: Time step [s].
        length: Of the cloth [m].
    """
    return {"integrator": "sdirk2", "dt": dt, "newton": NEWTON, "tolerance": HAIR * length}


def growth(base: Trace, moved: Sequence[Trace], masses: np.ndarray, length: float) -> Growth:
    """How runs drift apart from `base`.

    Args:
        base: A run.
        moved: Runs that differ from it by the hair alone.
        masses: (n,) [kg].
        length: Of the cloth [m].
    """
    looks = min(len(trace) for trace in (base, *moved))
    apart = [distances(m.positions[:looks], base.positions[:looks], masses, length) for m in moved]
    largest = np.max(apart, axis=0)
    beyond = np.flatnonzero(largest >= APART)
    last = (beyond[0] if len(beyond) else looks) - 1
    times = base.times[:looks]
    return Growth(
        times=times.tolist(),
        distance=largest.tolist(),
        members=len(moved),
        horizon=float(times[max(last, 0)]),
        reached=bool(len(beyond)),
        e_fold=_e_fold(times, largest),
    )


def _e_fold(times: np.ndarray, largest: np.ndarray) -> float | None:
    """Time [s] in which the distance grows e times, from a line through its logarithm; None for no growth."""
    seen = (largest > 0.0) & (largest < APART) & (times > 0.0)
    if np.count_nonzero(seen) < 3 or largest[seen][-1] < GROWN * largest[seen][0]:
        return None
    rate = float(np.polyfit(times[seen], np.log(largest[seen]), 1)[0])
    return 1.0 / rate if rate > 0.0 else None
