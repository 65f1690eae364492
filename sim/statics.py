"""Static rest: where a scene's cloth hangs when it has come to rest.

Without contact this is a minimum of the potential energy, found by damped Newton steps (Levenberg 1944): the
masses over h² hold them back at first; h grows while they do well, and the last ones are plain Newton steps
with the exact Hessian. With obstacles, or in the wind, whose push has no energy, it is where the motion
itself ends: the cloth is stepped, and stopped whenever its kinetic energy has passed a peak (kinetic damping,
Cundall 1976).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sim.contact.gap import NO_GAP_SPRINGS
from sim.effects import feels_obstacles
from sim.scene import Scene
from sim.simulation import Simulation, Snapshot
from sim.solve.direct import solve_directly
from sim.threads import processor_threads

RESIDUAL = 1e-9
"""Force left on any free vertex, as part of the largest force that acts on one."""

SLOW_RESIDUAL = 1e-6
"""The same where springs that do not know their second derivative take too many steps for that."""

STILL, WATCHED = 1e-4, 60
"""Part of the cloth's size that a vertex may move in so many steps, where contact holds it."""

EPSILON = 8.0 * float(np.finfo(float).eps)
"""What a coordinate loses of the positions that it is measured from."""

NUDGE, SLOWEST_FALL = 1e-5, 30.0
"""Part of the cloth's size by which it is moved off a saddle, and the time [s] in which that leaves it."""

MOST_STEPS, MOST_CONTACT_STEPS = 1500, 12000
"""Steps after which there is taken to be no equilibrium."""

SHORTEST, FIRST, LONGEST, GROWTH = 1e-7, 1e-2, 1e4, 4.0
"""Lengths h of the steps [s], and how much longer the next is than one that did well, or shorter."""

ACCEPTED, POOR, GOOD = 0.01, 0.25, 0.6
"""Part of the promised decrease from which a step is taken, below which the next is shorter, above longer."""

HIDDEN = 1e-14
"""Part of the energy below which a decrease is lost in adding it up."""


class EquilibriumError(RuntimeError):
    """No equilibrium was found; the message says how far from one the cloth was left."""


def equilibrium(scene: Scene | str | Path | dict[str, Any], **overrides: Any) -> Simulation:
    """A simulation of `scene` at static rest, velocities zero and time zero.

    The forces that are left are below 1e-9 of the largest that acts on a vertex, or 1e-6 where springs do
    not know their second derivative. On obstacles, which stay where they are at time zero, and in the wind,
    which blows without gusts, no vertex moves by more than 1e-4 of the cloth's size within 60 steps.

    Args:
        scene: As for Simulation.
        overrides: Settings that differ from the scene's.

    Raises:
        SceneError, ValueError: As Simulation; ValueError also for cloth that nothing holds up.
        EquilibriumError: where the cloth does not come to rest, as a flag that flutters.
    """
    world = Simulation(scene, **overrides)
    s = world.settings
    on_obstacles = s.contact != "none" and feels_obstacles(s, world.scene.obstacle_labels)
    blown = world.model.wind is not None and any(s.wind)
    if not on_obstacles and (blown or any(s.gravity)):
        _check_held(world)
    if on_obstacles or blown:
        at_rest = _relax(world)
    else:
        with processor_threads(world.settings.threads):
            at_rest = _minimise(world)
    world.restore(at_rest)
    return world


def _check_held(world: Simulation) -> None:
    n, edges = len(world.positions), world.edges
    joined = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    parts, part = connected_components(joined, directed=False)
    held = np.zeros(parts, dtype=bool)
    held[part[world.pinned]] = True
    if not held.all():
        loose = int(np.argmin(held[part]))
        raise ValueError(
            f"cloth[{world.pieces[loose]}]: expected pins, or an obstacle, to hold all of it; "
            f"nothing holds vertex {loose}"
        )


def _at_rest(world: Simulation, x: np.ndarray) -> Snapshot:
    """The state of `world` at `x` (n, 3), with what coordinates remember, but at rest and at time zero."""
    still = np.zeros_like(x)
    return replace(world.snapshot(), positions=x, velocities=still, time=0.0, previous=None, injected=0.0)


