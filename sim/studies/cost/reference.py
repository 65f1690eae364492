"""A reference that earns the name: methods of different kinds that agree, and agree with half the step.

SDIRK2 and BDF2 are both second order, but their errors differ in size and kind, so what they agree on is not
the doing of either. Where a step feels a contact every integrator is backward Euler, though: there the two
would agree even if both were wrong, and what tells is how much half the step still changes. The larger of
both distances is the floor: no error below ten times of it can be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.settings import Settings
from sim.studies.cost.measures import distances
from sim.studies.cost.trace import Trace

FINER = 16
"""Times that a reference's step is finer than the finest step swept."""

MARGIN = 10.0
"""Times that the smallest error plotted must be above the floor."""

ROUNDING = 1e-11
"""Errors below this are rounding: every method is exact there, and there is nothing to compare."""

ACCELERATION = 1e-4
"""Error of acceleration [m/s²] that a solve may leave in a run that is as good as converged; a
hundred-thousandth of the earth's. A position error of τ in a step of h is one of τ/h², so the tolerance goes
with h²."""

FINEST_TOLERANCE = 1e-12
"""As `tolerance` is bounded below [m]."""

NEWTON = 8
"""Most Newton iterations of a run that is as good as converged."""

REFERENCE_NEWTON = 2
"""The same for the reference, whose steps are so short that its first guess is nearly right. What that leaves
out shrinks with the step, so twice the step tells."""


class ReferenceError(ValueError):
    """There is no reference that errors could be told against; the message says why."""


@dataclass(frozen=True)
class Reference:
    """What errors are told against.

    Attributes:
        trace: Of the run that counts as the truth.
        dt: Its step [s].
        floor: (k,) for each look the largest distance up to there between it and its checks.
        checks: What it was compared with, and the distance at each look (k,).
    """

    trace: Trace
    dt: float
    floor: np.ndarray
    checks: dict[str, np.ndarray]

    def errors(self, trace: Trace, masses: np.ndarray, length: float) -> np.ndarray:
        """(k,) the largest distance e_x of a run from it up to each look."""
        looks = min(len(trace), len(self.trace))
        apart = distances(trace.positions[:looks], self.trace.positions[:looks], masses, length)
        return np.maximum.accumulate(apart)


def converged(dt: float) -> dict[str, Any]:
    """Settings of a run with steps of `dt` [s] whose equations are as good as solved."""
    return {"dt": dt, "newton": NEWTON, "tolerance": converged_tolerance(dt)}


def converged_tolerance(dt: float) -> float:
    """The position error [m] that a solve of such a run may leave."""
    return min(1e-2, max(FINEST_TOLERANCE, ACCELERATION * dt * dt))


def reference_settings(chosen: Settings, dt: float) -> list[dict[str, Any]]:
    """Settings of the reference and of the runs that check it: the other method, and twice the step."""
    from msgspec.structs import asdict

    base = {**asdict(chosen), "compensate": "off"}
    fine, coarse = ({**converged(h), "newton": REFERENCE_NEWTON} for h in (dt, 2.0 * dt))
    return [
        {**base, **fine, "integrator": "sdirk2"},
        {**base, **fine, "integrator": "bdf2"},
        {**base, **coarse, "integrator": "sdirk2"},
    ]


def judge(traces: Sequence[Trace], dt: float, masses: np.ndarray, length: float) -> Reference:
    """The reference out of the runs that `reference_settings` asks for.

    Raises:
        ReferenceError: where one of them failed.
    """
    for trace in traces:
        if trace.stopped:
            raise ReferenceError(f"the reference failed {trace.stopped}")
    looks = min(map(len, traces))
    truth, *others = traces
    names = "BDF2 at the same step", "SDIRK2 at twice the step"
    checks = {
        name: distances(other.positions[:looks], truth.positions[:looks], masses, length)
        for name, other in zip(names, others, strict=True)
    }
    floor = np.maximum.accumulate(np.max(list(checks.values()), axis=0))
    return Reference(truth, dt, floor, checks)


def comparable(floor: np.ndarray, errors: Sequence[np.ndarray], most: int) -> int | None:
    """The last look up to which the floor is a tenth of the smallest error; None if there is none.

    Args:
        floor: Of the reference (k,).
        errors: Of each run (k,), the largest up to each look.
        most: The last look that may be used.
    """
    looks = min([most + 1, len(floor), *map(len, errors)])
    smallest = np.min([error[:looks] for error in errors], axis=0)
    good = (smallest > ROUNDING) & (MARGIN * floor[:looks] <= smallest)
    found = np.flatnonzero(good)
    return int(found[-1]) if len(found) else None


def refuse(
    reference: Reference, errors: Sequence[np.ndarray], most: int, fewest: int, cut: bool, more: str
) -> ReferenceError:
    """The error that says why no look from `fewest` to `most` is `comparable`.

    Args:
        reference: That was tried.
        errors: Of each run (k,), the largest up to each look.
        most: The last look that could be used.
        fewest: The first one.
        cut: Whether later looks were asked for, and there was no time for them.
        more: What gives a study more time; nothing if it had all that it asked for.
    """
    looks = min([most + 1, len(reference.floor), *map(len, errors)])
    smallest = np.min([error[:looks] for error in errors], axis=0)
    if reference.floor[looks - 1] <= ROUNDING and smallest[-1] <= ROUNDING:
        later = (
            f"later looks take more time than there is; {more}" if cut and more else "ask for more --seconds"
        )
        return ReferenceError(
            f"up to {reference.trace.times[looks - 1]:.3g} s methods are exact to rounding: there is nothing "
            f"to compare; {later}, or another scene"
        )
    first = min(fewest, looks - 1)
    parts = reference.floor[first:looks] / np.maximum(smallest[first:], ROUNDING)
    at = first + int(np.argmin(parts))
    return ReferenceError(
        f"the reference is too coarse: with steps of {1e3 * reference.dt:.3g} ms it is known to "
        f"{reference.floor[at]:.1e} at {reference.trace.times[at]:.3g} s, where the smallest error is "
        f"{smallest[at]:.1e}; expected a tenth of that{more and f'; {more}'}"
    )
