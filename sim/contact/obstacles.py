"""Obstacles: solid shapes that stand still or move rigidly on keyed paths.

Each shape is given by its exact signed distance in its own frame, negative inside, and the direction in
which it grows. All of them are convex, so the plane through a nearest point leaves the whole obstacle on
one side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sim.compiled import Vec3, dot, inner, norm, scale
from sim.placement import pose
from sim.scene import Box, Obstacle, Plane, Scene, Sphere

SPHERE, PLANE, BOX, CAPSULE, MESH = range(5)


class Shapes(NamedTuple):
    """Shapes in their own frames: kind (o,) and size (o, 3) [m].

    Sizes: a sphere's radius; nothing for a plane, whose normal is z; a box's half sides; a capsule's half
    length along z and its radius.
    """

    kind: np.ndarray
    size: np.ndarray


class Poses(NamedTuple):
    """Where obstacles are: position (o, 3) [m] of the reference point, rotation (o, 3, 3) to the world."""

    position: np.ndarray
    rotation: np.ndarray


class Solid(NamedTuple):
    """The surfaces of mesh obstacles: vertices (k, 3) [m], triangles (m, 3) and edges (e, 2)."""

    vertices: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray


class Obstacles:
    """The obstacles of a scene as arrays, at any time.

    Attributes:
        parts: Of the scene.
        shapes: Of all of them.
        solid: The surfaces of those that are meshes, in their own frames.
    """

    def __init__(self, scene: Scene) -> None:
        self.parts = scene.obstacle
        described = [_describe(part) for part in self.parts]
        self.shapes = Shapes(
            np.array([kind for kind, _ in described], dtype=np.int64),
            np.array([size for _, size in described], dtype=float).reshape(-1, 3),
        )

        self.solid = Solid(
            np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 2), dtype=np.int64)
        )
        self._part = np.zeros(0, dtype=np.int64)

    def corners(self, poses: Poses) -> np.ndarray:
        """(k, 3) where the vertices of mesh obstacles are in these poses [m]."""
        turned = np.einsum("ijk,ik->ij", poses.rotation[self._part], self.solid.vertices)
        return poses.position[self._part] + turned

    def poses(self, time: float) -> Poses:
        """Where every obstacle is at `time` [s]."""
        position, rotation = np.zeros((len(self.parts), 3)), np.zeros((len(self.parts), 3, 3))
        for o, part in enumerate(self.parts):
            position[o], rotation[o] = pose(part, time)
        return Poses(position, rotation)


def _describe(part: Obstacle) -> tuple[int, tuple[float, float, float]]:
    if isinstance(part, Sphere):
        return SPHERE, (part.radius, 0.0, 0.0)
    if isinstance(part, Plane):
        return PLANE, (0.0, 0.0, 0.0)
    if isinstance(part, Box):
        x, y, z = part.size
        return BOX, (0.5 * x, 0.5 * y, 0.5 * z)
    return CAPSULE, (0.5 * math.dist(part.start, part.end), part.radius, 0.0)


@inner
def signed_distance(kind, size, p):
    """Signed distance [m] of point `p` in the shape's own frame, and the unit direction of its increase."""
    if kind == PLANE:
        return p.z, Vec3(0.0, 0.0, 1.0)
    if kind == BOX:
        return _box_distance(size, p)
    if kind == CAPSULE:
        p = Vec3(p.x, p.y, p.z - min(max(p.z, -size[0]), size[0]))
    radius = size[1] if kind == CAPSULE else size[0]
    length = norm(p)
    if length == 0.0:
        return -radius, Vec3(1.0, 0.0, 0.0)
    return length - radius, scale(1.0 / length, p)


@inner
def _box_distance(size, p):
    d = Vec3(abs(p.x) - size[0], abs(p.y) - size[1], abs(p.z) - size[2])
    side = Vec3(math.copysign(1.0, p.x), math.copysign(1.0, p.y), math.copysign(1.0, p.z))
    out = Vec3(max(d.x, 0.0), max(d.y, 0.0), max(d.z, 0.0))
    length = math.sqrt(dot(out, out))
    if length > 0.0:
        return length, Vec3(side.x * out.x / length, side.y * out.y / length, side.z * out.z / length)
    if d.x >= d.y and d.x >= d.z:
        return d.x, Vec3(side.x, 0.0, 0.0)
    if d.y >= d.z:
        return d.y, Vec3(0.0, side.y, 0.0)
    return d.z, Vec3(0.0, 0.0, side.z)
