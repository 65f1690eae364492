"""Preconditioned conjugate gradients (Hestenes and Stiefel 1952).

Fixed vertices are eliminated: their entries of every direction are zero. Sums are taken over a fixed number
of chunks, so the result is the same to the bit for any number of threads.

The solver stops on the error, not on the residual. After d more iterations the drop
Σ_{j=k}^{k+d−1} α_j r_jᵀ P⁻¹ r_j is a lower bound of the squared error ‖x_k − x*‖²_A that tightens quickly
(Strakoš and Tichý 2002), and ‖·‖_A bounds the mass-weighted norm from above because A − M is positive
semi-definite.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sim.compiled import inner, kernel, parallel_kernel
from sim.solve.multiscale import CHUNKS, in_order, precondition

WINDOW = 5
"""Iterations d whose drop estimates the error."""

SAFETY = 8.0
"""Largest error of a vertex over the mass-weighted mean that is allowed for."""

CONVERGED, EXHAUSTED, BROKEN = 0, 1, 2


@parallel_kernel
def multiply(matrix, free, x, y, partial):
    """Fill y = A x on free vertices and return xᵀ y."""
    n = len(x)
    for chunk in numba.prange(CHUNKS):
        total = 0.0
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
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
            y[i, 0], y[i, 1], y[i, 2] = sx, sy, sz
            total += u * sx + v * sy + w * sz
        partial[chunk] = total
    return in_order(partial)


@inner
def step_along(alpha, p, ap, x, r):
    """X += α p and r −= α A p."""
    for i in range(len(x)):
        for c in range(3):
            x[i, c] += alpha * p[i, c]
            r[i, c] -= alpha * ap[i, c]


@inner
def turn(p, z, beta):
    """P = z + β p."""
    for i in range(len(p)):
        for c in range(3):
            p[i, c] = z[i, c] + beta * p[i, c]


@kernel
def conjugate_gradients(matrix, preconditioner, r, x, shortcut, tolerance, most):
    """Solve A x = b on free vertices.

    Args:
        matrix: A, symmetric positive definite.
        preconditioner: P⁻¹, refreshed for A; says which vertices are free.
        r: (n, 3) the right-hand side b, overwritten by the residual b − A x.
        x: (n, 3) the guess, overwritten by the solution; fixed entries must be zero.
        shortcut: (n, 3) a direction that may hold most of the error (free fall), or zero.
        tolerance: Error allowed, in the mass-weighted norm ‖x − x*‖_M; already multiplied by √(total mass).
        most: Iterations after which it gives up.

    Returns:
        (iterations, estimated error in the norm of `tolerance`, CONVERGED, EXHAUSTED or BROKEN).
    """
    free, partial = preconditioner.free, np.zeros(CHUNKS)
    drops = np.zeros(WINDOW)
    z, p, ap = np.zeros(r.shape), np.zeros(r.shape), np.zeros(r.shape)
    multiply(matrix, free, x, ap, partial)
    for i in range(len(r)):
        for c in range(3):
            r[i, c] = r[i, c] - ap[i, c] if free[i] else 0.0
    curvature = multiply(matrix, free, shortcut, ap, partial)
    along = 0.0
    for i in range(len(r)):
        for c in range(3):
            along += shortcut[i, c] * r[i, c]
    step_along(along / curvature if curvature > 0.0 else 0.0, shortcut, ap, x, r)
    rz = precondition(preconditioner, r, z, partial)
    turn(p, z, 0.0)
    estimate = math.inf
    for k in range(most):
        if rz == 0.0:
            return k, 0.0, CONVERGED
        if not rz > 0.0:
            return k, estimate, BROKEN
        curvature = multiply(matrix, free, p, ap, partial)
        if not curvature > 0.0:
            return k, estimate, BROKEN
        alpha = rz / curvature
        drops[k % WINDOW] = alpha * rz
        estimate = SAFETY * math.sqrt(in_order(drops))
        old = rz
        step_along(alpha, p, ap, x, r)
        rz = precondition(preconditioner, r, z, partial)
        if k + 1 >= WINDOW and estimate <= tolerance:
            return k + 1, estimate, CONVERGED
        turn(p, z, rz / old)
    return most, estimate, EXHAUSTED
