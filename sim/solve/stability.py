"""The longest step of the explicit integrator, which the stiffest way to move the cloth sets.

Symplectic Euler with damping d = 2 γ ω is stable while (h ω)² + 2 h d < 4. For springs that share vertices
ω² and d are the largest eigenvalues of M⁻¹ H and M⁻¹ D, found by Lanczos iteration (1950);
together they err on the safe side.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import ArpackError, eigsh

from sim.contact.gap import NO_GAP_SPRINGS
from sim.model import Model
from sim.solve.direct import as_sparse

DIGITS = 1e-3
"""Relative accuracy of the eigenvalues; the result is rounded down by as much."""

DENSE = 32
"""Vertices up to which the matrix is small enough for all of its eigenvalues."""


def longest_step(model: Model, positions: np.ndarray) -> float:
    """Step [s] up to which symplectic Euler is stable about `positions` (n, 3); inf without springs."""
    stiffness, damping = system_matrices(model, positions)
    square, loss = _largest(model, stiffness), _largest(model, damping)
    if square <= 0.0:
        return 2.0 / loss if loss > 0.0 else math.inf
    limit = (math.sqrt(loss * loss + 4.0 * square) - loss) / square
    return (1.0 - DIGITS) * limit


def system_matrices(model: Model, positions: np.ndarray, exact: bool = False) -> tuple[csr_array, csr_array]:
    """H [N/m] and D [N s/m] at `positions` (n, 3), (3 n, 3 n); H is filtered, or the `exact` Hessian."""
    parts = []
    for h in (1.0, -1.0):
        model.linearise(positions, np.zeros_like(positions), NO_GAP_SPRINGS, h, exact)
        parts.append(as_sparse(model.matrix, model.coupling))
    masses = diags_array(np.repeat(model.masses, 3))
    return csr_array(0.5 * (parts[0] + parts[1]) - masses), csr_array(0.5 * (parts[0] - parts[1]))


def _largest(model: Model, matrix: csr_array) -> float:
    """The largest eigenvalue of M⁻¹ `matrix` on free vertices."""
    scale = np.repeat(np.sqrt(model.inverse_masses), 3)
    n = len(scale)
    diagonal = diags_array(scale)
    product = diagonal @ matrix @ diagonal
    if n <= 3 * DENSE:
        return float(np.linalg.eigvalsh(product.toarray()).max(initial=0.0))
    start = np.random.default_rng(0).standard_normal(n)
    try:
        values = eigsh(product, k=1, which="LA", tol=DIGITS, v0=start, return_eigenvectors=False)  # pyright: ignore
        return float(values[0])
    except ArpackError:  # no eigenvalue exceeds the largest row sum
        return float(abs(product).sum(axis=1).max())
