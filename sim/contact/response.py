"""How cloth answers the contacts that detection found.

Most responses first make contacts part of the implicit solve: a gap spring with K = s μ / h², so that one
step takes back s / (1 + s) of an overlap. What sets them apart:

- penalty: damped while the gap closes, and nothing more. Fast or heavy cloth sinks in, and with static
  detection tunnels; no guarantee.
- impulse: stiffer springs that recover only a tenth of an overlap per step (Bridson, Fedkiw and Anderson
  2002), then inelastic impulses until continuous detection finds nothing that would meet.
- postprocess: the step is solved as if nothing were there, then vertices are put where they do not overlap.
  Cheap; it loses volume, and friction acts on nothing but the speed that it takes away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.compiled import dot, kernel, norm, row, scale
from sim.contact.contacts import Contacts, lack_of
from sim.contact.friction import give, passing_of, shift, slip_of


@dataclass(frozen=True)
class Response:
    """What sets one response apart.

    Attributes:
        stiffness: s in K = s μ / h².
        damping: Damping ratio of a gap spring while the gap closes.
        recovery: Part of an overlap that one step aims to take back.
        impulses: Whether impulses end the step.
        carries: Whether gap springs begin with the force that contacts pressed with in the step before.
        solved: Whether a solve feels its gap springs; else they push as they did at the start of the step.
        projects: Whether nothing is felt, and overlaps are taken out of the positions after the step.
    """

    stiffness: float
    damping: float
    recovery: float
    impulses: bool
    carries: bool = False
    solved: bool = True
    projects: bool = False


RESPONSES = {
    "penalty": Response(10.0, 1.0, 1.0, False),
    "impulse": Response(100.0, 0.0, 0.1, True, carries=True),
    "postprocess": Response(0.0, 0.0, 1.0, False, solved=False, projects=True),
}

RECOVERY_SPEED = 0.2
"""Speed [m/s] at which an overlap is taken back at most: cloth found deep inside rises, and is not thrown."""

MOST_SWEEPS = 20
"""Gauss–Seidel sweeps over the contacts at a time."""

PROJECTIONS = 4
"""Passes over the contacts that projection makes."""

RESTING = 1e-12
"""A lack of gap [m] that is rounding and asks for no impulse."""


def targets(response: Response, contacts: Contacts, h: float) -> np.ndarray:
    """(c,) gap [m] that each contact should have after a step of h [s]; overlap is recovered in part."""
    overlap = np.maximum(contacts.thickness - contacts.start, 0.0)
    return contacts.thickness - overlap + np.minimum(response.recovery * overlap, RECOVERY_SPEED * h)


def lacks(response: Response, contacts: Contacts, positions: np.ndarray, h: float) -> np.ndarray:
    """(c,) how far each contact at `positions` (n, 3) is short of its target [m]; negative if it is not."""
    return targets(response, contacts, h) - contacts.gaps(positions)


@kernel
def push_apart(contacts, targets, masses, inverse_masses, h, positions, velocities, given):
    """Projected Gauss–Seidel: give contacts the least inelastic impulses that keep their targets.

    `masses` (c,) are those that the contacts move. Adds to what is `given` (c,) [N s], which is never
    negative: what a contact gave too much, as others then helped, it takes back. Returns the number of
    contacts that the last sweep still changed.
    """
    changed = 0
    for _ in range(MOST_SWEEPS):
        changed = 0
        for c in range(len(given)):
            if masses[c] == np.inf:
                continue
            n = row(contacts.normal, c)
            lack = lack_of(contacts, positions, c, targets[c])
            if lack > RESTING or (lack < -RESTING and given[c] > 0.0):
                impulse = max(masses[c] * lack / h, -given[c])
                given[c] += impulse
                changed += 1
                give(contacts, c, inverse_masses, scale(impulse, n), h, positions, velocities)
        if changed == 0:
            break
    return changed


@kernel
def project(contacts, friction, masses, inverse_masses, positions, velocities, rubbed):
    """Put contacts that are nearer than their thickness at it, and take off the speed at which they close.

    Positions change and velocities do not follow them; the speed taken off brings friction with it. Adds what
    friction changes velocities by to `rubbed` (n, 3) [m/s], and returns the work [J] that the motion of the
    other sides puts in by pushing and by friction.
    """
    pushed = dragged = 0.0
    for _ in range(PROJECTIONS):
        for c in range(len(masses)):
            n, speed = row(contacts.normal, c), row(contacts.speed, c)
            lack = lack_of(contacts, positions, c, contacts.thickness[c])
            if lack > 0.0 and masses[c] < np.inf:
                shift(contacts, c, inverse_masses, scale(masses[c] * lack, n), positions)
                closing = dot(n, passing_of(contacts, velocities, c))
                if closing < 0.0:
                    slip = slip_of(contacts, velocities, c)
                    part = min(-friction * closing / max(norm(slip), 1e-300), 1.0)
                    push, drag = scale(-masses[c] * closing, n), scale(-masses[c] * part, slip)
                    for impulse in (push, drag):
                        shift(contacts, c, inverse_masses, impulse, velocities)
                    shift(contacts, c, inverse_masses, drag, rubbed)
                    pushed += dot(push, speed)
                    dragged += dot(drag, speed)
    return pushed, dragged
