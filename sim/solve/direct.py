"""The direct linear solver: a sparse factorisation, for the last digits.

PARDISO (Schenk and Gärtner 2004) does it where the extra `direct` has installed pypardiso, on one thread so
that the bits do not depend on how many there are; SuperLU (Li 2005), which comes with SciPy, where not.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, coo_array, csc_array, csr_array, csr_matrix, triu
from scipy.sparse.linalg import splu

from sim.solve.coupling import Coupling
from sim.solve.system import Matrix


def as_sparse(matrix: Matrix, coupling: Coupling) -> csr_array:
    """The whole matrix, (3 n, 3 n), with what contacts couple."""
    n = len(matrix.diagonal)
    first = matrix.first.astype(np.int64) + np.arange(n + 1)
    blocks, column = np.empty((first[-1], 3, 3)), np.empty(first[-1], dtype=np.int32)
    own = np.zeros(first[-1], dtype=bool)
    own[first[:-1]] = True
    blocks[own], column[own] = matrix.diagonal, np.arange(n)
    blocks[~own], column[~own] = matrix.block, matrix.column
    return csr_array(bsr_array((blocks, column, first), shape=(3 * n, 3 * n))) + _of_contacts(coupling, n)


def _of_contacts(coupling: Coupling, n: int) -> csr_array:
    """What contacts add off the diagonal."""
    a, b = np.nonzero(~np.eye(4, dtype=bool))
    node, weight = coupling.node, coupling.weight
    full = coupling.tensor[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    entries = (weight[:, a] * weight[:, b])[:, :, None, None] * full[:, None]
    axis = np.arange(3)
    rows = np.broadcast_to(3 * node[:, a][:, :, None, None] + axis[:, None], entries.shape)
    columns = np.broadcast_to(3 * node[:, b][:, :, None, None] + axis, entries.shape)
    where = rows.ravel(), columns.ravel()
    return csr_array(coo_array((entries.ravel(), where), shape=(3 * n, 3 * n)))


def solve_directly(
    matrix: Matrix, coupling: Coupling, free: np.ndarray, b: np.ndarray, x: np.ndarray
) -> tuple[float, bool]:
    """Fill `x` (n, 3) with the solution of A x = b on `free` vertices, zero on the others.

    Returns:
        The largest part of the last correction, an estimate of the error at the worst vertex, and whether A
        is positive definite; where it is not, `x` need not be of any use.
    """
    kept = np.flatnonzero(np.repeat(free, 3))
    x[:] = 0.0
    if not len(kept):
        return 0.0, True
    a = as_sparse(matrix, coupling)[kept][:, kept]
    right = b.ravel()[kept]
    if not np.isfinite(a.data).all() or not np.isfinite(right).all():
        return np.inf, False
    solution, correction, definite = (_by_superlu if pardiso() is None else _by_pardiso)(a, right)
    x.ravel()[kept] = solution + (correction if definite else 0.0)
    return float(np.abs(correction).max()), definite


Solved = tuple[np.ndarray, np.ndarray, bool]
"""A solution, its correction by one step of iterative refinement, and whether A is positive definite."""


def _by_superlu(a: csr_array, b: np.ndarray) -> Solved:
    """By factors L D Lᵀ: nothing but the diagonal is pivoted on.

    D has as many negative entries as A has negative eigenvalues (Sylvester 1852).
    """
    try:
        factors = splu(
            csc_array(a), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError:  # a pivot is exactly zero
        return _no_solution(b)
    solution = factors.solve(b)
    return solution, factors.solve(b - a @ solution), bool((factors.U.diagonal() > 0.0).all())


def _no_solution(b: np.ndarray) -> Solved:
    return np.zeros_like(b), np.full_like(b, np.inf), False


@functools.cache
def pardiso() -> Any:
    """The one PARDISO solver of this process; None where pypardiso is not installed."""
    try:
        from pypardiso import PyPardisoSolver  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    solver = PyPardisoSolver(mtype=SYMMETRIC_POSITIVE_DEFINITE)
    solver.libmkl.MKL_Set_Num_Threads(ctypes.c_int(1))  # pyright: ignore[reportOptionalMemberAccess]
    return solver


SYMMETRIC_POSITIVE_DEFINITE = 2
"""What PARDISO calls matrix type 2."""

_one_at_a_time = threading.Lock()


def _by_pardiso(a: csr_array, b: np.ndarray) -> Solved:
    """By a Cholesky factorisation, which breaks down where A is not positive definite."""
    from pypardiso.pardiso_wrapper import PyPardisoError  # pyright: ignore[reportMissingImports]

    upper = csr_matrix(triu(a, format="csr"))
    with _one_at_a_time:
        solver = pardiso()
        try:
            solver.factorize(upper)
            solution = solver.solve(upper, b)
            return solution, solver.solve(upper, b - a @ solution), True
        except PyPardisoError:
            return _no_solution(b)
        finally:
            solver.free_memory(everything=True)
