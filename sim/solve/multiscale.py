"""The preconditioner: block Jacobi on the vertices, and on hat functions at coarser and coarser scales.

    P⁻¹ = D⁻¹ + H D_H⁻¹ Hᵀ,   D_H = the diagonal blocks of Hᵀ A H

The columns of H are tensor-product hat functions on lattices of 4, 16, 64 … edge lengths in the rest shape
of each
piece: they reproduce motions that are linear in the rest shape, which is what Jacobi alone is slow to find.
Only diagonal blocks are needed, no coarse solve (Bramble, Pasciak and Xu 1990; Zhang 1992 for the diagonal
scaling), so the number of iterations hardly grows with the mesh. It works on any mesh, as the lattices live
in space.

H depends on the rest shape and on which vertices are free: it is built once. D_H is gathered anew for each
matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import inner, parallel_kernel
from sim.mesh import Mesh
from sim.solve.system import Matrix

COARSENING = 4.0
"""Edge lengths per lattice spacing on the finest scale, and ratio from each scale to the next."""

CHUNKS = 32
"""Parts that every sum is split into; more threads than this find no work."""


class Preconditioner(NamedTuple):
    """P⁻¹ for n vertices and m hat functions of all scales.

    Attributes:
        free: (n,) bool.
        inverse: (n, 3, 3) inverses of the diagonal blocks of A, zero for fixed vertices.
        hat_inverse: (m, 3, 3) inverses of the diagonal blocks of Hᵀ A H.
        of_vertex: (n + 1,) where each vertex's hats start in `hat` and `hat_weight`.
        hat: The hats that are not zero at a vertex.
        hat_weight: And their values there.
        of_hat: (m + 1,) where each hat's vertices start in `vertex` and `vertex_weight`.
        vertex: The vertices at which a hat is not zero.
        vertex_weight: And its values there.
        of_block: (m + 1,) where each hat's blocks of A start in `block` and `block_weight`.
        block: Index in Matrix.block of a block above the diagonal, or −1 − i for the diagonal block of
            vertex i.
        block_weight: Product of the hat's values at the block's two vertices.
        shares: (CHUNKS + 1,) hats split so that every part has about as many vertices.
        coarse: (m, 3) room for Hᵀ r.
    """

    free: np.ndarray
    inverse: np.ndarray
    hat_inverse: np.ndarray
    of_vertex: np.ndarray
    hat: np.ndarray
    hat_weight: np.ndarray
    of_hat: np.ndarray
    vertex: np.ndarray
    vertex_weight: np.ndarray
    of_block: np.ndarray
    block: np.ndarray
    block_weight: np.ndarray
    shares: np.ndarray
    coarse: np.ndarray


def build_preconditioner(mesh: Mesh, free: np.ndarray, matrix: Matrix) -> Preconditioner:
    """The hats of `mesh` and where they meet the blocks of `matrix`; nothing is inverted yet."""
    n = len(free)
    vertex, hat, weight = _all_hats(mesh, free)
    m = int(hat.max(initial=-1)) + 1
    by_vertex, by_hat = np.lexsort((hat, vertex)), np.lexsort((vertex, hat))
    of_vertex, of_hat = _starts(vertex[by_vertex], n), _starts(hat[by_hat], m)
    block_hat, block, block_weight = _meeting(matrix, of_vertex, hat[by_vertex], weight[by_vertex])
    order = np.lexsort((block, block_hat))
    return Preconditioner(
        free=free,
        inverse=np.zeros((n, 3, 3)),
        hat_inverse=np.zeros((m, 3, 3)),
        of_vertex=of_vertex,
        hat=hat[by_vertex].astype(np.int32),
        hat_weight=weight[by_vertex],
        of_hat=of_hat,
        vertex=vertex[by_hat].astype(np.int32),
        vertex_weight=weight[by_hat],
        of_block=_starts(block_hat[order], m),
        block=block[order].astype(np.int32),
        block_weight=block_weight[order],
        shares=np.searchsorted(of_hat, np.linspace(0, of_hat[-1], CHUNKS + 1)).clip(0, m).astype(np.int32),
        coarse=np.zeros((m, 3)),
    )


def _starts(sorted_keys: np.ndarray, count: int) -> np.ndarray:
    return np.searchsorted(sorted_keys, np.arange(count + 1)).astype(np.int32)


def _all_hats(mesh: Mesh, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(vertex, hat, weight) of every value of every hat of every piece and scale that is not zero."""
    found = [(np.zeros(0, int), np.zeros(0, int), np.zeros(0))]
    count = 0
    lengths = np.linalg.norm(np.diff(mesh.rest_vertices[mesh.edges], axis=1)[:, 0], axis=1)
    for piece in range(len(mesh.density)):
        own = np.flatnonzero(free & (mesh.pieces == piece))
        sides = lengths[mesh.pieces[mesh.edges[:, 0]] == piece]
        if len(own) < 2 or not len(sides) or sides.mean() == 0.0:
            continue
        rest = mesh.rest_vertices[own] - mesh.rest_vertices[own].min(axis=0)
        spacing = COARSENING * sides.mean()
        while spacing < rest.max():
            vertex, hat, weight = _hats(rest, spacing)
            found.append((own[vertex], hat + count, weight))
            count += int(hat.max()) + 1
            spacing *= COARSENING
    vertices, hats, weights = zip(*found, strict=True)
    return np.concatenate(vertices), np.concatenate(hats), np.concatenate(weights)


