"""Conjugate gradients with a block-Jacobi preconditioner (Hestenes and Stiefel 1952).

Fixed vertices are eliminated: their entries of every direction are zero. Sums are taken over a fixed number of
chunks, so the result is the same to the bit for any number of threads.

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

CHUNKS = 32
"""Parts that every sum is split into; more threads than this find no work."""

WINDOW = 12
"""Iterations d whose drop estimates the error."""

SAFETY = 8.0
"""Largest error of a vertex over the mass-weighted mean that is allowed for."""

CONVERGED, EXHAUSTED, BROKEN = 0, 1, 2


@kernel
def invert_diagonal(diagonal, free, inverse):
    """Fill `inverse` (n, 3, 3) with the inverses of symmetric positive blocks, zero for fixed vertices."""
    for i in range(len(diagonal)):
        if not free[i]:
            inverse[i] = 0.0
            continue
        a, b, c = diagonal[i, 0, 0], diagonal[i, 0, 1], diagonal[i, 0, 2]
        d, e, f = diagonal[i, 1, 1], diagonal[i, 1, 2], diagonal[i, 2, 2]
        # Scaled to 1, so that the determinant of a very stiff or very light vertex neither over- nor underflows.
        size = max(a, d, f)
        a, b, c, d, e, f = a / size, b / size, c / size, d / size, e / size, f / size
        xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
        determinant = a * xx + b * xy + c * xz
        s = 1.0 / (determinant * size)
        inverse[i, 0, 0] = xx * s
        inverse[i, 0, 1] = inverse[i, 1, 0] = xy * s
        inverse[i, 0, 2] = inverse[i, 2, 0] = xz * s
        inverse[i, 1, 1] = (a * f - c * c) * s
        inverse[i, 1, 2] = inverse[i, 2, 1] = (b * c - a * e) * s
        inverse[i, 2, 2] = (a * d - b * b) * s


@inner
def in_order(parts):
    """The sum of `parts`, first to last."""
    total = 0.0
    for part in parts:
        total += part
    return total


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


@parallel_kernel
def advance(inverse, alpha, p, ap, x, r, z, partial):
    """Step x += α p, r −= α A p; fill z = P⁻¹ r and return rᵀ z."""
    n = len(x)
    for chunk in numba.prange(CHUNKS):
        total = 0.0
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            for c in range(3):
                x[i, c] += alpha * p[i, c]
                r[i, c] -= alpha * ap[i, c]
            for c in range(3):
                z[i, c] = inverse[i, c, 0] * r[i, 0] + inverse[i, c, 1] * r[i, 1] + inverse[i, c, 2] * r[i, 2]
                total += z[i, c] * r[i, c]
        partial[chunk] = total
    return in_order(partial)


@inner
def turn(p, z, beta):
    """P = z + β p."""
    for i in range(len(p)):
        for c in range(3):
            p[i, c] = z[i, c] + beta * p[i, c]


@kernel
def conjugate_gradients(matrix, inverse, free, b, x, shortcut, tolerance, most):
    """Solve A x = b on free vertices.

    Args:
        matrix: A, symmetric positive definite.
        inverse: (n, 3, 3) inverses of its diagonal blocks, zero for fixed vertices.
        free: (n,) bool.
        b: (n, 3) right-hand side.
        x: (n, 3) the guess, overwritten by the solution; fixed entries must be zero.
        shortcut: (n, 3) a direction that may hold most of the error (free fall), or zero.
        tolerance: Error allowed, in the mass-weighted norm ‖x − x*‖_M; already multiplied by √(total mass).
        most: Iterations after which it gives up.

    Returns:
        (iterations, estimated error in the norm of `tolerance`, CONVERGED, EXHAUSTED or BROKEN).
    """
    partial = np.zeros(CHUNKS)
    drops = np.zeros(WINDOW)
    r, z, p, ap = np.zeros(b.shape), np.zeros(b.shape), np.zeros(b.shape), np.zeros(b.shape)
    multiply(matrix, free, x, ap, partial)
    for i in range(len(b)):
        for c in range(3):
            r[i, c] = b[i, c] - ap[i, c] if free[i] else 0.0
    curvature = multiply(matrix, free, shortcut, ap, partial)
    along = 0.0
    for i in range(len(b)):
        for c in range(3):
            along += shortcut[i, c] * r[i, c]
    rz = advance(inverse, along / curvature if curvature > 0.0 else 0.0, shortcut, ap, x, r, z, partial)
    turn(p, z, 0.0)
    estimate = math.inf
    for k in range(most):
        if rz == 0.0:
            return k, 0.0, CONVERGED
        curvature = multiply(matrix, free, p, ap, partial)
        if not curvature > 0.0:
            return k, estimate, BROKEN
        alpha = rz / curvature
        drops[k % WINDOW] = alpha * rz
        estimate = SAFETY * math.sqrt(in_order(drops))
        old = rz
        rz = advance(inverse, alpha, p, ap, x, r, z, partial)
        if k + 1 >= WINDOW and estimate <= tolerance:
            return k + 1, estimate, CONVERGED
        turn(p, z, rz / old)
    return most, estimate, EXHAUSTED