def _minimise(world: Simulation) -> Snapshot:
    """Levenberg–Marquardt: Newton steps that masses over h² hold back, h longer after a good one."""
    model, masses = world.model, world.masses[:, None]
    x, still = world.positions.copy(), np.zeros_like(world.positions)
    step, nudges = np.zeros_like(x), np.random.default_rng(world.settings.seed)
    h, left = FIRST, np.inf
    for _ in range(MOST_STEPS):
        left = _residual(world, x)
        if left <= RESIDUAL:
            if _stable(world, x):
                return _at_rest(world, x)
            size = float(np.ptp(x, axis=0).max())
            x += NUDGE * size * nudges.standard_normal(x.shape) * model.free[:, None]
            h = FIRST
        for exact in (True, False):  # filtered only where the exact Hessian is no minimum's
            forces = model.linearise(x, still, NO_GAP_SPRINGS, h, exact).copy()
            if solve_directly(model.matrix, model.coupling, model.free, h * h * forces, step)[1]:
                break
        worth = _worth(world, x, step, 0.5 * float(np.sum(step * (forces + masses * step / h**2))), left)
        if worth > ACCEPTED:
            x = x + step
            model.remember(x)
        h = min(GROWTH * h, LONGEST) if worth > GOOD else max(h / GROWTH, SHORTEST) if worth < POOR else h
    if left <= SLOW_RESIDUAL:
        return _at_rest(world, x)
    raise EquilibriumError(
        f"no equilibrium within {MOST_STEPS} steps: forces of {left:.2g} times the largest are left"
    )


def _worth(world: Simulation, x: np.ndarray, step: np.ndarray, promised: float, left: float) -> float:
    """The part of its `promised` decrease of energy [J] that a step keeps; 1 where rounding hides it."""
    if not np.isfinite(step).all():
        return 0.0
    if not world.model.conservative:  # there is no energy to go by, only the part of forces that is left
        return float(_residual(world, x + step) < left)
    before, after = (sum(world.model.energies(y).values()) for y in (x, x + step))
    if abs(promised) <= HIDDEN * (abs(before) + abs(after)):
        return 1.0
    return (before - after) / promised


def _stable(world: Simulation, x: np.ndarray) -> bool:
    """Whether the energy is least at `x`, and not a saddle such as cloth that is flat by symmetry alone."""
    world.model.linearise(x, np.zeros_like(x), NO_GAP_SPRINGS, SLOWEST_FALL, exact=True)
    unused = np.zeros_like(x)
    return solve_directly(world.model.matrix, world.model.coupling, world.model.free, unused, unused.copy())[
        1
    ]


def _residual(world: Simulation, x: np.ndarray) -> float:
    """The largest force on a free vertex, less what is rounding, as part of the largest single force."""
    forces = world.model.forces(x, np.zeros_like(x))
    weight = world.masses * float(np.linalg.norm(world.settings.gravity))
    largest, rounding = float(weight.max(initial=0.0)), 0.0
    for springs in world.model.springs:
        e, size = springs.elements, np.linalg.norm(springs.elements.gradient, axis=2).max(axis=1, initial=0.0)
        largest = max(largest, float((np.abs(e.tension) * size).max(initial=0.0)))
        rounding = max(rounding, EPSILON * float((e.stiffness * size**2).max(initial=0.0) * np.abs(x).max()))
    left = float(np.linalg.norm(forces[world.model.free], axis=1).max(initial=0.0)) - rounding
    return left / largest if largest > 0.0 else 0.0


def _relax(world: Simulation) -> Snapshot:
    """Obstacles stay where they are at time zero, there are no gusts, and what solves leave is no motion."""
    first = [msgspec.structs.replace(o, path=o.path[:1]) for o in world.scene.obstacle]
    size = float(np.ptp(world.positions, axis=0).max()) or 1.0
    fine = min(world.settings.tolerance, STILL * size / WATCHED)
    steady = msgspec.structs.replace(world.settings, gust=0.0, tolerance=fine)
    moving = Simulation(msgspec.structs.replace(world.scene, obstacle=first, settings=steady))
    kinetic, moved, before = 0.0, np.inf, moving.positions.copy()
    for k in range(MOST_CONTACT_STEPS):
        moving.step()
        energy = moving.energy()["kinetic"]
        if energy < kinetic:
            moving.stop()
            energy = 0.0
        kinetic = energy
        if k % WATCHED == WATCHED - 1:
            moved = float(np.linalg.norm(moving.positions - before, axis=1).max()) / size
            if moved <= STILL:
                return replace(_at_rest(moving, moving.positions.copy()), ramp=world.snapshot().ramp)
            before = moving.positions.copy()
    raise EquilibriumError(
        f"no equilibrium within {MOST_CONTACT_STEPS} steps: it still moves by {moved:.2g} of its size in "
        f"{WATCHED} steps"
    )