def _hats(rest: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values at `rest` (k, 3) of the tensor hats on a lattice; flat shapes meet one or two of its layers."""
    cell, inside = np.divmod(rest / spacing, 1.0)
    vertex, corner, weight = [], [], []
    for offset in np.ndindex(2, 2, 2):
        value = np.where(offset, inside, 1.0 - inside).prod(axis=1)
        kept = value > 1e-6
        vertex.append(np.flatnonzero(kept))
        corner.append((cell + offset)[kept])
        weight.append(value[kept])
    _, hat = np.unique(np.concatenate(corner), axis=0, return_inverse=True)
    return np.concatenate(vertex), hat.ravel(), np.concatenate(weight)


def _meeting(matrix: Matrix, of_vertex: np.ndarray, hat: np.ndarray, weight: np.ndarray):
    """(hat, block, weight) of every block of A, diagonal or above, whose two vertices both lie under a hat.

    The diagonal block of vertex i is numbered −1 − i.
    """
    n = len(matrix.diagonal)
    row = np.repeat(np.arange(n), np.diff(matrix.first))
    above = np.flatnonzero(row < matrix.column)
    first = np.concatenate([np.arange(n), row[above]])
    second = np.concatenate([np.arange(n), matrix.column[above]])
    number = np.concatenate([-1 - np.arange(n), above])
    span = np.diff(of_vertex)
    found = [(np.zeros(0, int), np.zeros(0, int), np.zeros(0))]
    for a in range(int(span.max(initial=0))):
        for b in range(int(span.max(initial=0))):
            pair = np.flatnonzero((span[first] > a) & (span[second] > b))
            p, q = of_vertex[first[pair]] + a, of_vertex[second[pair]] + b
            same = hat[p] == hat[q]
            found.append((hat[p][same], number[pair][same], (weight[p] * weight[q])[same]))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@parallel_kernel
def refresh(preconditioner, matrix):
    """Invert the diagonal blocks of A and of Hᵀ A H."""
    for i in numba.prange(len(preconditioner.free)):
        if preconditioner.free[i]:
            invert(matrix.diagonal[i], preconditioner.inverse[i])
    for m in numba.prange(len(preconditioner.hat_inverse)):
        out = preconditioner.hat_inverse[m]
        for r in range(3):
            for c in range(3):
                out[r, c] = 0.0
        for k in range(preconditioner.of_block[m], preconditioner.of_block[m + 1]):
            p, w = preconditioner.block[k], preconditioner.block_weight[k]
            for r in range(3):
                for c in range(3):
                    if p < 0:
                        out[r, c] += w * matrix.diagonal[-1 - p, r, c]
                    else:
                        out[r, c] += w * (matrix.block[p, r, c] + matrix.block[p, c, r])
        invert(out, out)


@inner
def invert(block, inverse):
    """Fill `inverse` with that of a symmetric positive 3 × 3 `block`, which it may overwrite."""
    a, b, c = block[0, 0], block[0, 1], block[0, 2]
    d, e, f = block[1, 1], block[1, 2], block[2, 2]
    # Scaled to 1, so that the determinant of a very stiff or very light vertex neither over- nor underflows.
    size = max(a, d, f)
    a, b, c, d, e, f = a / size, b / size, c / size, d / size, e / size, f / size
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    s = 1.0 / ((a * xx + b * xy + c * xz) * size)
    inverse[0, 0] = xx * s
    inverse[0, 1] = inverse[1, 0] = xy * s
    inverse[0, 2] = inverse[2, 0] = xz * s
    inverse[1, 1] = (a * f - c * c) * s
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) * s
    inverse[2, 2] = (a * d - b * b) * s


@inner
def precondition(preconditioner, r, z, partial):
    """Fill z = P⁻¹ r and return rᵀ z; r must be zero on fixed vertices."""
    _to_hats(preconditioner, r, preconditioner.coarse)
    return _to_vertices(preconditioner, preconditioner.coarse, r, z, partial)


@parallel_kernel
def _to_hats(preconditioner, r, coarse):
    """Fill coarse = D_H⁻¹ Hᵀ r."""
    h = preconditioner
    for chunk in numba.prange(CHUNKS):
        for m in range(h.shares[chunk], h.shares[chunk + 1]):
            u = v = w = 0.0
            for k in range(h.of_hat[m], h.of_hat[m + 1]):
                i, s = h.vertex[k], h.vertex_weight[k]
                u += s * r[i, 0]
                v += s * r[i, 1]
                w += s * r[i, 2]
            for c in range(3):
                coarse[m, c] = (
                    h.hat_inverse[m, c, 0] * u + h.hat_inverse[m, c, 1] * v + h.hat_inverse[m, c, 2] * w
                )


@parallel_kernel
def _to_vertices(preconditioner, coarse, r, z, partial):
    """Fill z = D⁻¹ r + H coarse on free vertices and return rᵀ z."""
    h, n = preconditioner, len(r)
    for chunk in numba.prange(CHUNKS):
        total = 0.0
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            u, v, w = r[i, 0], r[i, 1], r[i, 2]
            for c in range(3):
                z[i, c] = h.inverse[i, c, 0] * u + h.inverse[i, c, 1] * v + h.inverse[i, c, 2] * w
            for k in range(h.of_vertex[i], h.of_vertex[i + 1]):
                m, s = h.hat[k], h.hat_weight[k]
                for c in range(3):
                    z[i, c] += s * coarse[m, c]
            total += z[i, 0] * u + z[i, 1] * v + z[i, 2] * w
        partial[chunk] = total
    return in_order(partial)


@inner
def in_order(parts):
    """The sum of `parts`, first to last."""
    total = 0.0
    for part in parts:
        total += part
    return total
