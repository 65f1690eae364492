"""The coarse levels of the preconditioner: one symmetric multigrid cycle V for the Galerkin matrix Hᵀ A H.

The first level's nodes are those of a lattice over the rest shape of each piece, H interpolates from them
linearly (`sim.solve.lattice`), and every further level does the same for the nodes of the level before. A
cycle relaxes by Gauss–Seidel on the way down and back up, and solves the coarsest level exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, even_shares, indices, inner, offsets, parallel_kernel
from sim.mesh import Mesh
from sim.solve.graph import Graph, connected, grown, symmetric
from sim.solve.lattice import Weights, by_point, interpolate, principal_axes
from sim.solve.patches import Patches, build_patches, factor, solve_patch
from sim.solve.system import invert

SPACING, COARSENING = 3.0, 4.0
"""Mean edge lengths between nodes of the finest lattice, and ratio from each lattice to the next."""

COARSEST = 100
"""A level of at most so many nodes is solved exactly."""


class Coarse(NamedTuple):
    """m nodes of all coarse levels, finest level first, and the blocks of their matrices.

    Attributes:
        level: (levels + 1,) where each level's nodes start.
        first: (m + 1,) where each node's blocks start in `column` and `block`, in ascending columns.
        middle: (m,) where those right of the diagonal start.
        column: The other node of each block.
        block: (b, 3, 3).
        diagonal: (m, 3, 3).
        inverse: (m, 3, 3) of `diagonal`.
        targets: (levels + 1,) where each level's targets start: its nodes, then its pairs of nodes.
        upper: (t,) index in `block` of each target above the diagonal, −1 − i for the diagonal of node i.
        lower: (t,) index of its transpose.
        of_target: (t + 1,) where each target's sources start.
        shares: (CHUNKS + 1,) the first level's targets split so that every part has about as many sources.
        source: Block of the level before, or of A for the first level, numbered like those of patches.
        weight: Factor of that block.
        of_up: (levels' nodes but the last + 1,) where each node's nodes on the next level start in `up`.
        up: Nodes of the next level that a node depends on.
        up_weight: Their weights.
        x: (m, 3) room for the solution.
        b: (m, 3) room for the right-hand side.
    """

    level: np.ndarray
    first: np.ndarray
    middle: np.ndarray
    column: np.ndarray
    block: np.ndarray
    diagonal: np.ndarray
    inverse: np.ndarray
    targets: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    of_target: np.ndarray
    shares: np.ndarray
    source: np.ndarray
    weight: np.ndarray
    of_up: np.ndarray
    up: np.ndarray
    up_weight: np.ndarray
    x: np.ndarray
    b: np.ndarray


def build_levels(
    mesh: Mesh, free: np.ndarray, graph: Graph, lengths: np.ndarray
) -> tuple[Weights, Coarse, Patches]:
    """Weights from the vertices to the first level, all coarse levels, and the patches of the coarsest.

    Args:
        mesh: The cloth.
        free: (n,) bool, the vertices that depend on nodes.
        graph: Which of them A couples.
        lengths: (pieces,) mean edge length of each piece [m].
    """
    n, spacing = len(free), SPACING * lengths
    owner = np.where(free & (spacing[mesh.pieces] > 0.0), mesh.pieces, -1)
    points = np.zeros((n, 3))
    for piece in range(len(spacing)):
        own = owner == piece
        if own.any():
            points[own] = principal_axes(mesh.rest_vertices[own])
    weights, points, owner = _next_level(points, owner, spacing)
    up, sizes = list[Weights](), [len(points)]
    products = [_galerkin(graph, weights, len(points))]
    while len(points) > COARSEST:
        spacing = COARSENING * spacing
        coarser, points, owner = _next_level(points, owner, spacing)
        if 2 * len(points) > sizes[-1]:
            break  # many small pieces: what is left hardly couples
        products.append(_galerkin(products[-1].graph, coarser, len(points)))
        up.append(coarser)
        sizes.append(len(points))
    return weights, *_joined(sizes, products, up)


def _next_level(
    points: np.ndarray, owner: np.ndarray, spacing: np.ndarray
) -> tuple[Weights, np.ndarray, np.ndarray]:
    """Weights of `points` (n, 3) from the lattice of their piece, its nodes (m, 3), and their pieces (m,).

    Args:
        points: In the axes of their piece.
        owner: (n,) piece of each point, −1 for one that shall depend on no node.
        spacing: (pieces,) of each piece's lattice.
    """
    found = [(np.zeros(0, int), np.zeros(0, int), np.zeros(0))]
    nodes, owners, count = [np.zeros((0, 3))], [np.zeros(0, int)], 0
    for piece in np.unique(owner[owner >= 0]):
        own = np.flatnonzero(owner == piece)
        point, node, weight, places = interpolate(points[own], float(spacing[piece]))
        found.append((own[point], node + count, weight))
        nodes.append(places)
        owners.append(np.full(len(places), piece))
        count += len(places)
    point, node, weight = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return by_point(point, node, weight, len(points)), np.concatenate(nodes), np.concatenate(owners)


class _Galerkin(NamedTuple):
    """How a coarse matrix comes from a finer one; its targets are m nodes, then pairs of them."""

    graph: Graph
    upper: np.ndarray
    lower: np.ndarray
    of_target: np.ndarray
    source: np.ndarray
    weight: np.ndarray


def _galerkin(fine: Graph, weights: Weights, m: int) -> _Galerkin:
    """Hᵀ A H for A with the pattern `fine` and H the weights from m nodes."""
    n = len(fine.first) - 1
    rows = np.concatenate([np.arange(n), np.repeat(np.arange(n), np.diff(fine.first))])
    columns = np.concatenate([np.arange(n), fine.column])
    number = np.concatenate([-1 - np.arange(n), np.arange(len(fine.column))])
    span = np.diff(weights.first)
    keys, sources, factors = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for a in range(int(span.max(initial=0))):
        for b in range(int(span.max(initial=0))):
            kept = np.flatnonzero((span[rows] > a) & (span[columns] > b))
            p, q = weights.first[rows[kept]] + a, weights.first[columns[kept]] + b
            above = weights.node[p] <= weights.node[q]
            p, q, kept = p[above], q[above], kept[above]
            i, j = weights.node[p], weights.node[q]
            keys.append(np.where(i == j, i, m + i * m + j))
            sources.append(number[kept])
            factors.append(weights.weight[p] * weights.weight[q])
    key, source, factor_ = np.concatenate(keys), np.concatenate(sources), np.concatenate(factors)
    order = np.lexsort((source, key))
    key = key[order]
    pairs = np.unique(key[key >= m])
    i, j = np.divmod(pairs - m, m) if m else (pairs, pairs)
    graph, upper, lower = symmetric(i, j, m)
    return _Galerkin(
        graph=graph,
        upper=np.concatenate([-1 - np.arange(m), upper]),
        lower=np.concatenate([np.zeros(m, int), lower]),
        of_target=np.append(np.searchsorted(key, np.concatenate([np.arange(m), pairs])), len(key)),
        source=source[order],
        weight=factor_[order],
    )


def _joined(sizes: list[int], products: list[_Galerkin], ups: list[Weights]) -> tuple[Coarse, Patches]:
    """All levels in one, numbered through, and the patches of the last one's connected parts."""
    level = np.concatenate([[0], np.cumsum(sizes)])
    m, blocks, contributions = int(level[-1]), 0, 0
    first, column, upper, lower, of_target, source, targets = [], [], [], [], [], [], [0]
    finer_blocks = 0
    for k, product in enumerate(products):
        first.append(product.graph.first[:-1] + blocks)
        column.append(product.graph.column + level[k])
        upper.append(np.where(product.upper < 0, product.upper - level[k], product.upper + blocks))
        lower.append(product.lower + blocks)
        of_target.append(product.of_target[:-1] + contributions)
        finer = level[k - 1] if k else 0
        source.append(np.where(product.source < 0, product.source - finer, product.source + finer_blocks))
        targets.append(targets[-1] + len(product.upper))
        finer_blocks, blocks = blocks, blocks + len(product.graph.column)
        contributions += len(product.source)
    first_, column_ = np.append(np.concatenate(first), blocks), np.concatenate(column)
    row = np.repeat(np.arange(m), np.diff(first_))
    last = np.zeros(m, dtype=bool)
    last[level[-2] :] = True
    graph = Graph(first_, column_)
    no_weights = np.zeros(0)
    coarse = Coarse(
        level=level.astype(np.int64),
        first=offsets(first_),
        middle=offsets(first_[:-1] + np.bincount(row, column_ < row, m)),
        column=indices(column_),
        block=np.zeros((blocks, 3, 3)),
        diagonal=np.zeros((m, 3, 3)),
        inverse=np.zeros((m, 3, 3)),
        targets=np.array(targets, dtype=np.int64),
        upper=np.concatenate(upper).astype(np.int32),
        lower=np.concatenate(lower).astype(np.int32),
        of_target=offsets(np.append(np.concatenate(of_target), contributions)),
        shares=even_shares(products[0].of_target),
        source=np.concatenate(source).astype(np.int32),
        weight=np.concatenate([p.weight for p in products]),
        of_up=offsets(np.concatenate([[0], *(np.diff(u.first) for u in ups)]).cumsum()),
        up=indices(np.concatenate([no_weights, *(u.node + level[k + 1] for k, u in enumerate(ups))])),
        up_weight=np.concatenate([no_weights, *(u.weight for u in ups)]),
        x=np.zeros((m, 3)),
        b=np.zeros((m, 3)),
    )
    parts = [grown(graph, part, last, 0) for part in connected(graph, last, m)]
    return coarse, build_patches(graph, parts)


@parallel_kernel
def galerkin(coarse, matrix):
    """Fill the blocks of the first level with Hᵀ A H."""
    for chunk in numba.prange(CHUNKS):
        _fill(coarse, coarse.shares[chunk], coarse.shares[chunk + 1], matrix.diagonal, matrix.block)


@inner
def _fill(coarse, begin, end, diagonal, block):
    """Fill the targets from `begin` to `end` from the matrix of the level before."""
    c = coarse
    lists = c.of_target, c.source, c.weight, c.upper, c.lower
    _gather(begin, end, *lists, diagonal, block, c.diagonal, c.block)


@inner
def _gather(begin, end, of_target, source, weight, upper, lower, diagonal, block, to_diagonal, to_block):
    """Fill the targets from `begin` to `end` with their sources, blocks of the matrix of the level before."""
    for target in range(begin, end):
        xx = xy = xz = yx = yy = yz = zx = zy = zz = 0.0
        for k in range(of_target[target], of_target[target + 1]):
            s, w = source[k], weight[k]
            a, s = (diagonal, -1 - s) if s < 0 else (block, s)
            xx += w * a[s, 0, 0]
            xy += w * a[s, 0, 1]
            xz += w * a[s, 0, 2]
            yx += w * a[s, 1, 0]
            yy += w * a[s, 1, 1]
            yz += w * a[s, 1, 2]
            zx += w * a[s, 2, 0]
            zy += w * a[s, 2, 1]
            zz += w * a[s, 2, 2]
        place = upper[target]
        out, p = (to_diagonal, -1 - place) if place < 0 else (to_block, place)
        out[p, 0, 0], out[p, 0, 1], out[p, 0, 2] = xx, xy, xz
        out[p, 1, 0], out[p, 1, 1], out[p, 1, 2] = yx, yy, yz
        out[p, 2, 0], out[p, 2, 1], out[p, 2, 2] = zx, zy, zz
        if place >= 0:
            p = lower[target]
            to_block[p, 0, 0], to_block[p, 0, 1], to_block[p, 0, 2] = xx, yx, zx
            to_block[p, 1, 0], to_block[p, 1, 1], to_block[p, 1, 2] = xy, yy, zy
            to_block[p, 2, 0], to_block[p, 2, 1], to_block[p, 2, 2] = xz, yz, zz


@inner
def prepare(coarse, coarsest):
    """The matrices of the second level and on, what Gauss–Seidel needs, and the factors of the last level."""
    for k in range(1, len(coarse.targets) - 1):
        _fill(coarse, coarse.targets[k], coarse.targets[k + 1], coarse.diagonal, coarse.block)
    for i in range(coarse.level[-2]):
        invert(coarse.diagonal[i], coarse.inverse[i])
    for k in range(len(coarsest.first) - 1):
        factor(coarsest, k, coarse.diagonal, coarse.block)


@inner
def cycle(coarse, coarsest):
    """Fill coarse.x on the first level with V coarse.b."""
    c = coarse  # its arrays are handed on one by one: with the whole tuple, loops take twice as long
    levels = len(c.level) - 1
    for k in range(levels - 1):
        begin, end = c.level[k], c.level[k + 1]
        c.b[end : c.level[k + 2]] = 0.0
        _relax_down(begin, end, c.first, c.middle, c.column, c.block, c.inverse, c.b, c.x)
        _restrict(begin, end, c.first, c.middle, c.column, c.block, c.of_up, c.up, c.up_weight, c.x, c.b)
    for k in range(len(coarsest.first) - 1):
        solve_patch(coarsest, k, c.b)
        for m in range(coarsest.first[k], coarsest.first[k + 1]):
            i = coarsest.vertex[m]
            for r in range(3):
                c.x[i, r] = coarsest.room[m, r]
    for k in range(levels - 2, -1, -1):
        begin, end = c.level[k], c.level[k + 1]
        _interpolate(begin, end, c.of_up, c.up, c.up_weight, c.x)
        _relax_up(begin, end, c.first, c.column, c.block, c.inverse, c.b, c.x)


@inner
def _relax_down(begin, end, first, middle, column, block, inverse, b, x):
    """Solve row after row for x, which is zero before."""
    for i in range(begin, end):
        u, v, w = _coupled(first[i], middle[i], column, block, x)
        _solve_row(inverse, i, b[i, 0] - u, b[i, 1] - v, b[i, 2] - w, x)


@inner
def _relax_up(begin, end, first, column, block, inverse, b, x):
    """Solve row after row for x, the last first."""
    for i in range(end - 1, begin - 1, -1):
        u, v, w = _coupled(first[i], first[i + 1], column, block, x)
        _solve_row(inverse, i, b[i, 0] - u, b[i, 1] - v, b[i, 2] - w, x)


@inner
def _restrict(begin, end, first, middle, column, block, of_up, up, up_weight, x, b):
    """Add to b on the next level what is left of it on this one: what later nodes have changed since."""
    for i in range(begin, end):
        u, v, w = _coupled(middle[i], first[i + 1], column, block, x)
        for p in range(of_up[i], of_up[i + 1]):
            j, s = up[p], up_weight[p]
            b[j, 0] -= s * u
            b[j, 1] -= s * v
            b[j, 2] -= s * w


@inner
def _interpolate(begin, end, of_up, up, up_weight, x):
    """Add the x of the next level to that of this one."""
    for i in range(begin, end):
        u = v = w = 0.0
        for p in range(of_up[i], of_up[i + 1]):
            j, s = up[p], up_weight[p]
            u += s * x[j, 0]
            v += s * x[j, 1]
            w += s * x[j, 2]
        x[i, 0] += u
        x[i, 1] += v
        x[i, 2] += w


@inner
def _coupled(begin, end, column, block, x):
    """Σ A_ij x_j over the blocks from `begin` to `end` of a row."""
    u = v = w = 0.0
    for p in range(begin, end):
        j = column[p]
        a, b, c = x[j, 0], x[j, 1], x[j, 2]
        u += block[p, 0, 0] * a + block[p, 0, 1] * b + block[p, 0, 2] * c
        v += block[p, 1, 0] * a + block[p, 1, 1] * b + block[p, 1, 2] * c
        w += block[p, 2, 0] * a + block[p, 2, 1] * b + block[p, 2, 2] * c
    return u, v, w


@inner
def _solve_row(inverse, i, u, v, w, x):
    x[i, 0] = inverse[i, 0, 0] * u + inverse[i, 0, 1] * v + inverse[i, 0, 2] * w
    x[i, 1] = inverse[i, 1, 0] * u + inverse[i, 1, 1] * v + inverse[i, 1, 2] * w
    x[i, 2] = inverse[i, 2, 0] * u + inverse[i, 2, 1] * v + inverse[i, 2, 2] * w
