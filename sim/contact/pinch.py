"""Where obstacles leave cloth less room than it should have from each of them: a pinch.

Contacts that ask for more than there is would push back and forth. So what they keep is taken from the room
that there is: a share for each side and for layers in between; and where obstacles overlap, cloth stays
halfway inside both, goes along with them, and comes out as they part.
"""

from __future__ import annotations

import numpy as np

from sim.compiled import dot, inner, kernel, row
from sim.contact.contacts import Contacts

OPPOSITE = -0.8
"""Cosine of two normals below which the room between their planes counts: cloth slips out of wider wedges."""

SHARES = 4.0
"""Parts that the room is split into: enough for a layer, and for two more."""


def fit(contacts: Contacts, positions: np.ndarray) -> tuple[Contacts, int]:
    """The same contacts with no more thickness than obstacles leave room for.

    Args:
        contacts: Of cloth with obstacles, and with itself.
        positions: (n, 3) about where vertices will be at the end of the step [m].

    Returns:
        The contacts, and how many vertices are pinched.
    """
    if not len(contacts.key):
        return contacts, 0
    room = np.full(len(positions), np.inf)
    find_room(contacts, positions, room)
    pinched = room < np.inf
    if not pinched.any():
        return contacts, 0
    room = np.where(room > 0.0, room / SHARES, room / 2.0)
    least = np.where(contacts.weight != 0.0, room[contacts.node], np.inf).min(axis=1)
    return contacts._replace(thickness=np.minimum(contacts.thickness, least)), int(np.count_nonzero(pinched))


@kernel
def find_room(contacts, positions, room):
    """Lower `room` (n,) [m] to the least distance between obstacles that face each other across a vertex.

    Only where it is less than the contacts ask for.
    """
    last = np.full(len(positions), -1, dtype=np.int64)
    before = np.empty(len(contacts.key), dtype=np.int64)
    for c in range(len(contacts.key)):
        i = _alone(contacts, c)
        if i < 0:
            continue
        n, p = row(contacts.normal, c), row(positions, i)
        other = last[i]
        while other >= 0:
            m = row(contacts.normal, other)
            if dot(n, m) < OPPOSITE:
                between = dot(n, p) - contacts.offset[c] + dot(m, p) - contacts.offset[other]
                if between < SHARES * max(contacts.thickness[c], contacts.thickness[other]):
                    room[i] = min(room[i], between)
            other = before[other]
        before[c] = last[i]
        last[i] = c


@inner
def _alone(contacts, c):
    """The vertex that contact c is of, or −1 where it is of several: these may go round a thin obstacle."""
    for a in range(4):
        if contacts.weight[c, a] == 1.0:
            for b in range(4):
                if b != a and contacts.weight[c, b] != 0.0:
                    return -1
            return contacts.node[c, a]
    return -1
