"""The local error of a simulation's settings, measured: one frame with them beside the same frame, far finer.

Both begin at a snapshot of the present state, in a simulation of the probe's own, so that nothing of the one
that is looked at changes. The finer run is SDIRK2, solved twice by Newton, with a quarter of the time step,
an eighth or a sixteenth. How far it is from the one with twice its own step is called the floor, and it is
refined until that is a tenth of the error. Of a smooth motion the finer one is off by a third of the floor.
Where cloth touches something every integrator is backward Euler, two runs are a sixteenth of its error apart
at last, and the finer one is off by about as much; where cloth lands, that is uneven, and twice as much was
seen. An error that is not ten times the floor even then is only known as at least what it exceeds the floor
by.

The error is local: that of a single frame, from a state that is taken for right. It is no bound on where many
frames lead, which `muslin cost` measures.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.report import StepReport
from sim.settings import FIELDS, Settings
from sim.simulation import Simulation, Snapshot
from sim.studies.cost.measures import distances, size
from sim.studies.cost.reference import MARGIN, reference_settings

FRAME = 1 / 60
"""Simulated time [s] of a frame; a longer time step is a frame of its own."""

REFINED = (2, 4, 8, 16)
"""Times that the step of a finer run is shorter."""

QUICK = REFINED[1]
"""The finest of a quick measurement, which has a fifth of the steps: the least that has a floor."""

ACCELERATION = 0.1
"""Error of acceleration [m/s²] that a solve of the finer run may leave, a hundredth of the earth's.

A tenth of that takes half as long again, and changed no error in its third digit."""

ROUNDING = 1e-12
"""Relative distance that is rounding."""


@dataclass(frozen=True)
class Truth:
    """Where a frame leads, as far as is known.

    Attributes:
        positions: (n, 3) at its end [m].
        seconds: Its length [s].
        floor: How far, relative to the cloth's size, the two finer runs are apart.
    """

    positions: np.ndarray
    seconds: float
    floor: float


@dataclass(frozen=True)
class LocalError:
    """What a frame with some settings was off by, and took.

    Attributes:
        error: Mass-weighted distance from the finer run, relative to the cloth's diagonal.
        floor: How far the finer run may be off itself, in the same measure.
        seconds: Length of the frame [s].
        ms: Milliseconds of the frame with the settings.
        inside: Most vertices inside an obstacle after a step of it.
        took: Processor time of the measurement [s], finer runs and all, in the thread that measured.
    """

    error: float
    floor: float
    seconds: float
    ms: float
    inside: int = 0
    took: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether the finer run is known to a tenth of the error, or all is exact to rounding."""
        return MARGIN * self.floor <= max(self.error, ROUNDING)

    @property
    def least(self) -> float:
        """What the error is at least."""
        return max(self.error - self.floor, 0.0)

    @property
    def most(self) -> float:
        """What the error is at most."""
        return self.error + self.floor


class Probe:
    """Measures local errors of a scene's cloth.

    Args:
        world: A simulation of the scene, which nobody else steps.
        between: Called before each step; what it raises ends a measurement.
        cost: Of a step, from its report; milliseconds unless something else is to be counted.
    """

    def __init__(
        self,
        world: Simulation,
        between: Callable[[], None] = lambda: None,
        cost: Callable[[StepReport], float] = lambda report: report.ms["total"],
    ) -> None:
        self._world, self._between, self._cost = world, between, cost
        self._length = size(world)
        world.keep_ledger(False)

    def measure(self, state: Snapshot, finest: int = REFINED[-1]) -> LocalError:
        """The local error at a state of the settings that hold there.

        Args:
            state: Where to begin.
            finest: Of REFINED, where to stop though the error may not be known to a tenth.

        Raises:
            StepError: where a step could not be done, of the frame or of the finer runs.
        """
        begin = time.thread_time()
        settings = state.ramp.target
        steps = _steps(settings, max(FRAME, settings.dt))
        reports, end = self._go(state, {}, steps)
        truth = self.truth(state, settings, steps * settings.dt, end, finest)
        return replace(self._found(reports, end, truth), took=time.thread_time() - begin)

    def truth(
        self,
        state: Snapshot,
        settings: Settings,
        seconds: float,
        end: np.ndarray | None = None,
        finest: int = REFINED[-1],
    ) -> Truth:
        """Where a frame of about `seconds` [s] leads from a state, with the physics of `settings`.

        The frame has a whole number of steps of settings.dt. Where the `end` (n, 3) [m] is given that some
        settings lead to, it is only made as fine as is needed to tell their error; and never finer than
        `finest`.
        """
        steps, floor = _steps(settings, seconds), math.inf
        now = self._finer(state, settings, REFINED[0], steps)
        for finer in REFINED[1 : REFINED.index(finest) + 1]:
            before, now = now, self._finer(state, settings, finer, steps)
            floor = self._apart(now, before)
            if end is not None and MARGIN * floor <= max(self._apart(end, now), ROUNDING):
                break
        return Truth(now, steps * settings.dt, floor)

    def _finer(self, state: Snapshot, settings: Settings, finer: int, steps: int) -> np.ndarray:
        """Where so many `steps` lead that are made in as many as `finer` parts each."""
        chosen = reference_settings(settings, settings.dt / finer)[0]
        tolerance = FIELDS["tolerance"].clamp(ACCELERATION * chosen["dt"] ** 2)
        return self._go(state, {**chosen, "tolerance": tolerance, "threads": 1}, steps * finer)[1]

    def error(self, state: Snapshot, changes: dict[str, Any], truth: Truth) -> LocalError:
        """How far from the truth the settings lead that hold at a state, with these `changes`."""
        dt = changes.get("dt", state.ramp.target.dt)
        return self._found(*self._go(state, changes, round(truth.seconds / dt)), truth)

    def _found(self, reports: list[StepReport], end: np.ndarray, truth: Truth) -> LocalError:
        error = self._apart(end, truth.positions)
        inside = max(report.penetrations for report in reports)
        return LocalError(error, truth.floor, truth.seconds, sum(map(self._cost, reports)), inside)

    def _go(
        self, state: Snapshot, changes: dict[str, Any], steps: int
    ) -> tuple[list[StepReport], np.ndarray]:
        """Step from a state with changed settings; gives the reports and where that ends."""
        self._world.restore(state)
        if changes:
            self._world.update(**changes)
        reports = []
        for _ in range(steps):
            self._between()
            reports.append(self._world.step())
        return reports, self._world.positions.copy()

    def _apart(self, one: np.ndarray, other: np.ndarray) -> float:
        return float(distances(one[None], other[None], self._world.masses, self._length)[0])


def _steps(settings: Settings, seconds: float) -> int:
    """Steps of settings.dt that take at least so long."""
    return max(1, math.ceil(seconds / settings.dt * (1.0 - 1e-9)))
