"""The preconditioner: what is fast locally, exact solves where cloth is free to flap, and coarse levels.

    P⁻¹ = D⁻¹ + Σ patches A_k⁻¹ + H V Hᵀ

D⁻¹ inverts the 3 × 3 blocks of single vertices. It is slow to find two things, which the others know.
Motions that are smooth over several edges: H interpolates them linearly from the nodes of a lattice over the
rest shape (`sim.solve.lattice`), and V is one symmetric multigrid cycle (Gauss–Seidel down and up, exact on
the coarsest level) for the Galerkin matrix Hᵀ A H and coarser ones. And motions that bend cloth almost
without stretching it: the free hem can flap in short waves, so the vertices within a few rings of it are
solved for together (`sim.solve.patches`), as are those joined by edges much shorter than the mesh's.
Where such edges are many, D⁻¹ is of little use, and strips of all the cloth, ring by ring from the hem
inwards, are solved exactly instead: an additive Schwarz method (Toselli and Widlund 2005). On even meshes
that would halve the iterations, and double what each takes.

All of that is symmetric and positive definite, so it suits conjugate gradients. What depends on the mesh
alone is built once; `refresh` computes the rest anew for each matrix, in a fixed order.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, even_shares, indices, inner, kernel, offsets, parallel_kernel, share
from sim.mesh import Mesh, triangles_at
from sim.solve.graph import Graph, connected, grown, neighbours, starts, symmetric
from sim.solve.multigrid import Coarse, build_levels, cycle, galerkin, prepare
from sim.solve.patches import Patches, build_patches, factor, solve_patch, work_to_factor, work_to_solve
from sim.solve.system import Matrix, invert, pattern

RINGS = 4
"""Rings of vertices from a free edge inwards that make up the hem."""

SHORT = 0.5
"""Edges shorter than this part of the mean join vertices that are solved for together."""

UNEVEN = 0.1
"""Part of the edges that may be short where only the hem is solved exactly: strips would halve the iterations
at most, and each takes twice as long."""

STRIPS = ((8, 512, 0), (2, 512, 1), (2, 64, 1))
"""Rings of vertices that make up a strip, vertices after which it is cut, and rings by which strips overlap:
tried in turn until WORK_OF_STRIPS is enough; the last is taken whatever it costs."""

WORK_OF_STRIPS = 7000.0
"""Multiplications per vertex of the mesh that factoring them may cost."""

ENDS = 4
"""Rings by which the parts of a strip that is cut overlap, so that the cuts do not show."""

SHORTEST = 256
"""Vertices up to which no strip is cut for there being more lanes than strips."""

LARGEST = 512
"""Vertices of a patch before it is cut: it is cut into parts that can be solved side by side."""

OVERLAP = 6
"""Rings by which parts of a patch overlap, so that the cuts do not show."""

WORK = 2000.0
"""Multiplications per vertex of the mesh that factoring a patch may cost; a costlier one is cut smaller."""

SMALLEST = 64
"""Vertices of a part that is not cut smaller, whatever it costs."""

LANES = 8
"""Parts that patches and coarse levels are shared out to."""

COUPLING = 25.0
"""What a block of the coarse levels takes in a cycle, over what an entry of a patch's factor takes."""


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
    mean, graph = _mean_lengths(mesh, lengths), pattern(matrix)
    short = lengths < SHORT * mean[mesh.pieces[mesh.edges[:, 0]]]
    patches = build_patches(graph, _patch_sets(mesh, free, graph, short))
    weights, coarse, coarsest = build_levels(mesh, free, graph, mean)
    m = int(coarse.level[1])
    single = free.copy()
    single[patches.vertex] = False
    point = np.repeat(np.arange(n), np.diff(weights.first))
    order = np.lexsort((point, weights.node))
    of_node = starts(weights.node[order], m)
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
        shares=even_shares(of_node),
    )
    return Preconditioner(local, patches, coarse, coarsest, _lanes(patches, coarse, coarsest))


def _mean_lengths(mesh: Mesh, lengths: np.ndarray) -> np.ndarray:
    """(pieces,) mean edge length [m], zero for a piece without edges."""
    piece, count = mesh.pieces[mesh.edges[:, 0]], len(mesh.density)
    return np.bincount(piece, lengths, count) / np.maximum(np.bincount(piece, minlength=count), 1)


def _patch_sets(mesh: Mesh, free: np.ndarray, whole: Graph, short: np.ndarray) -> list[np.ndarray]:
    """The vertices of each patch, in the order of elimination."""
    near, _, _ = symmetric(mesh.edges[:, 0], mesh.edges[:, 1], len(free))
    uneven = len(short) > 0 and float(short.mean()) > UNEVEN
    return _strips(mesh, free, whole, near) if uneven else _hem(mesh, free, whole, near, short)


