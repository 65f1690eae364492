"""What touches what before the first step: cloth and obstacles, and obstacles among themselves, by fcl.

The flexible collision library measures solid spheres, boxes and capsules against triangles exactly, and knows
nothing of our own contact code, which makes it a second opinion. It is used here, once per load, and nowhere
in a step. A plane's distance is taken in closed form: fcl's distance query crashes the process when given a
half-space, though its collision query handles one well. A mesh is a shell to fcl; whether a closed one goes
round something that it does not meet is asked of the shell itself. Cloth and cloth are asked whether they
cross, not how near they are; cloth without triangles is not looked at.
"""

from __future__ import annotations

import itertools
import math
import statistics

import fcl
import numpy as np

from sim.effects import felt_obstacles
from sim.mesh import Mesh
from sim.placement import pose
from sim.scene import Box, Capsule, Obstacle, Plane, Scene, SceneError, Sphere
from sim.shells import Shell
from sim.tangles import CROSSES, Surfaces, in_words, refusal, refuses, surfaces_of

TOUCH = 1e-6
"""Obstacles that reach into each other by less than this [m] merely stand on one another."""

MEETS = 1e-9
"""Distances below this [m] mean that the bodies meet: there fcl gives some number near or below zero."""


MOST_TRIANGLES = 50_000
"""Of more it is not asked what crosses what: that takes a list of some fifteen pairs for each."""


def crossing_warnings(mesh: Mesh, scene: Scene) -> list[str]:
    """A line where triangles cross at the start that share no vertex: of cloth, or of it and a mesh obstacle.

    Raises:
        SceneError: where a simulation would refuse to start.
    """
    felt = felt_obstacles(scene.settings, scene.obstacle_labels)
    parts = zip(scene.obstacle, mesh.shells, felt, strict=True)
    shells = [_Body(i, part, shell) for i, (part, shell, felt) in enumerate(parts) if shell and felt]
    first = np.cumsum([0] + [len(body.shell.vertices) for body in shells if body.shell])
    solid = [body.shell.triangles + k for body, k in zip(shells, first, strict=False) if body.shell]
    surfaces = surfaces_of(mesh, scene.settings, np.concatenate([np.zeros((0, 3), dtype=np.int64), *solid]))
    if surfaces is None:
        return []
    if len(surfaces.triangles) > MOST_TRIANGLES:
        return [f"more than {MOST_TRIANGLES:,} triangles: not looked at whether cloth crosses itself"]
    points = np.concatenate([mesh.vertices, *(body.somewhere() for body in shells)])
    pairs = crossing_pairs(points, surfaces)
    if not len(pairs):
        return []
    if refuses(scene.settings):
        raise SceneError(f"{scene.source}: {refusal(pairs, len(mesh.triangles))}")
    undone = "is to be untangled" if scene.settings.tangled == "untangle" else "no contact undoes"
    return [f"{CROSSES}, which {undone}: {in_words(pairs, len(mesh.triangles))}"]


def crossing_pairs(points: np.ndarray, surfaces: Surfaces) -> np.ndarray:
    """(p, 2) pairs of triangles that may not cross, share no vertex, and do cross at `points` (n, 3) [m]."""
    corners = surfaces.triangles
    shape, request = _triangles(points, corners), fcl.CollisionRequest(num_max_contacts=2**31 - 1)
    one, other = (fcl.CollisionObject(shape, fcl.Transform()) for _ in range(2))
    found = fcl.CollisionResult()
    fcl.collide(one, other, request, found)
    pairs = np.array([(c.b1, c.b2) for c in found.contacts if c.b1 < c.b2], dtype=np.int64).reshape(-1, 2)
    joined = (corners[pairs[:, 0], :, None] == corners[pairs[:, 1], None]).any(axis=(1, 2))
    wrong = surfaces.counts(*corners[pairs][:, :, 0].T)
    return np.unique(pairs[~joined & wrong], axis=0)


def clearance_warnings(mesh: Mesh, scene: Scene) -> list[str]:
    """A line for each piece of cloth inside or too near an obstacle, and each pair of obstacles that overlap.

    Args:
        mesh: The cloth of the scene where it starts.
        scene: The scene; obstacles are taken where they are at time 0.
    """
    bodies = [_Body(i, *pair) for i, pair in enumerate(zip(scene.obstacle, mesh.shells, strict=True))]
    warnings: list[str] = []
    for piece in range(len(scene.cloth)):
        corners = mesh.triangles[mesh.pieces[mesh.triangles[:, 0]] == piece]
        if len(corners):
            cloth = fcl.CollisionObject(_triangles(mesh.vertices, corners), fcl.Transform())
            for body in bodies:
                gap = _gap(cloth, mesh.vertices[corners.ravel()], body)
                warnings += _too_near(f"cloth[{piece}]", body.name, gap, scene.settings.thickness)
    for one, other in itertools.combinations(bodies, 2):
        if _overlap(one, other):
            warnings.append(f"{one.name} and {other.name} overlap")
    return warnings


