"""The broad phase: which vertices and triangles, and which pairs of edges, may come within reach.

Every vertex is given a box to roam in: around where it is and where it is going, with a skin. A list of
candidates holds every pair that can come within reach while all vertices stay in their boxes, so it serves
step after step until one leaves its box (Verlet 1967). Boxes are as wide as the motion needs, not wider: a
list for resting cloth lasts, and one for fast cloth is not long.

The tree's shape is that of the surface, which changes little; only its boxes are fitted anew (van den Bergen
1997). Leaves are compared in parallel, and what each finds is kept in the leaves' order.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, add, dot, inner, kernel, norm, parallel_kernel, row, scale, share, sub
from sim.contact.closest import edge_edge, separation, vertex_triangle
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE
from sim.contact.surface import Surface, Tree

MOST_CANDIDATES = 20_000_000
"""Pairs beyond which a list is refused: they would take more than 500 MB."""


MOVABLE, PARTNER = 1, 2
"""What a vertex may be; a pair of features needs some of both."""


class CandidateError(MemoryError):
    """More pairs within reach than a list may hold."""


class Candidates(NamedTuple):
    """p pairs that may come within `reach` while every vertex stays in its box.

    Attributes:
        kind: (p,) VERTEX_TRIANGLE or EDGE_EDGE; the former come first in each part.
        pair: (p, 2) int32 vertex and element, or two edges.
        node: (p, 4) int32 their vertices.
        distance: (p,) distance with all vertices in the middle of their boxes [m].
        middle: (n, 3) of the boxes [m].
        half: (n, 3) half of their sides [m].
        reach: [m].
    """

    kind: np.ndarray
    pair: np.ndarray
    node: np.ndarray
    distance: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    reach: float

    def hold(self, positions: np.ndarray) -> bool:
        """Whether every vertex of `positions` (n, 3) is in its box."""
        return bool(_inside(positions, self.middle, self.half))


class BroadPhase:
    """Makes lists of candidates for a surface.

    Args:
        surface: What can touch.
        tree: Over its elements.
        movable: (n,) bool, vertices that can move; a pair without any is none.
        partner: (n,) bool, vertices that others may touch; a pair without any is none.
    """

    def __init__(self, surface: Surface, tree: Tree, movable: np.ndarray, partner: np.ndarray) -> None:
        self.surface, self.tree = surface, tree
        self._role = (movable * MOVABLE + partner * PARTNER).astype(np.uint8)
        self._low, self._high = np.zeros((2, len(tree.begin), 3))
        self._boxes = np.zeros((len(surface.faces), 6))
        self._room = 64

    def candidates(self, one: np.ndarray, other: np.ndarray, skin: float, reach: float) -> Candidates:
        """The pairs within `reach` [m] of each other while vertices are between and around two places.

        Args:
            one: (n, 3) [m].
            other: (n, 3) [m].
            skin: How far around them they may roam [m].
            reach: Distance of a pair that counts [m].

        Raises:
            CandidateError: where there are more than MOST_CANDIDATES.
        """
        low, high = np.minimum(one, other) - skin, np.maximum(one, other) + skin
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        half *= 1.0 + 1e-12  # so that the ends themselves are inside
        tree = self.tree
        fit(
            self.surface.faces,
            tree.begin,
            tree.end,
            tree.skip,
            middle,
            half,
            reach,
            self._boxes,
            self._low,
            self._high,
        )
        lists = [
            self._room_for_all(_query, middle, half, reach),
            self._room_for_all(_near, middle, half, reach),
        ]
        pairs, numbers = (np.concatenate(parts) for parts in zip(*lists, strict=True))
        kind = pairs[:, 0].astype(np.int8)
        return Candidates(
            kind,
            np.ascontiguousarray(pairs[:, 1:3]),
            np.ascontiguousarray(pairs[:, 3:]),
            numbers,
            middle,
            half,
            reach,
        )

    def _room_for_all(self, find, middle: np.ndarray, half: np.ndarray, reach: float):
        """What `find` finds, with as much room as it turns out to need."""
        counts = np.zeros(CHUNKS, dtype=np.int64)
        while True:
            pairs, distance = (
                np.empty((CHUNKS, self._room, 7), dtype=np.int32),
                np.empty((CHUNKS, self._room)),
            )
            find(
                self.surface,
                self.tree,
                self._role,
                middle,
                half,
                reach,
                self._boxes,
                self._low,
                self._high,
                pairs,
                distance,
                counts,
            )
            most = int(counts.max())
            if most <= self._room:
                found = [slice(0, count) for count in counts]
                return (
                    np.concatenate([pairs[c, part] for c, part in enumerate(found)]),
                    np.concatenate([distance[c, part] for c, part in enumerate(found)]),
                )
            if int(counts.sum()) > MOST_CANDIDATES:
                raise CandidateError(
                    f"{int(counts.sum()):,} pairs may touch, and at most {MOST_CANDIDATES:,} are looked at"
                )
            self._room = most + most // 4


@kernel
def _inside(positions, middle, half):
    for i in range(len(positions)):
        for r in range(3):
            if not abs(positions[i, r] - middle[i, r]) <= half[i, r]:
                return False
    return True


@kernel
def fit(faces, begin, end, skip, middle, half, reach, boxes, low, high):
    """Fill the boxes of elements, least and most, and of the tree's nodes, each wider by half of `reach`."""
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        for r in range(3):
            boxes[f, r] = -0.5 * reach + min(
                middle[i, r] - half[i, r], middle[j, r] - half[j, r], middle[k, r] - half[k, r]
            )
            boxes[f, r + 3] = 0.5 * reach + max(
                middle[i, r] + half[i, r], middle[j, r] + half[j, r], middle[k, r] + half[k, r]
            )
    for node in range(len(begin) - 1, -1, -1):
        if skip[node] == node + 1:
            for r in range(3):
                least, most = np.inf, -np.inf
                for f in range(begin[node], end[node]):
                    least, most = min(least, boxes[f, r]), max(most, boxes[f, r + 3])
                low[node, r], high[node, r] = least, most
        else:
            one, other = node + 1, skip[node + 1]
            for r in range(3):
                low[node, r] = min(low[one, r], low[other, r])
                high[node, r] = max(high[one, r], high[other, r])


