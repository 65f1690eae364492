"""Does giving every vertex the same mass make a step cheaper to solve, and what does it do to the motion?

The mass of cloth is shared out by area, a third of each triangle to its corners, or alike to all vertices. On
a graded mesh the masses by area differ a lot, and flat cloth resists motion out of its plane by nothing but
its mass: so the matrix A = M + h² H is the worse conditioned the more the masses differ. Any preconditioner
that divides by the diagonal blocks takes that away. What is left is an error: alike masses put the weight
where the mesh is fine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

import sim
from sim.contact.gap import NO_GAP_SPRINGS
from sim.mesh import build_mesh
from sim.scene import load_scene
from sim.solve.cg import conjugate_gradients
from sim.solve.direct import as_sparse
from sim.solve.preconditioner import precondition, refresh
from sim.studies import Cell, Progress, Result, Table, watched
from sim.threads import processor_threads

COUNT, GRADINGS = 30, (1.0, 1.5, 2.0, 3.0)
"""Vertices along either side, and exponents g of the grading s^g."""

STRETCH, MASS, STEP = 100.0, 0.2, 1.0 / 60.0
"""k [N], mass of the sheet of 1 m² [kg], and time step [s]."""

RESIDUAL, ERROR = 1e-6, 1e-6
"""Relative residual |b − A x|/|b|, and relative error in the mass-weighted norm, that are asked for."""

MOST = 6000
"""Iterations after which conjugate gradients give up."""

BEYOND = f"> {MOST}"
"""Stands for more iterations than that."""

GRAVITY = 9.81
"""[m/s²]."""

PLATE_SWING = math.sqrt(1.5 * GRAVITY)
"""ω [rad/s] of a uniform plate of 1 m that swings on its upper edge: I = m/3, d = ½."""

MASSES = ("constant", "area")


def run(
    progress: Progress | None = None, count: int = COUNT, gradings: tuple[float, ...] = GRADINGS
) -> Result:
    """Solve steps of sheets with `count`² vertices, and hang a panel, for each of the `gradings`."""
    systems = [(g, load, mass) for g in gradings for load in LOADS for mass in MASSES]
    solved = [
        _solved_rows(count, *system)
        for system in watched(
            systems, progress, lambda system: f"g = {system[0]:g}, {system[1]}, {system[2]}"
        )
    ]
    panels = [(g, mass) for g in gradings for mass in MASSES]
    hung = [_panel_row(count, g, mass) for g, mass in panels]
    names = ("g", "right-hand side", "mass")
    return Result(
        "Mass lumping and conjugate gradients",
        (
            Table(
                f"Iterations to a relative residual of {RESIDUAL:g}, and condition number; {count} × {count} "
                f"vertices at s^g, k = {STRETCH:g} N, {MASS:g} kg, h = 1/{1 / STEP:.0f} s",
                (*names, *(f"{name}{what}" for name in PRECONDITIONERS for what in ("", ": condition"))),
                tuple(row for row, _ in solved),
            ),
            Table(
                f"Iterations to an error of {ERROR:g}, relative, in the mass-weighted norm",
                (*names, *PRECONDITIONERS, "Muslin's, until it stops by itself"),
                tuple(row for _, row in solved),
            ),
            Table(
                "The same sheet as a panel: hung by the middle of its upper edge, and swinging on that edge",
                (
                    "g",
                    "mass",
                    "hangs askew by [°]",
                    "swings with [rad/s]",
                    "off by [%]",
                    "lightest over mean vertex",
                    "longest explicit step [ms]",
                ),
                tuple(hung),
            ),
        ),
        (
            "Without a preconditioner, alike masses do help, and the more the mesh is graded. Block Jacobi, "
            "which every solver of cloth should have, takes the difference away.",
            "It takes a right-hand side that moves single vertices out of the plane to see it: the weight of "
            "a hanging sheet does not.",
            "Muslin's preconditioner takes about half of block Jacobi's iterations or less, for either mass. "
            "Muslin stops when its own estimate of the error says so, a little late to be safe.",
            "A uniform plate hangs straight and swings at √(3 g/2 L). With alike masses its weight is where "
            "its mesh is fine, so it hangs askew and swings at another speed. Masses by area have another "
            "price: the lightest vertex sets the longest step of an explicit integrator.",
        ),
    )


def graded(count: int, exponent: float) -> dict[str, Any]:
    """A sheet of 1 m², upright, `count` vertices a side at s^exponent: fine at the left and at the bottom."""
    mesh = build_mesh(load_scene({"cloth": {"kind": "grid", "resolution": [count, count]}}))
    x, z = ((mesh.vertices[:, :2] + 0.5).clip(0.0, 1.0) ** exponent).T
    return {"vertices": np.column_stack([x, 0.0 * x, z]), "triangles": mesh.triangles}


@dataclass(frozen=True)
class System:
    """A x = b of one step, on free vertices.

    Attributes:
        world: The simulation whose model holds the matrix.
        matrix: A, (3 n, 3 n).
        right: b, (3 n,).
        kept: (3 n,) which of the unknowns of all vertices these are.
        solution: x.
    """

    world: sim.Simulation
    matrix: csr_array
    right: np.ndarray
    kept: np.ndarray
    solution: np.ndarray

    @classmethod
    def of(cls, cloth: dict[str, Any], mass: str, load: str) -> System:
        """The system of the first step of a sheet, for a right-hand side out of `LOADS`."""
        pins, right_of = LOADS[load]
        world = _world({**cloth, "pins": pins(cloth["vertices"])}, mass=mass)
        model = world.model
        model.linearise(world.positions, world.velocities, NO_GAP_SPRINGS, STEP)
        kept = np.flatnonzero(np.repeat(model.free, 3))
        matrix = csr_array(as_sparse(model.matrix, model.coupling)[kept][:, kept])
        right = right_of(world).ravel()[kept]
        return cls(world, matrix, right, kept, splu(csc_array(matrix)).solve(right))

    def error(self, x: np.ndarray) -> float:
        """Of `x`, relative, in the mass-weighted norm."""
        weights = np.repeat(self.world.masses, 3)[self.kept]
        return math.sqrt(weights @ (x - self.solution) ** 2 / (weights @ self.solution**2))

    def spread(self, values: np.ndarray) -> np.ndarray:
        """`values` of the free unknowns as (n, 3) of all vertices, zero for the others."""
        out = np.zeros(3 * len(self.world.masses))
        out[self.kept] = values
        return out.reshape(-1, 3)


def no_preconditioner(system: System) -> Callable[[np.ndarray], np.ndarray]:
    """P = I."""
    return np.copy


def block_jacobi(system: System) -> Callable[[np.ndarray], np.ndarray]:
    """P: the diagonal 3 × 3 blocks of A."""
    inverse = np.linalg.inv(system.world.model.matrix.diagonal[system.world.model.free])
    return lambda r: np.einsum("nij,nj->ni", inverse, r.reshape(-1, 3)).ravel()


def multigrid(system: System) -> Callable[[np.ndarray], np.ndarray]:
    """Muslin's own."""
    model = system.world.model
    refresh(model.preconditioner, model.matrix)
    z = np.zeros((len(model.masses), 3))

    def apply(r: np.ndarray) -> np.ndarray:
        precondition(model.preconditioner, system.spread(r), z, model.work.partial, model.work.largest)
        return z.ravel()[system.kept]

    return apply


