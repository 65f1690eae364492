"""One step of the integrator that the settings ask for, with the implicit kernel to solve its stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.contact.gap import GapSprings
from sim.integrators import INTEGRATORS, State, Step
from sim.model import Model
from sim.settings import Settings
from sim.solve.implicit import Solution, backward_euler


def take_step(
    model: Model,
    contacts: GapSprings,
    settings: Settings,
    x: np.ndarray,
    v: np.ndarray,
    previous: State | None,
) -> tuple[Solution, str]:
    """The state settings.dt after (`x`, `v`), and the name of the integrator that took it there.

    Args:
        model: Springs and masses.
        contacts: What the step must feel; where there is any, an implicit step is one of backward Euler.
        settings: integrator, dt, and what `backward_euler` reads.
        x: (n, 3) positions [m].
        v: (n, 3) velocities [m/s], zero for pinned vertices.
        previous: The state one step before, where the integrator may use it.

    Raises:
        SolveError: as `backward_euler`.
    """
    name = settings.integrator
    if INTEGRATORS[name].implicit and len(contacts.drag):
        name = "backward_euler"
    stages: list[Solution] = []

    def solve(x_hat: np.ndarray, v_hat: np.ndarray, h: float) -> State:
        start = stages[-1].positions if stages else x
        stages.append(backward_euler(model, contacts, settings, x_hat, v_hat, h, start))
        return stages[-1].positions, stages[-1].velocities

    def acceleration(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return model.accelerations(x, v) + model.inverse_masses[:, None] * contacts.forces(x, v)

    end = INTEGRATORS[name].advance(Step(x, v, settings.dt, previous, solve, acceleration))
    if not stages:
        return Solution(*end, iterations=0, newton=0, residual=0.0, converged=True), name
    total = replace(
        stages[-1],
        positions=end[0],
        velocities=end[1],
        iterations=sum(stage.iterations for stage in stages),
        newton=sum(stage.newton for stage in stages),
        residual=max(stage.residual for stage in stages),
        converged=all(stage.converged for stage in stages),
    )
    return total, name
