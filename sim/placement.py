"""Where obstacles are at a time: on their keyed paths, and stood up from their own frames.

An obstacle's own frame has a plane's normal and a capsule's axis along z. NumPy alone, so that scenes can be
checked without a compiler.
"""

from __future__ import annotations

import math

import numpy as np

from sim.rotation import rotation_matrix
from sim.scene import Capsule, Key, Obstacle, Plane, ShellArrays, ShellFile


def pose(part: Obstacle, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] of the reference point and rotation (3, 3) from the own frame, at `time` [s]."""
    position, turn = _on_path(part, time)
    return position, rotation_matrix(turn) @ upright(part)


def upright(part: Obstacle) -> np.ndarray:
    """Rotation (3, 3) from the own frame to the world, before a path turns it."""
    if isinstance(part, ShellFile | ShellArrays):
        return rotation_matrix(part.rotation)
    if isinstance(part, Plane):
        return _turn_z_to(np.asarray(part.normal))
    if isinstance(part, Capsule):
        axis = np.subtract(part.end, part.start)
        return _turn_z_to(axis) if axis.any() else np.eye(3)
    return np.eye(3)


def _turn_z_to(axis: np.ndarray) -> np.ndarray:
    z = axis / np.linalg.norm(axis)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (1.0, 0.0, 0.0), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _on_path(part: Obstacle, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Position of the reference point and rotation vector at `time`."""
    if not part.path:
        return np.asarray(part.reference), np.zeros(3)
    keys = part.path
    first, last = keys[0].time, keys[-1].time
    if part.repeat and time > last:
        time = first + math.fmod(time - first, last - first)
    after = next((k for k, key in enumerate(keys) if key.time > time), len(keys))
    if after == 0 or after == len(keys):
        return _key(keys[max(after - 1, 0)], part.reference)
    a, b = keys[after - 1], keys[after]
    t = (time - a.time) / (b.time - a.time)
    if part.motion == "smooth":
        t = t * t * (3.0 - 2.0 * t)
    (x0, r0), (x1, r1) = _key(a, part.reference), _key(b, part.reference)
    return x0 + t * (x1 - x0), r0 + t * (r1 - r0)


def _key(key: Key, reference: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(reference if key.position is None else key.position), np.asarray(key.rotation)
