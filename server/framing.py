"""Where the variants stand, and where a camera sees them all."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from sim.mesh import Mesh, vertex_masses
from sim.placement import pose
from sim.scene import Box, Capsule, Obstacle, Plane, Scene, Sphere
from sim.shells import Shell

GAP = 0.04
"""Room between neighbours, as a share of the scene's own width."""

SLENDER = 0.5
"""Least width of a variant's place, as a share of its size: a strip needs room to curl, its label too."""

LABEL_ROOM, LABEL_CLEAR = 0.17, 0.06
"""Of labels, as shares of the size: height above everything, and above what a camera sees of the cloth."""

LABEL_PART = 0.12
"""Of a view's height, that a label with a few lines takes."""

MARGIN = 1.03
"""Times that the view is larger than what it must hold."""

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
"""(8, 3) of a box of size 1 at the origin."""

BETWEEN = 4
"""Moments at which a moving obstacle is looked at, for each key of its path."""

NO_SIZE = 1.0
"""Size [m] that a single point is framed with."""

DIRECTION = (0.25, -1.0, 0.42)
"""From what is looked at to the camera, where the scene's author says nothing."""

ASPECT, FIELD_OF_VIEW = 0.94, 0.6
"""Width over height of the view between the docks on a 1280 × 720 screen, a guess for clients that
have not said theirs; and its vertical angle [rad], narrow enough that the outer cloths are not distorted."""


