"""The spring kinds. A kind is one module here and one line in a registry below.

A kind's module holds one scalar coordinate q(x) of a stencil of two to four vertices:

    coordinate(positions, nodes, memory, q, gradient, new_memory)

a compiled kernel that fills, for every element e,

    q[e]             the coordinate [m or rad]
    gradient[e]      ∂q/∂x of each of its vertices, shape (nodes per element, 3)
    new_memory[e]    what the coordinate must remember of this step in the next one, read back as memory[e]

Force, Hessian, damping, energy and assembly are written once, in `sim.elements`, for all of them.
This module imports no numba: listing, checking and documenting kinds must be quick.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from types import ModuleType


@dataclass(frozen=True)
class SpringKind:
    """What there is to know of a kind before its kernel is compiled.

    Attributes:
        module: Import path of the module with the `coordinate` kernel.
        summary: One line for menus, tooltips and docs.
        stencil: The array of the mesh that its elements come from: "edges" or "hinges".
        vertices: Which vertices of the stencil the coordinate depends on.
        memory: Numbers that each element remembers from step to step.
        is_length: q is the distance of two points, so that ∇²q is known: (I − nnᵀ)/q across n.
        stiffness: The setting that scales it.
        match_fold: Fold [rad] at which a bending kind is given the stiffness of an angle spring.
    """

    module: str
    summary: str
    stencil: str
    vertices: tuple[int, ...]
    memory: int
    is_length: bool
    stiffness: str
    match_fold: float = 0.0

    def load(self) -> ModuleType:
        """The kind's module, imported (and its kernel compiled or read from the cache) on first use."""
        return importlib.import_module(self.module)


STRETCH: dict[str, SpringKind] = {
    "edge": SpringKind(
        "sim.springs.edge", "keeps the length of every edge", "edges", (0, 1), 3, True, "stretch"
    ),
}

BENDING: dict[str, SpringKind] = {
    "cross": SpringKind(
        "sim.springs.edge",
        "distance of the two opposite vertices; none when flat, blind to the side of the fold",
        "hinges",
        (2, 3),
        3,
        True,
        "bending",
        match_fold=math.pi / 3,  # flat, a cross spring has no linear bending stiffness
    ),
    "angle": SpringKind(
        "sim.springs.angle",
        "dihedral angle, free of ghost forces",
        "hinges",
        (0, 1, 2, 3),
        1,
        False,
        "bending",
    ),
}