@parallel_kernel
def _query(surface, tree, role, middle, half, reach, boxes, low, high, pairs, distance, counts):
    """Find the pairs of elements that are no neighbours."""
    for chunk in numba.prange(CHUNKS):
        # Leaves are dealt like cards: those early in the order have more to compare themselves with.
        counts[chunk] = _query_leaves(
            surface.faces,
            surface.solid,
            surface.edges,
            surface.own_vertex,
            surface.own_edge,
            surface.crowded,
            tree.begin,
            tree.end,
            tree.skip,
            tree.leaf,
            role,
            middle,
            half,
            reach,
            boxes,
            low,
            high,
            pairs[chunk],
            distance[chunk],
            chunk,
        )


@inner
def _query_leaves(
    faces,
    solid,
    edges,
    own_vertex,
    own_edge,
    crowded,
    begin,
    end,
    skip,
    leaves,
    role,
    middle,
    half,
    reach,
    boxes,
    low,
    high,
    pairs,
    distance,
    chunk,
):
    count = 0
    for k in range(chunk, len(leaves), CHUNKS):
        leaf = leaves[k]
        node = leaf
        while node < len(begin):
            if end[node] <= begin[leaf] or not _overlap(low, high, leaf, node):
                node = skip[node]
                continue
            if skip[node] == node + 1:
                for f in range(begin[leaf], end[leaf]):
                    for g in range(max(begin[node], f + 1), end[node]):
                        if not _faces_overlap(boxes, f, g) or _neighbours(faces, crowded, f, g):
                            continue
                        for side in range(2):
                            a, b = (f, g) if side == 0 else (g, f)
                            for c in range(3):
                                if own_vertex[a, c] and solid[b]:
                                    count = _keep(
                                        VERTEX_TRIANGLE,
                                        faces[a, c],
                                        b,
                                        faces[a, c],
                                        faces[b, 0],
                                        faces[b, 1],
                                        faces[b, 2],
                                        role,
                                        middle,
                                        half,
                                        reach,
                                        pairs,
                                        distance,
                                        count,
                                    )
                        for c in range(3):
                            for d in range(3):
                                one, other = own_edge[f, c], own_edge[g, d]
                                if one >= 0 and other >= 0:
                                    count = _keep(
                                        EDGE_EDGE,
                                        one,
                                        other,
                                        edges[one, 0],
                                        edges[one, 1],
                                        edges[other, 0],
                                        edges[other, 1],
                                        role,
                                        middle,
                                        half,
                                        reach,
                                        pairs,
                                        distance,
                                        count,
                                    )
            node += 1
    return count


@parallel_kernel
def _near(surface, tree, role, middle, half, reach, boxes, low, high, pairs, distance, counts):
    """Find the pairs among neighbours."""
    for chunk in numba.prange(CHUNKS):
        counts[chunk] = _near_pairs(
            surface.faces,
            surface.edges,
            surface.near_vertices,
            surface.near_edges,
            role,
            middle,
            half,
            reach,
            pairs[chunk],
            distance[chunk],
            chunk,
        )


