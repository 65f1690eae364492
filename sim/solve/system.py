"""The linear system A = M + h D + h² H as 3 × 3 blocks, assembled by gathering.

Which vertices are coupled depends on the stencils only, so it is worked out once per set of spring kinds.
Each block of A then *gathers* what the elements add to it, in a fixed order: no two threads write the same
number, and the sum is the same to the bit for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import (
    CHUNKS,
    corner,
    even_shares,
    indices,
    inner,
    kernel,
    offsets,
    parallel_kernel,
    scale,
    share,
)
from sim.elements import NONE, set_tension
from sim.solve.graph import Graph, symmetric


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
    """What the elements of one kind add, and where.

    Attributes:
        first: (n + p + 1,) where each target's contributions start: first the n vertices, then the p
            coupled pairs.
        shares: (CHUNKS + 1,) targets split so that every part has about as many contributions.
        element: (c,) element of each contribution.
        a: (c,) its node that stands for the target's row.
        b: (c,) its node that stands for the target's column.
        upper: (p,) index in Matrix.block of each pair's block.
        lower: (p,) and of its transpose.
    """

    first: np.ndarray
    shares: np.ndarray
    element: np.ndarray
    a: np.ndarray
    b: np.ndarray
    upper: np.ndarray
    lower: np.ndarray


def build_system(n: int, stencils: list[np.ndarray]) -> tuple[Matrix, list[Gather]]:
    """A zero matrix that couples n vertices as the (e, k) `stencils` do, and each one's gather lists."""
    parts = [_contributions(nodes.astype(np.int64), n) for nodes in stencils]
    pairs = np.unique(np.concatenate([key[key >= n] for key, *_ in parts] or [np.zeros(0, np.int64)]))
    i, j = np.divmod(pairs - n, n)
    graph, upper, lower = symmetric(i, j, n)
    matrix = Matrix(
        diagonal=np.zeros((n, 3, 3)),
        first=offsets(graph.first),
        column=indices(graph.column),
        block=np.zeros((len(graph.column), 3, 3)),
    )
    targets = np.concatenate([np.arange(n), pairs])
    return matrix, [_gather(part, targets, indices(upper), indices(lower)) for part in parts]


def pattern(matrix: Matrix) -> Graph:
    """Which vertices the matrix couples."""
    return Graph(matrix.first.astype(np.int64), matrix.column.astype(np.int64))


