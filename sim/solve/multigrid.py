"""The preconditioner: what is fast locally, exact solves where cloth is free to flap, and coarse levels.

    P⁻¹ = D⁻¹ + Σ patches A_k⁻¹ + H V Hᵀ

D⁻¹ inverts the 3 × 3 blocks of single vertices. It is slow to find two things, which the others know.
Motions that are smooth over several edges: H interpolates them linearly from the nodes of a lattice over the
rest shape (`sim.solve.lattice`), and V is one symmetric multigrid cycle (Gauss–Seidel down and up, exact on
the coarsest level) for the Galerkin matrix Hᵀ A H and coarser ones. And motions that bend cloth almost
without stretching it: the free hem can flap in short waves, so the vertices within a few rings of it are
solved for together (`sim.solve.patches`), as are those joined by edges much shorter than the mesh's.

All of that is symmetric and positive definite, so it suits conjugate gradients. What depends on the mesh
alone is built once; `refresh` computes the rest anew for each matrix, in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, indices, inner, kernel, offsets, parallel_kernel, share
from sim.mesh import Mesh
from sim.solve.graph import Graph, connected, grown
from sim.solve.lattice import Weights, by_point, interpolate, principal_axes, starts
from sim.solve.patches import Patches, band_width, build_patches, factor, solve_patch
from sim.solve.system import Matrix, pattern

SPACING, COARSENING = 3.0, 4.0
"""Mean edge lengths between nodes of the finest lattice, and ratio from each lattice to the next."""

COARSEST = 300
"""A level of at most so many nodes is solved exactly."""

RINGS = 4
"""Rings of vertices from a free edge inwards that make up the hem."""

SHORT = 0.5
"""Edges shorter than this part of the mean join vertices that are solved for together."""

LARGEST = 512
"""Vertices of a patch before it is cut: it is cut into parts that can be solved side by side."""

OVERLAP = 6
"""Rings by which parts of a patch overlap, so that the cuts do not show."""

WORK = 2000.0
"""Multiplications per vertex of the mesh that factoring a patch may cost; a costlier one is cut smaller."""

SMALLEST = 64
"""Vertices of a part that is not cut smaller, whatever it costs."""

PRODUCTS = 256
"""Parts of the Galerkin product; its targets differ in work, so there are many."""

LANES = 8
"""Parts that patches and coarse levels are shared out to."""


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
    source: np.ndarray
    weight: np.ndarray
    of_up: np.ndarray
    up: np.ndarray
    up_weight: np.ndarray
    x: np.ndarray
    b: np.ndarray


class Local(NamedTuple):
    """What happens at each of the n vertices.

    Attributes:
        free: (n,) bool.
        single: (n,) bool, which vertices are free and in no patch.
        inverse: (n, 3, 3) inverses of the diagonal blocks of A at single vertices.
        of_place: (n + 1,) where each vertex's places in patches start in `place`.
        place: Rows of the patches' room.
        of_vertex: (n + 1,) where each vertex's nodes of the first coarse level start in `node`.
        node: The nodes that a vertex depends on.
        node_weight: Their weights.
        of_node: (m1 + 1,) where each node's vertices start in `vertex`.
        vertex: The vertices that depend on a node.
        vertex_weight: Its weights there.
        shares: (CHUNKS + 1,) nodes split so that every part has about as many vertices.
    """

    free: np.ndarray
    single: np.ndarray
    inverse: np.ndarray
    of_place: np.ndarray
    place: np.ndarray
    of_vertex: np.ndarray
    node: np.ndarray
    node_weight: np.ndarray
    of_node: np.ndarray
    vertex: np.ndarray
    vertex_weight: np.ndarray
    shares: np.ndarray


class Lanes(NamedTuple):
    """Tasks shared out to lanes that run side by side.

    Attributes:
        first: (LANES + 1,) where each lane's tasks start in `task`.
        task: Patches by number; −1 stands for the coarse levels.
    """

    first: np.ndarray
    task: np.ndarray


class Preconditioner(NamedTuple):
    """P⁻¹; `coarsest` holds the patches of the last level's matrix."""

    local: Local
    patches: Patches
    coarse: Coarse
    coarsest: Patches
    lanes: Lanes


