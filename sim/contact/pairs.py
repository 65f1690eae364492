"""What of the cloth touches what of the cloth, and of mesh obstacles: vertices and triangles, pairs of edges.

Detection works on one set of vertices, those of the cloth and then those of mesh obstacles. What it finds are
contacts of cloth vertices alone: where the others are, and how they move, is in the contacts' offset and
speed.
"""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np

from sim.contact.broad import BETWEEN, WITHIN, BroadPhase, CandidateError, Candidates, strayed
from sim.contact.cones import around, in_cones
from sim.contact.contacts import NO_CONTACTS, NOT_OVER, Contacts, along
from sim.contact.hold import go_at_most
from sim.contact.impact import VERTEX_TRIANGLE
from sim.contact.obstacles import Solid
from sim.contact.outspread import border_of, clearance
from sim.contact.proximity import measure, meet
from sim.contact.surface import build_surface, inside_flats
from sim.mesh import Mesh

THICK = 0.4
"""Part of a typical edge that cloth may be thick, so that a flat sheet does not touch itself."""

FELT = 1.25
"""Times the thickness within which a pair is a contact: what pressed must not be forgotten as it lets go."""

GAP = 0.1
"""Part of the thickness that continuous detection keeps free on the way."""

AFTER = 2.0
"""Gaps that are left after a pair has met on the way."""

SKIN, QUIET_SKIN = 0.05, 0.25
"""Parts of a typical edge that the skin of a list is wide: while cloth moves, and while it hardly does."""

QUIET = 0.1
"""Part of a typical edge that cloth which hardly moves goes in a step, at most."""

MARGIN = 1e-9
"""Part of a distance that rounding may have taken off it, and far more than it does."""

MOST_LISTS = 8
"""Times the longest list that may be gone through in one step: what takes longer is cloth that blows up."""

MOST_ASKED = 8_000_000
"""Pairs that may be asked in one step however small the cloth is: some ten seconds, for many parts."""

MANY = 0.25
"""Part of the pairs that may be asked in one step after which it is split no further: to end in time."""

NEARER = 0.495
"""Part of the way to what is nearest that a vertex may go where nothing else helps: two such never meet."""


PARTS = 2
"""Kinds of partners: of the same piece, of another piece; those after them are the obstacles, one by one."""


class Feels(NamedTuple):
    """What cloth feels of cloth.

    Attributes:
        within: Whether a piece feels itself.
        between: Whether pieces feel each other.
        edges: Whether edges feel edges, those of mesh obstacles, too.
    """

    within: bool
    between: bool
    edges: bool = True


