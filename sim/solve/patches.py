"""Exact solves on patches: small sets of vertices, which may overlap, that a preconditioner takes together.

The diagonal block of a patch is factored as Uᵀ D U (Golub and Van Loan 2013, §4.3). Vertices are ordered
level by level from a far end (Cuthill and McKee 1969), so that the rows of U are short; each vertex has its
own length (George and Liu 1981, ch. 4). The three rows of a vertex are eliminated together: what they change
is read and written once, not three times. Factors are computed in double precision and kept in single: solves
are half as many bytes, and a preconditioner needs no more digits.
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
        start: (p + 1,) where each vertex's three rows start in `band`: all as long, from its first column on.
        band: float32, D⁻¹ on the diagonal, U after it, and nothing of use before.
        of_source: (k + 1,) where each patch's blocks start in `source` and `place`.
        source: Index of a block of the matrix, or −1 − i for the diagonal block of vertex i.
        place: (·, 2) the vertices in the patches' order that the block couples; row ≤ column.
        room: (p, 3) float32, the right-hand side, then the solution.
    """

    first: np.ndarray
    vertex: np.ndarray
    start: np.ndarray
    band: np.ndarray
    of_source: np.ndarray
    source: np.ndarray
    place: np.ndarray
    room: np.ndarray


def build_patches(graph: Graph, sets: list[np.ndarray]) -> Patches:
    """Room for the exact solves of `sets` of vertices of a matrix with the pattern `graph`."""
    source, place, counts, reaches, begin = [], [], [], [np.zeros(0, np.int64)], 0
    for members in sets:
        local = {int(i): k for k, i in enumerate(members)}
        found = [(-1 - i, k, k) for i, k in local.items()]
        for i, k in local.items():
            for b in range(graph.first[i], graph.first[i + 1]):
                other = local.get(int(graph.column[b]), -1)
                if other > k:
                    found.append((b, k, other))
        source += [s for s, _, _ in found]
        place += [(begin + k, begin + m) for _, k, m in found]
        counts.append(len(found))
        reaches.append(_reaches(graph, members))
        begin += len(members)
    start = np.append(0, np.cumsum(9 * np.concatenate(reaches)))
    return Patches(
        first=np.append(0, np.cumsum([len(members) for members in sets])).astype(np.int64),
        vertex=np.concatenate([np.zeros(0, np.int64), *sets]).astype(np.int32),
        start=start,
        band=np.zeros(start[-1], dtype=np.float32),
        of_source=np.append(0, np.cumsum(counts)).astype(np.int64),
        source=np.array(source, dtype=np.int32),
        place=np.array(place, dtype=np.int32).reshape(-1, 2),
        room=np.zeros((begin, 3), dtype=np.float32),
    )


def _reaches(graph: Graph, members: np.ndarray) -> np.ndarray:
    """(p,) vertices from each member on that its rows of the factor couple: as far as those before it do."""
    place = {int(i): k for k, i in enumerate(members)}
    last = [max([k, *(place.get(int(j), k) for j in neighbours(graph, i))]) for i, k in place.items()]
    return np.maximum.accumulate(np.array(last, dtype=np.int64)) - np.arange(len(members)) + 1


def work_to_factor(graph: Graph, members: np.ndarray) -> float:
    """Multiplications that factoring the patch `members`, in this order, takes."""
    return 13.5 * float(np.sum(_reaches(graph, members) ** 2.0))


def work_to_solve(patches: Patches) -> np.ndarray:
    """(k,) multiplications that a solve on each patch takes."""
    return 2.0 * np.diff(patches.start[patches.first])


@inner
def factor(patches, k, diagonal, block):
    """Factor patch k of the matrix with blocks `diagonal` (n, 3, 3) and `block` (b, 3, 3)."""
    begin, end, start = patches.first[k], patches.first[k + 1], patches.start
    origin = start[begin]
    u = np.zeros(start[end] - origin)
    for s in range(patches.of_source[k], patches.of_source[k + 1]):
        source, a, b = patches.source[s], patches.place[s, 0], patches.place[s, 1]
        rows, width = _rows(start, a, origin)
        column = 3 * (b - a)
        for r in range(3):
            for c in range(3):
                if source >= 0:
                    u[rows + r * width + column + c] = block[source, r, c]
                else:
                    u[rows + r * width + c] = diagonal[-1 - source, r, c]
    for m in range(begin, end):
        rows, width = _rows(start, m, origin)
        for r in range(3):
            u[rows + r * (width + 1)] *= 1.0 + SHIFT
    for m in range(begin, end):
        _eliminate(u, start, m, origin)
    for i in range(len(u)):
        patches.band[origin + i] = u[i]