class _Body:
    """An obstacle as fcl knows it, where it is at time 0."""

    def __init__(self, i: int, part: Obstacle, shell: Shell | None) -> None:
        kind = type(part).__name__.lower() if shell is None else "mesh"
        self.name = f'obstacle[{i}] ({kind} "{part.name}")' if part.name else f"obstacle[{i}] ({kind})"
        self.part, self.shell = part, shell
        self.position, self.rotation = pose(part, 0.0)
        self.normal = self.rotation[:, 2].copy()
        self.solid = self._solid()

    def _solid(self) -> fcl.CollisionObject:
        if isinstance(self.part, Plane):
            half_space = fcl.Halfspace(self.normal, float(self.normal @ self.position))
            return fcl.CollisionObject(half_space, fcl.Transform())
        if isinstance(self.part, Sphere):
            shape = fcl.Sphere(self.part.radius)
        elif isinstance(self.part, Box):
            shape = fcl.Box(*self.part.size)
        elif isinstance(self.part, Capsule):
            shape = fcl.Capsule(self.part.radius, math.dist(self.part.start, self.part.end))
        else:
            assert self.shell is not None
            shape = _triangles(self.shell.vertices, self.shell.triangles)
        return fcl.CollisionObject(shape, fcl.Transform(self.rotation, self.position))

    def heights(self, points: np.ndarray) -> np.ndarray:
        """(n,) heights of points (n, 3) above a plane [m]."""
        return (points - self.position) @ self.normal

    def encloses(self, point: np.ndarray) -> bool:
        """Whether this is a closed shell round a point (3,) of the world."""
        if self.shell is None or self.shell.open_edges:
            return False
        return self.shell.encloses((point - self.position) @ self.rotation)

    def somewhere(self) -> np.ndarray:
        """(k, 3) points of the world that the obstacle holds: all corners of a shell, or its middle [m]."""
        if self.shell is None:
            return self.position[None]
        return self.shell.vertices @ self.rotation.T + self.position


def _overlap(one: _Body, other: _Body) -> bool:
    """Whether two obstacles reach into each other, or one is inside the other."""
    for plane, body in ((one, other), (other, one)):
        if isinstance(plane.part, Plane) and body.shell is not None:
            return bool(plane.heights(body.somewhere()).min() < -TOUCH)
    if depth(one.solid, other.solid, shells=one.shell is not None and other.shell is not None) > TOUCH:
        return True
    return any(a.encloses(b.somewhere()[0]) for a, b in ((one, other), (other, one)))


def depth(one: fcl.CollisionObject, other: fcl.CollisionObject, shells: bool = False) -> float:
    """How far two solids reach into each other [m], at most; zero where they do not.

    Of two shells it is what most of the pairs of triangles say that meet: fcl gives the length of a side for
    some that lie in one plane. Of a sphere and a shell it gives depths with the other sign.
    """
    result = fcl.CollisionResult()
    fcl.collide(one, other, fcl.CollisionRequest(num_max_contacts=16, enable_contact=True), result)
    depths = [abs(contact.penetration_depth) for contact in result.contacts] or [0.0]
    return statistics.median(depths) if shells else max(depths)


def _gap(cloth: fcl.CollisionObject, points: np.ndarray, body: _Body) -> float:
    """Least distance [m] of cloth from the obstacle, zero or less where they meet."""
    if isinstance(body.part, Plane):
        return float(body.heights(points).min())
    if body.encloses(points[0]):
        return 0.0
    return float(fcl.distance(cloth, body.solid, fcl.DistanceRequest(), fcl.DistanceResult()))


def _too_near(cloth: str, obstacle: str, gap: float, thickness: float) -> list[str]:
    if gap < MEETS:
        return [f"{cloth} starts inside {obstacle}"]
    if gap < thickness:
        return [f"{cloth} starts {gap:.2g} m from {obstacle}, nearer than the thickness of {thickness:g} m"]
    return []


def _triangles(vertices: np.ndarray, triangles: np.ndarray) -> fcl.BVHModel:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(triangles))
    model.addSubModel(vertices, triangles)
    model.endModel()
    return model
