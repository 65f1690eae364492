"""The broad phase: which vertices and triangles, and which pairs of edges, may come within reach.

A list of candidates is made for a way of all vertices, straight from one place to another in the same time.
It holds for every way that stays within a skin of that one, so that it serves while impulses change the way,
and where cloth rests step after step (Verlet 1967). What two features do together does not count, only how
they move past each other: a list for cloth that falls as a whole is no longer than one for cloth at rest.

The tree's shape is that of the surface, which changes little; only its boxes are fitted anew (van den Bergen
1997). Leaves are compared in parallel, and what each finds is kept in the leaves' order.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, add, dot, inner, kernel, norm, parallel_kernel, row, scale, share, sub
from sim.contact.closest import separation
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE
from sim.contact.proximity import nearest, passing
from sim.contact.surface import Surface, Tree

MOST_CANDIDATES = 20_000_000
"""Pairs beyond which a list is refused, whatever the surface: it would take 2 GB and more to make."""

PLACE, ENTRY = 36, 61
"""Bytes that a place for a pair takes while they are found, and that each one found takes after that."""

FEW, MOST_PER_FACE = 200_000, 500
"""Pairs that any surface may have, and for each of its triangles; crumpled cloth has some fifteen of these.

Cloth that blows up may meet itself anywhere: to look at all of that would take minutes, for a step that is of
no use."""

LOPSIDED = 8
"""Part of all pairs that one of the CHUNKS may find before they are taken to be too many."""

BATCH = 64
"""Pairs that are looked at more closely at a time."""

ROUNDING = 1e-9
"""Part by which skins are a little wider than they say."""

MOVABLE, PARTNER, CLOTH = 1, 2, 4
"""What a vertex may be; a pair of features needs some of each."""

WITHIN, BETWEEN = 1, 2
"""Whether a piece of cloth feels itself, and whether pieces feel each other."""


class CandidateError(MemoryError):
    """More pairs within reach than may be looked at in one step.

    Attributes:
        taken: What a list of them would take [bytes], 0 where they were on several.
    """

    def __init__(self, count: int, most: int, taken: int = 0) -> None:
        self.taken = taken
        pairs = f"at least {count:,} pairs, {1e-6 * taken:,.0f} MB" if taken else f"{count:,} pairs"
        super().__init__(
            f"too much of the cloth comes near itself or mesh obstacles in one step ({pairs}, and at most "
            f"{most:,} are looked at); a shorter time step, less thickness or a coarser mesh make them fewer"
        )


class Candidates(NamedTuple):
    """p pairs that may come within `reach` on every way within `skin` of the one from `start` to `end`.

    Attributes:
        kind: (p,) VERTEX_TRIANGLE or EDGE_EDGE; the former come first in each part.
        pair: (p, 2) int32 vertex and element, or two edges.
        node: (p, 4) int32 their vertices.
        distance: (p,) at the start [m].
        start: (n, 3) [m].
        end: (n, 3) [m].
        skin: [m].
        reach: [m].
        least: The smallest distance at the start [m].
    """

    kind: np.ndarray
    pair: np.ndarray
    node: np.ndarray
    distance: np.ndarray
    start: np.ndarray
    end: np.ndarray
    skin: float
    reach: float
    least: float

    def hold_at(self, positions: np.ndarray) -> bool:
        """Whether no other pair is within reach with vertices at `positions` (n, 3) [m]."""
        return strayed(positions, self.end) <= self.skin or strayed(positions, self.start) <= self.skin

    def made_for(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether a list for the way from `start` to `end`, (n, 3) both [m], is this one."""
        return np.array_equal(start, self.start) and np.array_equal(end, self.end)

    def hold_on(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether no other pair comes within reach on the way from `start` to `end`, (n, 3) both [m]."""
        return strayed(end, self.end) <= self.skin and strayed(start, self.start) <= self.skin


class Roles(NamedTuple):
    """Who feels whom.

    Attributes:
        role: (n,) MOVABLE, PARTNER and CLOTH, what each vertex is.
        own: WITHIN, BETWEEN or both, what of the cloth feels cloth.
        of_face: (f,) the piece of each triangle, negative for those of obstacles.
        of_node: (k,) and of each of the tree's nodes, negative for those with several.
    """

    role: np.ndarray
    own: int
    of_face: np.ndarray
    of_node: np.ndarray


class BroadPhase:
    """Makes lists of candidates for a surface.

    Args:
        surface: What can touch.
        tree: Over its elements.
        movable: (n,) bool, vertices that may move; a pair without any is none.
        partner: (n,) bool, vertices that others may touch; a pair without any is none.
        piece: (n,) int, the piece of cloth that vertices are of, negative for those of obstacles; a pair
            without any cloth is none.
        own: WITHIN, BETWEEN or both, what of the cloth feels cloth.
    """

    def __init__(
        self,
        surface: Surface,
        tree: Tree,
        movable: np.ndarray,
        partner: np.ndarray,
        piece: np.ndarray,
        own: int = WITHIN | BETWEEN,
    ) -> None:
        if not own & WITHIN:  # neighbours are of one piece
            nobody = np.zeros((0, 2), dtype=np.int32)
            surface = surface._replace(near_vertices=nobody, near_edges=nobody)
        self.surface, self.tree = surface, tree
        of_face = piece[surface.faces[:, 0]]
        changes = np.append(0, np.cumsum(of_face[1:] != of_face[:-1]))
        several = changes[tree.begin] != changes[tree.end - 1] if len(of_face) else np.zeros(0, dtype=bool)
        of_node = np.where(several, -1, of_face[tree.begin]) if len(of_face) else np.zeros(0, dtype=np.int64)
        role = (movable * MOVABLE + partner * PARTNER + (piece >= 0) * CLOTH).astype(np.uint8)
        self._roles = Roles(role, own, of_face.astype(np.int32), of_node.astype(np.int32))
        self._boxes = np.zeros((len(surface.faces), 12)), np.zeros((len(tree.begin), 12))
        self._room = 64

    @property
    def most(self) -> int:
        """Pairs beyond which a list is refused."""
        return min(MOST_CANDIDATES, FEW + MOST_PER_FACE * len(self.surface.faces))

    def candidates(self, start: np.ndarray, end: np.ndarray, skin: float, reach: float) -> Candidates:
        """The pairs that may come within reach of each other on the way from start to end.

        Args:
            start: (n, 3) [m].
            end: (n, 3) [m].
            skin: How far off that way vertices may be [m].
            reach: Distance of a pair that counts [m].

        Raises:
            CandidateError: where there are more than `most`.
        """
        tree, room = self.tree, reach + 2.0 * skin * (1.0 + ROUNDING)
        fit(self.surface.faces, tree.begin, tree.end, tree.skip, (start, end), room, *self._boxes)
        while True:
            pairs, distance = (
                np.empty((CHUNKS, self._room, 7), dtype=np.int32),
                np.empty((CHUNKS, self._room)),
            )
            counts = np.zeros(CHUNKS, dtype=np.int64)
            about = self.surface, tree, self._roles, (start, end), room, *self._boxes
            _find(*about, pairs, distance, counts, self.most // LOPSIDED)
            most, total = int(counts.max()), int(counts.sum())
            if most <= self._room:
                break
            places = most + most // 4
            if total > self.most or most > self.most // LOPSIDED:
                raise CandidateError(total, self.most, PLACE * CHUNKS * places + ENTRY * total)
            self._room = places
        found = np.concatenate([pairs[chunk, :count] for chunk, count in enumerate(counts)])
        apart = np.concatenate([distance[chunk, :count] for chunk, count in enumerate(counts)])
        kind, pair, node = found[:, 0].astype(np.int8), found[:, 1:3].copy(), found[:, 3:].copy()
        least = float(apart.min(initial=np.inf))
        return Candidates(kind, pair, node, apart, start.copy(), end.copy(), skin, reach, least)


@kernel
def strayed(positions, places):
    """How far the farthest vertex is from its place [m], or from that moved along with all, if less."""
    mean, most, together = np.zeros(3), 0.0, 0.0
    for i in range(len(positions)):
        for r in range(3):
            mean[r] += positions[i, r] - places[i, r]
    mean /= len(positions)
    for i in range(len(positions)):
        square = aside = 0.0
        for r in range(3):
            way = positions[i, r] - places[i, r]
            square += way * way
            aside += (way - mean[r]) ** 2
        if not square <= most:
            most = square
        if not aside <= together:
            together = aside
    return np.sqrt(most if most < together else together)  # which is nan where any number is


@kernel
def fit(faces, begin, end, skip, way, room, boxes, hulls):
    """Fill the boxes of elements and of the tree's nodes where `way` starts and ends, half a room wider."""
    places, after = way
    for f in range(len(faces)):
        for r in range(3):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            a, b, c = places[i, r], places[j, r], places[k, r]
            boxes[f, r], boxes[f, r + 3] = min(a, b, c) - 0.5 * room, max(a, b, c) + 0.5 * room
            a, b, c = after[i, r], after[j, r], after[k, r]
            boxes[f, r + 6], boxes[f, r + 9] = min(a, b, c) - 0.5 * room, max(a, b, c) + 0.5 * room
    for node in range(len(begin) - 1, -1, -1):
        if skip[node] == node + 1:
            _copy(hulls, node, boxes, begin[node])
            for f in range(begin[node] + 1, end[node]):
                _widen(hulls, node, boxes, f)
        else:
            _copy(hulls, node, hulls, node + 1)
            _widen(hulls, node, hulls, skip[node + 1])


@inner
def _copy(boxes, node, others, other):
    for r in range(12):  # number by number: what Numba has for rows takes a second and a half to compile
        boxes[node, r] = others[other, r]


@inner
def _widen(boxes, node, others, other):
    for side in (0, 6):
        for r in range(side, side + 3):
            boxes[node, r] = min(boxes[node, r], others[other, r])
            boxes[node, r + 3] = max(boxes[node, r + 3], others[other, r + 3])


@inner
def _apart(boxes, a, others, b):
    """Whether the same side of one box is beyond the other's where the way starts, and where it ends.

    All goes straight and at the same time, so what is beyond a plane at both ends is so all along: boxes
    that move together pass each other as if they stood still.
    """
    for r in range(3):
        if boxes[a, r + 3] < others[b, r] and boxes[a, r + 9] < others[b, r + 6]:
            return True
        if others[b, r + 3] < boxes[a, r] and others[b, r + 9] < boxes[a, r + 6]:
            return True
    return False


@parallel_kernel
def _find(surface, tree, roles, way, room, boxes, hulls, pairs, distance, counts, most):
    """Find the pairs of elements that are no neighbours, then those among neighbours.

    Leaves are dealt like cards, as those early in the order have more to compare themselves with.
    """
    for part in numba.prange(CHUNKS):
        chunk = np.int64(part)  # as it is unsigned in threads alone, helpers would be compiled twice
        found = pairs[chunk], distance[chunk]
        count = _query_leaves(surface, tree, roles, way, room, boxes, hulls, *found, chunk, most)
        counts[chunk] = _near_pairs(surface, roles, way, room, *found, chunk, count)


@inner
def _query_leaves(surface, tree, roles, way, room, boxes, hulls, pairs, distance, chunk, most):
    # Arrays one by one, as in `sim.solve.multigrid.cycle`, whose loops took twice as long with whole tuples.
    faces, solid, edges, crowded = surface.faces, surface.solid, surface.edges, surface.crowded
    own_vertex, own_edge = surface.own_vertex, surface.own_edge
    begin, end, skip, leaves = tree.begin, tree.end, tree.skip, tree.leaf
    own, of_face, of_node = roles.own, roles.of_face, roles.of_node
    places, after = way
    about, count = (faces, edges, roles.role, places, after, room, pairs, distance), 0
    batch, many = np.empty((BATCH, 3), dtype=np.int32), 0
    for k in range(chunk, len(leaves), CHUNKS):
        if count > most:  # it is refused anyway
            break
        leaf = leaves[k]
        node = leaf
        while node < len(begin):
            if end[node] <= begin[leaf] or _apart(hulls, leaf, hulls, node):
                node = skip[node]
                continue
            if _strangers(own, of_node[leaf], of_node[node]):
                node = skip[node]
                continue
            if skip[node] == node + 1:
                for f in range(begin[leaf], end[leaf]):
                    for g in range(max(begin[node], f + 1), end[node]):
                        if _apart(boxes, f, boxes, g) or _neighbours(faces, crowded, f, g):
                            continue
                        if _strangers(own, of_face[f], of_face[g]):
                            continue
                        for side in range(2):
                            a, b = (f, g) if side == 0 else (g, f)
                            for c in range(3):
                                i = faces[a, c]
                                if not (own_vertex[a, c] and solid[b]):
                                    continue
                                if not _vertex_apart(faces, places, after, room, i, b):
                                    many = _note(batch, many, VERTEX_TRIANGLE, i, b)
                                    if many == BATCH:
                                        count, many = _keep(batch, many, *about, count), 0
                        for c in range(3):
                            for d in range(3):
                                one, other = own_edge[f, c], own_edge[g, d]
                                if one < 0 or other < 0:
                                    continue
                                if not _edges_apart(edges, places, after, room, one, other):
                                    many = _note(batch, many, EDGE_EDGE, one, other)
                                    if many == BATCH:
                                        count, many = _keep(batch, many, *about, count), 0
            node += 1
    return _keep(batch, many, *about, count)


@inner
def _near_pairs(surface, roles, way, room, pairs, distance, chunk, count):
    faces, edges, (places, after) = surface.faces, surface.edges, way
    near_vertices, near_edges = surface.near_vertices, surface.near_edges
    about = faces, edges, roles.role, places, after, room, pairs, distance
    batch, many = np.empty((BATCH, 3), dtype=np.int32), 0
    part = share(chunk, len(near_vertices))
    for k in range(part[0], part[1]):
        i, f = near_vertices[k, 0], near_vertices[k, 1]
        if not _vertex_apart(faces, places, after, room, i, f):
            many = _note(batch, many, VERTEX_TRIANGLE, i, f)
            if many == BATCH:
                count, many = _keep(batch, many, *about, count), 0
    part = share(chunk, len(near_edges))
    for k in range(part[0], part[1]):
        one, other = near_edges[k, 0], near_edges[k, 1]
        if not _edges_apart(edges, places, after, room, one, other):
            many = _note(batch, many, EDGE_EDGE, one, other)
            if many == BATCH:
                count, many = _keep(batch, many, *about, count), 0
    return _keep(batch, many, *about, count)


@inner
def _strangers(own, a, b):
    """Whether pieces a and b do not feel each other; what is negative is more than one piece, or none."""
    if a < 0 or b < 0:
        return False
    return not own & (WITHIN if a == b else BETWEEN)


@inner
def _neighbours(faces, crowded, f, g):
    for a in range(3):
        for b in range(3):
            if faces[f, a] == faces[g, b] and not crowded[faces[f, a]]:
                return True
    return False


@inner
def _vertex_apart(faces, places, after, room, i, f):
    """Whether a direction tells a vertex and a triangle apart at both ends of the way, as it does most pairs.

    Here and below a small function with few arrays: a call of `_keep` costs more than all that this does, as
    threads count in turn who uses an array. So it is called for a batch of pairs.
    """
    j, k, m = faces[f, 0], faces[f, 1], faces[f, 2]
    a, b, c, d = row(places, i), row(places, j), row(places, k), row(places, m)
    n = sub(scale(3.0, a), add(b, add(c, d)))
    reach = room * norm(n)
    if not min(dot(n, sub(a, b)), dot(n, sub(a, c)), dot(n, sub(a, d))) > reach:
        return False
    a, b, c, d = row(after, i), row(after, j), row(after, k), row(after, m)
    return min(dot(n, sub(a, b)), dot(n, sub(a, c)), dot(n, sub(a, d))) > reach


@inner
def _edges_apart(edges, places, after, room, one, other):
    """And two edges."""
    i, j, k, m = edges[one, 0], edges[one, 1], edges[other, 0], edges[other, 1]
    a, b, c, d = row(places, i), row(places, j), row(places, k), row(places, m)
    n = sub(add(a, b), add(c, d))
    reach = room * norm(n)
    if not min(dot(n, a), dot(n, b)) - max(dot(n, c), dot(n, d)) > reach:
        return False
    a, b, c, d = row(after, i), row(after, j), row(after, k), row(after, m)
    return min(dot(n, a), dot(n, b)) - max(dot(n, c), dot(n, d)) > reach


@inner
def _note(batch, many, kind, one, other):
    """Put one more pair into a batch that `many` are in."""
    batch[many, 0], batch[many, 1], batch[many, 2] = kind, one, other
    return many + 1


@inner
def _keep(batch, many, faces, edges, role, places, after, room, pairs, distance, count):
    """Count those of a batch that may come within `room`, and write them down where there is place."""
    for p in range(many):
        kind, one, other = batch[p, 0], batch[p, 1], batch[p, 2]
        if kind == VERTEX_TRIANGLE:
            i, j, k, m = one, faces[other, 0], faces[other, 1], faces[other, 2]
        else:
            i, j, k, m = edges[one, 0], edges[one, 1], edges[other, 0], edges[other, 1]
        if role[i] | role[j] | role[k] | role[m] != MOVABLE | PARTNER | CLOTH:
            continue
        if i in (k, m) or j in (k, m) or (kind == VERTEX_TRIANGLE and i == j):
            continue
        a, b, c, d = row(places, i), row(places, j), row(places, k), row(places, m)
        ways = (
            sub(row(after, i), a),
            sub(row(after, j), b),
            sub(row(after, k), c),
            sub(row(after, m), d),
        )
        reach = room + passing(kind, *ways)
        apart = norm(separation(nearest(kind, a, b, c, d), a, b, c, d))
        if apart > reach:
            continue
        if count < len(distance):
            pairs[count, 0], pairs[count, 1], pairs[count, 2] = kind, one, other
            pairs[count, 3], pairs[count, 4], pairs[count, 5], pairs[count, 6] = i, j, k, m
            distance[count] = apart
        count += 1
    return count