def build_preconditioner(mesh: Mesh, free: np.ndarray, matrix: Matrix) -> Preconditioner:
    """Patches and coarse levels of `mesh`, and where they meet the blocks of `matrix`."""
    n = len(free)
    lengths = np.linalg.norm(np.diff(mesh.rest_vertices[mesh.edges], axis=1)[:, 0], axis=1)
    patches = build_patches(pattern(matrix), _patch_sets(mesh, free, matrix, lengths))
    weights, coarse, coarsest = _levels(mesh, free, matrix, lengths)
    m = int(coarse.level[1])
    single = free.copy()
    single[patches.vertex] = False
    point = np.repeat(np.arange(n), np.diff(weights.first))
    order = np.lexsort((point, weights.node))
    of_node = starts(weights.node[order], m)
    share = np.searchsorted(of_node, np.linspace(0, of_node[-1], CHUNKS + 1)).clip(0, m)
    local = Local(
        free=free,
        single=single,
        inverse=np.zeros((n, 3, 3)),
        of_place=offsets(starts(np.sort(patches.vertex), n)),
        place=indices(np.argsort(patches.vertex, kind="stable")),
        of_vertex=offsets(weights.first),
        node=indices(weights.node),
        node_weight=weights.weight,
        of_node=offsets(of_node),
        vertex=indices(point[order]),
        vertex_weight=weights.weight[order],
        shares=share.astype(np.int64),
    )
    return Preconditioner(local, patches, coarse, coarsest, _lanes(patches, coarse, coarsest))


def _patch_sets(mesh: Mesh, free: np.ndarray, matrix: Matrix, lengths: np.ndarray) -> list[np.ndarray]:
    """The vertices of each patch: the hem, and what short edges join, cut where it would cost too much."""
    n = len(free)
    hem = _hem(mesh)
    mean = _mean_lengths(mesh, lengths)
    a, b = mesh.edges.T
    joined = (hem[a] & hem[b]) | (lengths < SHORT * mean[mesh.pieces[a]])
    a, b = mesh.edges[joined & free[a] & free[b]].T
    ends, others = np.concatenate([a, b]), np.concatenate([b, a])
    order = np.lexsort((others, ends))
    graph = Graph(starts(ends[order], n), others[order])
    whole, sets = pattern(matrix), []
    inside = np.diff(graph.first) > 0
    for component in connected(graph, inside, n):
        member = np.zeros(n, dtype=bool)
        member[component] = True
        most = LARGEST
        while True:
            parts = connected(graph, member, most)
            parts = [grown(graph, part, member, OVERLAP if len(parts) > 1 else 0) for part in parts]
            if most <= SMALLEST or _work(whole, parts) <= WORK * n:
                break
            most //= 2
        sets += parts
    return sets


def _work(graph: Graph, sets: list[np.ndarray]) -> float:
    """Multiplications that factoring takes."""
    return sum(1.5 * len(members) * band_width(graph, members) ** 2 for members in sets)


def _hem(mesh: Mesh) -> np.ndarray:
    """(n,) bool: vertices within RINGS rings of an edge that has a triangle on one side only, or none."""
    sides = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, inverse, count = np.unique(
        np.concatenate([sides, np.sort(mesh.edges, axis=1)]), axis=0, return_inverse=True, return_counts=True
    )
    bare = count[inverse.ravel()[len(sides) :]] < 3
    hem = np.zeros(len(mesh.vertices), dtype=bool)
    hem[mesh.edges[bare]] = True
    for _ in range(RINGS - 1):
        near = hem[mesh.edges].any(axis=1)
        hem[mesh.edges[near]] = True
    return hem


def _mean_lengths(mesh: Mesh, lengths: np.ndarray) -> np.ndarray:
    """(pieces,) mean edge length [m], zero for a piece without edges."""
    piece, count = mesh.pieces[mesh.edges[:, 0]], len(mesh.density)
    return np.bincount(piece, lengths, count) / np.maximum(np.bincount(piece, minlength=count), 1)


