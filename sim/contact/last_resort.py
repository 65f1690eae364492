"""The last resort: where impulses find no way, vertices go no farther than nothing can be met.

Their speeds stay. Those that would meet an obstacle that moves go along with it: where they were, it comes;
and so do those that would meet them. What obstacles run over nevertheless, as it is pinned or has no way out,
is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim.contact.contacts import NO_CONTACTS, Contacts
from sim.contact.faces import NOBODY, Faces
from sim.contact.pairs import Pairs

TOUCHING = 1e-3
"""Part of the usual gap within which an obstacle touches what is pinned, and does not pass it closely."""

MOST_TURNS = 4
"""Turns of holding back what meets, and what meets that, before all vertices are."""

STUCK = 12
"""Turns of holding back all vertices; more than three are never needed where they are of use."""


class Held(NamedTuple):
    """How holding back ended.

    Attributes:
        held: (n,) bool, which vertices were held back.
        over: What meets nevertheless.
        lost: What nothing could help: it weighs nothing that can move.
    """

    held: np.ndarray
    over: Contacts
    lost: Contacts


@dataclass(frozen=True)
class LastResort:
    """Of one step, or one part of it, whose start `faces` and `pairs` know.

    Attributes:
        faces: Of cloth, against obstacles but meshes.
        pairs: That may touch, if any.
        free: (n,) bool, which vertices can move.
        inverse_masses: (n,) [1/kg].
        hits: What meets on the way to an end (n, 3) [m], to a part of the usual gap.
    """

    faces: Faces
    pairs: Pairs | None
    free: np.ndarray
    inverse_masses: np.ndarray
    hits: Callable[[np.ndarray, float], Contacts]

    def met(self, end: np.ndarray) -> tuple[Contacts, Contacts]:
        """What meets on the way to `end` (n, 3) [m] and can be pushed apart, and what obstacles run over.

        That weighs nothing that can move. What comes so near where it is pinned may still meet elsewhere, and
        can be pushed there. With the obstacle that runs over a vertex, its other contacts are let go, too.
        """
        hits = self.hits(end, 1.0)
        fixed = self._fixed(hits)
        if not fixed.any():
            return hits, NO_CONTACTS
        touching = self.hits(end, TOUCHING)
        run_over = self._fixed(touching)
        lost, elsewhere = touching.only(run_over), np.isin(touching.key, hits.key[fixed])
        hits = hits.only(~fixed).and_also(touching.only(elsewhere & ~run_over))
        of_hits, of_lost = self._obstacle(hits), self._obstacle(lost)
        gone = np.zeros(len(of_hits), dtype=bool)
        for o in np.unique(of_lost):
            over = lost.only(of_lost == o)
            over = np.unique(over.node[over.weight != 0.0])
            gone |= (of_hits == o) & np.isin(hits.node, over).any(axis=1)
        return hits.only(~gone), lost

    def hold_back(self, start: np.ndarray, end: np.ndarray) -> Held:
        """Let vertices that would still meet something on the way to `end` (n, 3) [m] go less far.

        Where that leads others into what they would not have met, over and over, all go along with the
        obstacle that moves, if it is one; and at last all stay near their `start` (n, 3) [m].
        """
        asked, rest, carrier = end.copy(), start.copy(), np.full(len(end), NOBODY)
        met = self.met(end)
        found = self._held(end, met, rest, MOST_TURNS, carrier)
        carriers = np.unique(carrier[carrier >= 0])
        if len(found.over.key) and len(carriers) == 1:
            end[:], rest[self.free] = asked, self.faces.along(carriers[0], self.free)
            found = self._held(end, met, rest, STUCK)
        if len(found.over.key):
            end[:], rest[:] = asked, start
            found = self._held(end, met, rest, STUCK)
        return found

    def _held(
        self,
        x: np.ndarray,
        met: tuple[Contacts, Contacts],
        rest: np.ndarray,
        turns: int,
        carrier: np.ndarray | None = None,
    ) -> Held:
        """Let what `met` on the way to `x` (n, 3) [m] end near `rest` (n, 3) [m].

        `carrier` (n,) says by which obstacle each vertex rests, and more come to rest by one as they meet it;
        without it, rests stay, and all that can move is held back together.
        """
        held, (over, lost) = np.zeros(len(x), dtype=bool), met
        for _ in range(turns):
            if not len(over.key):
                break
            obstacle, carried = self._obstacle(over), False
            if carrier is not None:
                carried = self.faces.carry(over, obstacle, rest, carrier, held)
            shortened = self.faces.shorten(x, over.only(over.key < self.faces.last_key), rest)
            if self.pairs is not None:
                # All vertices of a pair: it might turn about those that weigh nothing where it meets.
                node = over.only(over.key >= self.faces.last_key).node
                which = np.flatnonzero(self.free) if carrier is None else np.unique(node[self.free[node]])
                shortened = np.union1d(shortened, self.pairs.shorten(x, which, rest))
            if not (len(shortened) or carried):
                break
            stay = shortened[held[shortened]]  # what is left of these ways is rounding
            x[stay] = rest[stay]
            held[shortened] = True
            over, lost = self.met(x)
        return Held(held, over, lost)

    def run_over(self, contacts: Contacts) -> np.ndarray:
        """(k, 2) the vertices of `contacts`, and the obstacles that each of them is with."""
        c, a = np.nonzero(contacts.weight != 0.0)
        over = np.stack([contacts.node[c, a], self._obstacle(contacts)[c]], axis=1).astype(np.int64)
        return over[over[:, 1] != NOBODY]

    def _fixed(self, contacts: Contacts) -> np.ndarray:
        """(c,) whether nothing that can move has a share in each of the contacts."""
        return ~np.isfinite(contacts.masses(self.inverse_masses))

    def _obstacle(self, contacts: Contacts) -> np.ndarray:
        """(c,) the obstacle that each of the contacts is with, NOBODY where that is cloth."""
        obstacle = self.faces.obstacle(contacts)
        if self.pairs is not None:
            of_pairs = contacts.key >= self.faces.last_key
            obstacle[of_pairs] = self.pairs.obstacle(contacts.only(of_pairs))
        return obstacle