PRECONDITIONERS = {"plain": no_preconditioner, "block Jacobi": block_jacobi, "Muslin's": multigrid}

LOADS: dict[str, tuple[Callable, Callable]] = {
    "random": (
        lambda vertices: [],
        lambda world: np.random.default_rng(0).standard_normal(world.positions.shape),
    ),
    "weight": (
        lambda vertices: np.flatnonzero(vertices[:, 2] == vertices[:, 2].max()).tolist(),
        lambda world: STEP * world.masses[:, None] * np.asarray(world.settings.gravity),
    ),
}
"""Right-hand sides: which vertices are held, and b of the simulation."""


@dataclass(frozen=True)
class Solve:
    """How conjugate gradients went: iterations to RESIDUAL and to ERROR, or BEYOND; and cond(P⁻¹A)."""

    to_residual: int | str
    to_error: int | str
    condition: float


def textbook_cg(system: System, apply: Callable[[np.ndarray], np.ndarray]) -> Solve:
    """Preconditioned conjugate gradients from zero (Hestenes and Stiefel 1952), until both goals are reached.

    Its coefficients are those of the Lanczos iteration, whose tridiagonal matrix has about the extreme
    eigenvalues of P⁻¹A (Golub and Van Loan, chapter 11).
    """
    x, r = np.zeros_like(system.right), system.right.copy()
    z = apply(r)
    p, rz, enough = z.copy(), float(r @ z), RESIDUAL * float(np.linalg.norm(r))
    alphas, betas = [], []
    to_residual = to_error = None
    while len(alphas) < MOST and (to_residual is None or to_error is None):
        ap = system.matrix @ p
        alphas.append(rz / float(p @ ap))
        x += alphas[-1] * p
        r -= alphas[-1] * ap
        if to_residual is None and np.linalg.norm(r) <= enough:
            to_residual = len(alphas)
        if to_error is None and system.error(x) <= ERROR:
            to_error = len(alphas)
        z = apply(r)
        rz, before = float(r @ z), rz
        betas.append(rz / before)
        p = z + betas[-1] * p
    condition = _condition(np.array(alphas), np.array(betas))
    return Solve(to_residual or BEYOND, to_error or BEYOND, condition)


