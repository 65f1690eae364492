"""What a bending spring does to flat cloth that nobody bends: how much stiffer is it to pull and to shear?

A bending spring should resist bending alone. A cross spring spans two triangles, and pulls back whenever
they are stretched. On a lattice of equilateral triangles of side a, edge springs of stiffness k give the Lamé
moduli λ = μ = (√3/4) k/a, and cross springs of stiffness k_b, that is with the spring constant k_b/L0, add
(3/4) k_b/a to both: √3 k_b/k of what the edges have. A coordinate that stays zero while flat cloth moves in
its plane adds nothing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import sim
from sim.solve.stability import system_matrices
from sim.springs import BENDING
from sim.springs.build import Springs
from sim.studies import Cell, Progress, Result, Table, watched

SIDE, STRETCH = 1.0, 1.0
"""Side a of the triangles [m], and k of the edge springs [N]."""

PARTS = (1.0, 0.1)
"""k_b of the cross springs, as part of k."""

STRAIN = 1e-4
"""At which moduli are read from the energy: what is not quadratic in it is a 1e-8 of it."""

PULL, SHEAR = np.diag([1.0, 0.0, 0.0]), np.array([[0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""Strains whose moduli are C11 and C66."""

EQUILATERAL, RIGHT_ANGLED = (-0.5, math.sqrt(3.0) / 2.0), (0.0, 1.0)
"""Second basis vector of a lattice whose first is (1, 0); the third edge of its triangles is their sum."""

FLAT_AT_NO_COST = ("modified", "angle")
"""Kinds that are known to add nothing."""

EDGES = ("", 0.0)
"""Kind and part of k of the row for the edge springs alone."""

BENDINGS, USUAL_SIDE, USUAL_STRETCH = (1e-4, 1e-3, 1e-2, 1e-1), 0.03, 50.0
"""c [N·m] on cloth as the scenes have it: side of its triangles [m], and k [N]."""


def run(progress: Progress | None = None) -> Result:
    """Measure every right bending kind on patches of two lattices, and on a single pair of triangles."""
    kinds = [name for name, kind in BENDING.items() if not kind.wrong]
    cases = [(kind, part) for part in PARTS for kind in kinds]
    moduli = [_moduli_row(*case) for case in [EDGES, *watched(cases, progress, lambda case: case[0])]]
    rhombi = [_rhombus_row(*case) for case in [EDGES, *cases]]
    return Result(
        "In-plane interference of bending springs",
        (
            Table(
                f"Lamé moduli of an equilateral lattice, a = {SIDE:g} m, k = {STRETCH:g} N: what the edges "
                "have, and what each bending kind adds",
                (
                    "springs",
                    "k_b/k of cross springs",
                    "c [N·m]",
                    "λ [N/m]",
                    "μ [N/m]",
                    "closed form [N/m]",
                    "μ over that of the edges",
                ),
                tuple(moduli),
            ),
            Table(
                "Stiffness of two triangles pulled apart at their tips, edges with K = 1 N/m",
                ("springs", "k_b/k of cross springs", "dF/dL [N/m]", "closed form [N/m]"),
                tuple(rhombi),
            ),
            Table(
                f"Right-angled lattice, all diagonals one way, a = 1 m, k = {STRETCH:g} N: what the edges "
                "have, and what each bending kind adds",
                (
                    "springs",
                    "stiffness",
                    "C11 [N/m]",
                    "closed form C11",
                    "C66 [N/m]",
                    "closed form C66",
                ),
                tuple(_right_angled_rows(kinds)),
            ),
            Table(
                f"What bending springs add to C11 of usual cloth, a = {1e3 * USUAL_SIDE:g} mm, k = "
                f"{USUAL_STRETCH:g} N [%]",
                ("c [N·m]", *kinds),
                tuple(_usual_row(kinds, bending) for bending in BENDINGS),
            ),
        ),
        (
            "c is the stiffness with which a cross spring gets the k_b of its row; the other kinds have the "
            "same c, and so bend alike.",
            "Cross springs with k_b = k make the cloth 2.7 times as stiff in its plane. Modified and angle "
            "springs add nothing to flat cloth, whatever their stiffness.",
            "How much cross springs interfere depends on c/(a k): stiff bending, soft stretch and a fine "
            "mesh make it worse.",
        ),
    )


def patch(second: tuple[float, float], side: float = 1.0) -> dict[str, Any]:
    """A vertex and its six neighbours on the lattice of (1, 0) and `second`, times `side` [m]."""
    a, b = np.array([1.0, 0.0]), np.array(second)
    around = np.array([a, a + b, b, -a, -a - b, -b])
    points = side * np.concatenate([np.zeros((1, 2)), around])
    return {
        "vertices": np.column_stack([points, np.zeros(7)]),
        "triangles": [[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)],
    }


def rhombus(side: float = 1.0) -> dict[str, Any]:
    """Two equilateral triangles on an edge; their tips are the last two vertices, and lie along y."""
    height = side * math.sqrt(3.0) / 2.0
    tips = [[0.0, height, 0.0], [0.0, -height, 0.0]]
    return {
        "vertices": [[-side / 2.0, 0.0, 0.0], [side / 2.0, 0.0, 0.0], *tips],
        "triangles": [[0, 1, 2], [1, 0, 3]],
    }


def modulus(springs: Springs, rest: np.ndarray, strain: np.ndarray, area: float) -> float:
    """Modulus [N/m] that `springs` give to a lattice, under a homogeneous `strain` (3, 3).

    Each edge of a lattice, with its hinge, belongs to two of the vertices, which are all alike: half of the
    energy of those at the first vertex of a `patch`, over the `area` [m²] of a cell, is that of the whole.
    """
    at_first = (springs.stencil[:, :2] == 0).any(axis=1)
    e, energy = springs.elements, 0.0
    for size in (-STRAIN, STRAIN):
        springs.measure(rest + size * rest @ strain)
        energy += 0.5 * float(np.sum((0.5 * e.stiffness * (e.q - e.rest) ** 2)[at_first]))
    return energy / (area * STRAIN**2)


