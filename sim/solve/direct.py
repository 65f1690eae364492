"""The direct linear solver: a sparse factorisation (SuperLU, Li 2005), for the last digits."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from sim.solve.system import Matrix


def as_sparse(matrix: Matrix) -> csr_array:
    """The whole matrix, (3 n, 3 n)."""
    n = len(matrix.diagonal)
    first = matrix.first.astype(np.int64) + np.arange(n + 1)
    blocks, column = np.empty((first[-1], 3, 3)), np.empty(first[-1], dtype=np.int32)
    own = np.zeros(first[-1], dtype=bool)
    own[first[:-1]] = True
    blocks[own], column[own] = matrix.diagonal, np.arange(n)
    blocks[~own], column[~own] = matrix.block, matrix.column
    return csr_array(bsr_array((blocks, column, first), shape=(3 * n, 3 * n)))


def solve_directly(matrix: Matrix, free: np.ndarray, b: np.ndarray, x: np.ndarray) -> tuple[float, bool]:
    """Fill `x` (n, 3) with the solution of A x = b on `free` vertices, zero on the others.

    Returns:
        The largest part of the last correction, an estimate of the error at the worst vertex, and whether A
        is positive definite: the factors are L D Lᵀ, since nothing but the diagonal is pivoted on, and D has
        as many negative entries as A has negative eigenvalues (Sylvester 1852).
    """
    kept = np.flatnonzero(np.repeat(free, 3))
    x[:] = 0.0
    if not len(kept):
        return 0.0, True
    a = csc_array(as_sparse(matrix)[kept][:, kept])
    try:
        factors = splu(a, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return np.inf, False
    right = b.ravel()[kept]
    solution = factors.solve(right)
    correction = factors.solve(right - a @ solution)
    x.ravel()[kept] = solution + correction
    definite = bool((factors.U.diagonal() > 0.0).all())
    return float(np.abs(correction).max()), definite