def _strips(mesh: Mesh, free: np.ndarray, whole: Graph, near: Graph) -> list[np.ndarray]:
    """Strips of all the cloth that follow the hem, or where there is none, surround some vertex."""
    n, bare = len(free), _on_hem(mesh)
    parts, first = np.unique(mesh.parts, return_index=True)
    bare[first[~np.isin(parts, mesh.parts[bare])]] = True
    depth, strips, shared = _depths(near, bare, n), list[np.ndarray](), max(n // (2 * LANES), SHORTEST)
    for rings, most, overlap in STRIPS:
        strips = []
        for strip in range(int(depth.max(initial=0)) // rings + 1):
            for component in connected(near, free & (depth // rings == strip), n):
                cut = _cut(near, _mask(component, n), min(most, shared), ENDS)
                cut = [grown(near, part, free, overlap) for part in cut]
                strips += [grown(whole, part, _mask(part, n), 0) for part in cut]  # in narrow order
        if _work(whole, strips) <= WORK_OF_STRIPS * n:
            break
    return strips


def _hem(mesh: Mesh, free: np.ndarray, whole: Graph, near: Graph, short: np.ndarray) -> list[np.ndarray]:
    """What is within RINGS rings of the hem, and what `short` edges join, cut where that costs too much."""
    n, hem = len(free), _depths(near, _on_hem(mesh), RINGS - 1) >= 0
    joined = (hem[mesh.edges].all(axis=1) | short) & free[mesh.edges].all(axis=1)
    a, b = mesh.edges[joined].T
    graph, _, _ = symmetric(a, b, n)
    sets = []
    for component in connected(graph, np.diff(graph.first) > 0, n):
        most = LARGEST
        while True:
            parts = _cut(graph, _mask(component, n), most, OVERLAP)
            if most <= SMALLEST or _work(whole, parts) <= WORK * n:
                break
            most //= 2
        sets += parts
    return sets


def _cut(graph: Graph, inside: np.ndarray, most: int, overlap: int) -> list[np.ndarray]:
    """Parts of at most `most` of the vertices `inside` (n,), and rings by which they overlap if several."""
    parts = connected(graph, inside, most)
    return [grown(graph, part, inside, overlap if len(parts) > 1 else 0) for part in parts]


def _work(graph: Graph, sets: list[np.ndarray]) -> float:
    """Multiplications that factoring takes."""
    return sum(work_to_factor(graph, members) for members in sets)


def _mask(members: np.ndarray, n: int) -> np.ndarray:
    """(n,) bool, true at `members`."""
    mask = np.zeros(n, dtype=bool)
    mask[members] = True
    return mask


def _on_hem(mesh: Mesh) -> np.ndarray:
    """(n,) bool: vertices of edges that have a triangle on one side only, or none."""
    n = len(mesh.vertices)
    return _mask(mesh.edges[triangles_at(mesh.edges, mesh.triangles, n) < 2], n)


def _depths(near: Graph, begin: np.ndarray, most: int) -> np.ndarray:
    """(n,) edges, up to `most`, between each vertex and the nearest where `begin` (n,) is true; or −1."""
    depth, front = np.where(begin, 0, -1), np.flatnonzero(begin)
    for ring in range(1, most + 1):
        if not len(front):
            break
        reached = np.unique(np.concatenate([neighbours(near, int(i)) for i in front]))
        front = reached[depth[reached] < 0]
        depth[front] = ring
    return depth


def _lanes(patches: Patches, coarse: Coarse, coarsest: Patches) -> Lanes:
    """Tasks shared out to lanes, so that each half of the lanes, and each half of that, has as much to do."""
    cycle = float(work_to_solve(coarsest).sum()) + COUPLING * len(coarse.column)
    lanes = _halved({-1: cycle, **dict(enumerate(work_to_solve(patches)))}, LANES)
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
def factor_lanes(lanes, patches, coarse, coarsest, matrix):
    """Factor the patches, and prepare the coarse levels."""
    for lane in numba.prange(LANES):
        for t in range(lanes.first[lane], lanes.first[lane + 1]):
            if lanes.task[t] >= 0:
                factor(patches, lanes.task[t], matrix.diagonal, matrix.block)
            else:
                prepare(coarse, coarsest)


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
            u = v = w = 0.0  # summed here and below without a common helper: a call for each costs more
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
                cycle(coarse, coarsest)


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
    return in_order(partial), highest(largest)


@inner
def in_order(parts):
    """The sum of `parts`, first to last."""
    total = 0.0
    for part in parts:
        total += part
    return total


@inner
def highest(parts):
    """The largest of `parts`, none of which is negative."""
    most = 0.0
    for part in parts:
        most = max(most, part)
    return most
