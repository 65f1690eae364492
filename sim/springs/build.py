"""From the mesh and the settings to the elements of each spring kind in force.

Rest values need no formula per kind: each coordinate is measured on the element's rest shape, and a bending
coordinate on its rest hinge folded to θ0. Nor does stiffness: a bending kind gets K = c w / (dq/dθ)², so that
all kinds resist a small fold alike; dq/dθ is its own gradient along the motion that folds the hinge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from sim.elements import Elements, elastic_energy, make_elements
from sim.mesh import Mesh
from sim.settings import Settings
from sim.springs import BENDING, STRETCH, SpringKind

FLATTEST = 1e-3
"""A hinge with a rest triangle lower than this part of its edge has no usable angle and is left out."""

LEAST_FELT = 1e-2
"""A hinge whose coordinate feels a fold by less than this part of what it feels of its tips is left out."""


@dataclass
class Springs:
    """One spring kind on one mesh.

    Attributes:
        name: Of the kind.
        kind: What there is to know of it.
        elements: Its coordinates.
        stencil: (e, stencil) int32 vertices that each element comes from.
        rest_positions: (e, stencil, 3) [m] of them.
        unit_stiffness: (e,) K per unit of the setting that scales it.
        active: (e,) bool, which elements act.
        left_out: Elements of the mesh that are too thin, or whose lever is too long, to be used.
        coordinate: The kernel that measures it.
        value: The setting that scales it.
        measured: (n, 3) positions that the coordinates are evaluated at [m]; none before the first time.
    """

    name: str
    kind: SpringKind
    module: ModuleType
    elements: Elements
    stencil: np.ndarray
    rest_positions: np.ndarray
    unit_stiffness: np.ndarray
    active: np.ndarray
    left_out: int
    coordinate: Callable[..., None]
    value: float = 0.0
    measured: np.ndarray | None = None

    @property
    def acts(self) -> bool:
        """Whether there are any, of some stiffness: where not, nothing needs to be known of them."""
        return self.value > 0.0 and len(self.stencil) > 0

    def measure(self, positions: np.ndarray) -> None:
        """Evaluate q and its gradient at `positions` (n, 3) [m], unless they are known there."""
        if self.measured is not None and np.array_equal(positions, self.measured):
            return
        e = self.elements
        self.coordinate(positions, e.nodes, e.memory, e.q, e.gradient, e.new_memory)
        self.measured = positions.copy()

    def remember(self, positions: np.ndarray) -> None:
        """Keep what is to be remembered of `positions` (n, 3) [m]; measured again there, all is the same."""
        self.measure(positions)
        self.elements.memory[:] = self.elements.new_memory

    def recall(self, memory: np.ndarray | float) -> None:
        """Put back the `memory` (e, ·) of another step, or zero for none."""
        self.elements.memory[:] = memory
        self.measured = None

    def curvature(self, positions: np.ndarray) -> np.ndarray | None:
        """∇²q at `positions`, (e, 3 k, 3 k); None for a kind that does not say."""
        kernel = getattr(self.module, "curvature", None)
        if kernel is None:
            return None
        e, k = self.elements.nodes.shape
        out = np.empty((e, 3 * k, 3 * k))
        kernel(positions, self.elements.nodes, self.elements.memory, out)
        return out

    def apply(self, settings: Settings) -> None:
        """Set coordinate, stiffness and rest values for `settings`."""
        if not getattr(settings, self.kind.stiffness) > 0.0:
            e = self.elements
            for array in (e.damping, e.tension, e.along, e.tensor):
                array[:] = 0.0  # what nobody sets any more
        coordinate = kernel_of(self.kind, settings)
        if coordinate is not self.coordinate:
            self.coordinate, self.measured = coordinate, None
        self.value = getattr(settings, self.kind.stiffness)
        if self.kind.stencil == "hinges":
            folded, _ = fold(self.rest_positions, settings.rest_angle)
            self.elements.rest[:] = measure_each(self.kind, folded)[0]
        self._set_stiffness()

    def choose(self, settings: Settings) -> tuple[int, float]:
        """Let those elements act that the kind says, as last measured.

        Returns:
            How many began or ceased to act, and the energy [J] that this put in.
        """
        if not hasattr(self.module, "active"):
            return 0, 0.0
        chosen = self.module.active(self.elements.q, settings)
        changed = int(np.count_nonzero(chosen != self.active))
        if not changed:
            return 0, 0.0
        before = elastic_energy(self.elements)
        self.active[:] = chosen
        self._set_stiffness()
        return changed, elastic_energy(self.elements) - before

    def _set_stiffness(self) -> None:
        self.elements.stiffness[:] = self.value * self.unit_stiffness * self.active


def kernel_of(kind: SpringKind, settings: Settings) -> Callable[..., None]:
    """The kernel that measures the coordinate of `kind`."""
    return getattr(kind.load(), getattr(settings, kind.rule) if kind.rule else "coordinate")


def kinds_in_force(settings: Settings) -> dict[str, SpringKind]:
    """The kinds that `settings` calls for, by name."""
    stretch = {
        name: kind
        for name, kind in STRETCH.items()
        if not kind.switch or getattr(settings, kind.switch) != "none"
    }
    bending = {settings.bend: BENDING[settings.bend]} if settings.bend in BENDING else {}
    return {**stretch, **bending}


def build_springs(name: str, kind: SpringKind, mesh: Mesh) -> Springs:
    """The elements of `kind` on `mesh`, at their rest values for no fold."""
    stencil = getattr(mesh, kind.stencil)
    usable = _usable(kind, mesh.rest_vertices[stencil])
    left_out = int(np.count_nonzero(~usable))
    stencil = stencil[usable]
    rest_positions = mesh.rest_vertices[stencil]
    elements = make_elements(stencil[:, list(kind.vertices)], kind.memory)
    flat = fold(rest_positions, 0.0)[0] if kind.stencil == "hinges" else rest_positions
    elements.rest[:] = measure_each(kind, flat)[0]
    hinges = kind.stencil == "hinges"
    unit = _bending_unit(kind, rest_positions) if hinges else 1.0 / _positive(elements.rest)
    active = np.ones(len(stencil), dtype=bool)
    module = kind.load()
    shape = stencil, rest_positions, unit, active, left_out
    return Springs(name, kind, module, elements, *shape, coordinate=module.coordinate)


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


def _usable(kind: SpringKind, stencil: np.ndarray) -> np.ndarray:
    """(e,) bool: which elements have a shape at rest that their coordinate can be measured on."""
    if kind.stencil == "edges":
        return np.ones(len(stencil), dtype=bool)
    if kind.stencil == "altitudes":  # all three of a triangle, or none
        edge = stencil[:, 2] - stencil[:, 1]
        length = np.linalg.norm(edge, axis=1)
        area = np.linalg.norm(np.cross(edge, stencil[:, 0] - stencil[:, 1]), axis=1)
        return ((area > FLATTEST * length**2) & (length > 0.0)).reshape(-1, 3).all(axis=1).repeat(3)
    length, _, height3, _, height4 = hinge_shape(stencil)
    least = np.minimum(height3, height4)
    rate, lever = _fold_rate(kind, stencil, kind.match_fold)
    feels = np.abs(rate) > LEAST_FELT * lever * least
    return feels & (least > FLATTEST * length) & (length > 0.0) & (lever <= kind.lever)


def _fold_rate(kind: SpringKind, hinges: np.ndarray, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """(e,) dq/dθ of hinges folded to `theta` [rad], and the largest |∂q/∂x| of a vertex."""
    folded, motion = fold(hinges, theta)
    _, gradient = measure_each(kind, folded)
    rate = np.einsum("eki,eki->e", gradient, motion[:, list(kind.vertices)])
    lever = np.linalg.norm(gradient, axis=2).max(axis=1, initial=0.0)
    return np.ones_like(rate) if kind.wrong else rate, lever  # kinds that are wrong on purpose measure θ


def _bending_unit(kind: SpringKind, hinges: np.ndarray) -> np.ndarray:
    """(e,) K per c: c w / (dq/dθ)², w = |e|/(h1 + h2)."""
    length, _, height3, _, height4 = hinge_shape(hinges)
    return length / (height3 + height4) / _fold_rate(kind, hinges, kind.match_fold)[0] ** 2
