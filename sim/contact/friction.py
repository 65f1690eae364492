"""Coulomb friction, |Jt| ≤ μ Jn.

The implicit solve must feel friction, or cloth would never hang on what holds it. It feels the drag d = μ λ
/ slip with the normal force λ and the slip that are expected; where that turns out to hold two sides together
by more than the cone allows, both are estimated anew and the solve goes on from where it was. A drag never
adds energy, whatever its size. After the solve slow contacts are stopped, each by itself, so far as the cone
still allows, and impulses given after it bring friction of their own.
"""

import numpy as np

from sim.compiled import Vec3, add, dot, inner, kernel, norm, put, row, scale, sub

CREEP = 1e-4
"""Smallest slip [m/s] that a drag is estimated with."""

SLOW = 5e-3
"""What slides no faster [m/s] is stopped after the solve, so far as its cone allows. To stop what is faster
one vertex at a time would strain the springs between them."""

STEADY = 0.7
"""Part of its slip that a sliding contact is expected to keep in a step at least; less may be too little."""

EXCESS = 1.001
"""Friction this many times what the cone allows is worth another solve."""

LACKING = 0.1
"""Part of the friction of all that slides that a solve may leave out, where it estimated slips too large."""


def first_drag(bound: np.ndarray, slip: np.ndarray, mass: np.ndarray, h: float) -> np.ndarray:
    """(c,) drag [kg/s] to expect before the first solve of a step.

    Args:
        bound: (c,) the most that friction takes from each contact, by what presses it [N].
        slip: (c,) at the start of the step, or expected after the one before [m/s].
        mass: (c,) [kg].
        h: Length of the step [s].
    """
    slowed = np.maximum(slip - bound * h / mass, STEADY * slip)
    return bound / np.maximum(slowed, CREEP)


@kernel
def expected_drag(contacts, held_drag, pieces, piece_masses, velocities, pushes, friction, h, drag):
    """Fill the `drag` to expect after a solve that ended at `velocities`.

    Returns the worst excess, and the part of what the cones allow that sliding contacts were not given.

    The slip expected is that of the solve, or more where a whole piece is about to break away: the piece then
    gains what friction held it by beyond the cones, less what all its other contacts can yet hold, over its
    mass. While those have more to spare than is held beyond the cones, it breaks away nowhere.
    """
    worst, lacking, allowed = 0.0, 0.0, 1e-300
    gain = np.zeros((len(piece_masses), 3))
    excess, spare = np.zeros(len(piece_masses)), np.zeros(len(piece_masses))
    for c in range(len(drag)):
        slip = slip_of(contacts, velocities, c)
        found = norm(slip)
        beyond = h * held_drag[c] * found - friction * pushes[c]
        allowed += friction * pushes[c]
        if found > CREEP:
            lacking += max(-beyond, 0.0)
        if beyond > 0.0 or found > CREEP:
            worst = max(worst, 1.0 + beyond / max(friction * pushes[c], 1e-300))
        for a in range(4):
            piece, weight = pieces[contacts.node[c, a]], contacts.weight[c, a]
            if beyond > 0.0:
                part = weight * beyond / (found * piece_masses[piece])
                put(gain, piece, add(row(gain, piece), scale(part, slip)))
                excess[piece] += abs(weight) * beyond
            else:
                spare[piece] -= abs(weight) * beyond
    for p in range(len(piece_masses)):
        part = max(1.0 - spare[p] / max(excess[p], 1e-300), 0.0)
        put(gain, p, scale(part, row(gain, p)))
    for c in range(len(drag)):
        slip = slip_of(contacts, velocities, c)
        ahead = slip
        for a in range(4):
            ahead = add(ahead, scale(contacts.weight[c, a], row(gain, pieces[contacts.node[c, a]])))
        fast = norm(slip)
        if dot(slip, ahead) >= 0.0:  # else it would turn about, which friction does not make it do
            fast = max(fast, norm(ahead))
        drag[c] = friction * pushes[c] / h / max(fast, CREEP)
    return worst, lacking / allowed


@inner
def passing_of(contacts, velocities, c):
    """Velocity [m/s] of one side of contact c relative to the other."""
    u, v, w = -contacts.speed[c, 0], -contacts.speed[c, 1], -contacts.speed[c, 2]
    for a in range(4):
        i, s = contacts.node[c, a], contacts.weight[c, a]
        u += s * velocities[i, 0]
        v += s * velocities[i, 1]
        w += s * velocities[i, 2]
    return Vec3(u, v, w)


@inner
def slip_of(contacts, velocities, c):
    """Velocity [m/s] of one side of contact c past the other, across the normal."""
    passing, n = passing_of(contacts, velocities, c), row(contacts.normal, c)
    return sub(passing, scale(dot(n, passing), n))


@kernel
def rub(contacts, masses, inverse_masses, h, positions, velocities, allowed):
    """Slow each sliding contact by an impulse across its normal of no more than is `allowed` (c,) [N s].

    `masses` (c,) are those that the contacts move, infinite where they move nothing. Returns the work [J] of
    these impulses that the motion of the contacts' other sides puts in.
    """
    carried = 0.0
    for c in range(len(allowed)):
        slip = slip_of(contacts, velocities, c)
        speed = norm(slip)
        if speed > 0.0 and allowed[c] > 0.0 and masses[c] < np.inf:
            shove = scale(-min(allowed[c] / speed, masses[c]), slip)
            give(contacts, c, inverse_masses, shove, h, positions, velocities)
            carried += dot(shove, row(contacts.speed, c))
    return carried


@inner
def give(contacts, c, inverse_masses, impulse, h, positions, velocities):
    """Let the two sides of contact c part by `impulse` [N s]; positions follow the velocities for h [s]."""
    shift(contacts, c, inverse_masses, impulse, velocities)
    shift(contacts, c, inverse_masses, scale(h, impulse), positions)


@inner
def shift(contacts, c, inverse_masses, impulse, vectors):
    """Add to each vertex of contact c its share of `impulse` over its mass."""
    for a in range(4):
        i = contacts.node[c, a]
        s = contacts.weight[c, a] * inverse_masses[i]
        if s != 0.0:
            vectors[i, 0] += s * impulse.x
            vectors[i, 1] += s * impulse.y
            vectors[i, 2] += s * impulse.z
