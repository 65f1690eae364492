"""Exact solves on patches: small sets of vertices, which may overlap, that a preconditioner takes together.

The diagonal block of a patch is factored as Uᵀ D U within its band (Golub and Van Loan 2013, §4.3), its
vertices ordered level by level from a far end (Cuthill and McKee 1969) so that the band is narrow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import inner
from sim.solve.graph import Graph, neighbours

SHIFT = 1e-10
"""Part of each diagonal entry that is added to it, so that coarse matrices that are singular factor, too."""


class Patches(NamedTuple):
    """k patches of p vertices in all, and room for their factors.

    Attributes:
        first: (k + 1,) where each patch's vertices start in `vertex`.
        vertex: (p,) in the order of elimination.
        width: (k,) entries of a row of the factor, the pivot among them.
        start: (k + 1,) where each patch's rows start in `band`.
        band: U above the diagonal and D on it, 3 rows per vertex.
        of_source: (k + 1,) where each patch's blocks start in `source` and `place`.
        source: Index of a block of the matrix, or −1 − i for the diagonal block of vertex i.
        place: (·, 2) the vertices of the patch, counted from its first, that the block couples; row ≤ column.
        room: (p, 3) the right-hand side, then the solution.
    """

    first: np.ndarray
    vertex: np.ndarray
    width: np.ndarray
    start: np.ndarray
    band: np.ndarray
    of_source: np.ndarray
    source: np.ndarray
    place: np.ndarray
    room: np.ndarray


def band_width(graph: Graph, members: np.ndarray) -> int:
    """Entries of a row of the factor of the patch `members`, in this order."""
    place = {int(i): k for k, i in enumerate(members)}
    reach = max(
        (place[int(j)] - k for k, i in enumerate(members) for j in neighbours(graph, i) if int(j) in place),
        default=0,
    )
    return 3 * (max(reach, 0) + 1)


def build_patches(graph: Graph, sets: list[np.ndarray]) -> Patches:
    """Room for the exact solves of `sets` of vertices of a matrix with the pattern `graph`."""
    width = np.array([band_width(graph, members) for members in sets], dtype=np.int64)
    sizes = np.array([len(members) for members in sets], dtype=np.int64)
    source, place, counts = [], [], []
    for members in sets:
        local = {int(i): k for k, i in enumerate(members)}
        found = [(-1 - i, k, k) for i, k in local.items()]
        for i, k in local.items():
            for b in range(graph.first[i], graph.first[i + 1]):
                other = local.get(int(graph.column[b]), -1)
                if other > k:
                    found.append((b, k, other))
        source += [s for s, _, _ in found]
        place += [(k, m) for _, k, m in found]
        counts.append(len(found))
    starts = np.concatenate([[0], np.cumsum(3 * sizes * width)]).astype(np.int64)
    return Patches(
        first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        vertex=np.concatenate([np.zeros(0, np.int64), *sets]).astype(np.int32),
        width=width,
        start=starts,
        band=np.zeros(starts[-1]),
        of_source=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        source=np.array(source, dtype=np.int32),
        place=np.array(place, dtype=np.int32).reshape(-1, 2),
        room=np.zeros((int(sizes.sum()), 3)),
    )


@inner
def factor(patches, k, diagonal, block):
    """Factor patch k of the matrix with blocks `diagonal` (n, 3, 3) and `block` (b, 3, 3)."""
    rows, width = 3 * (patches.first[k + 1] - patches.first[k]), patches.width[k]
    u = patches.band[patches.start[k] : patches.start[k + 1]].reshape((rows, width))
    u[:, :] = 0.0
    for s in range(patches.of_source[k], patches.of_source[k + 1]):
        source, a, b = patches.source[s], 3 * patches.place[s, 0], 3 * patches.place[s, 1]
        for r in range(3):
            for c in range(3):
                if source >= 0:
                    u[a + r, b + c - a - r] = block[source, r, c]
                elif c >= r:
                    u[a + r, c - r] = diagonal[-1 - source, r, c]
    for i in range(rows):
        u[i, 0] *= 1.0 + SHIFT
    for p in range(rows):
        reach = min(width, rows - p)
        pivot = u[p, 0]
        inverse = 1.0 / pivot if pivot > 0.0 else 0.0
        for i in range(1, reach):
            part, right, below = u[p, i] * inverse, u[p, i:reach], u[p + i]
            for j in range(len(right)):
                below[j] -= part * right[j]
        u[p, 0] = inverse
        for i in range(1, reach):
            u[p, i] *= inverse


@inner
def solve_patch(patches, k, r):
    """Fill the room of patch k with A_k⁻¹ r, for r (n, 3)."""
    begin, end, width = patches.first[k], patches.first[k + 1], patches.width[k]
    rows = 3 * (end - begin)
    u = patches.band[patches.start[k] : patches.start[k + 1]].reshape((rows, width))
    x = patches.room[begin:end].reshape(rows)
    for m in range(begin, end):
        i = patches.vertex[m]
        for c in range(3):
            x[3 * (m - begin) + c] = r[i, c]
    for p in range(rows):
        value, right, after = x[p], u[p, 1 : min(width, rows - p)], x[p + 1 :]
        for i in range(len(right)):
            after[i] -= right[i] * value
    for p in range(rows - 1, -1, -1):
        right, after = u[p, 1 : min(width, rows - p)], x[p + 1 :]
        s0 = s1 = s2 = s3 = 0.0
        quarters = len(right) // 4
        for i in range(quarters):  # four sums, so that additions need not wait for each other
            s0 += right[4 * i] * after[4 * i]
            s1 += right[4 * i + 1] * after[4 * i + 1]
            s2 += right[4 * i + 2] * after[4 * i + 2]
            s3 += right[4 * i + 3] * after[4 * i + 3]
        for i in range(4 * quarters, len(right)):
            s0 += right[i] * after[i]
        x[p] = x[p] * u[p, 0] - ((s0 + s1) + (s2 + s3))
