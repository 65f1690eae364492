"""The preconditioner: exact solves on overlapping strips of cloth, and coarse levels for the rest.

    P⁻¹ = Σ strips A_k⁻¹ + H V Hᵀ

That is an additive Schwarz method with a coarse space (Dryja and Widlund 1987; Toselli and Widlund 2005). It
has to find two things fast. Motions that are smooth over many edges: H interpolates them linearly from the
nodes of a lattice over the rest shape (`sim.solve.lattice`), and V is one symmetric multigrid cycle
(Gauss–Seidel down and up, exact on the coarsest level) for the Galerkin matrix Hᵀ A H and coarser ones. And
motions that bend cloth almost without stretching it, as the hem flaps and as folds roll: linear interpolation
stretches it, so it does not find them, but exact solves on strips a few vertices wide do
(`sim.solve.patches`). The strips follow the hem, ring by ring of vertices, so that they can be long and their
factors narrow.

All of that is symmetric and positive definite, so it suits conjugate gradients. What depends on the mesh
alone is built once; `refresh` computes the rest anew for each matrix, in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, even_shares, indices, inner, kernel, offsets, parallel_kernel, share
from sim.mesh import Mesh
from sim.solve.graph import Graph, connected, grown, neighbours, starts, symmetric
from sim.solve.multigrid import Coarse, build_levels, cycle, galerkin, prepare
from sim.solve.patches import Patches, build_patches, factor, solve_patch, work_to_factor, work_to_solve
from sim.solve.system import Matrix, pattern

SHAPES = ((8, 512, 0), (2, 512, 1), (2, 64, 1))
"""Rings of vertices that make up a strip, vertices after which it is cut, and rings by which strips overlap:
tried in turn. Even meshes do without overlap, which uneven ones need."""

WORK = 7_000.0
"""Multiplications per vertex that factoring them may cost; the last shape is taken whatever it costs."""

ENDS = 4
"""Rings by which the parts of a strip that is cut overlap, so that the cuts do not show."""

SHORTEST = 256
"""Vertices up to which no strip is cut for there being more lanes than strips."""

LANES = 8
"""Parts that strips and coarse levels are shared out to."""

COUPLING = 25.0
"""What a block of the coarse levels takes in a cycle, over what an entry of a strip's factor takes."""


class Local(NamedTuple):
    """What happens at each of the n vertices.

    Attributes:
        free: (n,) bool.
        of_place: (n + 1,) where each vertex's places in strips start in `place`.
        place: Rows of the strips' room.
        of_vertex: (n + 1,) where each vertex's nodes of the first coarse level start in `node`.
        node: The nodes that a vertex depends on.
        node_weight: Their weights.
        of_node: (m1 + 1,) where each node's vertices start in `vertex`.
        vertex: The vertices that depend on a node.
        vertex_weight: Its weights there.
        shares: (CHUNKS + 1,) nodes split so that every part has about as many vertices.
    """

    free: np.ndarray
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
        task: Strips by number; −1 stands for the coarse levels.
    """

    first: np.ndarray
    task: np.ndarray


class Preconditioner(NamedTuple):
    """P⁻¹; `coarsest` holds the patches of the last level's matrix."""

    local: Local
    strips: Patches
    coarse: Coarse
    coarsest: Patches
    lanes: Lanes


def build_preconditioner(mesh: Mesh, free: np.ndarray, matrix: Matrix) -> Preconditioner:
    """Strips and coarse levels of `mesh`, and where they meet the blocks of `matrix`."""
    n, graph = len(free), pattern(matrix)
    strips = build_patches(graph, _strips(mesh, free, graph))
    weights, coarse, coarsest = build_levels(mesh, free, graph, _mean_lengths(mesh))
    m = int(coarse.level[1])
    point = np.repeat(np.arange(n), np.diff(weights.first))
    order = np.lexsort((point, weights.node))
    of_node = starts(weights.node[order], m)
    local = Local(
        free=free,
        of_place=offsets(starts(np.sort(strips.vertex), n)),
        place=indices(np.argsort(strips.vertex, kind="stable")),
        of_vertex=offsets(weights.first),
        node=indices(weights.node),
        node_weight=weights.weight,
        of_node=offsets(of_node),
        vertex=indices(point[order]),
        vertex_weight=weights.weight[order],
        shares=even_shares(of_node),
    )
    return Preconditioner(local, strips, coarse, coarsest, _lanes(strips, coarse, coarsest))


def _mean_lengths(mesh: Mesh) -> np.ndarray:
    """(pieces,) mean edge length [m], zero for a piece without edges."""
    lengths = np.linalg.norm(np.diff(mesh.rest_vertices[mesh.edges], axis=1)[:, 0], axis=1)
    piece, count = mesh.pieces[mesh.edges[:, 0]], len(mesh.density)
    return np.bincount(piece, lengths, count) / np.maximum(np.bincount(piece, minlength=count), 1)


