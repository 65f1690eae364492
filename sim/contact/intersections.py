"""Which edges of cloth cross which of its triangles now: exactly, and fast where few come near.

Boxes that overlap are found on a grid. Of those pairs, signs of volumes decide, with Shewchuk's bound of
their error (1997, Adaptive Precision Floating-Point Arithmetic, §4.4), and axes on which the two are apart by
more than rounding. What is left touches or all but touches, and is decided in whole numbers.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sim.compiled import cross, dot, inner, kernel, row, sub
from sim.mesh import sides_of

APART, UNSURE, CROSSING = 0, 1, 2

VOLUME_ERROR = 8.0 * 2.0**-53
"""Error of a volume as a part of the sum of its terms' sizes: 7u and a little, u the unit roundoff."""

PROJECTION_ERROR = 16.0 * 2.0**-53
"""Error of a projection as a part of the sizes of the axis and of what is projected: 5u, amply."""

UNDERFLOW = 1e-280
"""Signs of less are not believed: a product on the way may have been rounded to zero."""

CELLS = 16
"""Cells of the grid that a triangle lies in on average, at most; otherwise they are made larger."""

LONGEST_GRID = 2.0**20
"""Cells along an axis, at most, so that a cell's number fits into 64 bits."""


def intersections(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Edges that cross triangles with which they share no vertex.

    Args:
        positions: (n, 3) float64 [m].
        triangles: (m, 3) int, vertex numbers.

    Returns:
        (p, 2) int64 [edge, triangle], ascending. Edges are the sides of the triangles, each once, in the
        ascending order of their lower and then their higher vertex: `world.edges`, where a scene has no
        edges besides.

    Raises:
        ValueError: A position is not finite, a vertex number out of range, or a shape wrong.

    Exact: a pair is listed where the edge and the triangle, both with their boundary, have any point in
    common. So touching counts, in whatever way, and what has no length or area counts as the points that are
    left of it. Pairs that share a vertex are passed over, even if they cross elsewhere. Layers that have
    passed through each other completely leave no pair behind: only continuous detection sees that.
    """
    x, corners = _checked(positions, triangles)
    if len(corners) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    return crossing(x, sides_of(corners, len(x)), corners)


def crossing(x: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """`intersections`, where nothing is wrong with what is given, and the `edges` are listed already.

    Args:
        x: (n, 3) float64 [m], finite.
        edges: (e, 2) int64 sides of the triangles, as `sim.mesh.sides_of` gives them.
        triangles: (m, 3) int64, contiguous; one at least.
    """
    pairs, sure = _candidates(x, edges, triangles)
    for k in np.flatnonzero(~sure):
        sure[k] = _meet(x[edges[pairs[k, 0]]], x[triangles[pairs[k, 1]]])
    pairs = pairs[sure]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _checked(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, corners = np.ascontiguousarray(positions, dtype=np.float64), np.asarray(triangles)
    if x.ndim != 2 or x.shape[1] != 3:
        raise ValueError(f"positions: expected an array of shape (n, 3), got {x.shape}")
    wrong = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if len(wrong):
        raise ValueError(f"positions[{wrong[0]}]: expected finite numbers, got {x[wrong[0]].tolist()}")
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"triangles: expected integers of shape (m, 3), got {corners.dtype} {corners.shape}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(x):
        least, most = corners.min(), corners.max()
        raise ValueError(f"triangles: expected vertices from 0 to {len(x) - 1}, got {least} to {most}")
    return x, np.ascontiguousarray(corners, dtype=np.int64)


class _Boxes(NamedTuple):
    """Edges or triangles, their boxes, and the cells of the grid from `first` to `last` that these touch."""

    nodes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    first: np.ndarray
    last: np.ndarray


def _candidates(x: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(c, 2) pairs that cross or may, and (c,) whether they surely do."""
    low, high = x[triangles].min(axis=1), x[triangles].max(axis=1)
    origin, far = low.min(axis=0), high.max(axis=0)
    size = max((high - low).max(axis=1).mean(), (far - origin).max() / LONGEST_GRID) or 1.0
    faces = _boxes(x, triangles, origin, size)
    while (faces.last - faces.first + 1).prod(axis=1).mean() > CELLS:
        size *= 2.0
        faces = _boxes(x, triangles, origin, size)
    sides = _boxes(x, edges, origin, size)
    counts = faces.last.max(axis=0) + 1
    keys, members = _in_cells(faces, counts)
    order = np.argsort(keys, kind="stable")
    keys, members = keys[order], members[order]
    side_keys, side_members = _in_cells(sides, counts)
    runs = np.stack([np.searchsorted(keys, side_keys, side) for side in ("left", "right")], axis=1)
    room = len(edges)
    while True:
        pairs, crossing = np.empty((room, 2), dtype=np.int64), np.empty(room, dtype=np.bool_)
        count = _sift(x, sides, faces, counts, side_keys, side_members, runs, members, pairs, crossing)
        if count <= room:
            return pairs[:count], crossing[:count]
        room = count


def _boxes(x: np.ndarray, nodes: np.ndarray, origin: np.ndarray, size: float) -> _Boxes:
    low, high = x[nodes].min(axis=1), x[nodes].max(axis=1)
    first, last = (np.floor(p / size - origin / size).astype(np.int64) for p in (low, high))
    return _Boxes(nodes, low, high, first, last)


def _in_cells(boxes: _Boxes, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells and boxes in them: (k,) numbers of cells, and (k,) the box."""
    total = int((boxes.last - boxes.first + 1).prod(axis=1).sum())
    keys, members = np.empty((2, total), dtype=np.int64)
    _fill(boxes, counts, keys, members)
    return keys, members


@kernel
def _fill(boxes, counts, keys, members):
    k = 0
    for i in range(len(boxes.first)):
        for a in range(boxes.first[i, 0], boxes.last[i, 0] + 1):
            for b in range(boxes.first[i, 1], boxes.last[i, 1] + 1):
                for c in range(boxes.first[i, 2], boxes.last[i, 2] + 1):
                    keys[k], members[k] = (a * counts[1] + b) * counts[2] + c, i
                    k += 1


@kernel
def _sift(x, sides, faces, counts, side_keys, side_members, runs, members, pairs, crossing):
    """Fill `pairs` and `crossing` as far as there is room; the number of pairs that there are."""
    count = 0
    for k in range(len(side_keys)):
        e = side_members[k]
        i, j = sides.nodes[e, 0], sides.nodes[e, 1]
        p, q = row(x, i), row(x, j)
        for m in range(runs[k, 0], runs[k, 1]):
            f = members[m]
            if not _overlap(sides, e, faces, f):
                continue
            if _first_common_cell(sides, e, faces, f, counts) != side_keys[k]:
                continue  # the pair is looked at once only
            u, v, w = faces.nodes[f, 0], faces.nodes[f, 1], faces.nodes[f, 2]
            if i in (u, v, w) or j in (u, v, w):
                continue
            verdict = _classify(p, q, row(x, u), row(x, v), row(x, w))
            if verdict != APART:
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1], crossing[count] = e, f, verdict == CROSSING
                count += 1
    return count


@inner
def _overlap(a, i, b, j):
    for axis in range(3):
        if a.low[i, axis] > b.high[j, axis] or b.low[j, axis] > a.high[i, axis]:
            return False
    return True


@inner
def _first_common_cell(a, i, b, j, counts):
    key = 0
    for axis in range(3):
        key = key * counts[axis] + max(a.first[i, axis], b.first[j, axis])
    return key


@inner
def _classify(p, q, a, b, c):
    """Whether the edge pq and the triangle abc are APART or CROSSING, or UNSURE."""
    above, below = _side(a, b, c, p), _side(a, b, c, q)
    if above * below > 0:
        return APART
    s, t, u = _side(p, q, a, b), _side(p, q, b, c), _side(p, q, c, a)
    if s * t < 0 or t * u < 0 or u * s < 0:
        return APART
    if above * below < 0 and s * t > 0 and t * u > 0:
        return CROSSING
    if p in (a, b, c) or q in (a, b, c):  # whole layers may lie on each other
        return CROSSING
    return APART if _separated(p, q, a, b, c) else UNSURE


@inner
def _side(a, b, c, d):
    """Sign of the volume (a − d) · (b − d) × (c − d), or 0 where it is not certain."""
    a, b, c = sub(a, d), sub(b, d), sub(c, d)
    bc, ca, ab = b.x * c.y, c.x * a.y, a.x * b.y
    cb, ac, ba = c.x * b.y, a.x * c.y, b.x * a.y
    volume = a.z * (bc - cb) + b.z * (ca - ac) + c.z * (ab - ba)
    terms = abs(a.z) * (abs(bc) + abs(cb)) + abs(b.z) * (abs(ca) + abs(ac)) + abs(c.z) * (abs(ab) + abs(ba))
    error = VOLUME_ERROR * terms + UNDERFLOW
    return 1 if volume > error else (-1 if volume < -error else 0)


@inner
def _separated(p, q, a, b, c):
    """Whether an axis in or square to the triangle's plane shows that the two are apart, beyond rounding."""
    ab, bc, ca, pq = sub(b, a), sub(c, b), sub(a, c), sub(q, p)
    n = cross(ab, bc)
    for axis in (
        n,
        cross(n, ab),
        cross(n, bc),
        cross(n, ca),
        cross(n, pq),
        cross(ab, pq),
        cross(bc, pq),
        cross(ca, pq),
    ):
        if _apart(axis, p, q, a, b, c):
            return True
    return False


@inner
def _apart(axis, p, q, a, b, c):
    pa, pb, pc, qa, qb, qc = sub(p, a), sub(p, b), sub(p, c), sub(q, a), sub(q, b), sub(q, c)
    longest = max(_size(pa), _size(pb), _size(pc), _size(qa), _size(qb), _size(qc))
    error = PROJECTION_ERROR * _size(axis) * longest + UNDERFLOW
    f, g, h = dot(axis, pa), dot(axis, pb), dot(axis, pc)
    i, j, k = dot(axis, qa), dot(axis, qb), dot(axis, qc)
    return min(f, g, h, i, j, k) > error or max(f, g, h, i, j, k) < -error


@inner
def _size(a):
    return abs(a.x) + abs(a.y) + abs(a.z)


def _meet(edge: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether an edge (2, 3) and a triangle (3, 3) have a point in common, in exact arithmetic."""
    p, q, a, b, c = _whole(np.concatenate([edge, triangle]))
    n = _cross(_minus(b, a), _minus(c, a))
    above, below = _dot(n, _minus(p, a)), _dot(n, _minus(q, a))
    if above * below > 0:
        return False
    sides = list(pairwise((a, b, c, a)))
    if above or below:
        volumes = [_dot(_minus(q, p), _cross(_minus(u, p), _minus(v, p))) for u, v in sides]
        return min(volumes) >= 0 or max(volumes) <= 0
    if any(_segments_meet(p, q, u, v) for u, v in sides):
        return True
    turns = [_dot(n, _cross(_minus(v, u), _minus(p, u))) for u, v in sides]
    return any(n) and (min(turns) >= 0 or max(turns) <= 0)  # inside a triangle that has an inside


def _segments_meet(p, q, a, b) -> bool:
    u, v, w = _minus(q, p), _minus(b, a), _minus(a, p)
    n = _cross(u, v)
    if any(n):  # two lines; they meet at p + s u = a + t v, s and t as parts of n · n
        s, t, whole = _dot(_cross(w, v), n), _dot(_cross(w, u), n), _dot(n, n)
        return _dot(w, n) == 0 and 0 <= s <= whole and 0 <= t <= whole
    if any(_cross(w, u)) or any(_cross(w, v)):
        return False
    return all(
        max(min(p[k], q[k]), min(a[k], b[k])) <= min(max(p[k], q[k]), max(a[k], b[k])) for k in range(3)
    )


def _whole(points: np.ndarray) -> list[tuple[int, ...]]:
    """The points times a power of two that makes every coordinate a whole number."""
    ratios = [[float(value).as_integer_ratio() for value in point] for point in points]
    scale = max(below for point in ratios for _, below in point)
    return [tuple(above * (scale // below) for above, below in point) for point in ratios]


def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
