"""The spring kinds. A kind is one module here and one line in a registry below.

A kind's module holds one scalar coordinate q(x) of a stencil of two to four vertices:

    coordinate(positions, nodes, memory, q, gradient, new_memory)

a compiled kernel that fills, for every element e,

    q[e]             the coordinate [m or rad]
    gradient[e]      ∂q/∂x of each of its vertices, shape (nodes per element, 3)
    new_memory[e]    what the coordinate must remember of this step in the next one, read back as memory[e]

Force, Hessian, damping, energy and assembly are written once, in `sim.elements`, for all of them. Two more
functions are optional:

    curvature(positions, nodes, memory, out)   a kernel that fills out[e] with ∇²q, (3 k, 3 k), row 3 a + r
                                               for component r of node a; solvers that want the exact Hessian
                                               use it, and take ∇²q as zero without
    active(q, settings)                        which elements act, (e,) bool, asked once per step

This module imports no numba: listing, checking and documenting kinds must be quick.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from types import ModuleType
from typing import Literal


@dataclass(frozen=True)
class SpringKind:
    """What there is to know of a kind before its kernel is compiled.

    Attributes:
        module: Import path of the module with the `coordinate` kernel.
        summary: One line for menus, tooltips and docs.
        stencil: The array of the mesh that its elements come from: "edges", "altitudes" or "hinges".
        vertices: Which vertices of the stencil the coordinate depends on.
        stiffness: The setting that scales it.
        memory: Numbers that each element remembers from step to step.
        bends: How a tense coordinate resists motion across its gradient: "length", alike in all directions,
            as the distance of two points does; "normal", only along the unit vector that its memory begins
            with; or "none" that is known.
        switch: The setting that leaves the kind out where it is "none"; "" for one that is always there.
        rule: The setting that names the kernel of the module, where it has several instead of `coordinate`.
        match_fold: Fold [rad] at which a bending kind is given the stiffness of an angle spring.
        lever: Largest |∂q/∂x| at rest of an element that is used; a mesh has more only where it is bad.
        wrong: What is wrong with it, for a kind that shows a mistake: its "gradient" is none of q.
    """

    module: str
    summary: str
    stencil: str
    vertices: tuple[int, ...]
    stiffness: str
    memory: int = 0
    bends: Literal["none", "length", "normal"] = "none"
    switch: str = ""
    rule: str = ""
    match_fold: float = 0.0
    lever: float = math.inf
    wrong: str = ""

    def load(self) -> ModuleType:
        """The kind's module, imported (and its kernel compiled or read from the cache) on first use."""
        return importlib.import_module(self.module)


STRETCH: dict[str, SpringKind] = {
    "edge": SpringKind(
        "sim.springs.edge",
        "keeps the length of every edge",
        "edges",
        (0, 1),
        "stretch",
        memory=3,
        bends="length",
    ),
    "altitude": SpringKind(
        "sim.springs.altitude",
        "keeps the heights of every triangle, and so keeps it from collapsing",
        "altitudes",
        (0, 1, 2),
        "altitude",
        memory=3,
        bends="normal",
        switch="altitudes",
    ),
}

BENDING: dict[str, SpringKind] = {
    "cross": SpringKind(
        "sim.springs.edge",
        "distance of the two opposite vertices; no stiffness when flat, blind to the side of the fold, and "
        "stiffens the cloth in its plane",
        "hinges",
        (2, 3),
        "bending",
        memory=3,
        bends="length",
        match_fold=math.pi / 3,  # flat, a cross spring has no linear bending stiffness
    ),
    "modified": SpringKind(
        "sim.springs.modified",
        "signed distance of the shared edge's line from the line through the opposite vertices; knows the "
        "side of the fold, and does nothing in the plane of flat cloth",
        "hinges",
        (0, 1, 2, 3),
        "bending",
        memory=5,
        lever=2.0,
    ),
    "angle": SpringKind(
        "sim.springs.angle",
        "dihedral angle, free of ghost forces",
        "hinges",
        (0, 1, 2, 3),
        "bending",
        memory=1,
    ),
    "adhoc": SpringKind(
        "sim.springs.adhoc_angle",
        "wrong on purpose: the angle's force applied at the tips by rule of thumb",
        "hinges",
        (0, 1, 2, 3),
        "bending",
        memory=1,
        rule="adhoc_rule",
        wrong="not the gradient of any energy: its ghost forces push and turn cloth out of nothing",
    ),
}