@inner
def _near_pairs(faces, edges, near_vertices, near_edges, role, middle, half, reach, pairs, distance, chunk):
    count = 0
    part = share(chunk, len(near_vertices))
    for k in range(part[0], part[1]):
        i, f = near_vertices[k, 0], near_vertices[k, 1]
        count = _keep(
            VERTEX_TRIANGLE,
            i,
            f,
            i,
            faces[f, 0],
            faces[f, 1],
            faces[f, 2],
            role,
            middle,
            half,
            reach,
            pairs,
            distance,
            count,
        )
    part = share(chunk, len(near_edges))
    for k in range(part[0], part[1]):
        one, other = near_edges[k, 0], near_edges[k, 1]
        count = _keep(
            EDGE_EDGE,
            one,
            other,
            edges[one, 0],
            edges[one, 1],
            edges[other, 0],
            edges[other, 1],
            role,
            middle,
            half,
            reach,
            pairs,
            distance,
            count,
        )
    return count


@inner
def _overlap(low, high, a, b):
    return (
        low[a, 0] <= high[b, 0]
        and low[b, 0] <= high[a, 0]
        and low[a, 1] <= high[b, 1]
        and low[b, 1] <= high[a, 1]
        and low[a, 2] <= high[b, 2]
        and low[b, 2] <= high[a, 2]
    )


@inner
def _neighbours(faces, crowded, f, g):
    for a in range(3):
        for b in range(3):
            if faces[f, a] == faces[g, b] and not crowded[faces[f, a]]:
                return True
    return False


@inner
def _faces_overlap(boxes, f, g):
    return (
        boxes[f, 0] <= boxes[g, 3]
        and boxes[g, 0] <= boxes[f, 3]
        and boxes[f, 1] <= boxes[g, 4]
        and boxes[g, 1] <= boxes[f, 4]
        and boxes[f, 2] <= boxes[g, 5]
        and boxes[g, 2] <= boxes[f, 5]
    )


@inner
def _keep(kind, one, other, i, j, k, m, role, middle, half, reach, pairs, distance, count):
    """Count the pair, and write it down where there is room, if it may come within reach."""
    if role[i] | role[j] | role[k] | role[m] != MOVABLE | PARTNER:
        return count
    if i in (k, m) or j in (k, m) or (kind == VERTEX_TRIANGLE and i == j):
        return count
    a, b, c, d = row(middle, i), row(middle, j), row(middle, k), row(middle, m)
    ra, rb, rc, rd = row(half, i), row(half, j), row(half, k), row(half, m)
    if kind == VERTEX_TRIANGLE:
        way = sub(a, scale(1.0 / 3.0, add(b, add(c, d))))
        if (
            _apart(way, a, ra, b, rb, reach)
            and _apart(way, a, ra, c, rc, reach)
            and _apart(way, a, ra, d, rd, reach)
        ):
            return count
        gap = separation(vertex_triangle(a, b, c, d), a, b, c, d)
        if (
            _apart(gap, a, ra, b, rb, reach)
            and _apart(gap, a, ra, c, rc, reach)
            and _apart(gap, a, ra, d, rd, reach)
        ):
            return count
    else:
        way = sub(add(a, b), add(c, d))
        if (
            _apart(way, a, ra, c, rc, reach)
            and _apart(way, a, ra, d, rd, reach)
            and _apart(way, b, rb, c, rc, reach)
            and _apart(way, b, rb, d, rd, reach)
        ):
            return count
        gap = separation(edge_edge(a, b, c, d), a, b, c, d)
        if (
            _apart(gap, a, ra, c, rc, reach)
            and _apart(gap, a, ra, d, rd, reach)
            and _apart(gap, b, rb, c, rc, reach)
            and _apart(gap, b, rb, d, rd, reach)
        ):
            return count
    if count < len(distance):
        pairs[count, 0], pairs[count, 1], pairs[count, 2] = kind, one, other
        pairs[count, 3], pairs[count, 4], pairs[count, 5], pairs[count, 6] = i, j, k, m
        distance[count] = norm(gap)
    return count + 1


@inner
def _apart(way, a, ra, b, rb, reach):
    """Whether boxes around a and b, of half sides ra and rb, stay more than `reach` apart along `way`."""
    roam = abs(way.x) * (ra.x + rb.x) + abs(way.y) * (ra.y + rb.y) + abs(way.z) * (ra.z + rb.z)
    return dot(way, sub(a, b)) > roam + reach * norm(way)
