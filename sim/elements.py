"""What every scalar coordinate q(x) with gradient g = ∂q/∂x shares, whatever kind of spring or contact it is.

    energy  ½ K (q − q0)²      force on node a  −s g_a,  s = K (q − q0) + b q̇,   q̇ = Σ g_a·v_a − drift
    damping b = γ · 2 √(μ K),  1/μ = Σ |g_a|² / m_a
    matrix  block(a, b) = along g_a g_bᵀ + across (g_a·g_b) S

The matrix is that of an implicit step h: M + h D + h² H. Its exact form has along = h b + h² K, and on top of
that h² K (q − q0) ∇²q (`sim.solve.system.add_curvature`). The filtered form, positive semi-definite in every
element, keeps of ∇²q what tension makes stiff: K_t = K max(0, 1 − q0/q), clamped in compression (Choi and Ko
2002). A length has it across its whole direction, S = I, so that along = h b + h² (K − K_t); a height only
along the normal m of its triangle, S = mmᵀ; of other coordinates nothing is kept (Gauss–Newton).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, corner, dot, inner, kernel, norm, parallel_kernel, row, scale, share

NONE, LINE, LENGTH, NORMAL = range(4)
"""What S is: nothing; nothing, of gradients that are all along one line; or of such, too, I, or mmᵀ with the
unit vector m that the element's memory begins with."""


class Elements(NamedTuple):
    """The elements of one kind, e of them with k nodes each, as arrays.

    Attributes:
        nodes: (e, k) int32.
        rest: (e,) q0, in the unit of q.
        stiffness: (e,) K.
        damping: (e,) b, set where the matrix is.
        drift: (e,) speed of the coordinate's other side: zero for springs, an obstacle's for contacts.
        q: (e,) the coordinate.
        gradient: (e, k, 3).
        memory: (e, ·) what the coordinate remembers of the last step.
        new_memory: (e, ·) what it will remember of this one if it is accepted.
        tension: (e,) s.
        along: (e,) factor of g gᵀ in the matrix.
        weight: (e, k) w, where the kind has such: g_a = w_a n with one unit vector n.
        tensor: (e, 6) then along nnᵀ + across S: xx, xy, xz, yy, yz, zz; block(a, b) = w_a w_b times that.
    """

    nodes: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    drift: np.ndarray
    q: np.ndarray
    gradient: np.ndarray
    memory: np.ndarray
    new_memory: np.ndarray
    tension: np.ndarray
    along: np.ndarray
    weight: np.ndarray
    tensor: np.ndarray


def make_elements(nodes: np.ndarray, memory: int) -> Elements:
    """Elements on the (e, k) `nodes`, all quantities zero."""
    e, k = nodes.shape
    arrays: dict[str, np.ndarray]
    arrays = {name: np.zeros(e) for name in Elements._fields}
    arrays["nodes"] = np.ascontiguousarray(nodes, dtype=np.int32)
    arrays["gradient"] = np.zeros((e, k, 3))
    arrays["memory"] = np.zeros((e, memory))
    arrays["new_memory"] = np.zeros((e, memory))
    arrays["weight"] = np.zeros((e, k))
    arrays["tensor"] = np.zeros((e, 6))
    return Elements(**arrays)


class Pool(NamedTuple):
    """What matrix and forces are made of, of all kinds' elements one after the other.

    Attributes:
        gradient: (s, 3), for the s nodes of all e elements.
        weight: (s,).
        tension: (e,).
        along: (e,).
        tensor: (e, 6).
    """

    gradient: np.ndarray
    weight: np.ndarray
    tension: np.ndarray
    along: np.ndarray
    tensor: np.ndarray


def pooled(kinds: list[Elements]) -> tuple[Pool, list[Elements]]:
    """A pool, and the elements of each of the `kinds`, one or more, with their part of it for arrays."""

    def whole(name: str, *shape: int) -> np.ndarray:
        return np.concatenate([getattr(e, name).reshape(-1, *shape) for e in kinds])

    pool = Pool(whole("gradient", 3), whole("weight"), whole("tension"), whole("along"), whole("tensor", 6))
    e = s = 0
    shared = []
    for own in kinds:
        elements, nodes = slice(e, e + len(own.q)), slice(s, s + own.nodes.size)
        shared.append(
            own._replace(
                gradient=pool.gradient[nodes].reshape(own.gradient.shape),
                weight=pool.weight[nodes].reshape(own.nodes.shape),
                tension=pool.tension[elements],
                along=pool.along[elements],
                tensor=pool.tensor[elements],
            )
        )
        e, s = elements.stop, nodes.stop
    return pool, shared


@parallel_kernel
def linearise(elements, velocities, inverse_masses, ratios, h, bends):
    """Do `set_damping`, `set_tension` and `set_matrix_factors` while the elements are in the cache."""
    for chunk in numba.prange(CHUNKS):
        part = share(chunk, len(elements.q))
        _damp(elements, part, inverse_masses, ratios)
        _tense(elements, part, velocities)
        _set_factors(elements, part, h, bends)