class Framing:
    """The layout of a scene's variants.

    Attributes:
        offsets: (variants, 3) where each variant's origin is put [m].
        size: Largest extent [m] of a variant, with all obstacles and where its cloth may get to.
        scale: What thickness of strands is to be measured by [m]; larger where the view must hold more.
        floor: Height [m] of the ground.
        label_place: (3,) middle of the coloured bar that a variant's label stands on [m].
        bar: (3,) that bar, from end to end [m].
    """

    def __init__(self, scene: Scene, mesh: Mesh, count: int):
        down = downward(scene)
        way = [mesh.vertices, hanging(mesh, (1.0 + droop(scene, mesh)) * down), swung(mesh, down)]
        points = np.concatenate([*way, *map(obstacle_corners, scene.obstacle, mesh.shells)])
        self.size = float(np.ptp(points, axis=0).max()) or NO_SIZE
        self._low, self._high = points.min(axis=0), points.max(axis=0)
        self._toward = self._view_direction(scene)
        self._right = np.cross([0.0, 0.0, 1.0], self._toward)
        self._right /= np.linalg.norm(self._right)
        self._up = np.cross(self._toward, self._right)
        across = points @ self._right
        height = self._high[2] - self._low[2]
        self._width = max(float(np.ptp(across)), SLENDER * self.size)
        steps = (np.arange(count) - (count - 1) / 2) * self._width * (1 + GAP)
        self.offsets = np.outer(steps, self._right)
        self.scale = max(self.size, count * self._width / 2)
        self._target = (self._low + self._high) / 2
        self.label_place = self._above(middle(mesh, down), np.concatenate(way), max(height, self._width))
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

    def _above(self, middle: np.ndarray, cloth: np.ndarray, size: float) -> np.ndarray:
        """(3,) the point over `middle` that is above all else, and is also seen above the cloth's far end."""
        clear = (cloth @ self._up).max() + LABEL_CLEAR * size - middle[:2] @ self._up[:2]
        return np.array([*middle[:2], max(self._high[2] + LABEL_ROOM * size, clear / self._up[2])])

    def camera(
        self,
        aspect: float = ASPECT,
        fov: float = FIELD_OF_VIEW,
        covered: float = 0.0,
        labels: float = LABEL_PART,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position and target [m] of a camera with this width over height and vertical angle [rad].

        The view holds all variants above the part of its height that is `covered` from below, and over each
        place for a label as much of its height as `labels`; what is beside the docks is not part of it.
        """
        sides = self._target + np.outer([-0.5, 0.5], self._width * self._right)
        points = np.concatenate([self._low + CORNERS * (self._high - self._low), sides, [self.label_place]])
        points = (points + self.offsets[:, None]).reshape(-1, 3) - self._target
        depth, across, above = points @ self._toward, points @ self._right, points @ self._up
        tangent, count = np.tan(fov / 2) / MARGIN, len(self.offsets)
        top = np.tile([*np.ones(len(CORNERS) + 2), 1.0 - 2.0 * labels], count) * tangent
        bottom = (1.0 - 2.0 * covered) * tangent
        # Lifted by the same, one point is below `top` and the other above `bottom` from this distance on:
        apart = (above + top * depth)[:, None] - (above - bottom * depth)
        distance = max(
            (depth + np.abs(across) / (tangent * aspect)).max(), (apart / (top[:, None] + bottom)).max()
        )
        least = (-bottom * (distance - depth) - above).max()
        most = (top * (distance - depth) - above).min()
        target = self._target - (least + most) / 2 * self._up
        return target + self._toward * distance, target


def downward(scene: Scene) -> np.ndarray:
    """(3,) unit vector along which cloth falls; zero without gravity."""
    gravity = np.array(scene.settings.gravity)
    return gravity / (np.linalg.norm(gravity) or 1.0)


def droop(scene: Scene, mesh: Mesh) -> float:
    """By which share of its length a strand that is let go stretches at most, one metre per metre at worst.

    That is twice what it does at rest. Sheets share the weight out among too many edges to stretch visibly.
    """
    if len(mesh.triangles):
        return 0.0
    s = scene.settings
    masses = vertex_masses(mesh, s.mass, s.density)
    masses[mesh.pinned] = 0.0
    weight = np.bincount(mesh.pieces, masses).max() * np.linalg.norm(s.gravity)
    return min(2.0 * float(weight) / max(s.stretch, 1e-9), 1.0)


def middle(mesh: Mesh, down: np.ndarray) -> np.ndarray:
    """(3,) middle [m] of where the cloth can be: half-way from its start to hanging straight down."""
    start = np.concatenate([mesh.vertices, swung(mesh, down)]).mean(axis=0)
    below = hanging(mesh, down)
    return (start + below.mean(axis=0)) / 2 if len(below) else start


def hanging(mesh: Mesh, down: np.ndarray) -> np.ndarray:
    """(k, 3) points [m] below the pins, as deep as the cloth can hang from them; none if it cannot hang.

    `down` is where a metre of it hangs to.
    """
    pins = mesh.vertices[mesh.pinned]
    if not len(pins) or not down.any():
        return np.empty((0, 3))
    nearest = np.full(len(mesh.vertices), np.inf)
    for pin in pins:
        nearest = np.minimum(nearest, np.linalg.norm(mesh.vertices - pin, axis=1))
    return pins + float(nearest.max()) * down


def swung(mesh: Mesh, down: np.ndarray) -> np.ndarray:
    """(k, 3) points [m] that cloth with a single pin swings to: its start on the other side of the pin."""
    pinned_pieces, counts = np.unique(mesh.pieces[mesh.pinned], return_counts=True)
    points = [np.empty((0, 3))]
    for piece in pinned_pieces[counts == 1] if down.any() else ():
        (pin,) = mesh.vertices[mesh.pinned[mesh.pieces[mesh.pinned] == piece]]
        arm = mesh.vertices[mesh.pieces == piece] - pin
        points.append(pin + 2 * np.outer(arm @ down, down) - arm)
    return np.concatenate(points)


def obstacle_corners(obstacle: Obstacle, shell: Shell | None = None) -> np.ndarray:
    """(k, 3) points [m] that bound what an obstacle fills, along its path; none for a plane."""
    own, radius = _own_points(obstacle) if shell is None else (shell.vertices, 0.0)
    if not len(own):
        return np.empty((0, 3))
    corners = []
    for position, rotation in (pose(obstacle, time) for time in _moments(obstacle)):
        points = position + own @ rotation.T
        corners += [points.min(axis=0) - radius, points.max(axis=0) + radius]
    return np.array(corners)


def _own_points(obstacle: Obstacle) -> tuple[np.ndarray, float]:
    """(k, 3) points [m] in an obstacle's own frame, and the radius [m] of what is about them."""
    match obstacle:
        case Sphere(radius=radius):
            return np.zeros((1, 3)), radius
        case Box(size=size):
            return (CORNERS - 0.5) * size, 0.0
        case Capsule(start=start, end=end, radius=radius):
            half = float(np.linalg.norm(np.subtract(end, start))) / 2
            return np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]), radius
        case _:
            return np.empty((0, 3)), 0.0


def _moments(obstacle: Obstacle) -> np.ndarray:
    """Times [s] at which to look at an obstacle: those of its keys, and some between, where it may turn."""
    keys = [key.time for key in obstacle.path]
    if not keys:
        return np.zeros(1)
    return np.interp(np.arange(BETWEEN * len(keys)) / BETWEEN, range(len(keys)), keys)


def is_floor(obstacle: Obstacle) -> TypeGuard[Plane]:
    """Whether an obstacle is a plane that the drawn ground can stand for."""
    upright = isinstance(obstacle, Plane) and obstacle.normal[2] > 0.999 * np.linalg.norm(obstacle.normal)
    return bool(upright and not obstacle.path)
