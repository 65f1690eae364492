"""Preconditioned conjugate gradients (Hestenes and Stiefel 1952).

Fixed vertices are eliminated: their entries of every direction are zero. Sums are taken over a fixed number
of chunks, so the result is the same to the bit for any number of threads.

The solver stops on the error at the worst vertex, not on the residual. Every WINDOW iterations it asks how
far the farthest vertex has gone since the last time, and by what factor such windows shrink: of their size or
of the drop of the squared error in the A-norm, Σ α r·z (Strakoš and Tichý 2002), whichever shrinks less. What
is still to come is then their geometric series. A single window may shrink by luck, so that factor falls
slowly from one to the next. Where an error is so local that a window has hardly begun to move it, the
preconditioned residual still shows it, some times smaller than it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, inner, kernel, parallel_kernel, share
from sim.solve.coupling import coupled, move
from sim.solve.preconditioner import highest, in_order, precondition

WINDOW = 3
"""Iterations between two looks at the error."""

SLOWEST = 0.95
"""Largest factor by which windows are taken to shrink: slower than that, their ratio is noise."""

MEMORY = 0.8
"""Part of the factor of the window before that the next one's is at least."""

SAFETY = 1.5
"""What the estimate is multiplied by, as windows do not shrink evenly."""

LEVERAGE, CERTAINTY = 5.0, 100.0
"""The error is seldom less, and never was more, than so many times the preconditioned residual."""

CONVERGED, EXHAUSTED, BROKEN = 0, 1, 2


class Workspace(NamedTuple):
    """Room for the vectors of a solve, (n, 3) each, and for partial sums, (CHUNKS,) each."""

    z: np.ndarray
    p: np.ndarray
    ap: np.ndarray
    old: np.ndarray
    partial: np.ndarray
    largest: np.ndarray


def make_workspace(n: int) -> Workspace:
    """Room for a solve of n vertices."""
    z, p, ap, old = np.zeros((4, n, 3))
    return Workspace(z, p, ap, old, np.zeros(CHUNKS), np.zeros(CHUNKS))


@parallel_kernel
def multiply(matrix, coupling, free, x, y, partial):
    """Fill y = A x on free vertices and return xᵀ y; x must be zero on fixed ones."""
    n = len(x)
    if len(coupling.node):
        move(coupling, x)
    for chunk in numba.prange(CHUNKS):
        total = 0.0
        begin, end = share(chunk, n)
        for i in range(begin, end):
            if not free[i]:
                y[i, 0] = y[i, 1] = y[i, 2] = 0.0
                continue
            u, v, w = x[i, 0], x[i, 1], x[i, 2]
            d = matrix.diagonal
            sx = d[i, 0, 0] * u + d[i, 0, 1] * v + d[i, 0, 2] * w
            sy = d[i, 1, 0] * u + d[i, 1, 1] * v + d[i, 1, 2] * w
            sz = d[i, 2, 0] * u + d[i, 2, 1] * v + d[i, 2, 2] * w
            b = matrix.block
            for p in range(matrix.first[i], matrix.first[i + 1]):
                j = matrix.column[p]
                q, r, s = x[j, 0], x[j, 1], x[j, 2]
                sx += b[p, 0, 0] * q + b[p, 0, 1] * r + b[p, 0, 2] * s
                sy += b[p, 1, 0] * q + b[p, 1, 1] * r + b[p, 1, 2] * s
                sz += b[p, 2, 0] * q + b[p, 2, 1] * r + b[p, 2, 2] * s
            if coupling.first[i] < coupling.first[i + 1]:
                q, r, s = coupled(coupling, i, u, v, w)
                sx, sy, sz = sx + q, sy + r, sz + s
            y[i, 0], y[i, 1], y[i, 2] = sx, sy, sz
            total += u * sx + v * sy + w * sz
        partial[chunk] = total
    return in_order(partial)


@parallel_kernel
def step_along(alpha, p, ap, x, r):
    """X += α p and r −= α A p."""
    n = len(x)
    for chunk in numba.prange(CHUNKS):
        begin, end = share(chunk, n)
        for i in range(begin, end):
            for c in range(3):
                x[i, c] += alpha * p[i, c]
                r[i, c] -= alpha * ap[i, c]


@parallel_kernel
def turn(p, z, beta):
    """P = z + β p."""
    n = len(p)
    for chunk in numba.prange(CHUNKS):
        begin, end = share(chunk, n)
        for i in range(begin, end):
            for c in range(3):
                p[i, c] = z[i, c] + beta * p[i, c]


