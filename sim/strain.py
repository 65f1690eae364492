"""Strain limiting: after the solve, impulses along edges let none be longer than its limit.

Edges then are inextensible beyond a strain, as woven cloth is that gives way at first and then no more
(Provot 1995; Bridson, Marino and Fedkiw 2003). An impulse only pulls, and acts alike on both ends of an edge,
along the line through where they end: so linear momentum stays as it is, and angular momentum as it does with
the springs of an implicit step, which act along that line, too.

All impulses are solved for at once: λ ≥ 0 that minimise ½ λᵀ A λ − λᵀ excess, A = J M⁻¹ Jᵀ, and again where
the edges have turned on the way (compare Goldenthal et al. 2007). Sweeps from edge to edge would need as many
of them as the square of the edges from one end of the cloth to the other.

It comes before contact has its say: where cloth cannot both keep its limit and stay out of something, it
stays out. What is left over the limit is reported.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import add, dot, inner, kernel, norm, put, row, scale, sub

MOST_ROUNDS = 40
"""Solves of one step at most."""

ENOUGH = 2e-4
"""Strain beyond the limit that is left alone."""

MOST_ITERATIONS = 400
"""Of a solve."""

REMAINDER = 0.02
"""Part of the error at its start that a solve leaves; the next one sees to it."""

SLACK = 1e-5
"""Part of its diagonal that is added to A, as more edges may be taut than vertices can do anything about."""

BALANCE = 1.0
"""How much larger than among the edges that pull the gradient may be that lets others pull, too."""


class Limit(NamedTuple):
    """Edges and room to solve for their impulses.

    Attributes:
        edges: (e, 2) vertices.
        rest: (e,) rest lengths [m].
        valence: The most edges that a vertex has.
        free: (3,) one for each coordinate that may change, zero for that which the scene keeps.
        direction: (e, 3) along them, of length 1/√(1/m_i + 1/m_j) [√kg], zero where both ends are fixed; of
            that what is `free`.
        excess: (e,) over the limit, times that [m √kg].
        pull: (e,) λ ≥ 0 over that [m √kg].
        work: (3, e) gradient, direction of search and its product with A.
        moved: (n, 3) room for M⁻¹ Jᵀ p.
    """

    edges: np.ndarray
    rest: np.ndarray
    valence: int
    free: np.ndarray
    direction: np.ndarray
    excess: np.ndarray
    pull: np.ndarray
    work: np.ndarray
    moved: np.ndarray


def make_limit(edges: np.ndarray, rest_vertices: np.ndarray, axis: int | None = None) -> Limit:
    """The edges (e, 2) of a mesh with `rest_vertices` (n, 3) [m], which do not move along `axis`."""
    e, ends = len(edges), rest_vertices[edges]
    rest, valence = (
        np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
        int(np.bincount(edges.ravel()).max(initial=1)),
    )
    room = np.zeros((e, 3)), np.zeros(e), np.zeros(e), np.zeros((3, e)), np.zeros_like(rest_vertices)
    return Limit(edges, rest, valence, np.array([float(k != axis) for k in range(3)]), *room)


@kernel
def shorten(limit, strain, inverse_masses, h, positions, velocities):
    """Let no edge be longer than 1 + `strain` times its rest length at the end of a step of h [s].

    `inverse_masses` (n,) [1/kg] are zero for what cannot move. Changes `positions` (n, 3) [m] and
    `velocities` (n, 3) [m/s].

    Returns:
        The largest strain that is left, and how many edges pull.
    """
    limit.pull[:] = 0.0
    worst = _exceed(limit, strain, inverse_masses, positions)
    for _ in range(MOST_ROUNDS):
        if worst <= strain + ENOUGH:
            break
        _solve(limit, inverse_masses)
        for i in range(len(positions)):
            d = row(limit.moved, i)
            put(positions, i, add(row(positions, i), d))
            put(velocities, i, add(row(velocities, i), scale(1.0 / h, d)))
        worst = _exceed(limit, strain, inverse_masses, positions)
    pulling = 0
    for e in range(len(limit.pull)):
        pulling += limit.pull[e] > 0.0
    return worst, pulling


@inner
def _exceed(limit, strain, inverse_masses, positions):
    """Fill directions and excess at `positions`, and return the largest strain of what can move."""
    worst = -1.0
    for e in range(len(limit.rest)):
        i, j = limit.edges[e, 0], limit.edges[e, 1]
        inverse, d = inverse_masses[i] + inverse_masses[j], sub(row(positions, j), row(positions, i))
        length = norm(d)
        size = 1.0 / np.sqrt(inverse) if inverse > 0.0 else 0.0
        along = size / length if length > 0.0 else 0.0
        for r in range(3):
            limit.direction[e, r] = limit.free[r] * along * (positions[j, r] - positions[i, r])
        limit.excess[e] = size * (length - (1.0 + strain) * limit.rest[e])
        if inverse > 0.0:
            worst = max(worst, length / limit.rest[e] - 1.0)
    return worst


@inner
def _solve(limit, inverse_masses):
    """Minimise over λ ≥ 0 from those of the round before; leave where this moves vertices in `moved`.

    Conjugate gradients among the edges that pull, steepest descent to let others pull, and a projected step
    where one ceases to pull (MPRGP; Dostál and Schöberl 2005). None of these raises what is minimised.
    """
    x, g, p, q = limit.pull, limit.work[0], limit.work[1], limit.work[2]
    given = limit.pull.copy()
    longest = 1.0 / (limit.valence + SLACK)
    for e in range(len(x)):
        g[e] = -limit.excess[e]
        p[e] = g[e] if x[e] > 0.0 else 0.0
    enough = -1.0
    for _ in range(MOST_ITERATIONS):
        pulls = joins = balance = 0.0
        for e in range(len(x)):
            if x[e] > 0.0:
                pulls += g[e] * g[e]
                balance += g[e] * min(x[e] / longest, g[e])
            elif g[e] < 0.0:
                joins += g[e] * g[e]
        if enough < 0.0:
            enough = REMAINDER * REMAINDER * (pulls + joins)
        if pulls + joins <= enough:
            break
        if joins > BALANCE * balance:
            for e in range(len(x)):
                p[e] = g[e] if x[e] <= 0.0 and g[e] < 0.0 else 0.0
        curvature, slope, feasible = _multiply(limit, inverse_masses, p, q), 0.0, np.inf
        for e in range(len(x)):
            slope += g[e] * p[e]
            if p[e] > 0.0:
                feasible = min(feasible, x[e] / p[e])
        if not curvature > 0.0:
            break
        step = min(slope / curvature, feasible)
        for e in range(len(x)):
            x[e] = max(x[e] - step * p[e], 0.0)
            g[e] -= step * q[e]
        if step < feasible:
            again = 0.0
            for e in range(len(x)):
                again += g[e] * q[e] if x[e] > 0.0 else 0.0
            again /= curvature
            for e in range(len(x)):
                p[e] = (g[e] if x[e] > 0.0 else 0.0) - again * p[e]
            continue
        for e in range(len(x)):
            if x[e] > 0.0:
                x[e] = max(x[e] - longest * g[e], 0.0)
            q[e] = x[e] - given[e]
        _multiply(limit, inverse_masses, q, g)
        for e in range(len(x)):
            g[e] -= limit.excess[e]
            p[e] = g[e] if x[e] > 0.0 else 0.0
    for e in range(len(x)):
        p[e] = x[e] - given[e]
    _move(limit, inverse_masses, p)


@inner
def _move(limit, inverse_masses, p):
    """Fill `moved` = M⁻¹ Jᵀ p."""
    moved = limit.moved
    moved[:] = 0.0
    for e in range(len(p)):
        if p[e] != 0.0:
            i, j, d = limit.edges[e, 0], limit.edges[e, 1], row(limit.direction, e)
            put(moved, i, add(row(moved, i), scale(p[e] * inverse_masses[i], d)))
            put(moved, j, sub(row(moved, j), scale(p[e] * inverse_masses[j], d)))


@inner
def _multiply(limit, inverse_masses, p, q):
    """Fill q = (A + SLACK) p and return pᵀ q."""
    _move(limit, inverse_masses, p)
    moved, total = limit.moved, 0.0
    for e in range(len(p)):
        i, j = limit.edges[e, 0], limit.edges[e, 1]
        q[e] = dot(row(limit.direction, e), sub(row(moved, i), row(moved, j))) + SLACK * p[e]
        total += p[e] * q[e]
    return total
