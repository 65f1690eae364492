"""Coulomb friction, |Jt| ≤ μ Jn.

The implicit solve must feel friction, or cloth would never hang on what holds it. It feels the drag d = μ λ
/ slip with the normal force λ and the slip that are expected; where that turns out to hold a vertex by more
than the cone allows, both are estimated anew and the solve goes on from where it was. A drag never adds
energy, whatever its size. What the cone still allows after the solve slows each vertex by itself.
"""

import numpy as np

from sim.compiled import add, corner, dot, inner, kernel, norm, row, scale, sub

CREEP = 1e-4
"""Smallest slip [m/s] that a drag is estimated with; what creeps no faster is stopped after the solve."""

EXCESS = 1.001
"""Friction this many times what the cone allows is worth another solve."""


@kernel
def add_drag(springs, drag, velocities, h, matrix, forces):
    """Add the force −d (I − nnᵀ)(v − speed), d from `drag` (c,), and its part h d (I − nnᵀ) of the matrix."""
    for c in range(len(drag)):
        i = springs.elements.nodes[c, 0]
        n = corner(springs.elements.gradient, c, 0)
        slip = _slip(springs, velocities, c)
        for r in range(3):
            forces[i, r] -= drag[c] * slip[r]
            matrix.diagonal[i, r, r] += h * drag[c]
            for s in range(3):
                matrix.diagonal[i, r, s] -= h * drag[c] * n[r] * n[s]


@kernel
def expected_drag(springs, pieces, piece_masses, velocities, pushes, friction, h, drag):
    """Fill the `drag` to expect after a solve that ended at `velocities`; return the worst excess.

    The slip expected of a vertex is that of the solve, or more where its whole piece is about to break
    away: the piece then gains what friction held it by beyond the cones, over its mass.
    """
    worst = 0.0
    gain = np.zeros((len(piece_masses), 3))
    for c in range(len(drag)):
        i = springs.elements.nodes[c, 0]
        slip = _slip(springs, velocities, c)
        found = norm(slip)
        held = h * springs.drag[c] * found
        if held > friction * pushes[c] or found > CREEP:
            worst = max(worst, held / max(friction * pushes[c], 1e-300))
            for r in range(3):
                gain[pieces[i], r] += (
                    (held - friction * pushes[c]) * slip[r] / (found * piece_masses[pieces[i]])
                )
    for c in range(len(drag)):
        slip = _slip(springs, velocities, c)
        ahead = norm(add(slip, row(gain, pieces[springs.elements.nodes[c, 0]])))
        drag[c] = friction * pushes[c] / h / max(norm(slip), ahead, CREEP)
    return worst


@inner
def _slip(springs, velocities, c):
    """Velocity of contact c's vertex across the normal, relative to the obstacle."""
    passing = sub(row(velocities, springs.elements.nodes[c, 0]), row(springs.speed, c))
    return across(corner(springs.elements.gradient, c, 0), passing)


@inner
def across(n, a):
    """The part of `a` across the unit vector n."""
    return sub(a, scale(dot(n, a), n))


@kernel
def rub(contacts, friction, masses, h, positions, velocities, impulses, drag):
    """Slow each sliding vertex by what the cone of `impulses` (c,) [N s] leaves over the solve's `drag`."""
    for c in range(len(contacts.vertex)):
        i = contacts.vertex[c]
        slip = across(row(contacts.normal, c), sub(row(velocities, i), row(contacts.speed, c)))
        speed = norm(slip)
        over = friction * impulses[c] - h * drag[c] * speed
        if speed > 0.0 and over > 0.0:
            loss = scale(min(over / (masses[i] * speed), 1.0), slip)
            for r in range(3):
                velocities[i, r] -= loss[r]
                positions[i, r] -= h * loss[r]
