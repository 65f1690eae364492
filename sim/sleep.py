"""Sleep: cloth that has come to rest is left out of steps until something could move it.

All cloth of a scene sleeps together, or none does. It falls asleep where for AFTER seconds no step ended with
a vertex faster than SPEED, changed a velocity by more than CALM allows, or was driven: by gusts, by an
obstacle that moved or turned within reach, by settings on their way. Its velocities are then zero, and the
energy that this takes is booked. A change of settings or of places wakes it, and so does an obstacle that
moves, before it comes within reach.

What sleep may miss is creep that is slower than SPEED, and a pull weaker than SPEED / AFTER: cloth that
starts from rest under a stronger one is faster than SPEED before AFTER is over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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


def still(before: np.ndarray, after: np.ndarray, h: float, size: float) -> bool:
    """Whether all vertices are still in a step of h [s] between velocities, (n, 3) both [m/s].

    `size` is the cloth's [m].
    """
    speed, change = (np.linalg.norm(v, axis=1).max() for v in (after, after - before))
    return bool(speed <= SPEED * size and change <= CALM * size * h)


def driven(settings: Settings, obstacles: Obstacles, time: float, positions: np.ndarray) -> bool:
    """Whether something may move cloth at rest at `positions` (n, 3) [m] in the step from `time` [s]."""
    if settings.drag > 0.0 and settings.gust > 0.0 and any(settings.wind):
        return True
    felt = obstacles.felt(settings).which
    if settings.contact == "none" or not felt.any():
        return False
    before, after = obstacles.poses(time), obstacles.poses(time + settings.dt)
    moves = (before.position != after.position).any(axis=1)
    moves |= (before.rotation != after.rotation).any(axis=(1, 2))
    if not (moves & felt).any():
        return False
    here, shapes = box(positions), obstacles.shapes
    near = within_reach(shapes, before, after, here, here, CLEARANCE * settings.thickness) | (
        shapes.kind == MESH
    )
    return bool((moves & felt & near).any())
