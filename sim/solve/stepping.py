"""One step of the integrator that the settings ask for, with the implicit kernel to solve its stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.contact.gap import GapSprings
from sim.integrators import CALM, INTEGRATORS, State, Step
from sim.ledger import Tally
from sim.model import Model
from sim.settings import Settings
from sim.solve.implicit import Solution, backward_euler

GROWTH = 0.5
"""Part of the kinetic energy at both ends by which a step of a method that damps may raise the energy.

Of springs that are linear a method of one step that damps never raises it; where they turn and buckle within
the step it may, and then soon does without bounds. BDF2 raises that of a single spring now and then."""


def take_step(
    model: Model,
    contacts: GapSprings,
    settings: Settings,
    x: np.ndarray,
    v: np.ndarray,
    previous: State | None,
    tally: Tally | None = None,
    guess: np.ndarray | None = None,
) -> tuple[Solution, str]:
    """The state settings.dt after (`x`, `v`), and the name of the integrator that took it there.

    Args:
        model: Springs and masses.
        contacts: What the step must feel; where there is any, an implicit step is one of backward Euler, as
            it is where an integrator that damps would raise the energy.
        settings: integrator, dt, and what `backward_euler` reads.
        x: (n, 3) positions [m].
        v: (n, 3) velocities [m/s], zero for pinned vertices.
        previous: The state one step before, where the integrator may use it.
        tally: Of a ledger, to be integrated along with the state.
        guess: (n, 3) velocities near those at its end, where a step much like it has been solved [m/s].

    Raises:
        SolveError: as `backward_euler`.
    """
    name = settings.integrator
    if INTEGRATORS[name].implicit and len(contacts.drag):
        name = CALM
    given = model, contacts, settings, x, v
    end = _advanced(name, *given, previous, tally, guess)
    chosen = INTEGRATORS[name]
    if name != CALM and chosen.calms and not chosen.looks_back and _grew(model, settings, x, v, end):
        name = CALM
        end = _advanced(name, *given, None, tally, guess)
    return end, name


def _grew(model: Model, settings: Settings, x: np.ndarray, v: np.ndarray, end: Solution) -> bool:
    """Whether a step from (`x`, `v`) that feels no contact ends with energy that nothing gave it."""
    gain, before, after, blown = model.gain(x, v, end.positions, end.velocities, settings.dt)
    return not gain <= blown + GROWTH * (before + after)  # also where it is no number


def _advanced(
    name: str,
    model: Model,
    contacts: GapSprings,
    settings: Settings,
    x: np.ndarray,
    v: np.ndarray,
    previous: State | None,
    tally: Tally | None,
    guess: np.ndarray | None,
) -> Solution:
    """The end of a step of the integrator `name`."""
    stages: list[Solution] = []
    n = len(x)

    def solve(x_hat: np.ndarray, v_hat: np.ndarray, h: float) -> State:
        start = stages[-1].positions if stages else x
        kernel = model, contacts, settings, x_hat[:n], v_hat[:n], h, start
        near = None if stages else guess
        stages.append(backward_euler(*kernel, booked=tally is not None, guess=near))
        if tally is not None:
            return tally.after(stages[-1], v_hat, h)
        return stages[-1].positions, stages[-1].velocities

    def acceleration(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        if tally is not None:
            return tally.rates(x[:n], v[:n])
        return model.accelerations(x, v) + model.inverse_masses[:, None] * contacts.forces(x, v)

    begin, earlier = (x, v), previous
    if tally is not None:
        begin = tally.state(x, v)
        earlier = None if previous is None else tally.earlier(*previous, v)
    end_x, end_v = INTEGRATORS[name].advance(Step(*begin, settings.dt, earlier, solve, acceleration))
    end = {"positions": end_x[:n], "velocities": end_v[:n], "rows": None if tally is None else end_v[n:]}
    if not stages:
        return Solution(**end, iterations=0, newton=0, residual=0.0, converged=True)
    return replace(
        stages[-1],
        **end,
        iterations=sum(stage.iterations for stage in stages),
        newton=sum(stage.newton for stage in stages),
        residual=max(stage.residual for stage in stages),
        converged=all(stage.converged for stage in stages),
    )