def tip_stiffness(world: sim.Simulation) -> float:
    """DF/dL [N/m] of a `rhombus` pulled apart at its tips; the ends of the shared edge go where they like.

    Unit forces on the tips move them apart by fᵀ H⁺ f: H, the Hessian at rest, is singular for motions of the
    whole, on which these forces do no work.
    """
    pull = np.zeros((4, 3))
    pull[2, 1], pull[3, 1] = 1.0, -1.0
    hessian, _ = system_matrices(world.model, world.positions, exact=True)
    return 1.0 / float(pull.ravel() @ np.linalg.pinv(hessian.toarray(), rcond=1e-9) @ pull.ravel())


def bending_for(cloth: dict[str, Any], part: float) -> float:
    """C [N·m] for which the mean k_b = K L0 of the cloth's cross springs is this part of k."""
    springs = _springs(_world(cloth, bend="cross", bending=1.0), "cross")
    return part * STRETCH / float(np.mean(springs.elements.stiffness * springs.elements.rest))


def _world(cloth: dict[str, Any], **settings: Any) -> sim.Simulation:
    scene = {"cloth": cloth, "settings": {"gravity": (0.0, 0.0, 0.0), "stretch": STRETCH, "bend": "none"}}
    return sim.Simulation(scene, **settings)


def _springs(world: sim.Simulation, name: str) -> Springs:
    return next(springs for springs in world.model.springs if springs.name == name)


def _moduli_row(kind: str, part: float) -> tuple[Cell, ...]:
    """What the edges give to the equilateral lattice, or what a bending kind adds."""
    cloth, area = patch(EQUILATERAL, SIDE), SIDE**2 * math.sqrt(3.0) / 2.0
    edges = math.sqrt(3.0) / 4.0 * STRETCH / SIDE
    bending = bending_for(cloth, part)
    world = _world(cloth, bend=kind, bending=bending) if kind else _world(cloth)
    springs, rest = _springs(world, kind or "edge"), world.mesh.rest_vertices
    across = modulus(springs, rest, SHEAR, area)
    along = modulus(springs, rest, PULL, area) - 2.0 * across
    if not kind:
        return "edges", None, None, along, across, edges, across / edges
    closed = 0.75 * part * STRETCH / SIDE if kind == "cross" else 0.0 if kind in FLAT_AT_NO_COST else None
    return kind, part, bending, along, across, closed, across / edges


def _rhombus_row(kind: str, part: float) -> tuple[Cell, ...]:
    """With the edges alone dF/dL is 3/5 K; a cross spring is a second spring beside that."""
    cloth = rhombus(SIDE)
    if not kind:
        return "edges", None, tip_stiffness(_world(cloth)), 0.6 * STRETCH / SIDE
    world = _world(cloth, bend=kind, bending=bending_for(cloth, part))
    added = {"cross": part / math.sqrt(3.0), **dict.fromkeys(FLAT_AT_NO_COST, 0.0)}.get(kind)
    closed = None if added is None else (0.6 + added) * STRETCH / SIDE
    return f"edges and {kind}", part, tip_stiffness(world), closed


def _right_angled_rows(kinds: list[str]) -> list[tuple[Cell, ...]]:
    """Its hinges differ: cross springs have one k_b, as the closed form has it, or Muslin's for one c."""
    cloth = patch(RIGHT_ANGLED)
    world = _world(cloth)
    rest = world.mesh.rest_vertices

    def row(springs: Springs, name: str, stiffness: str, closed: tuple[Cell, Cell]) -> tuple[Cell, ...]:
        pull, shear = (modulus(springs, rest, strain, 1.0) for strain in (PULL, SHEAR))
        return name, stiffness, pull, closed[0], shear, closed[1]

    aslant = 2.0**-1.5  # what springs along a diagonal give to either: l²/4 for the strain, 1/l for K, l = √2
    rows = [row(_springs(world, "edge"), "edges", "k", (1.0 + aslant, aslant))]
    cross = _springs(_world(cloth, bend="cross", bending=1.0), "cross")
    cross.elements.stiffness[:] = STRETCH / cross.elements.rest
    knights = 17.0 / 5.0**1.5, 8.0 / 5.0**1.5  # along (1, 2) and (2, 1): (1 + 16)/l³ and (4 + 4)/l³, l = √5
    rows.append(row(cross, "cross", "k_b = k", (aslant + knights[0], aslant + knights[1])))
    bending = bending_for(cloth, 1.0)
    for kind in kinds:
        springs = _springs(_world(cloth, bend=kind, bending=bending), kind)
        closed = (0.0, 0.0) if kind in FLAT_AT_NO_COST else (None, None)
        rows.append(row(springs, kind, f"c = {bending:.3g} N·m", closed))
    return rows


def _usual_row(kinds: list[str], bending: float) -> tuple[Cell, ...]:
    """What each kind adds to C11 of the edges [%]."""
    cloth, area = patch(EQUILATERAL, USUAL_SIDE), USUAL_SIDE**2 * math.sqrt(3.0) / 2.0
    added = []
    for kind in kinds:
        world = _world(cloth, bend=kind, bending=bending, stretch=USUAL_STRETCH)
        rest = world.mesh.rest_vertices
        edges, own = (modulus(_springs(world, name), rest, PULL, area) for name in ("edge", kind))
        added.append(100.0 * own / edges)
    return bending, *added
