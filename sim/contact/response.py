"""How cloth answers the contacts that detection found.

Every response first makes contacts part of the implicit solve: a gap spring with K = s m / h², so that one
step takes back s / (1 + s) of an overlap. What sets them apart:

- penalty: damped while the vertex approaches, and nothing more. Fast or heavy cloth sinks in, and with
  static detection tunnels; no guarantee.
- impulse: stiffer springs that recover only a tenth of an overlap per step (Bridson, Fedkiw and Anderson
  2002), then inelastic impulses that leave no free vertex on the wrong side of a plane that detection
  showed it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.compiled import dot, kernel, row
from sim.contact.detect import Contacts


@dataclass(frozen=True)
class Response:
    """What sets one response apart.

    Attributes:
        stiffness: s in K = s m / h².
        damping: Damping ratio of a gap spring while the gap closes.
        recovery: Part of an overlap that one step aims to take back.
        impulses: Whether impulses end the step.
        solved: Whether a solve feels its gap springs; else they push as they did at the start of the step.
    """

    stiffness: float
    damping: float
    recovery: float
    impulses: bool
    solved: bool = True


RESPONSES = {"penalty": Response(10.0, 1.0, 1.0, False), "impulse": Response(100.0, 0.0, 0.1, True)}

RECOVERY_SPEED = 0.2
"""Speed [m/s] at which an overlap is taken back at most: cloth found deep inside rises, and is not thrown."""

MOST_SWEEPS = 20
"""Gauss–Seidel sweeps over the contacts; only a vertex between several obstacles needs more than one."""

RESTING = 1e-12
"""A lack of gap [m] that is rounding and asks for no impulse."""


def targets(response: Response, contacts: Contacts, thickness: float, h: float) -> np.ndarray:
    """(c,) gap [m] that each vertex should have after a step of h [s]: an overlap is recovered in part."""
    overlap = np.maximum(thickness - contacts.start, 0.0)
    return thickness - overlap + np.minimum(response.recovery * overlap, RECOVERY_SPEED * h)


def lacks(
    response: Response, contacts: Contacts, positions: np.ndarray, thickness: float, h: float
) -> np.ndarray:
    """(c,) how far each vertex at `positions` (n, 3) is short of its target [m]; negative where it is not."""
    gap = np.einsum("ij,ij->i", contacts.normal, positions[contacts.vertex]) - contacts.offset
    return targets(response, contacts, thickness, h) - gap


@kernel
def push_out(contacts, targets, masses, h, positions, velocities, impulses):
    """Give every vertex that is nearer than its target the inelastic impulse that keeps the target.

    Adds to `impulses` (c,) [N s], and returns the number of vertices still too near after the last sweep.
    """
    pushed = 0
    for _ in range(MOST_SWEEPS):
        pushed = 0
        for c in range(len(contacts.vertex)):
            i = contacts.vertex[c]
            n = row(contacts.normal, c)
            lack = targets[c] + contacts.offset[c] - dot(n, row(positions, i))
            if lack > RESTING:
                pushed += 1
                impulses[c] += masses[i] * lack / h
                for r in range(3):
                    positions[i, r] += lack * contacts.normal[c, r]
                    velocities[i, r] += lack / h * contacts.normal[c, r]
        if pushed == 0:
            break
    return pushed
