"""Whether a step put in more energy than anything there could have given: then it is not taken.

Impulses move vertices without asking the springs, and a linearised step tells little of what happens to cloth
that is stopped within an edge's length; in steps that are short enough neither matters.
"""

from __future__ import annotations

import numpy as np

from sim.contact.contacts import Contacts
from sim.contact.response import RECOVERY_SPEED
from sim.model import Model
from sim.settings import Settings
from sim.solve.implicit import Solution

GROWTH = 0.1
"""Part of the kinetic energy by which a step may raise the energy and still be a good one."""


def erupts(
    model: Model,
    settings: Settings,
    contacts: Contacts,
    pressed: np.ndarray,
    x: np.ndarray,
    v: np.ndarray,
    solved: Solution,
    end: Solution,
) -> str:
    """What put in more energy than obstacles can have given, or overlaps that were recovered.

    Returns "impulses" where those after the solve did that by themselves, else "solve"; "" where nothing did.

    Args:
        model: Springs and masses.
        settings: Of the step.
        contacts: All that it met.
        pressed: (c,) what each of them gave [N s].
        x: (n, 3) positions at its start [m].
        v: (n, 3) velocities there [m/s].
        solved: Its end before impulses.
        end: Its end.
    """
    if not len(contacts.key):
        return ""
    mass, speed = model.masses, np.linalg.norm(contacts.speed, axis=1)
    moved = np.unique(contacts.node[contacts.weight != 0.0])
    work = (1.0 + settings.friction) * float(pressed @ speed)
    thrown = 2.0 * mass[moved].sum() * speed.max() ** 2
    lifted = 0.5 * RECOVERY_SPEED**2 + settings.thickness * float(np.linalg.norm(settings.gravity))
    gain, before, after, blown = model.gain(x, v, end.positions, end.velocities, settings.dt)
    allowed = blown + thrown + mass.sum() * lifted + GROWTH * before
    # What obstacles press goes into springs; what they set in motion is no faster than they throw it.
    excess = max(gain - allowed - work, min(gain, after - before) - allowed)
    limiting = _by_limiting(model, settings, solved) if excess > 0.0 else 0.0
    if not excess > limiting:
        return ""
    by_solve = model.gain(x, v, solved.positions, solved.velocities, settings.dt)[0]
    return "impulses" if gain - by_solve > allowed else "solve"


def _by_limiting(model: Model, settings: Settings, end: Solution) -> float:
    """Energy [J] that strain limiting put in after a solve, which it does in shorter steps, too."""
    if end.limited is None:
        return 0.0
    given = model.inverse_masses[:, None] * end.limited
    x, v = end.positions, end.velocities
    return max(model.gain(x - settings.dt * given, v - given, x, v, settings.dt)[0], 0.0)
