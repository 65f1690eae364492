"""Sleep: cloth that has come to rest is left out of steps until something could move it.

Parts of the cloth sleep one by one: a part is all that springs join, and parts that touch each other sleep
and wake together. They fall asleep where for AFTER seconds no step ended with one of their vertices faster
than SPEED, changed a velocity by more than CALM allows, or was driven: by gusts, by an obstacle that moved or
turned within reach, by settings on their way. Their velocities are then zero, and the energy that this takes
is booked. While others move they stay where they are as if pinned, to the bit. A change of settings or of
places wakes all cloth; an obstacle that moves wakes the parts that it comes near, before it is within reach;
and a step in which cloth that is awake touches cloth that sleeps is done again with that awake, too.

What sleep may miss is creep that is slower than SPEED, and a pull weaker than SPEED / AFTER: cloth that
starts from rest under a stronger one is faster than SPEED before AFTER is over. That is a threshold and no
bound on where cloth ends after any length of time, so sleep is off unless it is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim.contact.contacts import groups
from sim.contact.obstacles import MESH
from sim.contact.reach import box, within_reach

if TYPE_CHECKING:
    from sim.contact.obstacles import Obstacles
    from sim.settings import Settings

AFTER = 0.5
"""Time [s] that cloth is still before it falls asleep."""

SPEED = 1e-5
"""Part of the cloth's size that a vertex which is still goes in a second, at most."""

CALM = 1e-3
"""Part of the cloth's size by which its speed changes in a second, at most: contacts may chatter within
SPEED, for what lasts is told by SPEED."""


CLEARANCE = 2.0
"""Times the thickness within which an obstacle that moves wakes cloth: more than contacts feel."""


class Rest:
    """Which parts of the cloth sleep, and for how long the others have been still.

    Args:
        part: (n,) the part that each vertex is of.
        size: Of the cloth [m].

    Attributes:
        part: As above.
        still: (parts,) for how long each one has been still [s]; replaced, never changed.
    """

    def __init__(self, part: np.ndarray, size: float) -> None:
        self.part, self._size = part, size
        self.wake()

    @property
    def asleep(self) -> np.ndarray:
        """(parts,) bool, which ones sleep."""
        return self.still >= AFTER

    def wake(self) -> None:
        """Have all cloth awake."""
        self.still = np.zeros(int(self.part.max(initial=-1)) + 1)

    def rouse(self, which: np.ndarray) -> bool:
        """Wake those (parts,) bool that sleep; whether there were any."""
        found = bool((which & self.asleep).any())
        if found:
            self.still = np.where(which & self.asleep, 0.0, self.still)
        return found

    def touched(self, joins: np.ndarray) -> np.ndarray:
        """(parts,) bool, which ones awake cloth touches, itself or by others: `joins` (k, 2) touch."""
        group, awake = groups(len(self.still), joins), ~self.asleep
        return np.isin(group, group[awake])

    def after(self, before: np.ndarray, velocities: np.ndarray, h: float, driven: np.ndarray, joins) -> None:
        """Count a step of `h` [s] between velocities (n, 3) [m/s], with what is `driven` (parts,) bool.

        `joins` (k, 2) are parts that touch.
        """
        fast = np.linalg.norm(velocities, axis=1) > SPEED * self._size
        fast |= np.linalg.norm(velocities - before, axis=1) > CALM * self._size * h
        driven = driven.copy()
        driven[self.part[fast]] = True
        group = groups(len(self.still), joins)
        least = np.full(len(self.still), np.inf)
        np.minimum.at(least, group, np.where(driven, 0.0, self.still + h))
        self.still = least[group]


def driven(
    settings: Settings, obstacles: Obstacles, time: float, positions: np.ndarray, part: np.ndarray
) -> np.ndarray:
    """(parts,) bool, which parts at rest something may move in the step from `time` [s].

    Args:
        settings: In force.
        obstacles: Of the scene.
        time: At the start of the step [s].
        positions: (n, 3) [m].
        part: (n,) the part that each vertex is of.
    """
    parts = int(part.max(initial=-1)) + 1
    if settings.drag > 0.0 and settings.gust > 0.0 and any(settings.wind):
        return np.ones(parts, dtype=bool)
    felt = obstacles.felt(settings).which
    if settings.contact == "none" or not felt.any():
        return np.zeros(parts, dtype=bool)
    before, after = obstacles.poses(time), obstacles.poses(time + settings.dt)
    moves = (before.position != after.position).any(axis=1)
    moves |= (before.rotation != after.rotation).any(axis=(1, 2))
    moves &= felt
    shapes, found = obstacles.shapes, np.zeros(parts, dtype=bool)
    found[:] = (moves & (shapes.kind == MESH)).any()
    for p in range(parts if moves.any() and not found.all() else 0):
        here = box(positions[part == p])
        found[p] = (
            moves & within_reach(shapes, before, after, here, here, CLEARANCE * settings.thickness)
        ).any()
    return found