@inner
def _rows(start, m, origin):
    """Where the rows of vertex m start, and how long each is."""
    return start[m] - origin, (start[m + 1] - start[m]) // 3


@inner
def _eliminate(u, start, m, origin):
    """Take the three rows of a vertex out of those after them that they reach."""
    rows, width = _rows(start, m, origin)
    a, b = u[rows : rows + width], u[rows + width : rows + 2 * width]
    c = u[rows + 2 * width : rows + 3 * width]
    in_a = _reciprocal(a[0])
    on_b, on_c = a[1] * in_a, a[2] * in_a
    for j in range(1, width):
        b[j] -= on_b * a[j]
        c[j] -= on_c * a[j]
    in_b = _reciprocal(b[1])
    on_c = b[2] * in_b
    for j in range(2, width):
        c[j] -= on_c * b[j]
    in_c = _reciprocal(c[2])
    for later in range(1, width // 3):
        there, long = _rows(start, m + later, origin)
        right = width - 3 * later
        right_a, right_b, right_c = a[3 * later :], b[3 * later :], c[3 * later :]
        for r in range(3):
            on_a, on_b, on_c = right_a[r] * in_a, right_b[r] * in_b, right_c[r] * in_c
            below = u[there : there + right]
            for j in range(right):
                below[j] -= on_a * right_a[j] + on_b * right_b[j] + on_c * right_c[j]
            there += long
    for j in range(1, width):
        a[j] *= in_a
        b[j] *= in_b
        c[j] *= in_c
    a[0], b[1], c[2] = in_a, in_b, in_c


@inner
def _reciprocal(pivot):
    """1 / |pivot|, or zero: solves stay positive definite, and it is iterations that find out if A is not."""
    return 1.0 / abs(pivot) if pivot != 0.0 else 0.0


@unordered
def solve_patch(patches, k, r):
    """Fill the room of patch k with A_k⁻¹ r, for r (n, 3)."""
    begin, end, start = patches.first[k], patches.first[k + 1], patches.start
    x = patches.room[begin:end].reshape(3 * (end - begin))
    for m in range(begin, end):
        i = patches.vertex[m]
        for c in range(3):
            x[3 * (m - begin) + c] = r[i, c]
    for m in range(begin, end):  # three rows at a time, as in `_eliminate`
        rows, width = _rows(start, m, 0)
        u, p = patches.band[rows : rows + 3 * width], 3 * (m - begin)
        of_a, of_b, of_c = u[3:width], u[width + 3 : 2 * width], u[2 * width + 3 :]
        after = x[p + 3 : p + width]
        x[p + 1] -= u[1] * x[p]
        x[p + 2] -= u[2] * x[p] + u[width + 2] * x[p + 1]
        xa, xb, xc = x[p], x[p + 1], x[p + 2]
        for j in range(len(after)):
            after[j] -= of_a[j] * xa + of_b[j] * xb + of_c[j] * xc
    for m in range(end - 1, begin - 1, -1):
        rows, width = _rows(start, m, 0)
        u, p = patches.band[rows : rows + 3 * width], 3 * (m - begin)
        of_a, of_b, of_c = u[3:width], u[width + 3 : 2 * width], u[2 * width + 3 :]
        after = x[p + 3 : p + width]
        sa = sb = sc = np.float32(0.0)
        for j in range(len(after)):
            value = after[j]
            sa += of_a[j] * value
            sb += of_b[j] * value
            sc += of_c[j] * value
        x[p + 2] = u[2 * width + 2] * x[p + 2] - sc
        x[p + 1] = u[width + 1] * x[p + 1] - sb - u[width + 2] * x[p + 2]
        x[p] = u[0] * x[p] - sa - u[1] * x[p + 1] - u[2] * x[p + 2]
