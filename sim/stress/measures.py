"""Measurements that cases and tests share: bounds of a step, statics and hinges against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq

from sim.elements import Elements, make_elements
from sim.report import StepReport
from sim.simulation import Simulation
from sim.solve.system import Matrix
from sim.springs import BENDING, SpringKind
from sim.springs.build import fold
from sim.statics import equilibrium
from sim.stress.worlds import chain, scene

G = 9.81
"""[m/s²]."""

EARTH = [0.0, 0.0, -G]


def dense(matrix: Matrix) -> np.ndarray:
    """The (3n, 3n) array that a block matrix stands for."""
    n = len(matrix.diagonal)
    full = np.zeros((n, 3, n, 3))
    for i in range(n):
        full[i, :, i] = matrix.diagonal[i]
        for p in range(matrix.first[i], matrix.first[i + 1]):
            full[i, :, matrix.column[p]] = matrix.block[p]
    return full.reshape(3 * n, 3 * n)


# The bound of a step of backward Euler


def potential_parts(world: Simulation, velocities: np.ndarray | float) -> np.ndarray:
    """Φ's energies and its inertia [J], for a step that began with `velocities`; damping is left out."""
    energies = world.energy()
    del energies["kinetic"]
    inertia = 0.5 * world.masses @ ((world.velocities - velocities) ** 2).sum(axis=1)
    return np.array([*energies.values(), inertia])


def rise(world: Simulation) -> tuple[float, StepReport]:
    """By how much a step raises Φ, over the sum of the sizes of Φ's parts; and the report of that step.

    Φ(v) = ½ ‖v − vⁿ‖²_M + E(xⁿ + h v): where a step does not raise it, E(xⁿ⁺¹) + ½ ‖vⁿ⁺¹ − vⁿ‖²_M is at most
    E(xⁿ) + ½ ‖vⁿ‖²_M, however stiff the cloth, long the step, and badly solved the system.
    """
    velocities = world.velocities.copy()
    before = potential_parts(world, 0.0)
    report = world.step()
    return relative_rise(before, potential_parts(world, velocities)), report


def relative_rise(before: np.ndarray, after: np.ndarray) -> float:
    """By how much the sum of parts grew, over the sum of their sizes."""
    return float((after.sum() - before.sum()) / max(np.abs([before, after]).sum(), 1e-300))


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where `function` is zero between `low` and `high`, at which its signs differ."""
    return float(brentq(function, low, high, xtol=1e-14))  # pyright: ignore[reportArgumentType]


# Hanging chains and pendulums

SPAN = 0.5
"""Between the ends of a chain of unit length [m]."""

HARD = 1e6
"""Tension over stiffness is 5e-7 in a chain of unit weight; what that lengthens it by goes as 1/k."""


def slack_chain(links: int, stretch: float = HARD, **settings: Any) -> dict[str, Any]:
    """A chain of unit length and weight between points half a metre apart, on a parabola of its length."""

    def parabola(depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = np.linspace(0.0, 1.0, 1001)
        x, z = SPAN * s, -4.0 * depth * s * (1.0 - s)
        return x, z, np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(z))))

    x, z, along = parabola(root(lambda depth: parabola(depth)[2][-1] - 1.0, 0.0, 1.0))
    places = np.linspace(0.0, along[-1], links + 1)
    points = np.stack([np.interp(places, along, x), 0.0 * places, np.interp(places, along, z)], axis=1)
    cloth = chain(points, [1.0 / (G * links)] * (links + 1), pins=[0, links])
    cloth["rest_vertices"] = [[k / links, 0, 0] for k in range(links + 1)]
    return scene(cloth, gravity=EARTH, stretch=stretch, **settings)


def sag(links: int, **settings: Any) -> float:
    """How far below its ends the chain's lowest vertex hangs [m]."""
    return -float(equilibrium(slack_chain(links, **settings)).positions[:, 2].min())


def period_ratio(degrees: float, integrator: str) -> float:
    """Period of a stiff pendulum let go at an angle, over that of small swings."""
    length, angle = 0.1, math.radians(degrees)
    small = 2.0 * math.pi * math.sqrt(length / G)
    rod = chain([[0, 0, 0], [length * math.sin(angle), 0, -length * math.cos(angle)]], [1.0, 0.01], pins=[0])
    rod["rest_vertices"] = [[0, 0, 0], [length, 0, 0]]
    solved = {"newton": 20, "tolerance": 1e-10, "stretch": 1e3, "gamma": 0.5}
    world = Simulation(scene(rod, gravity=EARTH, integrator=integrator, dt=small / 200, **solved))
    before, now = math.inf, world.positions[1, 0]
    while now > 0.0:
        world.step()
        before, now = now, world.positions[1, 0]
    quarter = world.time + world.settings.dt * now / (before - now)  # when it passed the lowest point
    return 4.0 * quarter / small


# Single elements


def elements_at(
    kind: SpringKind, positions: np.ndarray, stiffness: float = 1.0, rest: float = 0.0, memory: Any = 0.0
) -> Elements:
    """Elements of one stencil at `positions` (stencil, 3), measured."""
    chosen = np.ascontiguousarray(positions[list(kind.vertices)], dtype=float)
    e = make_elements(np.arange(len(chosen))[None], kind.memory)
    e.stiffness[:], e.rest[:], e.memory[:] = stiffness, rest, memory
    kind.load().coordinate(chosen, e.nodes, e.memory, e.q, e.gradient, e.new_memory)
    return e


def swept(
    name: str, tips: tuple[float, float], angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Q, ∂q/∂θ and gradient of a hinge with tips of heights `tips`, folded to each angle in turn."""
    kind = BENDING[name]
    flat = np.array([[[0.0, 0, 0], [1, 0, 0], [0.3, tips[0], 0], [0.6, -tips[1], 0]]])
    memory, found = np.zeros((1, kind.memory)), []
    for theta in angles:
        folded, motion = fold(flat, theta)
        e = elements_at(kind, folded[0], memory=memory)
        memory = e.new_memory.copy()
        turn = np.sum(e.gradient[0] * motion[0][list(kind.vertices)])
        found.append((e.q[0], turn, e.gradient[0].copy()))
    q, turn, gradient = (np.array(column) for column in zip(*found, strict=True))
    return q, turn, gradient
