"""Impact zones: contacts that share vertices, and are settled all at once where sweeps do not get there.

Their impulses are those of inelastic projection (Harmon, Vouga, Tamstorf and Grinspun 2008), the least that
keep every target: p ≥ 0, A p ≥ b, p·(A p − b) = 0 with A = C M⁻¹ Cᵀ. Principal pivoting finds which of them
act (Júdice and Pires 1994): all wrong guesses change at once as long as they get fewer, else the last one.
"""

from __future__ import annotations

import numpy as np

from sim.compiled import dot, inner, kernel, row, scale
from sim.contact.contacts import Contacts, lack_of
from sim.contact.friction import give
from sim.contact.response import push_apart
from sim.report import StepReport

MOST_IN_ZONE = 256
"""Contacts of a zone that is settled at once at most: the work grows with their cube."""

MOST_PASSES = 4
"""Times that zones are settled, as their impulses may lead into contacts that were none of theirs."""

MOST_PIVOTS = 60
"""Guesses at which contacts act."""

CHANCES = 3
"""Guesses that may be no better than the best before."""

UNSETTLED = 1e-9
"""Part of a contact's thickness by which a gap that was pushed may be off its target."""

DEPENDENT = 1e-11
"""Part of the diagonal that is added, so that of two contacts that say the same neither need be left out."""

FEASIBLE = 1e-6
"""Part of the largest lack that may be left for that."""

WRONG = 1e-10
"""Part of the largest term below which the sign of a sum is rounding."""


def keep_apart(
    contacts: Contacts,
    targets: np.ndarray,
    masses: np.ndarray,
    inverse_masses: np.ndarray,
    h: float,
    positions: np.ndarray,
    velocities: np.ndarray,
    given: np.ndarray,
    report: StepReport,
) -> None:
    """Sweep over the contacts, then settle the zones of those that still lack: see `push_apart`."""
    about = contacts, targets, masses, inverse_masses, h, positions, velocities, given
    if push_apart(*about):
        hopeless = np.zeros(len(positions), dtype=np.int64)
        for _ in range(MOST_PASSES):
            settled, _ = settle_zones(*about, hopeless)
            report.zones += settled
            if not settled:
                break


@kernel
def settle_zones(contacts, targets, masses, inverse_masses, h, positions, velocities, given, hopeless):
    """Replace what the contacts of unsettled zones were `given` (c,) [N s] by impulses that keep all targets.

    `targets` (c,) [m]; `masses` (c,) are those that the contacts move. Returns how many zones were settled,
    and how many could not be: too many contacts, or none of the impulses will do. `hopeless` (n,) has the
    size of the latter where their first vertex is, zero elsewhere: nothing else moves what is theirs, so
    they are not tried again at this size.
    """
    n, count = len(positions), len(given)
    lack = np.empty(count)
    zone = np.arange(n)
    for c in range(count):
        lack[c] = lack_of(contacts, positions, c, targets[c])
        if _acts(masses, lack, given, c):
            first = -1
            for a in range(4):
                i = contacts.node[c, a]
                if contacts.weight[c, a] * inverse_masses[i] != 0.0:
                    if first >= 0:
                        _join(zone, first, i)
                    first = i
    size, unsettled, of = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.bool_), np.full(count, -1)
    for c in range(count):
        if _acts(masses, lack, given, c):
            for a in range(4):
                i = contacts.node[c, a]
                if contacts.weight[c, a] * inverse_masses[i] != 0.0:
                    of[c] = _root(zone, i)
            size[of[c]] += 1
            unsettled[of[c]] |= abs(lack[c]) > UNSETTLED * abs(contacts.thickness[c])
    settled = left = 0
    for z in range(n):
        if not unsettled[z]:
            continue
        if size[z] > MOST_IN_ZONE or size[z] == hopeless[z]:
            left += 1
            continue
        members = np.flatnonzero(of == z)
        matrix, b = _system(contacts, inverse_masses, members), np.empty(len(members))
        for k in range(len(members)):
            b[k] = lack[members[k]] / h
            for m in range(len(members)):
                b[k] += matrix[k, m] * given[members[m]]
        impulse = np.empty(len(members))
        if not _complementary(matrix, b, impulse):
            hopeless[z] = size[z]
            left += 1
            continue
        settled += 1
        for k in range(len(members)):
            c = members[k]
            change = scale(impulse[k] - given[c], row(contacts.normal, c))
            give(contacts, c, inverse_masses, change, h, positions, velocities)
            given[c] = impulse[k]
            for a in range(4):
                hopeless[contacts.node[c, a]] = 0
    return settled, left


