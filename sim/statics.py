"""Static rest: where a scene's cloth hangs when it has come to rest.

Without contact this is a minimum of the potential energy, found by damped Newton: implicit steps from rest,
longer and longer, so that the masses, which keep the first ones short, fade out and the last ones are plain
Newton steps with the exact Hessian. With obstacles it is where the motion itself ends: the cloth is stepped,
and stopped whenever its kinetic energy has passed a peak (kinetic damping, Cundall 1976).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from sim.contact.gap import NO_GAP_SPRINGS
from sim.scene import Scene
from sim.simulation import Simulation
from sim.solve.direct import solve_directly
from sim.solve.implicit import SolveError, backward_euler

RESIDUAL = 1e-9
"""Force left on any free vertex, as part of the largest force that acts on one."""

CONTACT_RESIDUAL = 1e-4
"""The same as part of the heaviest vertex's weight where contact, which is not smooth, holds the cloth."""

EPSILON = 8.0 * float(np.finfo(float).eps)
"""What a coordinate loses of the positions that it is measured from."""

NUDGE, SLOWEST_FALL = 1e-5, 30.0
"""Part of the cloth's size by which it is moved off a saddle, and the time [s] in which that leaves it."""

MOST_STEPS, MOST_CONTACT_STEPS = 400, 6000
"""Steps after which there is taken to be no equilibrium."""

SHORTEST, LONGEST, GROWTH = 1e-4, 1e4, 4.0
"""Bounds of the implicit steps [s], and how much longer the next one is where a step went well."""


class EquilibriumError(RuntimeError):
    """No equilibrium was found; the message says how far from one the cloth was left."""


def equilibrium(scene: Scene | str | Path | dict[str, Any], **overrides: Any) -> Simulation:
    """A simulation of `scene` at static rest, velocities zero and time zero.

    The forces that are left are below 1e-9 of the largest that acts on a vertex; with obstacles, below 1e-4
    of a vertex's weight.

    Args:
        scene: As for Simulation.
        overrides: Settings that differ from the scene's.

    Raises:
        SceneError, ValueError: As Simulation; ValueError also for cloth that nothing holds up.
        EquilibriumError: where the cloth does not come to rest.
    """
    world = Simulation(scene, **overrides)
    touches = bool(world.scene.obstacle) and world.settings.contact != "none"
    if not touches and any(world.settings.gravity):
        _check_held(world)
    (_relax if touches else _minimise)(world)
    return world


def _check_held(world: Simulation) -> None:
    held = np.zeros(len(world.scene.cloth), dtype=bool)
    held[world.pieces[world.pinned]] = True
    if not held.all():
        piece = int(np.argmin(held))
        raise ValueError(f"cloth[{piece}]: expected a pinned vertex or an obstacle to rest on, got neither")


def _minimise(world: Simulation) -> None:
    model, free = world.model, world.model.free
    settings = msgspec.structs.replace(world.settings, newton=4, tolerance=1e-12, solver="direct")
    x = world.positions.copy()
    still = np.zeros_like(x)
    h, before, left, nudges = world.settings.dt, np.inf, np.inf, np.random.default_rng(world.settings.seed)
    for _ in range(MOST_STEPS):
        left = _residual(world, x)
        if left <= RESIDUAL:
            if _stable(world, x):
                world.place(x)
                return
            size = float(np.ptp(x, axis=0).max())
            x += NUDGE * size * nudges.standard_normal(x.shape) * free[:, None]
            h, before = world.settings.dt, np.inf
            continue
        h = min(GROWTH * h, LONGEST) if left < before else max(0.5 * h, SHORTEST)
        before = left
        try:
            solution = backward_euler(model, NO_GAP_SPRINGS, settings, x, still, h, x, filtered=0)
        except SolveError:
            h = max(0.1 * h, SHORTEST)
            continue
        x = np.where(free[:, None], solution.positions, x)
        model.remember(x)
    raise EquilibriumError(
        f"no equilibrium within {MOST_STEPS} steps: forces of {left:.2g} times the largest are left"
    )


def _stable(world: Simulation, x: np.ndarray) -> bool:
    """Whether the energy is least at `x`, and not a saddle such as cloth that is flat by symmetry alone."""
    world.model.linearise(x, np.zeros_like(x), NO_GAP_SPRINGS, SLOWEST_FALL, exact=True)
    unused = np.zeros_like(x)
    return solve_directly(world.model.matrix, world.model.free, world.masses, unused, unused.copy())[1]


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


def _relax(world: Simulation) -> None:
    weight = float(world.masses.max() * np.linalg.norm(world.settings.gravity))
    kinetic, stopped, left = 0.0, False, np.inf
    for _ in range(MOST_CONTACT_STEPS):
        world.step()
        energy = world.energy()["kinetic"]
        if stopped:  # this step began at rest: what it gained are the forces that are left
            pushes = world.masses * np.linalg.norm(world.velocities, axis=1) / world.settings.dt
            left = float(pushes.max()) / (weight or 1.0)
            if left <= CONTACT_RESIDUAL:
                world.place(world.positions)
                return
        stopped = energy < kinetic
        kinetic = 0.0 if stopped else energy
        if stopped:
            world.stop()
    raise EquilibriumError(
        f"no equilibrium within {MOST_CONTACT_STEPS} steps: {left:.2g} of the largest weight is left"
    )