@parallel_kernel
def set_damping(elements, inverse_masses, ratios):
    """Fill b = γ · 2 √(μ K) from the present gradient; an element without mass or gradient gets none.

    `ratios` is γ for all, shape (1, 2), or γ as a function of the element's frequency √(K/μ) [rad/s]: rows of
    frequency, ascending, and γ, between which it is linear in the logarithm.
    """
    for chunk in numba.prange(CHUNKS):
        _damp(elements, share(chunk, len(elements.q)), inverse_masses, ratios)


@inner
def _damp(elements, part, inverse_masses, ratios):
    if len(ratios) == 1 and ratios[0, 1] == 0.0:
        for e in range(part[0], part[1]):
            elements.damping[e] = 0.0
        return
    for e in range(part[0], part[1]):
        inverse = 0.0
        for a in range(elements.nodes.shape[1]):
            g = corner(elements.gradient, e, a)
            inverse += dot(g, g) * inverse_masses[elements.nodes[e, a]]
        elements.damping[e] = 0.0
        if inverse > 0.0 and elements.stiffness[e] > 0.0:
            gamma = _ratio_at(ratios, elements.stiffness[e] * inverse)
            elements.damping[e] = 2.0 * gamma * math.sqrt(elements.stiffness[e] / inverse)


@inner
def _ratio_at(ratios, square):
    last = len(ratios) - 1
    if last == 0:
        return ratios[0, 1]
    frequency = math.sqrt(square)
    if frequency <= ratios[0, 0]:
        return ratios[0, 1]
    if frequency >= ratios[last, 0]:
        return ratios[last, 1]
    k = 1
    while ratios[k, 0] < frequency:  # with `searchsorted` this is not inlined, and no faster with two threads
        k += 1
    part = math.log(frequency / ratios[k - 1, 0]) / math.log(ratios[k, 0] / ratios[k - 1, 0])
    return ratios[k - 1, 1] + part * (ratios[k, 1] - ratios[k - 1, 1])


@parallel_kernel
def set_tension(elements, velocities):
    """Fill s = K (q − q0) + b q̇; returns Σ ½ K (q − q0)² [J], which is stored, and Σ b q̇² [W], the loss."""
    sums = np.empty((CHUNKS, 2))
    for chunk in numba.prange(CHUNKS):
        sums[chunk, 0], sums[chunk, 1] = _tense(elements, share(chunk, len(elements.q)), velocities)
    stored = taken = 0.0
    for chunk in range(CHUNKS):
        stored, taken = stored + sums[chunk, 0], taken + sums[chunk, 1]
    return stored, taken


@inner
def _tense(elements, part, velocities):
    stored = taken = 0.0
    for e in range(part[0], part[1]):
        rate = -elements.drift[e]
        for a in range(elements.nodes.shape[1]):
            rate += dot(corner(elements.gradient, e, a), row(velocities, elements.nodes[e, a]))
        stretch = elements.q[e] - elements.rest[e]
        elements.tension[e] = elements.stiffness[e] * stretch + elements.damping[e] * rate
        stored += 0.5 * elements.stiffness[e] * stretch * stretch
        taken += elements.damping[e] * rate * rate
    return stored, taken


@parallel_kernel
def set_matrix_factors(elements, h, bends):
    """Fill along for an implicit step of h [s], and weights and tensors unless S, `bends`, is NONE."""
    for chunk in numba.prange(CHUNKS):
        _set_factors(elements, share(chunk, len(elements.q)), h, bends)


@inner
def _set_factors(elements, part, h, bends):
    for e in range(part[0], part[1]):
        stiffness, transverse = elements.stiffness[e], 0.0
        if bends in (LENGTH, NORMAL) and elements.q[e] > elements.rest[e]:
            transverse = stiffness * (1.0 - elements.rest[e] / elements.q[e])
        if bends == LENGTH:
            stiffness -= transverse
        along, across = h * elements.damping[e] + h * h * stiffness, h * h * transverse
        elements.along[e] = along
        if bends == NONE:
            continue
        n = corner(elements.gradient, e, 0)
        length = norm(n)
        n = scale(1.0 / length if length > 0.0 else 0.0, n)
        for a in range(elements.nodes.shape[1]):
            elements.weight[e, a] = dot(n, corner(elements.gradient, e, a))
        xx, xy, xz = along * n.x * n.x, along * n.x * n.y, along * n.x * n.z
        yy, yz, zz = along * n.y * n.y, along * n.y * n.z, along * n.z * n.z
        if bends == LENGTH:
            xx, yy, zz = xx + across, yy + across, zz + across
        elif across > 0.0:
            m = row(elements.new_memory, e)
            xx, xy, xz = xx + across * m.x * m.x, xy + across * m.x * m.y, xz + across * m.x * m.z
            yy, yz, zz = yy + across * m.y * m.y, yz + across * m.y * m.z, zz + across * m.z * m.z
        t = elements.tensor
        t[e, 0], t[e, 1], t[e, 2], t[e, 3], t[e, 4], t[e, 5] = xx, xy, xz, yy, yz, zz


@kernel
def elastic_energy(elements):
    """Σ ½ K (q − q0)² [J], to the bit as `set_tension` has it."""
    total = 0.0
    for chunk in range(CHUNKS):
        stored, part = 0.0, share(chunk, len(elements.q))
        for e in range(part[0], part[1]):
            stretch = elements.q[e] - elements.rest[e]
            stored += 0.5 * elements.stiffness[e] * stretch * stretch
        total += stored
    return total
