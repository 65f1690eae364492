"""Contacts: what detection finds and responses act on, of cloth with obstacles and with itself alike.

A contact is a scalar coordinate like a spring's, the gap q = Σ w_i n·x_i − offset over at most four vertices:
one vertex against the plane that an obstacle shows it, a vertex against a triangle, an edge against an edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import dot, inner, kernel, row

EDGEWISE = 0.1
"""Part of a normal below which it does not count as lying in the plane that motion is confined to."""


class Contacts(NamedTuple):
    """c contacts.

    Attributes:
        key: (c,) int64 that names the pair, in every step the same.
        node: (c, 4) int32 vertices; in place of those that a contact does not have are others, which weigh
            nothing: one of its own where it is of a pair.
        weight: (c, 4) w.
        start: (c,) gap at the start of the step [m].
        normal: (c, 3) n, a unit vector along which the gap grows.
        offset: (c,) part of the gap that cloth does not decide, at the end of the step [m].
        speed: (c, 3) velocity of the part that cloth does not decide [m/s].
        thickness: (c,) gap that is to be kept [m].
    """

    key: np.ndarray
    node: np.ndarray
    weight: np.ndarray
    start: np.ndarray
    normal: np.ndarray
    offset: np.ndarray
    speed: np.ndarray
    thickness: np.ndarray

    def gaps(self, positions: np.ndarray) -> np.ndarray:
        """(c,) gap [m] with vertices at `positions` (n, 3) [m]."""
        q = np.empty(len(self.key))
        set_gaps(self, positions, q)
        return q

    def passing(self, velocities: np.ndarray) -> np.ndarray:
        """(c, 3) velocity [m/s] of one side relative to the other."""
        return weighted(self, velocities) - self.speed

    def masses(self, inverse_masses: np.ndarray) -> np.ndarray:
        """(c,) μ [kg], 1/μ = Σ w²/m; infinite where no vertex can move."""
        inverse = np.sum(self.weight**2 * inverse_masses[self.node], axis=1)
        with np.errstate(divide="ignore"):
            return 1.0 / inverse

    def confined(self, axis: int | None, positions: np.ndarray) -> Contacts:
        """The same for vertices that do not move along `axis` from their `positions` (n, 3) [m].

        What the gap owes to that coordinate stays as it is, and the normal is what remains of it, scaled to a
        unit vector together with the gap; a contact of which hardly anything remains is left out.
        """
        if axis is None or not len(self.key):
            return self
        across = self.normal[:, axis]
        rest = np.sqrt(np.maximum(1.0 - across**2, 0.0))
        kept = self.only(rest > EDGEWISE)
        across, rest = across[rest > EDGEWISE], rest[rest > EDGEWISE]
        still = across * weighted(kept, positions)[:, axis]
        normal, speed = kept.normal / rest[:, None], kept.speed.copy()
        normal[:, axis] = speed[:, axis] = 0.0
        return kept._replace(
            start=kept.start / rest,
            normal=normal,
            offset=(kept.offset - still) / rest,
            speed=speed,
            thickness=kept.thickness / rest,
        )

    def only(self, which: np.ndarray | slice) -> Contacts:
        """Those of them that the mask or the indices `which` pick."""
        if not len(self.key):
            return self
        return Contacts(*(array[which] for array in self))

    def joins(self, label: np.ndarray) -> np.ndarray:
        """(k, 2) each two labels, out of those of the vertices (n,), that a contact joins."""
        if not (len(self.key) and label.any()):  # nor where all of the cloth has the label 0
            return np.zeros((0, 2), dtype=label.dtype)
        acts = self.weight != 0.0
        own = label[self.node[np.arange(len(self.node)), acts.argmax(axis=1)]]
        across = acts & (label[self.node] != own[:, None])
        return np.unique(np.column_stack([own[np.nonzero(across)[0]], label[self.node][across]]), axis=0)

    def or_else(self, others: Contacts, lack: np.ndarray, others_lack: np.ndarray) -> Contacts:
        """These, each replaced by that of the `others` with its key, if there is one and it lacks less [m].

        An obstacle is behind each of the planes that it shows a vertex, so to be before one is enough.
        """
        if not len(others.key):
            return self
        twin, known = self.twins(others)
        better = np.flatnonzero(known & (others_lack[twin] < lack))
        mixed = Contacts(*(array.copy() for array in self))
        for array, other in zip(mixed, others, strict=True):
            array[better] = other[twin[better]]
        return mixed

    def twins(self, others: Contacts) -> tuple[np.ndarray, np.ndarray]:
        """(c,) where among the `others`, of which there must be one, the same key is, and whether it is."""
        order = np.argsort(others.key, kind="stable")
        twin = order[np.searchsorted(others.key[order], self.key).clip(0, len(order) - 1)]
        return twin, others.key[twin] == self.key

    def and_also(self, others: Contacts) -> Contacts:
        """These, then `others`."""
        if not len(others.key):
            return self
        if not len(self.key):
            return others
        return Contacts(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))


def make_contacts(c: int) -> Contacts:
    """Room for c contacts."""
    whole, node = np.zeros(c, dtype=np.int64), np.zeros((c, 4), dtype=np.int32)
    one, two, three = np.zeros(c), np.zeros(c), np.zeros(c)
    return Contacts(whole, node, np.zeros((c, 4)), one, np.zeros((c, 3)), two, np.zeros((c, 3)), three)


NO_CONTACTS = make_contacts(0)


NOT_OVER, UNWATCHED = np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
"""`Touch.over` and `Touch.watched` where there are none."""


class Touch(NamedTuple):
    """What contacts remember of the step before, by their keys in ascending order.

    Attributes:
        key: (t,).
        pressed: (t,) normal impulse [N s].
        slip: (t,) speed at which the two sides passed each other after it [m/s].
        lasted: () how long it was [s].
        over: (k, 2) int64 vertices, and obstacles that have run over them (`sim.contact.overrun`).
        watched: (m,) int64 obstacles that all other cloth was kept apart from.
    """

    key: np.ndarray
    pressed: np.ndarray
    slip: np.ndarray
    lasted: np.ndarray
    over: np.ndarray = NOT_OVER
    watched: np.ndarray = UNWATCHED

    def ahead(self, keys: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        """(c,) force [N] that the contacts with these `keys` may go on with for `h` [s], and (c,) their slip.

        An impact that a short step took up is over; it does not push all through a longer one.
        """
        pressed, slip = self.of(keys)
        return pressed / max(h, float(self.lasted)), slip

    def and_also(self, others: Touch) -> Touch:
        """This, and what the `others` remember that it does not, as of contacts that force has not left."""
        others = others.only(~np.isin(others.key, self.key))
        if not len(others.key):
            return self
        if not len(self.key):
            return others._replace(over=self.over, watched=self.watched)
        pressed = others.pressed * (self.lasted / others.lasted)  # by the same force
        both = zip(self[:3], (others.key, pressed, others.slip), strict=True)
        key, pressed, slip = (np.concatenate(pair) for pair in both)
        order = np.argsort(key)
        return self._replace(key=key[order], pressed=pressed[order], slip=slip[order])

    def only(self, which: np.ndarray) -> Touch:
        """Those (t,) bool of them."""
        return self._replace(key=self.key[which], pressed=self.pressed[which], slip=self.slip[which])

    def still(self) -> Touch:
        """The same, with no slip."""
        return self._replace(slip=np.zeros_like(self.slip))

    def of(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(c,) pressed and (c,) slip of the contacts with these `keys`, zero for what is new."""
        if not len(self.key):
            return np.zeros(len(keys)), np.zeros(len(keys))
        place = np.searchsorted(self.key, keys).clip(0, len(self.key) - 1)
        known = self.key[place] == keys
        return np.where(known, self.pressed[place], 0.0), np.where(known, self.slip[place], 0.0)