def _condition(alphas: np.ndarray, betas: np.ndarray) -> float:
    diagonal = 1.0 / alphas
    diagonal[1:] += betas[:-1] / alphas[:-1]
    beside = np.sqrt(betas[:-1]) / alphas[:-1]
    ends = [
        eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(i, i))[0]
        for i in (0, len(alphas) - 1)
    ]
    return float(ends[1] / ends[0])


def own_iterations(system: System) -> int:
    """Of Muslin's solver from zero to the tolerance ERROR, until its estimate of the error says so."""
    model = system.world.model
    refresh(model.preconditioner, model.matrix)
    weights = np.repeat(system.world.masses, 3)[system.kept]
    allowed = ERROR * math.sqrt(3.0 * (weights @ system.solution**2) / weights.sum())  # at the worst vertex
    right, none = system.spread(system.right), np.zeros((len(model.masses), 3))
    count, _, _ = conjugate_gradients(
        model.matrix,
        model.coupling,
        model.preconditioner,
        model.work,
        right,
        none.copy(),
        none,
        allowed,
        MOST,
    )
    return int(count)


def rigid_panel(vertices: np.ndarray, masses: np.ndarray) -> tuple[float, float]:
    """What a sheet would do that does not bend: how far it hangs askew [°] and how fast it swings [rad/s].

    Askew by the middle of its upper edge, (½, 1) in the x–z plane; and swinging on that edge, a pendulum with
    ω² = m g d/I.
    """
    x, z = vertices[:, 0] - 0.5, 1.0 - vertices[:, 2]
    askew = math.degrees(math.atan2(masses @ x, masses @ z))
    return askew, math.sqrt(GRAVITY * (masses @ z) / (masses @ z**2))


def _world(cloth: dict[str, Any], **settings: Any) -> sim.Simulation:
    shared = {"stretch": STRETCH, "density": MASS, "gamma": 0.0, "bend": "none"}
    return sim.Simulation({"cloth": cloth, "settings": shared}, **settings)


def _solved_rows(
    count: int, exponent: float, load: str, mass: str
) -> tuple[tuple[Cell, ...], tuple[Cell, ...]]:
    """A row of the table of residuals, and one of that of errors."""
    system = System.of(graded(count, exponent), mass, load)
    with processor_threads(1):  # more would wait for each other on sheets this small
        solves = [textbook_cg(system, make(system)) for make in PRECONDITIONERS.values()]
        own = own_iterations(system)
    names = exponent, load, mass
    by_residual = *names, *(x for s in solves for x in (s.to_residual, s.condition))
    return by_residual, (*names, *(s.to_error for s in solves), own)


def _panel_row(count: int, exponent: float, mass: str) -> tuple[Cell, ...]:
    world = _world(graded(count, exponent), mass=mass)
    askew, swing = rigid_panel(world.positions, world.masses)
    lightest = float(world.masses.min() / world.masses.mean())
    off = 100.0 * (swing / PLATE_SWING - 1.0)
    return exponent, mass, round(askew, 9) + 0.0, swing, off, lightest, 1e3 * world.stability_limit()