def _contributions(nodes: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    """(key, element, a, b) of every block that elements touch: key i for vertex i, n + i n + j for i < j."""
    e, k = nodes.shape
    found = []
    for a in range(k):
        found.append((nodes[:, a], np.arange(e), a, a))
        for b in range(a + 1, k):
            low, high = np.minimum(nodes[:, a], nodes[:, b]), np.maximum(nodes[:, a], nodes[:, b])
            flip = nodes[:, a] > nodes[:, b]
            found.append((n + low * n + high, np.arange(e), np.where(flip, b, a), np.where(flip, a, b)))
    columns = zip(*((key, element, a + 0 * key, b + 0 * key) for key, element, a, b in found), strict=True)
    return tuple(np.concatenate(column) for column in columns)


def _gather(
    part: tuple[np.ndarray, ...], targets: np.ndarray, upper: np.ndarray, lower: np.ndarray
) -> Gather:
    key, element, a, b = part
    order = np.lexsort((element, key))
    first = np.append(np.searchsorted(key[order], targets), len(key))
    return Gather(
        first=offsets(first),
        shares=even_shares(first),
        element=indices(element[order]),
        a=a[order].astype(np.uint8),
        b=b[order].astype(np.uint8),
        upper=upper,
        lower=lower,
    )


@parallel_kernel
def reset(matrix, masses):
    """Set the matrix to the masses (n,) [kg] alone."""
    for chunk in numba.prange(CHUNKS):
        _reset_rows(matrix, share(chunk, len(masses)), masses)


@inner
def _reset_rows(matrix, part, masses):
    for i in range(part[0], part[1]):
        for r in range(3):
            for c in range(3):
                matrix.diagonal[i, r, c] = masses[i] if r == c else 0.0
        for p in range(matrix.first[i], matrix.first[i + 1]):
            for r in range(3):
                for c in range(3):
                    matrix.block[p, r, c] = 0.0


@parallel_kernel
def add_elements(elements, gather, bends, matrix):
    """Add along g_a g_bᵀ + across (g_a·g_b) S of every element to the matrix; S as in `sim.elements`."""
    n = len(matrix.diagonal)
    for chunk in numba.prange(CHUNKS):
        for target in range(gather.shares[chunk], gather.shares[chunk + 1]):
            if gather.first[target] == gather.first[target + 1]:
                continue  # coupled by other kinds only
            xx = xy = xz = yx = yy = yz = zx = zy = zz = 0.0
            if bends != NONE:
                for c in range(gather.first[target], gather.first[target + 1]):
                    e = gather.element[c]
                    w = elements.weight[e, gather.a[c]] * elements.weight[e, gather.b[c]]
                    xx += w * elements.tensor[e, 0]
                    xy += w * elements.tensor[e, 1]
                    xz += w * elements.tensor[e, 2]
                    yy += w * elements.tensor[e, 3]
                    yz += w * elements.tensor[e, 4]
                    zz += w * elements.tensor[e, 5]
                yx, zx, zy = xy, xz, yz
            else:
                for c in range(gather.first[target], gather.first[target + 1]):
                    e = gather.element[c]
                    g = scale(elements.along[e], corner(elements.gradient, e, gather.a[c]))
                    k = corner(elements.gradient, e, gather.b[c])
                    xx += g.x * k.x
                    xy += g.x * k.y
                    xz += g.x * k.z
                    yx += g.y * k.x
                    yy += g.y * k.y
                    yz += g.y * k.z
                    zx += g.z * k.x
                    zy += g.z * k.y
                    zz += g.z * k.z
            if target < n:
                _add(matrix.diagonal, target, xx, xy, xz, yx, yy, yz, zx, zy, zz)
            else:
                _add(matrix.block, gather.upper[target - n], xx, xy, xz, yx, yy, yz, zx, zy, zz)
                _add(matrix.block, gather.lower[target - n], xx, yx, zx, xy, yy, zy, xz, yz, zz)


@inner
def _add(blocks, p, xx, xy, xz, yx, yy, yz, zx, zy, zz):
    blocks[p, 0, 0] += xx
    blocks[p, 0, 1] += xy
    blocks[p, 0, 2] += xz
    blocks[p, 1, 0] += yx
    blocks[p, 1, 1] += yy
    blocks[p, 1, 2] += yz
    blocks[p, 2, 0] += zx
    blocks[p, 2, 1] += zy
    blocks[p, 2, 2] += zz


@kernel
def add_curvature(elements, gather, curvature, h, matrix):
    """Add h² K (q − q0) ∇²q of every element to the matrix, from its `curvature` (e, 3 k, 3 k)."""
    n = len(matrix.diagonal)
    for target in range(len(gather.first) - 1):
        for c in range(gather.first[target], gather.first[target + 1]):
            e = gather.element[c]
            a, b = 3 * np.int64(gather.a[c]), 3 * np.int64(gather.b[c])
            tension = h * h * elements.stiffness[e] * (elements.q[e] - elements.rest[e])
            for r in range(3):
                for s in range(3):
                    value = tension * curvature[e, a + r, b + s]
                    if target < n:
                        matrix.diagonal[target, r, s] += value
                    else:
                        matrix.block[gather.upper[target - n], r, s] += value
                        matrix.block[gather.lower[target - n], s, r] += value


@parallel_kernel
def add_forces(elements, gather, forces):
    """Add −s g_a of every element to `forces` (n, 3) [N]."""
    for i in numba.prange(len(forces)):
        x = y = z = 0.0
        for c in range(gather.first[i], gather.first[i + 1]):
            e, a = gather.element[c], gather.a[c]
            tension = elements.tension[e]
            x += tension * elements.gradient[e, a, 0]
            y += tension * elements.gradient[e, a, 1]
            z += tension * elements.gradient[e, a, 2]
        forces[i, 0] -= x
        forces[i, 1] -= y
        forces[i, 2] -= z


@kernel
def pull(elements, gather, velocities, forces):
    """Do `set_tension` and `add_forces` in one call, and return what the former does."""
    sums = set_tension(elements, velocities)
    add_forces(elements, gather, forces)
    return sums


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
