"""The linear system A = M + h D + h² H as 3 × 3 blocks, assembled by gathering.

Which vertices are coupled depends on the stencils only, so it is worked out once per set of spring kinds.
Each block of A then *gathers* what the elements of all kinds add to it, in a fixed order: no two threads
write the same number, and the sum is the same to the bit for any number of threads. Rows are filled one after
the other, and blocks left of the diagonal are copied from their transposes in a second pass: written at once
with them, out of turn, they would wait for memory where A is larger than the caches.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import (
    CHUNKS,
    even_shares,
    indices,
    inner,
    kernel,
    offsets,
    parallel_kernel,
    put,
    row,
    scale,
    sub,
)
from sim.solve.graph import Graph, starts, symmetric


class Matrix(NamedTuple):
    """A symmetric matrix of 3 × 3 blocks; row i couples vertex i to its neighbours.

    Attributes:
        diagonal: (n, 3, 3) blocks.
        first: (n + 1,) where each row's blocks start in `column` and `block`.
        column: (b,) the other vertex of each block.
        block: (b, 3, 3).
    """

    diagonal: np.ndarray
    first: np.ndarray
    column: np.ndarray
    block: np.ndarray


class Gather(NamedTuple):
    """What the elements in a pool add, and where.

    Targets are the blocks on the diagonal and right of it, row after row, each row's diagonal one first.

    Attributes:
        row: (n + 1,) where each row's targets start.
        place: (t,) index in Matrix.block of each target, −1 − i for the diagonal block of vertex i.
        first: (t + 1,) where each target's contributions start.
        middle: (t,) where those start that come without a tensor.
        element: (c,) element of each contribution.
        a: (c,) place in the pool of its node that stands for the target's row.
        b: (c,) and of that for the target's column.
        mirror: (b,) for each block left of the diagonal, its transpose.
        shares: (CHUNKS + 1,) rows split so that every part has about as many contributions.
    """

    row: np.ndarray
    place: np.ndarray
    first: np.ndarray
    middle: np.ndarray
    element: np.ndarray
    a: np.ndarray
    b: np.ndarray
    mirror: np.ndarray
    shares: np.ndarray


def build_system(n: int, stencils: list[np.ndarray], tensors: list[bool]) -> tuple[Matrix, Gather]:
    """A zero matrix that couples n vertices as elements do, and the lists to fill it by.

    Args:
        n: Vertices.
        stencils: (e, k) nodes of the elements of each kind, as they follow each other in a pool.
        tensors: Which kinds have tensors.
    """
    key, element, a, b, bare = _contributions(n, stencils, tensors)
    targets = np.unique(np.concatenate([key, np.arange(n) * (n + 1)]))
    i, j = np.divmod(targets, n)
    above = i < j
    graph, upper, lower = symmetric(i[above], j[above], n)
    matrix = Matrix(
        diagonal=np.zeros((n, 3, 3)),
        first=offsets(graph.first),
        column=indices(graph.column),
        block=np.zeros((len(graph.column), 3, 3)),
    )
    place = -1 - i
    place[above] = upper
    mirror = np.zeros(len(graph.column), dtype=np.int64)
    mirror[lower] = upper
    order = np.argsort(2 * key + bare, kind="stable")
    target = np.searchsorted(targets, key[order])
    rows, first = starts(i, n), starts(target, len(targets))
    return matrix, Gather(
        row=offsets(rows),
        place=place.astype(np.int32),
        first=offsets(first),
        middle=offsets(first[:-1] + np.bincount(target[~bare[order]], minlength=len(targets))),
        element=element[order],
        a=a[order],
        b=b[order],
        mirror=indices(mirror),
        shares=even_shares(first[rows]),
    )


def _contributions(n: int, stencils: list[np.ndarray], tensors: list[bool]) -> tuple[np.ndarray, ...]:
    """Key i n + j of the block i ≤ j, element, both places in the pool, and whether there is no tensor.

    They are in the order of the elements.
    """
    found: list[tuple[np.ndarray, ...]] = []
    elements = places = 0
    for nodes, tensor in zip(stencils, tensors, strict=True):
        e, k = nodes.shape
        p, q = np.triu_indices(k)
        ends = nodes[:, p].astype(np.int64), nodes[:, q].astype(np.int64)
        flip = ends[0] > ends[1]
        element = np.arange(e)[:, None]
        start = places + k * element
        columns = (
            np.minimum(*ends) * n + np.maximum(*ends),
            indices(np.broadcast_to(elements + element, flip.shape)),
            indices(start + np.where(flip, q, p)),
            indices(start + np.where(flip, p, q)),
            np.full(flip.shape, not tensor),
        )
        found.append(tuple(column.ravel() for column in columns))
        elements, places = elements + e, places + e * k
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def pattern(matrix: Matrix) -> Graph:
    """Which vertices the matrix couples."""
    return Graph(matrix.first.astype(np.int64), matrix.column.astype(np.int64))


@parallel_kernel
def assemble(pool, gather, masses, matrix):
    """Fill the matrix with the masses (n,) [kg] and what every element adds, as `sim.elements` has it."""
    for chunk in numba.prange(CHUNKS):
        _fill_rows(pool, gather, masses, matrix, gather.shares[chunk], gather.shares[chunk + 1])
    for chunk in numba.prange(CHUNKS):
        _mirror_rows(gather, matrix, gather.shares[chunk], gather.shares[chunk + 1])


@inner
def _fill_rows(pool, gather, masses, matrix, begin, end):
    """Fill the blocks on the diagonal and right of it of the rows from `begin` to `end`."""
    weight, tensor, gradient, along = pool.weight, pool.tensor, pool.gradient, pool.along
    for target in range(gather.row[begin], gather.row[end]):
        place, middle = gather.place[target], gather.middle[target]
        mass = masses[-1 - place] if place < 0 else 0.0
        xx, xy, xz, yy, yz, zz = mass, 0.0, 0.0, mass, 0.0, mass
        for c in range(gather.first[target], middle):
            e, w = gather.element[c], weight[gather.a[c]] * weight[gather.b[c]]
            xx += w * tensor[e, 0]
            xy += w * tensor[e, 1]
            xz += w * tensor[e, 2]
            yy += w * tensor[e, 3]
            yz += w * tensor[e, 4]
            zz += w * tensor[e, 5]
        yx, zx, zy = xy, xz, yz
        for c in range(middle, gather.first[target + 1]):
            g, k = scale(along[gather.element[c]], row(gradient, gather.a[c])), row(gradient, gather.b[c])
            xx += g.x * k.x
            xy += g.x * k.y
            xz += g.x * k.z
            yx += g.y * k.x
            yy += g.y * k.y
            yz += g.y * k.z
            zx += g.z * k.x
            zy += g.z * k.y
            zz += g.z * k.z
        if place < 0:
            _put(matrix.diagonal, -1 - place, xx, xy, xz, yx, yy, yz, zx, zy, zz)
        else:
            _put(matrix.block, place, xx, xy, xz, yx, yy, yz, zx, zy, zz)


@inner
def _put(blocks, p, xx, xy, xz, yx, yy, yz, zx, zy, zz):
    blocks[p, 0, 0], blocks[p, 0, 1], blocks[p, 0, 2] = xx, xy, xz
    blocks[p, 1, 0], blocks[p, 1, 1], blocks[p, 1, 2] = yx, yy, yz
    blocks[p, 2, 0], blocks[p, 2, 1], blocks[p, 2, 2] = zx, zy, zz


@inner
def _mirror_rows(gather, matrix, begin, end):
    """Fill the blocks left of the diagonal of the rows from `begin` to `end`."""
    b = matrix.block
    for i in range(begin, end):
        for p in range(matrix.first[i], matrix.first[i + 1]):
            if matrix.column[p] > i:
                break
            q = gather.mirror[p]
            xs, ys, zs = row(b[q], 0), row(b[q], 1), row(b[q], 2)
            _put(b, p, xs.x, ys.x, zs.x, xs.y, ys.y, zs.y, xs.z, ys.z, zs.z)


@kernel
def add_curvature(elements, curvature, h, matrix):
    """Add h² K (q − q0) ∇²q of every element to the matrix, from its `curvature` (e, 3 k, 3 k)."""
    k = elements.nodes.shape[1]
    for e in range(len(elements.q)):
        tension = h * h * elements.stiffness[e] * (elements.q[e] - elements.rest[e])
        for a in range(k):
            i = elements.nodes[e, a]
            begin, end = matrix.first[i], matrix.first[i + 1]
            for b in range(k):
                j = elements.nodes[e, b]
                blocks, p = matrix.diagonal, np.int64(i)
                if i != j:
                    blocks, p = matrix.block, np.int64(begin) + np.searchsorted(matrix.column[begin:end], j)
                for r in range(3):
                    for s in range(3):
                        blocks[p, r, s] += tension * curvature[e, 3 * a + r, 3 * b + s]


@parallel_kernel
def add_forces(pool, gather, forces):
    """Add −s g_a of every element to `forces` (n, 3) [N]."""
    for chunk in numba.prange(CHUNKS):
        _add_to_rows(pool, gather, forces, gather.shares[chunk], gather.shares[chunk + 1])


@inner
def _add_to_rows(pool, gather, forces, begin, end):
    for i in range(begin, end):
        force, own = row(forces, i), gather.row[i]
        for c in range(gather.first[own], gather.first[own + 1]):
            force = sub(force, scale(pool.tension[gather.element[c]], row(pool.gradient, gather.a[c])))
        put(forces, i, force)


@kernel
def confine(matrix, masses, axis, forces):
    """Take the motion along `axis` out of matrix and forces: nothing drives it, and nothing couples to it."""
    for i in range(len(masses)):
        forces[i, axis] = 0.0
        for r in range(3):
            matrix.diagonal[i, axis, r] = matrix.diagonal[i, r, axis] = 0.0
        matrix.diagonal[i, axis, axis] = masses[i]
        for p in range(matrix.first[i], matrix.first[i + 1]):
            for r in range(3):
                matrix.block[p, axis, r] = matrix.block[p, r, axis] = 0.0


@inner
def invert(block, inverse):
    """Fill `inverse` with that of a symmetric positive 3 × 3 `block`."""
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