class Pairs:
    """Pairs of features that may touch, kept up to date.

    A step, or a part of one, begins with `begin`; then `hits` and `shorten` are about where it ends. Lists
    are kept while they hold, and pairs are not looked at where bounds show that none can be near or meet: how
    near the nearest of them was, and how far vertices have gone past each other since.

    Args:
        mesh: The cloth, n vertices.
        free: (n,) bool, which of its vertices can move.
        solid: Mesh obstacles, k vertices, where they are at first.
        feels: What cloth feels of cloth, beside mesh obstacles.
        first_key: Keys of contacts start here.
        moves: (k,) bool, which vertices of mesh obstacles may move; none if left out.

    Attributes:
        exhaustive: Whether to make every list anew and look at all of it, whatever bounds say.
        lists: How many lists were made.
        looks: How often the pairs were looked at: where they are, or whether they meet.
        sweeps: How often it was looked whether they meet.
        listing: Time that lists took [s], added up.
        asked: Times a pair was asked whether it meets; for whoever takes a whole step to set to zero.
        looked: (parts, 2) how many pairs were on the longest list, by partner and kind, that bounds could not
            show to be all out of reach; for whoever takes a whole step to set to zero.
        outspread: Whether the proof of `sim.contact.outspread` stood in for a list; for whoever takes a whole
            step to set to False.
        felt: (parts, 2) how many pairs were found to be near or to meet, added up; for whoever takes a whole
            step to set to zero.
        counts: (parts, 2) how many pairs are on the list.
    """

    def __init__(
        self,
        mesh: Mesh,
        free: np.ndarray,
        solid: Solid,
        feels: Feels,
        first_key: int,
        moves: np.ndarray | None = None,
    ) -> None:
        n = len(free)
        self._mesh, self._n, self._first_key, self.feels, self.solid = mesh, n, first_key, feels, solid
        self.exhaustive, self.lists, self.looks, self.sweeps = False, 0, 0, 0
        places = np.concatenate([mesh.vertices, solid.vertices])
        edges = np.concatenate([mesh.edges, solid.edges + n])
        self._surface, tree = build_surface(
            places, np.concatenate([mesh.triangles, solid.triangles + n]), edges
        )
        self._around = around(self._surface.faces, len(places))
        flat = inside_flats(solid.vertices, solid.triangles, solid.edges)
        felt = np.zeros(n, dtype=bool), np.zeros(len(mesh.edges), dtype=bool)
        vertices, lines = (np.concatenate(pair) for pair in zip(felt, flat, strict=True))
        self._surface = self._surface.without(vertices, lines | (not feels.edges))
        outside = np.arange(len(places)) >= n
        moves = np.zeros(len(solid.vertices), dtype=bool) if moves is None else moves
        self._free = np.concatenate([free, np.zeros(len(moves), dtype=bool)])
        self._piece = np.concatenate([mesh.pieces, -1 - solid.part])
        own = WITHIN * feels.within | BETWEEN * feels.between
        self._broad = BroadPhase(
            self._surface, tree, np.concatenate([free, moves]), outside | (own > 0), self._piece, own
        )
        self._parts = PARTS + int(solid.part.max(initial=-1)) + 1
        self.looked, self.felt = (np.zeros((self._parts, 2), dtype=np.int64) for _ in range(2))
        ends = mesh.rest_vertices[mesh.edges] if len(mesh.edges) else solid.vertices[solid.edges]
        self.edge = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
        alone = feels.within and not feels.between and not len(solid.vertices)
        self._border = border_of(mesh) if alone else None
        self._clear: tuple[np.ndarray, float] | None = None
        self.asked, self.listing, self.outspread = 0, 0.0, False
        self.forget()

    @property
    def listed(self) -> int:
        """How many pairs there are on the list."""
        return 0 if self._list is None else len(self._list.kind)

    @property
    def most(self) -> int:
        """Times a pair may be asked in one step whether it meets."""
        return max(MOST_ASKED, MOST_LISTS * self._broad.most)

    @property
    def many(self) -> bool:
        """Whether so many of these have been asked that the step should be split no further."""
        return self.asked > MANY * self.most

    def forget(self) -> None:
        """Start with no list."""
        self._list: Candidates | None = None
        self.counts = np.zeros((self._parts, 2), dtype=np.int64)
        self._least = np.full((self._parts, 2), np.inf)

    def begin(
        self,
        x: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        h: float,
        thickness: float,
        over: np.ndarray = NOT_OVER,
    ) -> Contacts:
        """Begin a step of h [s] and find the pairs that are hardly farther than the thickness.

        Args:
            x: (n, 3) where the cloth's vertices are [m].
            before: (k, 3) where the obstacles' vertices are [m].
            after: (k, 3) where they will be [m].
            h: [s].
            thickness: That is asked for [m]; cloth is no thicker than a part of a typical edge.
            over: (k, 2) vertices, and obstacles that have run over them: their pairs are let go of.
        """
        self._over = over @ [self._parts, 1]
        self._start, self._after, self._h = np.concatenate([x, before]), after, h
        self.thickness = min(thickness, THICK * self.edge)
        self._reach = FELT * self.thickness
        known = self._list
        if known is None or self.exhaustive or known.reach != self._reach or not known.hold_at(self._start):
            if self._spread_out(self._start, self._reach):
                self.forget()
                return NO_CONTACTS
            known = self._renew(self._start)
        self._bound(known)
        if self._apart > self._reach and not self.exhaustive:
            return NO_CONTACTS
        self._note(self._reach)
        pairs, weight = known, self._measure(known)
        distance = self._distance
        close = np.flatnonzero((distance < self._reach) & (distance > 0.0))
        close = close[self._free[pairs.node[close]].any(axis=1)]
        close = close[~self._let_go(pairs.node[close])]
        close = close[~self._as_at_rest(pairs, close)]
        normal = np.einsum("ij,ijk->ik", weight[close], self._start[pairs.node[close]])
        normal /= distance[close, None]
        square = in_cones(self._around, pairs.node[close], weight[close], normal, self._start)
        close, normal = close[square], normal[square]
        self._count(pairs, close)
        keep = np.full(len(close), self.thickness)
        return self._contacts(pairs, close, weight[close], normal, keep)

    def hits(self, end: np.ndarray, part: float = 1.0) -> Contacts:
        """Contacts of pairs that meet before the cloth's vertices are at `end` (n, 3) [m].

        To meet is to come nearer than a `part` of the gap.
        """
        way, gap = (self._start, np.concatenate([end, self._after])), part * GAP * self.thickness
        pairs = self._holding(way)
        if pairs is None:
            if self._spread_out(way[1], gap):
                return NO_CONTACTS
            pairs = self._renewed(way)
        p = len(pairs.kind)
        far = 2.0 * strayed(way[1], way[0])
        if self._apart - far > gap and not self.exhaustive:
            return NO_CONTACTS
        self._note(gap + far)
        self._look(pairs)
        self.sweeps += 1
        time, normal, weight = np.empty(p), np.empty((p, 3)), np.empty((p, 4))
        meet(pairs.kind, pairs.node, self._distance, *way, gap, time, normal, weight)
        met = np.flatnonzero(time <= 1.0)
        met = met[~self._let_go(pairs.node[met])]
        self._count(pairs, met)
        keep = np.minimum(AFTER * gap, self._distance[met])
        return self._contacts(pairs, met, weight[met], normal[met], keep)

    def obstacle(self, contacts: Contacts) -> np.ndarray:
        """(c,) the obstacle that each contact of a pair is with, −1 where both of it are cloth."""
        faces, edges, piece = self._surface.faces, self._surface.edges, self._piece
        number, first = contacts.key - self._first_key, len(self._start) * len(faces)
        of_edges, least = number >= first, np.empty(len(number), dtype=np.int64)
        vertex, face = np.divmod(number[~of_edges], len(faces))
        least[~of_edges] = np.minimum(piece[vertex], piece[faces[face, 0]])
        one, other = np.divmod(number[of_edges] - first, max(len(edges), 1))
        least[of_edges] = np.minimum(piece[edges[one, 0]], piece[edges[other, 0]])
        return np.maximum(-1 - least, -1)

    def shorten(self, end: np.ndarray, which: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Let the vertices `which` of `end` go no farther from `rest` than they can without meeting anything.

        That is a part of their distance at the start from what is nearest, `rest` (n, 3) [m]. Returns those
        of them that would have gone farther.
        """
        way = self._start, np.concatenate([end, self._after])
        pairs = self._fresh(way)  # how far all others are must not depend on what an older list has of them
        self._note(np.inf)
        self._look(pairs)
        least, node = np.full(len(self._start), np.inf), pairs.node
        np.minimum.at(least, node.ravel(), np.repeat(np.where(self._let_go(node), np.inf, self._distance), 4))
        return go_at_most(rest, end, which, NEARER * least[which])

    def _holding(self, way: tuple[np.ndarray, np.ndarray]) -> Candidates | None:
        """The list, with bounds or `_distance` of its pairs at the start; None if it holds no longer."""
        known = self._list
        return None if known is None or self.exhaustive or not known.hold_on(*way) else known

    def _fresh(self, way: tuple[np.ndarray, np.ndarray]) -> Candidates:
        """The list that is made for just this way, with bounds or `_distance` of its pairs at the start."""
        known = self._list
        if known is not None and not self.exhaustive and known.made_for(*way):
            return known
        return self._renewed(way)

    def _renewed(self, way: tuple[np.ndarray, np.ndarray]) -> Candidates:
        """A new list for the way, with bounds of its pairs at the start."""
        known = self._renew(way[1])
        self._bound(known)
        return known

    def _spread_out(self, end: np.ndarray, room: float) -> bool:
        """Whether cloth is shown to be spread out on the way to `end`, no two features within `room` [m].

        Asked before a list is made, which costs ten times as much. Where it was shown before, with features
        farther apart than that, it holds until vertices have gone past each other by as much as they were.
        """
        if self._border is None or self.exhaustive:
            return False
        if self._clear is not None:
            places, distance = self._clear
            far = 2.0 * max(strayed(self._start, places), strayed(end, places))
            if distance * (1.0 - MARGIN) - far > room:
                self.outspread = True
                return True
        distance = clearance(self._mesh.triangles, self._border, self._start, end, room)
        self._clear = (end, distance) if distance > 0.0 else None
        self.outspread |= distance > 0.0
        return distance > 0.0

    def _bound(self, known: Candidates) -> None:
        """Set a lower bound of the distances of all pairs at the start; they are not measured."""
        self._strayed = 2.0 * strayed(self._start, known.start)
        self._apart = known.least * (1.0 - MARGIN) - self._strayed
        self._distance = np.zeros(0)

    def _note(self, reach: float) -> None:
        """Note the partners of whom some may be within `reach` [m] of the start.

        The bounds of all the others' pairs are those by which `measure` and `meet` pass over each of them.
        """
        near = ~(self._least * (1.0 - MARGIN) - self._strayed > reach) | self.exhaustive
        self.looked = np.maximum(self.looked, np.where(near, self.counts, 0))

    def _count(self, pairs: Candidates, which: np.ndarray) -> None:
        np.add.at(self.felt, (self._part[which], pairs.kind[which]), 1)

    def _look(self, pairs: Candidates) -> None:
        """Measure the pairs, if there was no need before, as they are about to be asked whether they meet."""
        if len(self._distance) != len(pairs.kind):
            self._measure(pairs)
        self.asked += len(pairs.kind)
        if self.asked > self.most:
            raise CandidateError(self.asked, self.most)

    def _renew(self, end: np.ndarray) -> Candidates:
        """Make a new list for the way from the start to `end` (n + k, 3) [m]."""
        begin = perf_counter()
        quiet = np.abs(end - self._start).max() < QUIET * self.edge
        skin = (QUIET_SKIN if quiet else SKIN) * self.edge
        self._list = self._broad.candidates(self._start, end, skin, self._reach)
        self.lists += 1
        self._sort(self._list)
        self.listing += perf_counter() - begin
        return self._list

    def _sort(self, pairs: Candidates) -> None:
        """Say of each pair whom it is with, and of these how many there are, and how near at least."""
        one, other = self._piece[pairs.node[:, 0]], self._piece[pairs.node[:, 3]]
        least = np.minimum(one, other)
        self._part = np.where(least < 0, PARTS - 1 - least, one != other)
        cell = 2 * self._part + pairs.kind
        self.counts = np.bincount(cell, minlength=2 * self._parts).reshape(-1, 2)
        self._least = np.full(2 * self._parts, np.inf)
        for c in np.flatnonzero(self.counts):
            self._least[c] = pairs.distance[cell == c].min()
        self._least = self._least.reshape(-1, 2)

    def _measure(self, pairs: Candidates) -> np.ndarray:
        """Set `_distance` of the pairs at the start; returns the weights of those that are near."""
        self._distance, weight = np.empty(len(pairs.kind)), np.empty((len(pairs.kind), 4))
        about = pairs.kind, pairs.node, pairs.distance, pairs.start
        measure(*about, self._start, self._reach, self._distance, weight)
        self._apart = float(self._distance.min(initial=np.inf)) * (1.0 - MARGIN)
        self.looks += 1
        return weight

    def _let_go(self, node: np.ndarray) -> np.ndarray:
        """(p,) whether pairs of the vertices `node` (p, 4) are of one that their obstacle has run over."""
        if not len(self._over) or not len(self.solid.vertices):
            return np.zeros(len(node), dtype=bool)
        obstacle = (-1 - self._piece[node]).max(axis=1)
        return (obstacle >= 0) & np.isin(node * self._parts + obstacle[:, None], self._over).any(axis=1)

    def _as_at_rest(self, pairs: Candidates, close: np.ndarray) -> np.ndarray:
        """Which of these pairs are of one piece and as near at rest: within the thickness, or the reach."""
        rest, pieces, node = self._mesh.rest_vertices, self._mesh.pieces, pairs.node[close]
        inside = np.minimum(node, self._n - 1)
        alike = np.flatnonzero(
            (node < self._n).all(axis=1) & (pieces[inside] == pieces[inside[:, :1]]).all(axis=1)
        )
        apart, near = np.empty(len(alike)), np.zeros(len(close), dtype=bool)
        about = pairs.kind[close[alike]], node[alike], np.zeros(len(alike)), rest
        measure(*about, rest, self._reach, apart, np.empty((len(alike), 4)))
        let_go = self._distance[close[alike]] >= self.thickness
        near[alike] = apart < np.where(let_go, self._reach, self.thickness)
        return near

    def _contacts(
        self, pairs: Candidates, which: np.ndarray, weight: np.ndarray, normal: np.ndarray, keep: np.ndarray
    ) -> Contacts:
        """Contacts of the pairs `which`, with what the vertices of obstacles do in offset and speed."""
        kind, node, n = pairs.kind[which], pairs.node[which], self._n
        one, other = pairs.pair[which].T.astype(np.int64)
        faces, edges = len(self._surface.faces), len(self._surface.edges)
        key = np.where(kind == VERTEX_TRIANGLE, one * faces, len(self._start) * faces + one * edges)
        outside = node >= n
        ours = node[np.arange(len(node)), outside.argmin(axis=1)]
        theirs, index = np.where(outside, weight, 0.0), np.where(outside, node - n, 0)
        offset, speed = np.zeros(len(which)), np.zeros((len(which), 3))
        if outside.any():
            before = self._start[n:]
            offset = -along(normal, np.einsum("ij,ijk->ik", theirs, self._after[index]))
            speed = -np.einsum("ij,ijk->ik", theirs, (self._after - before)[index]) / self._h
        return Contacts(
            key=self._first_key + key + other,
            node=np.where(outside, ours[:, None], node).astype(np.int32),
            weight=np.where(outside, 0.0, weight),
            start=self._distance[which],
            normal=normal,
            offset=offset,
            speed=speed,
            thickness=keep,
        )
