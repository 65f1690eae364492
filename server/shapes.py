"""Triangle meshes of obstacles in their own frame, and how that frame stands at the start.

An obstacle's own frame has its reference point at the origin; a plane's normal and a capsule's axis are z
there, as in the poses that a simulation gives.
"""

from __future__ import annotations

import math

import numpy as np

from sim.placement import upright
from sim.scene import Box, Capsule, Obstacle, Plane, Sphere
from sim.shells import Shell

DETAIL = 24
"""How finely round shapes are drawn: rings from the middle to a pole, and half the points of a ring."""

PLANE_SIZE = 1.6
"""Side [m] of the square that stands for an infinite plane."""


def obstacle_mesh(obstacle: Obstacle, shell: Shell | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float32 [m] and triangles (m, 3), wound outward; a `shell` as it is."""
    if shell is not None:
        return shell.vertices.astype(np.float32), shell.triangles
    match obstacle:
        case Sphere(radius=radius):
            return capsule(np.zeros(3), radius)
        case Capsule(start=start, end=end, radius=radius):
            return capsule(np.array([0.0, 0.0, math.dist(start, end) / 2]), radius)
        case Box(size=size):
            return box(np.array(size))
        case Plane():
            return square(np.array([0.0, 0.0, 1.0]), PLANE_SIZE)
    raise TypeError(f"no shape for an obstacle of type {type(obstacle).__name__}")


def standing(obstacle: Obstacle) -> np.ndarray:
    """Rotation matrix from an obstacle's own frame to the world before its path turns it."""
    match obstacle:
        case Capsule(start=start, end=end):
            return frame_along(np.subtract(end, start))
        case Plane(normal=normal):
            return frame_along(np.array(normal, float))
    return upright(obstacle)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Rotation matrix whose third column points along `axis`; any for a zero one."""
    length = np.linalg.norm(axis)
    third = axis / length if length > 0 else np.array([0.0, 0.0, 1.0])
    helper = np.eye(3)[np.argmin(np.abs(third))]
    first = np.cross(helper, third)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(third, first), third])


def capsule(half: np.ndarray, radius: float, detail: int = DETAIL) -> tuple[np.ndarray, np.ndarray]:
    """A capsule from −half to +half; a sphere for half = 0. `detail` is how many rings each end has."""
    around = 2 * detail
    polar = np.linspace(0.0, np.pi, 2 * detail)
    turn = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    height = radius * np.cos(polar) + np.where(polar < np.pi / 2, 1, -1) * np.linalg.norm(half)
    ring = radius * np.sin(polar)
    local = np.stack(
        [np.outer(ring, np.cos(turn)), np.outer(ring, np.sin(turn)), np.outer(height, np.ones(around))],
        axis=-1,
    )
    vertices = local.reshape(-1, 3) @ frame_along(half).T
    a = (np.arange(2 * detail - 1)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(2 * detail - 1)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    triangles = np.concatenate(
        [np.column_stack([a, a + around, b]), np.column_stack([b, a + around, b + around])]
    )
    return vertices.astype(np.float32), triangles


def box(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A box around the origin, with its own corners on each side so that its edges look sharp."""
    vertices, triangles = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = np.zeros(3)
            normal[axis] = sign
            corners, faces = square(normal, 1.0)
            triangles.append(faces + 4 * len(vertices))
            vertices.append((corners + normal / 2) * size)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(triangles)


def square(normal: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """A square at the origin that faces along `normal`."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2
    return (corners @ frame_along(normal).T).astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]])


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """(w, x, y, z) of a rotation matrix."""
    m = np.asarray(rotation, float)
    squares = np.array([1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2]])
    squares = np.append(squares, [1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2]])
    largest = int(np.argmax(squares))  # the divisor that loses least
    rows = (
        (squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]),
        (m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]),
        (m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]),
        (m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]),
    )
    w, x, y, z = (float(v) for v in np.array(rows[largest]) / (2 * np.sqrt(squares[largest])))
    return w, x, y, z