def _levels(
    mesh: Mesh, free: np.ndarray, matrix: Matrix, lengths: np.ndarray
) -> tuple[Weights, Coarse, Patches]:
    """Weights from the vertices to the first level, all coarse levels, and the patches of the coarsest."""
    n, spacing = len(free), SPACING * _mean_lengths(mesh, lengths)
    owner = np.where(free & (spacing[mesh.pieces] > 0.0), mesh.pieces, -1)
    points = np.zeros((n, 3))
    for piece in range(len(spacing)):
        own = owner == piece
        if own.any():
            points[own] = principal_axes(mesh.rest_vertices[own])
    weights, points, owner = _next_level(points, owner, spacing)
    up, sizes = list[Weights](), [len(points)]
    products = [_galerkin(pattern(matrix), weights, len(points))]
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
    ends, others = np.concatenate([i, j]), np.concatenate([j, i])
    sorting = np.lexsort((others, ends))
    place = np.empty_like(sorting)
    place[sorting] = np.arange(len(sorting))
    return _Galerkin(
        graph=Graph(starts(ends[sorting], m), others[sorting]),
        upper=np.concatenate([-1 - np.arange(m), place[: len(pairs)]]),
        lower=np.concatenate([np.zeros(m, int), place[len(pairs) :]]),
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


def _lanes(patches: Patches, coarse: Coarse, coarsest: Patches) -> Lanes:
    """Tasks shared out to lanes, the longest first and each to the lane with the least to do.

    The two longest stand in the first and the last lane: the first half of the lanes, which is one thread's
    part of two, has then about as much to do as the second.
    """
    length = 3.0 * np.diff(patches.first) * patches.width
    cycle = 3.0 * float(np.diff(coarsest.first) @ coarsest.width) + 9.0 * len(coarse.column)
    work = {-1: cycle, **dict(enumerate(length))}
    lanes: list[list[int]] = [[] for _ in range(LANES)]
    load = np.zeros(LANES)
    for task in sorted(work, key=lambda t: (-work[t], t)):
        lane = int(load.argmin())
        lanes[lane].append(task)
        load[lane] += work[task]
    order = [*range(0, LANES, 2), *range(LANES - 1, 0, -2)]
    counts = [len(lanes[k]) for k in order]
    return Lanes(np.concatenate([[0], np.cumsum(counts)]), np.array([t for k in order for t in lanes[k]]))


@kernel
def refresh(preconditioner, matrix):
    """Compute P⁻¹ anew for `matrix`."""
    h = preconditioner
    invert_singles(h.local, matrix)
    galerkin(h.coarse, matrix)
    factor_lanes(h.lanes, h.patches, h.coarse, h.coarsest, matrix)


@parallel_kernel
def invert_singles(local, matrix):
    """Invert the diagonal blocks of A of single vertices."""
    for i in numba.prange(len(local.single)):
        if local.single[i]:
            invert(matrix.diagonal[i], local.inverse[i])


@parallel_kernel
def galerkin(coarse, matrix):
    """Fill the blocks of the first level with Hᵀ A H."""
    for chunk in numba.prange(PRODUCTS):
        begin, end = chunk * coarse.targets[1] // PRODUCTS, (chunk + 1) * coarse.targets[1] // PRODUCTS
        _gather(coarse, begin, end, matrix.diagonal, matrix.block)


@inner
def _gather(coarse, begin, end, diagonal, block):
    """Fill the targets from `begin` to `end` with their sources, blocks of the matrix of the level before."""
    for target in range(begin, end):
        xx = xy = xz = yx = yy = yz = zx = zy = zz = 0.0
        for k in range(coarse.of_target[target], coarse.of_target[target + 1]):
            s, w = coarse.source[k], coarse.weight[k]
            a = diagonal[-1 - s] if s < 0 else block[s]
            xx += w * a[0, 0]
            xy += w * a[0, 1]
            xz += w * a[0, 2]
            yx += w * a[1, 0]
            yy += w * a[1, 1]
            yz += w * a[1, 2]
            zx += w * a[2, 0]
            zy += w * a[2, 1]
            zz += w * a[2, 2]
        place = coarse.upper[target]
        out = coarse.diagonal[-1 - place] if place < 0 else coarse.block[place]
        out[0, 0], out[0, 1], out[0, 2] = xx, xy, xz
        out[1, 0], out[1, 1], out[1, 2] = yx, yy, yz
        out[2, 0], out[2, 1], out[2, 2] = zx, zy, zz
        if place >= 0:
            other = coarse.block[coarse.lower[target]]
            other[0, 0], other[0, 1], other[0, 2] = xx, yx, zx
            other[1, 0], other[1, 1], other[1, 2] = xy, yy, zy
            other[2, 0], other[2, 1], other[2, 2] = xz, yz, zz


@parallel_kernel
def factor_lanes(lanes, patches, coarse, coarsest, matrix):
    """Factor the patches, and prepare the coarse levels."""
    for lane in numba.prange(LANES):
        for t in range(lanes.first[lane], lanes.first[lane + 1]):
            if lanes.task[t] >= 0:
                factor(patches, lanes.task[t], matrix.diagonal, matrix.block)
            else:
                _prepare(coarse, coarsest)


@inner
def _prepare(coarse, coarsest):
    """The matrices of the second level and on, what Gauss–Seidel needs, and the factors of the last level."""
    for k in range(1, len(coarse.targets) - 1):
        _gather(coarse, coarse.targets[k], coarse.targets[k + 1], coarse.diagonal, coarse.block)
    for i in range(coarse.level[-2]):
        invert(coarse.diagonal[i], coarse.inverse[i])
    for k in range(len(coarsest.width)):
        factor(coarsest, k, coarse.diagonal, coarse.block)


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


@inner
def _cycle(coarse, coarsest):
    """Fill coarse.x on the first level with V coarse.b."""
    c = coarse
    levels = len(c.level) - 1
    for k in range(levels - 1):
        c.b[c.level[k + 1] : c.level[k + 2]] = 0.0
        for i in range(c.level[k], c.level[k + 1]):
            _relax(i, c.first[i], c.middle[i], c.column, c.block, c.inverse, c.b, c.x)
        for i in range(c.level[k], c.level[k + 1]):  # what is left of b is what later nodes have changed
            left = _coupled(c.middle[i], c.first[i + 1], c.column, c.block, c.x)
            for p in range(c.of_up[i], c.of_up[i + 1]):
                j, s = c.up[p], c.up_weight[p]
                for r in range(3):
                    c.b[j, r] -= s * left[r]
    for k in range(len(coarsest.width)):
        solve_patch(coarsest, k, c.b)
        for m in range(coarsest.first[k], coarsest.first[k + 1]):
            i = coarsest.vertex[m]
            for r in range(3):
                c.x[i, r] = coarsest.room[m, r]
    for k in range(levels - 2, -1, -1):
        for i in range(c.level[k], c.level[k + 1]):
            for p in range(c.of_up[i], c.of_up[i + 1]):
                j, s = c.up[p], c.up_weight[p]
                for r in range(3):
                    c.x[i, r] += s * c.x[j, r]
        for i in range(c.level[k + 1] - 1, c.level[k] - 1, -1):
            _relax(i, c.first[i], c.first[i + 1], c.column, c.block, c.inverse, c.b, c.x)


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
def _relax(i, begin, end, column, block, inverse, b, x):
    """Solve row i for x_i, given those of the blocks from `begin` to `end`."""
    u, v, w = _coupled(begin, end, column, block, x)
    u, v, w = b[i, 0] - u, b[i, 1] - v, b[i, 2] - w
    for r in range(3):
        x[i, r] = inverse[i, r, 0] * u + inverse[i, r, 1] * v + inverse[i, r, 2] * w


@inner
def precondition(preconditioner, r, z, partial, largest):
    """Fill z = P⁻¹ r and return rᵀ z and the largest |z_i|²; r must be zero on fixed vertices."""
    h = preconditioner
    _to_nodes(h.local, r, h.coarse.b)
    _solve_lanes(h.lanes, h.patches, h.coarse, h.coarsest, r)
    return _to_vertices(h.local, h.patches.room, h.coarse.x, r, z, partial, largest)


@parallel_kernel
def _to_nodes(local, r, b):
    """Fill b on the first level with Hᵀ r."""
    for chunk in numba.prange(CHUNKS):
        for m in range(local.shares[chunk], local.shares[chunk + 1]):
            u = v = w = 0.0
            for k in range(local.of_node[m], local.of_node[m + 1]):
                i, s = local.vertex[k], local.vertex_weight[k]
                u += s * r[i, 0]
                v += s * r[i, 1]
                w += s * r[i, 2]
            b[m, 0], b[m, 1], b[m, 2] = u, v, w


@parallel_kernel
def _solve_lanes(lanes, patches, coarse, coarsest, r):
    """Solve on the patches, and on the coarse levels."""
    for lane in numba.prange(LANES):
        for t in range(lanes.first[lane], lanes.first[lane + 1]):
            if lanes.task[t] >= 0:
                solve_patch(patches, lanes.task[t], r)
            else:
                _cycle(coarse, coarsest)


@parallel_kernel
def _to_vertices(local, room, x, r, z, partial, largest):
    """Fill z with what single vertices, patches and nodes give; returns rᵀ z and the largest |z_i|²."""
    n = len(r)
    for chunk in numba.prange(CHUNKS):
        total = most = 0.0
        begin, end = share(chunk, n)
        for i in range(begin, end):
            u, v, w = r[i, 0], r[i, 1], r[i, 2]
            if local.single[i]:
                d = local.inverse[i]
                a = d[0, 0] * u + d[0, 1] * v + d[0, 2] * w
                b = d[1, 0] * u + d[1, 1] * v + d[1, 2] * w
                c = d[2, 0] * u + d[2, 1] * v + d[2, 2] * w
            else:
                a = b = c = 0.0
                for k in range(local.of_place[i], local.of_place[i + 1]):
                    m = local.place[k]
                    a += room[m, 0]
                    b += room[m, 1]
                    c += room[m, 2]
            for k in range(local.of_vertex[i], local.of_vertex[i + 1]):
                m, s = local.node[k], local.node_weight[k]
                a += s * x[m, 0]
                b += s * x[m, 1]
                c += s * x[m, 2]
            z[i, 0], z[i, 1], z[i, 2] = a, b, c
            total += a * u + b * v + c * w
            most = max(most, a * a + b * b + c * c)
        partial[chunk], largest[chunk] = total, most
    most = 0.0
    for chunk in range(CHUNKS):
        most = max(most, largest[chunk])
    return in_order(partial), most


@inner
def in_order(parts):
    """The sum of `parts`, first to last."""
    total = 0.0
    for part in parts:
        total += part
    return total