@parallel_kernel
def _farthest(x, old, largest):
    """The largest |x_i − old_i|; old becomes x."""
    n = len(x)
    for chunk in numba.prange(CHUNKS):
        most = 0.0
        begin, end = share(chunk, n)
        for i in range(begin, end):
            square = 0.0
            for c in range(3):
                square += (x[i, c] - old[i, c]) ** 2
                old[i, c] = x[i, c]
            most = max(most, square)
        largest[chunk] = most
    return math.sqrt(highest(largest))


@inner
def _residual(matrix, coupling, free, b, x, ap, partial, r):
    """Fill r = b − A x on free vertices, zero on fixed ones; r may be b, and ap becomes A x."""
    multiply(matrix, coupling, free, x, ap, partial)
    for i in range(len(r)):
        for c in range(3):
            r[i, c] = b[i, c] - ap[i, c] if free[i] else 0.0


@kernel
def rounding_error(matrix, coupling, preconditioner, work, b, x):
    """The estimated error of x at the worst vertex by the residual b − A x as it is, not as it was updated.

    The updated one goes on to fall where rounding has long stopped the other (Greenbaum 1997).
    """
    r, partial = work.p, work.partial
    _residual(matrix, coupling, preconditioner.local.free, b, x, work.ap, partial, r)
    _, residual = precondition(preconditioner, r, work.z, partial, work.largest)
    return LEVERAGE * math.sqrt(residual)


@kernel
def conjugate_gradients(matrix, coupling, preconditioner, work, r, x, shortcut, tolerance, most):
    """Solve A x = b on free vertices.

    Args:
        matrix: A, symmetric positive definite.
        coupling: And what contacts add to it.
        preconditioner: P⁻¹, refreshed for A; says which vertices are free.
        work: Room for the vectors.
        r: (n, 3) the right-hand side b, overwritten by the residual b − A x.
        x: (n, 3) the guess, overwritten by the solution; fixed entries must be zero.
        shortcut: (n, 3) a direction that may hold most of the error (free fall), or zero.
        tolerance: Error |x_i − x*_i| allowed at the worst vertex i.
        most: Iterations after which it gives up.

    Returns:
        (iterations, estimated error at the worst vertex, CONVERGED, EXHAUSTED or BROKEN).
    """
    free, partial, largest = preconditioner.local.free, work.partial, work.largest
    z, p, ap, old = work.z, work.p, work.ap, work.old
    _residual(matrix, coupling, free, r, x, ap, partial, r)
    curvature = multiply(matrix, coupling, free, shortcut, ap, partial)
    along = 0.0
    for i in range(len(r)):
        for c in range(3):
            along += shortcut[i, c] * r[i, c]
    step_along(along / curvature if curvature > 0.0 else 0.0, shortcut, ap, x, r)
    rz, residual = precondition(preconditioner, r, z, partial, largest)
    for i in range(len(r)):
        for c in range(3):
            p[i, c] = z[i, c]
    _farthest(x, old, largest)
    estimate, went, drop, dropped, rate = math.inf, 0.0, 0.0, 0.0, 0.0
    for k in range(most):
        if rz == 0.0:
            return k, 0.0, CONVERGED
        if not rz > 0.0:
            return k, estimate, BROKEN
        if k > 0 and CERTAINTY * math.sqrt(residual) <= tolerance:  # small errors add up over steps
            return k, CERTAINTY * math.sqrt(residual), CONVERGED
        curvature = multiply(matrix, coupling, free, p, ap, partial)
        if not curvature > 0.0:
            return k, estimate, BROKEN
        alpha = rz / curvature
        drop += alpha * rz
        before = rz
        step_along(alpha, p, ap, x, r)
        rz, residual = precondition(preconditioner, r, z, partial, largest)
        if (k + 1) % WINDOW == 0:
            far = _farthest(x, old, largest)
            if dropped > 0.0:
                seen = max(math.sqrt(drop / dropped), far / went if went > 0.0 else 0.0)
                rate = min(max(seen, MEMORY * rate), SLOWEST)
                estimate = max(SAFETY * far * rate / (1.0 - rate), LEVERAGE * math.sqrt(residual))
            went, dropped, drop = far, drop, 0.0
            if estimate <= tolerance:
                return k + 1, estimate, CONVERGED
        turn(p, z, rz / before)
    return most, estimate, EXHAUSTED
