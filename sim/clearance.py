"""What touches what before the first step: cloth and obstacles, and obstacles among themselves, by fcl.

The flexible collision library measures solid spheres, boxes and capsules against triangles exactly, and knows
nothing of our own contact code, which makes it a second opinion. It is used here, once per load, and nowhere
in a step. A plane's distance is taken in closed form: fcl's distance query crashes the process when given a
half-space, though its collision query handles one well. Not measured: cloth against cloth, and cloth without
triangles.
"""

from __future__ import annotations

import itertools
import math

import fcl
import numpy as np

from sim.mesh import Mesh
from sim.placement import pose
from sim.scene import Box, Obstacle, Plane, Scene, Sphere

TOUCH = 1e-6
"""Obstacles that reach into each other by less than this [m] merely stand on one another."""

MEETS = 1e-9
"""Distances below this [m] mean that the bodies meet: there fcl gives some number near or below zero."""


def clearance_warnings(mesh: Mesh, scene: Scene) -> list[str]:
    """A line for each piece of cloth inside or too near an obstacle, and each pair of obstacles that overlap.

    Args:
        mesh: The cloth of the scene where it starts.
        scene: The scene; obstacles are taken where they are at time 0.
    """
    names = [_name(i, obstacle) for i, obstacle in enumerate(scene.obstacle)]
    solids = [_solid(obstacle) for obstacle in scene.obstacle]
    warnings: list[str] = []
    for piece in range(len(scene.cloth)):
        corners = mesh.triangles[mesh.pieces[mesh.triangles[:, 0]] == piece]
        if len(corners):
            shell = _shell(mesh.vertices, corners)
            for name, obstacle, solid in zip(names, scene.obstacle, solids, strict=True):
                gap = _gap(shell, mesh.vertices[corners.ravel()], obstacle, solid)
                warnings += _too_near(f"cloth[{piece}]", name, gap, scene.settings.thickness)
    for i, j in itertools.combinations(range(len(solids)), 2):
        if depth(solids[i], solids[j]) > TOUCH:
            warnings.append(f"{names[i]} and {names[j]} overlap")
    return warnings


def depth(one: fcl.CollisionObject, other: fcl.CollisionObject) -> float:
    """How far two solids reach into each other [m], at most; zero where they do not."""
    result = fcl.CollisionResult()
    fcl.collide(one, other, fcl.CollisionRequest(num_max_contacts=16, enable_contact=True), result)
    return max((contact.penetration_depth for contact in result.contacts), default=0.0)


def _gap(
    shell: fcl.CollisionObject, points: np.ndarray, obstacle: Obstacle, solid: fcl.CollisionObject
) -> float:
    """Least distance [m] of the shell from the solid, zero or less where they meet."""
    if isinstance(obstacle, Plane):
        normal, point = _plane_now(obstacle)
        return float(((points - point) @ normal).min())
    return float(fcl.distance(shell, solid, fcl.DistanceRequest(), fcl.DistanceResult()))


def _too_near(cloth: str, obstacle: str, gap: float, thickness: float) -> list[str]:
    if gap < MEETS:
        return [f"{cloth} starts inside {obstacle}"]
    if gap < thickness:
        return [f"{cloth} starts {gap:.2g} m from {obstacle}, nearer than the thickness of {thickness:g} m"]
    return []


def _name(i: int, obstacle: Obstacle) -> str:
    kind = type(obstacle).__name__.lower()
    return f'obstacle[{i}] ({kind} "{obstacle.name}")' if obstacle.name else f"obstacle[{i}] ({kind})"


def _shell(vertices: np.ndarray, triangles: np.ndarray) -> fcl.CollisionObject:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(triangles))
    model.addSubModel(vertices, triangles)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())


def _solid(obstacle: Obstacle) -> fcl.CollisionObject:
    """The obstacle as fcl knows it, where it is at time 0."""
    if isinstance(obstacle, Plane):
        normal, point = _plane_now(obstacle)
        return fcl.CollisionObject(fcl.Halfspace(normal, float(normal @ point)), fcl.Transform())
    position, rotation = pose(obstacle, 0.0)
    if isinstance(obstacle, Sphere):
        shape = fcl.Sphere(obstacle.radius)
    elif isinstance(obstacle, Box):
        shape = fcl.Box(*obstacle.size)
    else:
        shape = fcl.Capsule(obstacle.radius, math.dist(obstacle.start, obstacle.end))
    return fcl.CollisionObject(shape, fcl.Transform(rotation, position))


def _plane_now(plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Unit normal and a point of the plane at time 0."""
    point, rotation = pose(plane, 0.0)
    return rotation[:, 2].copy(), point