def _strips(mesh: Mesh, free: np.ndarray, graph: Graph) -> list[np.ndarray]:
    """The vertices of each strip, in the order in which it is to be solved."""
    n = len(free)
    near, _, _ = symmetric(mesh.edges[:, 0], mesh.edges[:, 1], n)
    depth, strips, shared = _depths(mesh, near), list[np.ndarray](), max(n // (2 * LANES), SHORTEST)
    for rings, most, overlap in SHAPES:
        strips = []
        for strip in range(int(depth.max(initial=0)) // rings + 1):
            inside = free & (depth // rings == strip)
            for whole in connected(near, inside, n):
                strips += _cut(whole, min(most, shared), overlap, near, free, graph)
        if sum(work_to_factor(graph, strip) for strip in strips) <= WORK * n:
            break
    return strips


def _cut(
    whole: np.ndarray, most: int, overlap: int, near: Graph, free: np.ndarray, graph: Graph
) -> list[np.ndarray]:
    """Parts of the strip `whole`, of at most `most` vertices before they overlap."""
    n = len(free)
    inside = _mask(whole, n)
    parts = connected(near, inside, most)
    if len(parts) > 1:
        parts = [grown(near, part, inside, ENDS) for part in parts]
    parts = [grown(near, part, free, overlap) for part in parts]
    return [grown(graph, part, _mask(part, n), 0) for part in parts]  # in narrow order


def _mask(members: np.ndarray, n: int) -> np.ndarray:
    """(n,) bool, true at `members`."""
    mask = np.zeros(n, dtype=bool)
    mask[members] = True
    return mask


def _depths(mesh: Mesh, near: Graph) -> np.ndarray:
    """(n,) rings between each vertex and the hem, or where there is none, some vertex of its part.

    The hem are the edges that have a triangle on one side only, or none.
    """
    sides = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, inverse, count = np.unique(
        np.concatenate([sides, np.sort(mesh.edges, axis=1)]), axis=0, return_inverse=True, return_counts=True
    )
    depth = np.full(len(mesh.vertices), -1)
    depth[mesh.edges[count[inverse.ravel()[len(sides) :]] < 3]] = 0
    parts, first = np.unique(mesh.parts, return_index=True)
    depth[first[~np.isin(parts, mesh.parts[depth == 0])]] = 0
    ring, front = 0, np.flatnonzero(depth == 0)
    while len(front):
        ring += 1
        reached = np.unique(np.concatenate([neighbours(near, int(i)) for i in front]))
        front = reached[depth[reached] < 0]
        depth[front] = ring
    return depth


def _lanes(strips: Patches, coarse: Coarse, coarsest: Patches) -> Lanes:
    """Tasks shared out to lanes, so that each half of the lanes, and each half of that, has as much to do."""
    cycle = float(work_to_solve(coarsest).sum()) + COUPLING * len(coarse.column)
    lanes = _halved({-1: cycle, **dict(enumerate(work_to_solve(strips)))}, LANES)
    counts = [len(lane) for lane in lanes]
    return Lanes(
        np.concatenate([[0], np.cumsum(counts)]), np.array([task for lane in lanes for task in lane])
    )


def _halved(work: dict[int, float], lanes: int) -> list[list[int]]:
    """The tasks in `work` shared out to a power of two of lanes."""
    if lanes == 1:
        return [list(work)]
    halves: list[dict[int, float]] = [{}, {}]
    for task in sorted(work, key=lambda t: (-work[t], t)):
        min(halves, key=lambda half: sum(half.values()))[task] = work[task]
    return [lane for half in halves for lane in _halved(half, lanes // 2)]


@kernel
def refresh(preconditioner, matrix):
    """Compute P⁻¹ anew for `matrix`."""
    h = preconditioner
    galerkin(h.coarse, matrix)
    factor_lanes(h.lanes, h.strips, h.coarse, h.coarsest, matrix)


@parallel_kernel
def factor_lanes(lanes, strips, coarse, coarsest, matrix):
    """Factor the strips, and prepare the coarse levels."""
    for lane in numba.prange(LANES):
        for t in range(lanes.first[lane], lanes.first[lane + 1]):
            if lanes.task[t] >= 0:
                factor(strips, lanes.task[t], matrix.diagonal, matrix.block)
            else:
                prepare(coarse, coarsest)


@inner
def precondition(preconditioner, r, z, partial, largest):
    """Fill z = P⁻¹ r and return rᵀ z and the largest |z_i|²; r must be zero on fixed vertices."""
    h = preconditioner
    _to_nodes(h.local, r, h.coarse.b)
    _solve_lanes(h.lanes, h.strips, h.coarse, h.coarsest, r)
    return _to_vertices(h.local, h.strips.room, h.coarse.x, r, z, partial, largest)


@parallel_kernel
def _to_nodes(local, r, b):
    """Fill b on the first level with Hᵀ r."""
    for chunk in numba.prange(CHUNKS):
        for m in range(local.shares[chunk], local.shares[chunk + 1]):
            u = v = w = 0.0  # summed here and below without a common helper: a call for each costs more
            for k in range(local.of_node[m], local.of_node[m + 1]):
                i, s = local.vertex[k], local.vertex_weight[k]
                u += s * r[i, 0]
                v += s * r[i, 1]
                w += s * r[i, 2]
            b[m, 0], b[m, 1], b[m, 2] = u, v, w


@parallel_kernel
def _solve_lanes(lanes, strips, coarse, coarsest, r):
    """Solve on the strips, and on the coarse levels."""
    for lane in numba.prange(LANES):
        for t in range(lanes.first[lane], lanes.first[lane + 1]):
            if lanes.task[t] >= 0:
                solve_patch(strips, lanes.task[t], r)
            else:
                cycle(coarse, coarsest)


@parallel_kernel
def _to_vertices(local, room, x, r, z, partial, largest):
    """Fill z with what strips and nodes give; returns rᵀ z and the largest |z_i|²."""
    n = len(r)
    for chunk in numba.prange(CHUNKS):
        total = most = 0.0
        begin, end = share(chunk, n)
        for i in range(begin, end):
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
            total += a * r[i, 0] + b * r[i, 1] + c * r[i, 2]
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
