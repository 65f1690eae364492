"""From the mesh and the settings to the elements of each spring kind in force.

Rest values need no formula per kind: each coordinate is measured on the element's rest shape, and a bending
coordinate on its rest hinge folded to θ0. Nor does stiffness: a bending kind gets K = c w / (dq/dθ)², so that
all kinds resist a small fold alike; dq/dθ is its own gradient along the motion that folds the hinge.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from sim.elements import Elements, make_elements
from sim.mesh import Mesh
from sim.settings import Settings
from sim.springs import BENDING, STRETCH, SpringKind

FLATTEST = 1e-3
"""A hinge with a rest triangle lower than this part of its edge has no usable angle and is left out."""


@dataclass(frozen=True)
class Springs:
    """One spring kind on one mesh. `unit_stiffness` is K per unit of the setting that scales it."""

    name: str
    kind: SpringKind
    module: ModuleType
    elements: Elements
    stencil: np.ndarray
    rest_positions: np.ndarray
    unit_stiffness: np.ndarray

    def measure(self, positions: np.ndarray) -> None:
        """Evaluate q and its gradient at `positions` (n, 3) [m]."""
        e = self.elements
        self.module.coordinate(positions, e.nodes, e.memory, e.q, e.gradient, e.new_memory)

    def apply(self, settings: Settings) -> None:
        """Set stiffness and rest values for `settings`."""
        self.elements.stiffness[:] = getattr(settings, self.kind.stiffness) * self.unit_stiffness
        if self.kind.stencil == "hinges":
            folded, _ = fold(self.rest_positions, settings.rest_angle)
            self.elements.rest[:] = measure_each(self.kind, folded)[0]


def kinds_in_force(settings: Settings) -> dict[str, SpringKind]:
    """The kinds that `settings` calls for, by name."""
    bending = {settings.bend: BENDING[settings.bend]} if settings.bend in BENDING else {}
    return {**STRETCH, **bending}


def build_springs(name: str, kind: SpringKind, mesh: Mesh) -> Springs:
    """The elements of `kind` on `mesh`, at their rest values for no fold."""
    stencil = getattr(mesh, kind.stencil)
    if kind.stencil == "hinges":
        stencil = stencil[_usable(mesh.rest_vertices[stencil])]
    rest_positions = mesh.rest_vertices[stencil]
    elements = make_elements(stencil[:, list(kind.vertices)], kind.memory)
    if kind.stencil == "hinges":
        flat, _ = fold(rest_positions, 0.0)
        elements.rest[:] = measure_each(kind, flat)[0]
        unit = _bending_unit(kind, rest_positions)
    else:
        elements.rest[:] = measure_each(kind, rest_positions)[0]
        unit = 1.0 / _positive(elements.rest)
    return Springs(name, kind, kind.load(), elements, stencil, rest_positions, unit)


def measure_each(kind: SpringKind, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q (e,) and its gradient (e, k, 3) on separate elements given by `positions` (e, stencil, 3)."""
    chosen = np.ascontiguousarray(positions[:, list(kind.vertices)])
    e, k, _ = chosen.shape
    own = make_elements(np.arange(e * k).reshape(e, k), kind.memory)
    kind.load().coordinate(chosen.reshape(-1, 3), own.nodes, own.memory, own.q, own.gradient, own.new_memory)
    return own.q, own.gradient


def fold(hinges: np.ndarray, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """Rest hinges (e, 4, 3) folded to the angle `theta` [rad], and ∂x/∂θ, each (e, 4, 3).

    Both triangles keep their shape and each turns by half of θ about the shared edge.
    """
    length, foot3, height3, foot4, height4 = hinge_shape(hinges)
    shape, motion = np.zeros(hinges.shape), np.zeros(hinges.shape)
    shape[:, 1, 0] = length
    c, s = np.cos(theta / 2.0), np.sin(theta / 2.0)
    for vertex, foot, height, side in ((2, foot3, height3, 1.0), (3, foot4, height4, -1.0)):
        shape[:, vertex] = np.stack([foot, side * height * c, height * s], axis=1)
        motion[:, vertex] = 0.5 * np.stack([0.0 * foot, -side * height * s, height * c], axis=1)
    return shape, motion


def hinge_shape(hinges: np.ndarray) -> tuple[np.ndarray, ...]:
    """Edge length, then foot and height of x3 and of x4 over the shared edge, each (e,) [m]."""
    edge = hinges[:, 1] - hinges[:, 0]
    length = np.linalg.norm(edge, axis=1)
    along = edge / np.maximum(length, 1e-300)[:, None]
    parts = [length]
    for vertex in (2, 3):
        to = hinges[:, vertex] - hinges[:, 0]
        foot = np.einsum("ij,ij->i", to, along)
        parts += [foot, np.linalg.norm(to - foot[:, None] * along, axis=1)]
    return tuple(parts)


def _positive(lengths: np.ndarray) -> np.ndarray:
    """`lengths` with those of coincident vertices replaced by the mean of the others [m]."""
    real = lengths > 1e-9
    return np.where(real, lengths, lengths[real].mean() if real.any() else 1.0)


def _usable(hinges: np.ndarray) -> np.ndarray:
    length, _, height3, _, height4 = hinge_shape(hinges)
    return (np.minimum(height3, height4) > FLATTEST * length) & (length > 0.0)


def _bending_unit(kind: SpringKind, hinges: np.ndarray) -> np.ndarray:
    length, _, height3, _, height4 = hinge_shape(hinges)
    folded, motion = fold(hinges, kind.match_fold)
    _, gradient = measure_each(kind, folded)
    rate = np.einsum("eki,eki->e", gradient, motion[:, list(kind.vertices)])
    return length / (height3 + height4) / rate**2
