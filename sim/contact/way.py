"""What one step through contact, or one part of it, has to go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.contact.contacts import Touch
from sim.contact.gap import NO_GAP_SPRINGS, GapSprings
from sim.contact.obstacles import Poses
from sim.contact.reach import box
from sim.contact.response import Response
from sim.ledger import Part, Unbooked
from sim.report import StepReport
from sim.settings import Settings
from sim.solve.implicit import Solution

Solve = Callable[[GapSprings, Settings, np.ndarray, np.ndarray, np.ndarray | None], Solution]
"""solve(springs, settings, x, v, guess): `guess` is velocities near those at its end, where there are any."""


@dataclass
class Way:
    """The way of cloth and obstacles over one step, or one part of it, and what is found on it.

    Attributes:
        settings: With the length of the part.
        response: How cloth answers contacts, if it does.
        time: Where it starts [s].
        before: Poses of the obstacles where it starts.
        after: And where it ends.
        x: (n, 3) positions where it starts [m].
        v: (n, 3) velocities where it starts [m/s].
        touched: What the contacts of the part before remember.
        solve: Makes the implicit solve.
        report: Of the whole step.
        part: The books of it.
        over: (k, 2) vertices that obstacles are over, and which.
        last: Whether there is no other try, in halves.
        deepest: Nor for the sake of what an obstacle runs over.
        erupted: What put in energy the last time it was tried, "impulses" or "solve"; else "".
        springs: That the last solve of it felt.
        guess: (n, 3) velocities that this ended with [m/s], if there was one.
    """

    settings: Settings
    response: Response | None
    time: float
    before: Poses
    after: Poses
    x: np.ndarray
    v: np.ndarray
    touched: Touch
    solve: Solve
    report: StepReport
    part: Part | Unbooked
    over: np.ndarray
    last: bool = False
    deepest: bool = False
    erupted: str = ""
    springs: GapSprings = NO_GAP_SPRINGS
    guess: np.ndarray | None = None

    @cached_property
    def start(self) -> np.ndarray:
        """(8, 3) corners of the box around `x` [m]."""
        return box(self.x)