@inner
def _acts(masses, lack, given, c):
    return masses[c] < np.inf and (lack[c] > 0.0 or given[c] > 0.0)


@inner
def _root(zone, i):
    while zone[i] != i:
        zone[i] = zone[zone[i]]
        i = zone[i]
    return i


@inner
def _join(zone, i, j):
    i, j = _root(zone, i), _root(zone, j)
    zone[max(i, j)] = min(i, j)


@inner
def _system(contacts, inverse_masses, members):
    """C M⁻¹ Cᵀ of the contacts `members`: how fast each gap grows for an impulse at another."""
    size = len(members)
    matrix = np.zeros((size, size))
    for k in range(size):
        for m in range(k + 1):
            c, d, total = members[k], members[m], 0.0
            for a in range(4):
                for b in range(4):
                    if contacts.node[c, a] == contacts.node[d, b]:
                        shared = contacts.weight[c, a] * contacts.weight[d, b]
                        total += shared * inverse_masses[contacts.node[c, a]]
            matrix[k, m] = matrix[m, k] = total * dot(row(contacts.normal, c), row(contacts.normal, d))
    for k in range(size):
        matrix[k, k] *= 1.0 + DEPENDENT
    return matrix


@inner
def _complementary(matrix, b, p):
    """Fill p with the solution of p ≥ 0, A p ≥ b, p·(A p − b) = 0; False where pivoting does not find it."""
    size = len(b)
    acts, wrong = b > 0.0, np.zeros(size, dtype=np.bool_)
    fewest, chances = size + 1, CHANCES
    for _ in range(MOST_PIVOTS):
        if not _solve(matrix, b, acts, p):
            return False
        count, last, acting = 0, -1, np.flatnonzero(acts)
        for k in range(size):
            if acts[k]:
                wrong[k] = p[k] < 0.0
            else:
                rest, most = -b[k], abs(b[k])
                for m in acting:
                    rest += matrix[k, m] * p[m]
                    most = max(most, abs(matrix[k, m] * p[m]))
                wrong[k] = rest < -WRONG * most
            if wrong[k]:
                count, last = count + 1, k
        if count == 0:  # unless it is no way out, but made so by what is added to the diagonal
            largest = 0.0
            for k in range(size):
                largest = max(largest, abs(b[k]))
            for k in range(size):
                wrong[k] = not DEPENDENT * (matrix[k, k] * p[k]) < FEASIBLE * largest
            return not wrong.any()
        if count < fewest:
            fewest, chances = count, CHANCES
        elif chances > 0:
            chances -= 1
        else:
            wrong[:] = False
            wrong[last] = True
        for k in range(size):
            acts[k] ^= wrong[k]
    return False


@inner
def _solve(matrix, b, acts, p):
    """Fill p with the solution of A p = b for those that act, and zero for others, by Cholesky.

    Each row of the factor is taken off all those below it, along rows: the sums are the same, in the same
    order, as entry by entry, but the compiler can do several at once.
    """
    p[:] = 0.0
    which = np.flatnonzero(acts).astype(np.uint32)
    size, one = np.uint64(len(which)), np.uint64(1)  # unsigned, as indices are
    factor, y = np.empty((len(which), len(which))), b[which]
    for k in range(size):
        for m in range(k, size):
            factor[k, m] = matrix[which[m], which[k]]
    for s in range(size):
        if not factor[s, s] > 0.0:
            return False
        factor[s, s] = np.sqrt(factor[s, s])
        y[s] /= factor[s, s]
        for m in range(s + one, size):
            factor[s, m] /= factor[s, s]
            y[m] -= factor[s, m] * y[s]
        for k in range(s + one, size):
            part = factor[s, k]
            for m in range(k, size):
                factor[k, m] -= part * factor[s, m]
    for k in range(len(which) - 1, -1, -1):
        total = y[k]
        for s in range(k + 1, len(which)):
            total -= factor[k, s] * p[which[s]]
        p[which[k]] = total / factor[k, k]
    return True
