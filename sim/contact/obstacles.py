"""Obstacles: shapes that stand still or move rigidly on keyed paths.

Spheres, capsules and boxes are all points within a radius of a box, which may be as small as a point or as
thin as a line. Their and a plane's signed distance, negative inside, and the direction in which it grows are
exact, in the shape's own frame. They are convex, so the plane through a nearest point leaves the whole
obstacle on one side. Obstacles that are meshes have corners and edges instead of a distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sim.compiled import Vec3, dot, inner, row
from sim.mesh import distinct_edges
from sim.placement import pose
from sim.scene import Box, Capsule, Obstacle, Plane, Scene, Sphere
from sim.shells import Shell

ROUNDED, PLANE, MESH = range(3)


class Shapes(NamedTuple):
    """Shapes in their own frames.

    Attributes:
        kind: (o,) ROUNDED, all within a radius of a box; PLANE, below z = 0; or MESH, not described here.
        half: (o, 3) half sides of the box [m], zero for a sphere; along z for a capsule.
        radius: (o,) [m], zero for a box.
    """

    kind: np.ndarray
    half: np.ndarray
    radius: np.ndarray


class Shape(NamedTuple):
    """One of them, for a kernel."""

    kind: int
    half: Vec3
    radius: float


class Poses(NamedTuple):
    """Where obstacles are: position (o, 3) [m] of the reference point, rotation (o, 3, 3) to the world."""

    position: np.ndarray
    rotation: np.ndarray


class Solid(NamedTuple):
    """The surfaces of mesh obstacles: vertices (k, 3) [m], triangles (m, 3) and edges (e, 2)."""

    vertices: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray


NO_SOLID = Solid(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 2), dtype=np.int64))
"""No surface at all."""


class Obstacles:
    """The obstacles of a scene as arrays, at any time.

    Args:
        scene: The scene.
        shells: Of its obstacles, in order, None for those that are no meshes (`sim.mesh.Mesh.shells`).

    Attributes:
        parts: Of the scene.
        shapes: Of all of them.
        solid: The surfaces of those that are meshes, in their own frames.
    """

    def __init__(self, scene: Scene, shells: Sequence[Shell | None] = ()) -> None:
        self.parts = scene.obstacle
        kinds, halves, radii = zip(*map(_describe, self.parts), strict=True) if self.parts else ((), (), ())
        self.shapes = Shapes(
            np.array(kinds, dtype=np.int64), np.array(halves, dtype=float).reshape(-1, 3), np.array(radii)
        )
        self.solid, self._part = _joined(shells)

    def corners(self, poses: Poses, solid: Solid | None = None) -> np.ndarray:
        """(k, 3) where the vertices of mesh obstacles, all or those of `solid`, are in these poses [m]."""
        if solid is NO_SOLID:
            return NO_SOLID.vertices
        turned = np.einsum("ijk,ik->ij", poses.rotation[self._part], self.solid.vertices)
        return poses.position[self._part] + turned

    def poses(self, time: float) -> Poses:
        """Where every obstacle is at `time` [s]."""
        position, rotation = np.zeros((len(self.parts), 3)), np.zeros((len(self.parts), 3, 3))
        for o, part in enumerate(self.parts):
            position[o], rotation[o] = pose(part, time)
        return Poses(position, rotation)


def _describe(part: Obstacle) -> tuple[int, tuple[float, float, float], float]:
    if isinstance(part, Sphere):
        return ROUNDED, (0.0, 0.0, 0.0), part.radius
    if isinstance(part, Capsule):
        return ROUNDED, (0.0, 0.0, 0.5 * math.dist(part.start, part.end)), part.radius
    if isinstance(part, Box):
        x, y, z = part.size
        return ROUNDED, (0.5 * x, 0.5 * y, 0.5 * z), 0.0
    return PLANE if isinstance(part, Plane) else MESH, (0.0, 0.0, 0.0), 0.0


def _joined(shells: Sequence[Shell | None]) -> tuple[Solid, np.ndarray]:
    """All shells as one surface, and (k,) which obstacle each of its vertices belongs to."""
    vertices, triangles = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    part = [np.zeros(0, dtype=np.int64)]
    first = 0
    for o, shell in enumerate(shells):
        if shell is not None:
            vertices.append(shell.vertices)
            triangles.append(shell.triangles + first)
            part.append(np.full(len(shell.vertices), o))
            first += len(shell.vertices)
    corners = np.concatenate(triangles)
    edges = distinct_edges(corners, np.zeros((0, 2), dtype=np.int64), first).astype(np.int64)
    return Solid(np.concatenate(vertices), corners, edges), np.concatenate(part)


@inner
def shape_of(shapes, o):
    """Shape o."""
    return Shape(shapes.kind[o], row(shapes.half, o), shapes.radius[o])


@inner
def signed_distance(shape, p):
    """Signed distance [m] of point `p` in the shape's own frame, and the unit direction of its increase."""
    if shape.kind == PLANE:
        return p.z, Vec3(0.0, 0.0, 1.0)
    half, radius = shape.half, shape.radius
    d = Vec3(abs(p.x) - half.x, abs(p.y) - half.y, abs(p.z) - half.z)
    side = Vec3(math.copysign(1.0, p.x), math.copysign(1.0, p.y), math.copysign(1.0, p.z))
    out = Vec3(max(d.x, 0.0), max(d.y, 0.0), max(d.z, 0.0))
    length = math.sqrt(dot(out, out))
    if length > 0.0:
        n = Vec3(side.x * out.x / length, side.y * out.y / length, side.z * out.z / length)
        return length - radius, n
    if d.x >= d.y and d.x >= d.z:
        return d.x - radius, Vec3(side.x, 0.0, 0.0)
    if d.y >= d.z:
        return d.y - radius, Vec3(0.0, side.y, 0.0)
    return d.z - radius, Vec3(0.0, 0.0, side.z)
