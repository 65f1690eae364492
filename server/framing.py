"""Where the variants stand, and where a camera sees them all."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from sim.mesh import Mesh
from sim.scene import Box, Capsule, Plane, Scene, Sphere

GAP = 0.04
"""Room between neighbours, as a share of the scene's own width."""

SLENDER = 0.5
"""Least width of a variant's place, as a share of its height: a strip needs room to curl, its label too."""

DIRECTION = (0.25, -1.0, 0.42)
"""From what is looked at to the camera, where the scene's author says nothing."""

ASPECT, FIELD_OF_VIEW = 0.94, 0.6
"""Width over height of the view between the docks on a 1280 × 720 screen, a guess for clients that
have not said theirs; and its vertical angle [rad], narrow enough that the outer cloths are not distorted."""


class Framing:
    """The layout of a scene's variants.

    Attributes:
        offsets: (variants, 3) where each variant's origin is put [m].
        floor: Height [m] of the ground.
        label_place: (3,) middle of the coloured bar that a variant's label stands on [m].
        bar: (3,) that bar, from end to end [m].
    """

    def __init__(self, scene: Scene, mesh: Mesh, count: int):
        points = np.concatenate([mesh.vertices, hanging(mesh), *map(obstacle_corners, scene.obstacle)])
        self._low, self._high = points.min(axis=0), points.max(axis=0)
        self._toward = self._view_direction(scene)
        self._right = np.cross([0.0, 0.0, 1.0], self._toward)
        self._right /= np.linalg.norm(self._right)
        across = points @ self._right
        height = self._high[2] - self._low[2]
        self._width = max(float(np.ptp(across)), SLENDER * height)
        steps = (np.arange(count) - (count - 1) / 2) * self._width * (1 + GAP)
        self.offsets = np.outer(steps, self._right)
        self._target = (self._low + self._high) / 2
        self.label_place = np.array([*middle(mesh)[:2], self._high[2] + 0.17 * max(height, self._width)])
        self.bar = 0.45 * self._width * self._right
        self.floor = self._floor(scene, max(height, self._width))

    def _view_direction(self, scene: Scene) -> np.ndarray:
        camera = scene.camera
        toward = np.subtract(camera.position, camera.look_at) if camera else np.array(DIRECTION)
        if np.hypot(*toward[:2]) < 0.05 * np.linalg.norm(toward):
            toward = toward + np.array([0.0, -0.05, 0.0]) * np.linalg.norm(
                toward
            )  # from above: pick a "right"
        return toward / np.linalg.norm(toward)

    def _floor(self, scene: Scene, size: float) -> float:
        floors = [o.point[2] for o in scene.obstacle if is_floor(o)]
        return max(floors) if floors else float(self._low[2]) - 0.2 * size

    def camera(self, aspect: float = ASPECT, fov: float = FIELD_OF_VIEW) -> tuple[np.ndarray, np.ndarray]:
        """Position and target [m] of a camera with this width over height and vertical angle [rad].

        The view holds all variants with their labels; what is beside the docks is not part of it.
        """
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        top = np.array([0.0, 0.0, self.label_place[2] + 0.15 * self._width - self._high[2]])
        points = self._low + corners * (self._high + top - self._low)
        sides = self._target + np.outer([-0.5, 0.5], self._width * self._right)
        points = np.concatenate([points, sides])
        points = (points[None] + self.offsets[:, None]).reshape(-1, 3) - self._target
        up = np.cross(self._toward, self._right)
        depth, across, above = points @ self._toward, points @ self._right, points @ up
        tangent = np.tan(fov / 2)
        distance = np.max(
            depth + 1.03 * np.maximum(np.abs(across) / (tangent * aspect), np.abs(above) / tangent)
        )
        return self._target + self._toward * distance, self._target


def middle(mesh: Mesh) -> np.ndarray:
    """(3,) middle [m] of where the cloth can be: half-way from its start to hanging straight down."""
    start, below = mesh.vertices.mean(axis=0), hanging(mesh)
    return (start + below.mean(axis=0)) / 2 if len(below) else start


def hanging(mesh: Mesh) -> np.ndarray:
    """(k, 3) points [m] below the pins, as deep as the cloth can hang from them; none without pins."""
    pins = mesh.vertices[mesh.pinned]
    if not len(pins):
        return pins
    nearest = np.full(len(mesh.vertices), np.inf)
    for pin in pins:
        nearest = np.minimum(nearest, np.linalg.norm(mesh.vertices - pin, axis=1))
    return pins - [0.0, 0.0, float(nearest.max())]


def obstacle_corners(obstacle: Sphere | Plane | Box | Capsule) -> np.ndarray:
    """(k, 3) points [m] that bound what an obstacle fills, along its path; none for a plane."""
    reference = np.array(obstacle.reference)
    match obstacle:
        case Sphere(radius=radius):
            half = np.full(3, radius)
        case Box(size=size):
            half = np.array(size) / 2
        case Capsule(start=start, end=end, radius=radius):
            half = np.abs(np.subtract(end, start)) / 2 + radius
        case _:
            return np.empty((0, 3))
    places = [reference, *(np.array(key.position) for key in obstacle.path if key.position is not None)]
    return np.concatenate([[place - half, place + half] for place in places])


def is_floor(obstacle: Sphere | Plane | Box | Capsule) -> TypeGuard[Plane]:
    """Whether an obstacle is a plane that the drawn ground can stand for."""
    upright = isinstance(obstacle, Plane) and obstacle.normal[2] > 0.999 * np.linalg.norm(obstacle.normal)
    return bool(upright and not obstacle.path)
