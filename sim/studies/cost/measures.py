"""What is measured of cloth: distances between two runs, and observables that need no second run.

Distances are relative, and weighted by mass: e_x = √(Σ mᵢ |xᵢ − yᵢ|² / Σ mᵢ) / L, with L the diagonal of the
cloth at rest. Observables are numbers that a person would read off: they still mean something where two runs
have fallen into different folds, and between meshes of different resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.simulation import Simulation
from sim.springs.angle import coordinate

UNITS = {
    "sag": "m",
    "drape radius": "m",
    "hinge angle": "rad",
    "area": "m²",
    "projected area": "m²",
    "volume": "m³",
}
"""Of the observables; those that a scene cannot have are left out."""


@dataclass(frozen=True)
class Look:
    """Numbers of one instant: energy [J] by kind, the largest strain of an edge, observables by name."""

    energy: dict[str, float]
    strain: float
    observables: dict[str, float]


def size(world: Simulation) -> float:
    """L: the diagonal of the largest piece of cloth at rest [m]."""
    rest, pieces = world.mesh.rest_vertices, world.pieces
    spans = [np.ptp(rest[pieces == p], axis=0) for p in np.unique(pieces)]
    return max(float(np.linalg.norm(span)) for span in spans)


def distances(one: np.ndarray, other: np.ndarray, masses: np.ndarray, length: float) -> np.ndarray:
    """(k,) relative, mass-weighted distances e_x of positions (k, n, 3) [m].

    Args:
        one: Positions.
        other: Those they are compared with.
        masses: (n,) [kg].
        length: L [m].
    """
    squares = np.einsum("kij,kij->ki", one - other, one - other)
    return np.sqrt(squares @ masses / masses.sum()) / length


class Measures:
    """Takes the observables of a simulation.

    Sag is how far the lowest vertex hangs below the pins, drape radius the root mean square distance of mass
    from the vertical through the centre of mass, hinge angle the root mean square of all fold angles,
    projected area the shadow that triangles cast along gravity, each for itself, and volume that within
    closed cloth.

    Args:
        world: The simulation; `look` is about its present state.
    """

    def __init__(self, world: Simulation) -> None:
        self._world, mesh = world, world.mesh
        gravity = np.asarray(world.settings.gravity)
        strength = float(np.linalg.norm(gravity))
        self._down = gravity / strength if strength else None
        ends = mesh.rest_vertices[mesh.edges]
        self._rest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        sides = 3 * len(mesh.triangles)
        self._closed = sides > 0 and sides == 2 * len(mesh.hinges)
        self._memory = np.zeros((len(mesh.hinges), 1))

    def look(self) -> Look:
        """Measure the present state."""
        return Look(self._world.energy(), self._strain(), self._observables())

    def _strain(self) -> float:
        if not len(self._rest):
            return 0.0
        ends = self._world.positions[self._world.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        return float((lengths / self._rest).max() - 1.0)

    def _observables(self) -> dict[str, float]:
        world, found = self._world, {}
        x, masses, down = world.positions, world.masses, self._down
        if down is not None:
            if len(world.pinned):
                found["sag"] = float((x @ down).max() - (x[world.pinned] @ down).mean())
            off = x - masses @ x / masses.sum()
            aside = off - np.outer(off @ down, down)
            found["drape radius"] = float(
                np.sqrt(masses @ np.einsum("ij,ij->i", aside, aside) / masses.sum())
            )
        if len(world.mesh.hinges):
            found["hinge angle"] = float(np.sqrt(np.mean(self._angles() ** 2)))
        if len(world.triangles):
            corners = x[world.triangles]
            normals = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            found["area"] = float(np.linalg.norm(normals, axis=1).sum())
            if down is not None:
                found["projected area"] = float(np.abs(normals @ down).sum())
            if self._closed:
                found["volume"] = abs(float(np.einsum("ij,ij->", corners.mean(axis=1), normals)) / 3.0)
        return found

    def _angles(self) -> np.ndarray:
        """(h,) fold angles [rad], followed past half a turn from look to look."""
        count = len(self._memory)
        q, gradient, memory = np.empty(count), np.empty((count, 4, 3)), np.empty_like(self._memory)
        coordinate(self._world.positions, self._world.mesh.hinges, self._memory, q, gradient, memory)
        self._memory = memory
        return q