def groups(count: int, joins: np.ndarray) -> np.ndarray:
    """(count,) a number for each of so many that is the same for all that `joins` (k, 2) join."""
    group = np.arange(count)
    for a, b in joins:
        group[group == group[b]] = group[a]
    return group


UNTOUCHED = Touch(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), np.zeros(()))


def touch(keys: np.ndarray, pressed: np.ndarray, slip: np.ndarray, h: float) -> Touch:
    """What to remember of a step of `h` [s].

    Where a pair has several contacts, that is the sum of what they pressed by and the largest slip.
    """
    if not len(keys):
        return UNTOUCHED._replace(lasted=np.array(h))
    unique, place = np.unique(keys, return_inverse=True)
    most = np.zeros(len(unique))
    np.maximum.at(most, place, slip)
    return Touch(unique, np.bincount(place, pressed, len(unique)), most, np.array(h))


@kernel
def set_gaps(contacts, positions, q):
    """Fill q = Σ w n·x − offset [m]."""
    for c in range(len(q)):
        q[c] = -lack_of(contacts, positions, c, 0.0)


@inner
def lack_of(contacts, positions, c, target):
    """How far the gap of contact c at `positions` (n, 3) is short of `target` [m]."""
    n, lack = row(contacts.normal, c), target + contacts.offset[c]
    for a in range(4):
        if contacts.weight[c, a] != 0.0:
            lack -= contacts.weight[c, a] * dot(n, row(positions, contacts.node[c, a]))
    return lack


def along(normals: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(c,) n·a of each row."""
    return np.einsum("ij,ij->i", normals, vectors)


def weighted(contacts: Contacts, vectors: np.ndarray) -> np.ndarray:
    """(c, 3) Σ w_i a_i over each contact's vertices."""
    return np.einsum("ij,ijk->ik", contacts.weight, vectors[contacts.node])
