"""Obstacles: shapes that stand still or move rigidly on keyed paths.

Spheres, capsules and boxes are all points within a radius of a box, which may be as small as a point or as
thin as a line. Their and a plane's signed distance, negative inside, and the direction in which it grows are
exact, in the shape's own frame. They are convex, so the plane through a nearest point leaves the whole
obstacle on one side. Obstacles that are meshes have corners and edges instead of a distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim.compiled import Vec3, dot, inner, row
from sim.effects import felt_obstacles, single_obstacles
from sim.mesh import sides_of
from sim.placement import pose
from sim.scene import Box, Capsule, Obstacle, Plane, Scene, Sphere
from sim.settings import Settings
from sim.shells import Shell

ROUNDED, PLANE, MESH = range(3)


class Shapes(NamedTuple):
    """Shapes in their own frames.

    Attributes:
        kind: (o,) ROUNDED, all within a radius of a box; PLANE, below z = 0; or MESH, not described here, and
            passed over by whoever looks for shapes.
        half: (o, 3) half sides of the box [m], zero for a sphere; along z for a capsule.
        radius: (o,) [m], zero for a box.
    """

    kind: np.ndarray
    half: np.ndarray
    radius: np.ndarray

    def only(self, which: np.ndarray) -> Shapes:
        """The same with those (o,) bool to be met, and none of the others; numbers stay."""
        return self._replace(kind=np.where(which, self.kind, MESH))


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
    """The surfaces of mesh obstacles.

    Attributes:
        vertices: (k, 3) [m].
        triangles: (m, 3).
        edges: (e, 2).
        part: (k,) which obstacle a vertex belongs to.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    part: np.ndarray

    def only(self, which: np.ndarray) -> Solid:
        """The surfaces of those obstacles (o,) bool alone."""
        keep = which[self.part]
        number = np.cumsum(keep) - 1
        triangles, edges = (number[c[keep[c[:, 0]]]] for c in (self.triangles, self.edges))
        return Solid(self.vertices[keep], triangles, edges, self.part[keep])


@dataclass(frozen=True)
class Felt:
    """Which obstacles cloth feels.

    Attributes:
        which: (o,) bool.
        forced: (o,) bool, those of them that are looked at in every step.
        solid: The surfaces of those that are meshes.
    """

    which: np.ndarray
    forced: np.ndarray
    solid: Solid


class Obstacles:
    """The obstacles of a scene as arrays, at any time.

    Args:
        scene: The scene.
        shells: Of its obstacles, in order, None for those that are no meshes (`sim.mesh.Mesh.shells`).

    Attributes:
        parts: Of the scene.
        labels: What each one is called.
        shapes: Of all of them.
        solid: The surfaces of those that are meshes, in their own frames.
        shells: Of those that are meshes, None for others.
        moves: (o,) bool, which of them have a path.
    """

    def __init__(self, scene: Scene, shells: Sequence[Shell | None] = ()) -> None:
        self.parts, self.labels = scene.obstacle, scene.obstacle_labels
        kinds, halves, radii = zip(*map(_describe, self.parts), strict=True) if self.parts else ((), (), ())
        self.shapes = Shapes(
            np.array(kinds, dtype=np.int64), np.array(halves, dtype=float).reshape(-1, 3), np.array(radii)
        )
        self.shells, self.solid = tuple(shells), _joined(shells)
        self.moves = np.array([bool(part.path) for part in self.parts], dtype=bool)
        self._felt: tuple[tuple[str, str], Felt] | None = None

    def felt(self, settings: Settings) -> Felt:
        """Which of them cloth feels with these settings; the same object while they are the same."""
        switches = settings.obstacles, settings.each_obstacle
        if self._felt is None or self._felt[0] != switches:
            single = single_obstacles(settings.each_obstacle)
            each = [single.get(label, settings.obstacles) for label in self.labels]
            which = np.array(felt_obstacles(settings, self.labels), dtype=bool)
            forced = which & np.array([how == "on" for how in each], dtype=bool)
            self._felt = switches, Felt(which, forced, self.solid.only(which))
        return self._felt[1]

    def corners(self, poses: Poses, solid: Solid | None = None) -> np.ndarray:
        """(k, 3) where the vertices of mesh obstacles, all or those of `solid`, are in these poses [m]."""
        solid = self.solid if solid is None else solid
        turned = np.einsum("ijk,ik->ij", poses.rotation[solid.part], solid.vertices)
        return poses.position[solid.part] + turned

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


def _joined(shells: Sequence[Shell | None]) -> Solid:
    """All shells as one surface."""
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
    return Solid(np.concatenate(vertices), corners, sides_of(corners, first), np.concatenate(part))


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
