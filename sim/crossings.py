"""How much crosses in a scene at a time, felt or not: for those who look on, no step asks for it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from sim.contact.intersections import intersections
from sim.contact.obstacles import Obstacles
from sim.mesh import Mesh
from sim.tangles import Surfaces, all_surfaces, crossings


class Crossings:
    """Counts edges of cloth and mesh obstacles that go through triangles of cloth or of the other.

    Layers that have passed through each other completely leave none.

    Args:
        mesh: The cloth.
        obstacles: Of its scene.
    """

    def __init__(self, mesh: Mesh, obstacles: Obstacles) -> None:
        self._mesh, self._obstacles = mesh, obstacles

    @cached_property
    def _surfaces(self) -> Surfaces:
        return all_surfaces(self._mesh, self._obstacles.solid.triangles)

    def count(self, time: float, positions: np.ndarray) -> int:
        """How many there are at `time` [s] with cloth at `positions` (n, 3) [m]."""
        corners = self._obstacles.corners(self._obstacles.poses(time))
        return len(crossings(np.concatenate([positions, corners]), self._surfaces))


def compile_counting() -> None:
    """Compile, or read from the cache, the kernels that the first count needs: two triangles are enough."""
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    intersections(np.concatenate([flat, flat + 0.1]), np.arange(6).reshape(2, 3))
