"""Exact solves on patches: small sets of vertices, which may overlap, that a preconditioner takes together.

The diagonal block of a patch is factored as Uᵀ D U within its band (Golub and Van Loan 2013, §4.3), its
vertices ordered level by level from a far end (Cuthill and McKee 1969) so that the band is narrow. The three
rows of a vertex are eliminated together: what they change is read and written once, not three times. Factors
are computed in double precision and kept in single: solves are half as many bytes, and a preconditioner needs
no more digits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import inner, unordered
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
        band: float32, U above the diagonal and D on it, 3 rows per vertex.
        of_source: (k + 1,) where each patch's blocks start in `source` and `place`.
        source: Index of a block of the matrix, or −1 − i for the diagonal block of vertex i.
        place: (·, 2) the vertices of the patch, counted from its first, that the block couples; row ≤ column.
        room: (p, 3) float32, the right-hand side, then the solution.
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
        band=np.zeros(starts[-1], dtype=np.float32),
        of_source=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        source=np.array(source, dtype=np.int32),
        place=np.array(place, dtype=np.int32).reshape(-1, 2),
        room=np.zeros((int(sizes.sum()), 3), dtype=np.float32),
    )


@inner
def factor(patches, k, diagonal, block):
    """Factor patch k of the matrix with blocks `diagonal` (n, 3, 3) and `block` (b, 3, 3)."""
    rows, width = 3 * (patches.first[k + 1] - patches.first[k]), patches.width[k]
    u = np.zeros((rows, width))
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
    for p in range(0, rows, 3):
        _eliminate(u, p, min(width, rows - p))
    kept = patches.band[patches.start[k] : patches.start[k + 1]].reshape((rows, width))
    for i in range(rows):
        for j in range(width):
            kept[i, j] = u[i, j]


@inner
def _eliminate(u, p, reach):
    """Take the three rows of a vertex from p on out of those after them, which reach as far as row p does."""
    a, b, c = u[p], u[p + 1], u[p + 2]
    in_a = _reciprocal(a[0])
    on_b, on_c = a[1] * in_a, a[2] * in_a
    for j in range(1, reach):
        b[j - 1] -= on_b * a[j]
    for j in range(2, reach):
        c[j - 2] -= on_c * a[j]
    in_b = _reciprocal(b[0])
    on_c = b[1] * in_b
    for j in range(2, reach):
        c[j - 2] -= on_c * b[j - 1]
    in_c = _reciprocal(c[0])
    for i in range(3, reach):
        on_a, on_b, on_c = a[i] * in_a, b[i - 1] * in_b, c[i - 2] * in_c
        right_a, right_b, right_c, below = a[i:reach], b[i - 1 :], c[i - 2 :], u[p + i]
        for j in range(len(right_a)):
            below[j] -= on_a * right_a[j] + on_b * right_b[j] + on_c * right_c[j]
    for line, inverse in ((a, in_a), (b, in_b), (c, in_c)):
        line[0] = inverse
        for j in range(1, len(line)):
            line[j] *= inverse


@inner
def _reciprocal(pivot):
    return 1.0 / pivot if pivot > 0.0 else 0.0


@unordered
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
    for p in range(0, rows, 3):  # the three rows of a vertex at a time, as in `_eliminate`
        a, b, c, after = u[p], u[p + 1], u[p + 2], x[p + 3 : p + min(width, rows - p)]
        x[p + 1] -= a[1] * x[p]
        x[p + 2] -= a[2] * x[p] + b[1] * x[p + 1]
        of_a, of_b, of_c, xa, xb, xc = a[3:], b[2:], c[1:], x[p], x[p + 1], x[p + 2]
        for j in range(len(after)):
            after[j] -= of_a[j] * xa + of_b[j] * xb + of_c[j] * xc
    for p in range(rows - 3, -1, -3):
        a, b, c, after = u[p], u[p + 1], u[p + 2], x[p + 3 : p + min(width, rows - p)]
        of_a, of_b, of_c = a[3:], b[2:], c[1:]
        sa = sb = sc = np.float32(0.0)
        for j in range(len(after)):
            value = after[j]
            sa += of_a[j] * value
            sb += of_b[j] * value
            sc += of_c[j] * value
        x[p + 2] = x[p + 2] * c[0] - sc
        x[p + 1] = x[p + 1] * b[0] - sb - b[1] * x[p + 2]
        x[p] = x[p] * a[0] - sa - a[1] * x[p + 1] - a[2] * x[p + 2]
