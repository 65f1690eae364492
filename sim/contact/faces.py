"""Where triangles and edges of cloth meet spheres, capsules and boxes between their vertices.

Vertices that keep their distance keep a triangle out of a large smooth obstacle, but not out of a needle, a
small ball or the corner of a box. So triangles are looked at, too, and have contacts of their own where they
come nearer than a part of the thickness: a chord between vertices at the whole of it may cut that deep.

Everything is seen from the obstacle, which is convex. A direction in which all three vertices are beyond its
farthest point sets the two apart, and since vertices go straight, it tells until when. Such a direction is
that between the nearest points, so detection advances from time to time as it does for pairs of cloth
(`sim.contact.impact`), and misses nothing. What is flat has no way between vertices: planes meet these alone.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from sim.compiled import Vec3, add, cross, dot, inner, kernel, norm, put, row, scale, sub
from sim.contact.closest import edge_edge, vertex_triangle
from sim.contact.contacts import NO_CONTACTS, Contacts, make_contacts
from sim.contact.detect import SAME_SIDE, into_frame, turn
from sim.contact.hold import go_at_most
from sim.contact.obstacles import PLANE, ROUNDED, Obstacles, Poses, Shapes, shape_of
from sim.mesh import Mesh, elements

CUT = 0.5
"""Part of the thickness that a chord between vertices may cut away."""

REACH = 0.75
"""Part of the thickness within which a face is felt: one that was let go at CUT would come back at once."""

GAP = 0.1
"""Part of the thickness that continuous detection keeps free on the way."""

AFTER = 2.0
"""Gaps that are left after a triangle has met an obstacle on the way."""

ROOM = 0.25
"""Part of the distance at the start that the gap may be: else what starts near would start in contact."""

NEAR = 2.0
"""A distance of so many gaps is a contact, so that the last jump need not be exact."""

MOST_JUMPS = 64
"""Jumps of continuous detection after which the time reached counts as the time of contact."""

NOBODY, SEVERAL = -1, -2
"""What carries a vertex along that no obstacle does, or more than one would."""

NEARER = 0.5
"""Part of the way to an obstacle that a triangle may go where nothing else helps."""


class Faces:
    """Contacts of the elements of a mesh (`sim.mesh.elements`) with obstacles.

    A step, or a part of one, begins with `begin`; then `hits` and `shorten` are about where it ends.

    Args:
        mesh: The cloth, n vertices.
        free: (n,) bool, which of its vertices can move.
        obstacles: Of the scene.
        first_key: Keys of contacts start here.

    Attributes:
        last_key: The one after their last.
    """

    def __init__(self, mesh: Mesh, free: np.ndarray, obstacles: Obstacles, first_key: int) -> None:
        faces = elements(mesh)
        movable = free[faces].any(axis=1)
        self._free, self._axis, self._movable = free, mesh.axis, int(np.count_nonzero(movable))
        order = np.argsort(~movable, kind="stable")[: None if obstacles.moves.any() else self._movable]
        self._faces = np.ascontiguousarray(faces[order], dtype=np.int32)
        self._first_key, self._room, self._shapes = first_key, 64, len(obstacles.parts)
        self.last_key = first_key + len(self._faces) * len(obstacles.parts)

    def begin(
        self, x: np.ndarray, before: Poses, after: Poses, h: float, thickness: float, shapes: Shapes | None
    ) -> Contacts:
        """Begin a step of h [s] at `x` (n, 3) [m], and find what is nearer than a part of the thickness.

        Only `shapes` are looked at; None stands for no shape.
        """
        self._step = x, before, after, h, thickness
        return self._found(shapes, x, REACH * thickness, CUT * thickness, continuous=False)

    def hits(self, end: np.ndarray, shapes: Shapes | None, part: float = 1.0) -> Contacts:
        """Contacts of what meets one of `shapes` before the vertices are at `end` (n, 3) [m].

        To meet is to come nearer than a `part` of the gap.
        """
        gap = part * GAP * self._step[-1]
        found = self._found(shapes, end, gap, AFTER * gap, continuous=True)
        return found if shapes is None else found.and_also(self._through_planes(shapes, end, gap))

    def obstacle(self, contacts: Contacts) -> np.ndarray:
        """(c,) the obstacle that contacts with one are with, NOBODY for others."""
        one, face = contacts.key < self._first_key, contacts.key - self._first_key
        of_face = np.where(contacts.key < self.last_key, face // max(len(self._faces), 1), NOBODY)
        return np.where(one, contacts.key % max(self._shapes, 1), of_face)

    def along(self, o: int, which: np.ndarray) -> np.ndarray:
        """(k, 3) where the vertices `which` end that go along with obstacle o, as far as they may [m]."""
        x, _, after, *_ = self._step
        places = self._seen_from(o)[which] @ after.rotation[o].T + after.position[o]
        if self._axis is not None:
            places[:, self._axis] = x[which, self._axis]
        return places

    def _seen_from(self, o: int) -> np.ndarray:
        """(n, 3) where the vertices start, in the frame of obstacle o [m]."""
        x, before, *_ = self._step
        return (x - before.position[o]) @ before.rotation[o]

    def carry(
        self, hits: Contacts, obstacle: np.ndarray, rest: np.ndarray, carrier: np.ndarray, held: np.ndarray
    ) -> bool:
        """Let `rest` (n, 3) [m] of the vertices in `hits` be where the obstacle takes what goes along.

        `obstacle` (c,) is the one that each hit is with, or NOBODY: what met there is already `held` (n,)
        bool near where it rests, and goes along with what it meets. `carrier` (n,) is the obstacle that each
        vertex goes along with, NOBODY at first. A vertex that meets several of them is between their jaws: it
        goes with none. Returns whether any goes along that did not.
        """
        before = carrier.copy()
        for c in np.flatnonzero((obstacle == NOBODY) & held[hits.node].all(axis=1)):
            others = np.unique(before[hits.node[c]])
            others = others[others >= 0]
            if len(others):
                self._take(others[0], hits.node[c], rest, carrier)
        for o in np.unique(obstacle[obstacle != NOBODY]):
            if self._moves(o):
                self._take(o, np.unique(hits.node[obstacle == o]), rest, carrier)
        return bool((carrier != before).any())

    def _moves(self, o: int) -> bool:
        """Whether obstacle o moves in this step."""
        _, before, after, *_ = self._step
        return any((a[o] != b[o]).any() for a, b in zip(before, after, strict=True))

    def _take(self, o: int, which: np.ndarray, rest: np.ndarray, carrier: np.ndarray) -> None:
        """Let the vertices `which` that can move go along with obstacle o, unless they do with another."""
        which, x = which[self._free[which]], self._step[0]
        carrier[which] = np.where((carrier[which] == NOBODY) | (carrier[which] == o), o, SEVERAL)
        rest[which] = np.where((carrier[which] == o)[:, None], self.along(o, which), x[which])

    def shorten(self, end: np.ndarray, hits: Contacts, rest: np.ndarray) -> np.ndarray:
        """Let vertices in `hits` go no farther to `end` than they can without meeting what they rest beside.

        That is a part of their distance at the start away from `rest` (n, 3) [m]. Returns the vertices that
        would have gone farther.
        """
        least = np.full(len(end), np.inf)
        np.minimum.at(least, hits.node.ravel(), np.repeat(hits.start, 4))
        which = np.flatnonzero(least < np.inf)
        return go_at_most(rest, end, which, NEARER * least[which])

    def _found(
        self, shapes: Shapes | None, end: np.ndarray, gap: float, keep: float, continuous: bool
    ) -> Contacts:
        if shapes is None or not (len(self._faces) and (shapes.kind == ROUNDED).any()):
            return NO_CONTACTS
        start, before, after, h, _ = self._step
        while True:
            found = make_contacts(self._room)
            faces = self._faces if continuous else self._faces[: self._movable]
            way = shapes, before, after, faces, start, end, h
            count = _sweep(*way, gap, keep, continuous, len(self._faces), found)
            if count <= self._room:
                break
            self._room = count + count // 4
        contacts = found.only(slice(0, count))
        contacts.key[:] += self._first_key
        return contacts

    def _through_planes(self, shapes: Shapes, end: np.ndarray, gap: float) -> Contacts:
        """Contacts of vertices that come nearer than `gap` [m] to a plane before they are at `end` (n, 3)."""
        x, _, after, h, _ = self._step
        found = [NO_CONTACTS]
        for o in np.flatnonzero(shapes.kind == PLANE).tolist():
            start, normal = self._seen_from(o)[:, 2], after.rotation[o][:, 2]
            height = (end - after.position[o]) @ normal
            which = np.flatnonzero((start > 0.0) & (height < np.minimum(gap, ROOM * start)))
            contacts = make_contacts(len(which))
            contacts.key[:], contacts.node[:] = which * self._shapes + o, which[:, None]
            contacts.weight[:, 0], contacts.normal[:] = 1.0, normal
            contacts.start[:], contacts.offset[:] = start[which], normal @ after.position[o]
            contacts.speed[:] = (self.along(o, which) - x[which]) / h
            contacts.thickness[:] = np.minimum(AFTER * gap, start[which])
            found.append(contacts)
        return functools.reduce(Contacts.and_also, found)


@kernel
def _sweep(shapes, before, after, faces, start, end, h, gap, keep, continuous, numbers, found):
    """Fill `found` with contacts; return how many there are, even where there is no room for them.

    Keys leave room for so many `numbers` of faces.
    """
    count = 0
    a, b = np.empty_like(start), np.empty_like(start)
    for o in range(len(shapes.kind)):
        shape = shape_of(shapes, o)
        if shape.kind != ROUNDED:
            continue
        for i in range(len(start)):
            put(a, i, into_frame(before.position[o], before.rotation[o], row(start, i)))
            put(b, i, into_frame(after.position[o], after.rotation[o], row(end, i)))
        for f in range(len(faces)):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            a0, a1, a2, b0, b1, b2 = row(a, i), row(a, j), row(a, k), row(b, i), row(b, j), row(b, k)
            if continuous:
                far = _far(shape, a0, a1, a2, b0, b1, b2, gap)
            else:
                far = _far(shape, a0, a1, a2, a0, a1, a2, gap)
            if far:
                continue
            touches, apart, w, s, n = _meet(shape, a0, a1, a2, b0, b1, b2, gap, continuous)
            if not touches:
                continue
            ahead, p, m, _ = _plane(shape, b0, b1, b2)
            # it slides on, or the obstacle turns below it: if it ends apart, that plane is nearer the truth
            if dot(m, n) > SAME_SIDE and _beyond(shape, m, b0, b1, b2) > 0.0:
                w, s, n = ahead, p, m
            if count < len(found.key):
                _write(found, count, shape, before, after, o, h, w, s, n)
                found.key[count] = o * numbers + f
                found.start[count] = apart
                found.thickness[count] = min(keep, apart) if continuous else keep
                for c in range(4):
                    found.node[count, c] = faces[f, min(c, 2)]
                if j == k:  # an edge, or a vertex
                    found.weight[count, 1] += found.weight[count, 2]
                    found.weight[count, 2] = 0.0
                if i == j:
                    found.weight[count, 0], found.weight[count, 1] = 1.0, 0.0
            count += 1
    return count


@inner
def _write(found, count, shape, before, after, o, h, w, s, n):
    """Weights, speed and plane of a contact at the point s of obstacle o, which is all behind that plane."""
    normal = turn(after.rotation[o], n)
    was = add(turn(before.rotation[o], s), row(before.position, o))
    now = add(turn(after.rotation[o], s), row(after.position, o))
    put(found.normal, count, normal)
    put(found.speed, count, scale(1.0 / h, sub(now, was)))
    found.offset[count] = dot(normal, row(after.position, o)) + _farthest(shape, n)
    for c in range(3):
        found.weight[count, c] = w[c]


@inner
def _far(shape, a0, a1, a2, b0, b1, b2, gap):
    """Whether some direction shows that a triangle stays farther than `gap` on its way from a to b.

    The sides of the box around the shape are tried, then the direction to the middle of the way.
    """
    half, reach = shape.half, shape.radius + gap
    if (
        min(a0.x, a1.x, a2.x, b0.x, b1.x, b2.x) > half.x + reach
        or max(a0.x, a1.x, a2.x, b0.x, b1.x, b2.x) < -half.x - reach
        or min(a0.y, a1.y, a2.y, b0.y, b1.y, b2.y) > half.y + reach
        or max(a0.y, a1.y, a2.y, b0.y, b1.y, b2.y) < -half.y - reach
        or min(a0.z, a1.z, a2.z, b0.z, b1.z, b2.z) > half.z + reach
        or max(a0.z, a1.z, a2.z, b0.z, b1.z, b2.z) < -half.z - reach
    ):
        return True
    middle = scale(1.0 / 6.0, add(add(add(a0, a1), add(a2, b0)), add(b1, b2)))
    n = sub(middle, _clamped(half, middle))
    length = norm(n)
    if not length > 0.0:
        return False
    n = scale(1.0 / length, n)
    return min(_beyond(shape, n, a0, a1, a2), _beyond(shape, n, b0, b1, b2)) > gap


@inner
def _meet(shape, a0, a1, a2, b0, b1, b2, gap, continuous):
    """Whether and how a triangle comes nearer than `gap` on its way from a to b, or starts so.

    Returns:
        Whether it does; the distance at the start [m]; the weights of its nearest point; the shape's, and the
        direction between them. A triangle that is not set apart at the start has no contact: which side it
        should be on cannot be told, and its vertices have contacts.
    """
    w, s, n, apart = _plane(shape, a0, a1, a2)
    if not _beyond(shape, n, a0, a1, a2) > 0.0:
        return False, apart, w, s, n
    if not continuous:
        return apart < gap, apart, w, s, n
    t, distance, own = 0.0, apart, min(gap, ROOM * apart)
    for _ in range(MOST_JUMPS):
        if not distance > NEAR * own:
            break
        reach = dot(n, s) + own
        reached = min(
            _reached(n, a0, b0, reach, t), _reached(n, a1, b1, reach, t), _reached(n, a2, b2, reach, t)
        )
        if reached == math.inf:
            return False, apart, w, s, n
        if not reached > t:
            break
        t = min(reached, 1.0)
        w, s, n, distance = _plane(shape, _between(a0, b0, t), _between(a1, b1, t), _between(a2, b2, t))
    return True, apart, w, s, n


@inner
def _plane(shape, a, b, c):
    """Weights of a triangle's nearest point, the shape's, the direction between them, and the distance."""
    w, core, r = _nearest(shape.half, a, b, c)
    length = norm(r)
    n = scale(1.0 / max(length, 1e-300), r)
    if not _beyond(shape, n, a, b, c) > 0.0:
        n = _axis(shape, n, a, b, c)
    return w, add(core, scale(shape.radius, n)), n, length - shape.radius


@inner
def _axis(shape, n, a, b, c):
    """Whichever of n and the axes of a box and a triangle sets the two farthest apart.

    For where they are all but touching: the difference of the nearest points is then mostly rounding, which a
    long triangle magnifies, but these axes are exact. One of them sets any two apart that do not overlap
    (Gottschalk, Lin and Manocha 1996).
    """
    best, most = n, _beyond(shape, n, a, b, c)
    ab, bc, ca = sub(b, a), sub(c, b), sub(a, c)
    for side in (Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0)):
        for m in (side, cross(side, ab), cross(side, bc), cross(side, ca), cross(ab, ca)):
            length = norm(m)
            for unit in (1.0 / max(length, 1e-300), -1.0 / max(length, 1e-300)):
                beyond = _beyond(shape, scale(unit, m), a, b, c)
                if length > 0.0 and beyond > most:
                    best, most = scale(unit, m), beyond
    return best


@kernel
def overlapping(shapes, o, poses, faces, positions, overlaps):
    """Fill `overlaps` (f,) with whether no direction sets apart elements `faces` (f, 3) and obstacle o."""
    shape = shape_of(shapes, o)
    for f in range(len(faces)):
        a, b, c = (
            into_frame(poses.position[o], poses.rotation[o], row(positions, faces[f, 0])),
            into_frame(poses.position[o], poses.rotation[o], row(positions, faces[f, 1])),
            into_frame(poses.position[o], poses.rotation[o], row(positions, faces[f, 2])),
        )
        if shape.kind == PLANE:
            overlaps[f] = not min(a.z, b.z, c.z) > 0.0
        else:
            overlaps[f] = not _beyond(shape, _plane(shape, a, b, c)[2], a, b, c) > 0.0


@inner
def _beyond(shape, n, p, q, r):
    """How far all of p, q and r are beyond the shape's farthest point in the direction n [m]."""
    return min(dot(n, p), dot(n, q), dot(n, r)) - _farthest(shape, n)


@inner
def _farthest(shape, n):
    """How far the shape reaches in the direction n [m]."""
    half = shape.half
    return abs(n.x) * half.x + abs(n.y) * half.y + abs(n.z) * half.z + shape.radius


@inner
def _reached(n, a, b, reach, t):
    """First time from t on at which the way from a to b is no farther than `reach` along n, or inf."""
    f, g = dot(n, a), dot(n, b)
    if not f + t * (g - f) > reach:
        return t
    return math.inf if g > reach else (f - reach) / (f - g)


@inner
def _between(a, b, t):
    return add(scale(1.0 - t, a), scale(t, b))


@inner
def _clamped(half, p):
    """The point of a box nearest to p."""
    return Vec3(
        min(max(p.x, -half.x), half.x), min(max(p.y, -half.y), half.y), min(max(p.z, -half.z), half.z)
    )


@inner
def _nearest(half, a, b, c):
    """Of a triangle and a box apart: weights of its nearest point, the box's, and their difference.

    One of three pairs is nearest: a vertex and the box, a corner and the triangle, an edge and a side.
    """
    w, s = (1.0, 0.0, 0.0), _clamped(half, a)
    r = sub(a, s)
    p = _clamped(half, b)
    if dot(sub(b, p), sub(b, p)) < dot(r, r):
        w, s, r = (0.0, 1.0, 0.0), p, sub(b, p)
    p = _clamped(half, c)
    if dot(sub(c, p), sub(c, p)) < dot(r, r):
        w, s, r = (0.0, 0.0, 1.0), p, sub(c, p)
    for k in range(8):
        if _twice(half, k):
            continue
        p = _corner(half, k)
        v = vertex_triangle(p, a, b, c)
        q = sub(_at(-v[1], a, -v[2], b, -v[3], c), p)
        if dot(q, q) < dot(r, r):
            w, s, r = (-v[1], -v[2], -v[3]), p, q
        for axis in range(3):
            if k >> axis & 1 or not _side(half, axis) > 0.0:
                continue
            end = _corner(half, k | 1 << axis)
            for side in range(3):
                d, e = (a, b) if side == 0 else (b, c) if side == 1 else (c, a)
                v = edge_edge(p, end, d, e)
                m = add(scale(v[0], p), scale(v[1], end))
                q = sub(add(scale(-v[2], d), scale(-v[3], e)), m)
                if dot(q, q) < dot(r, r):
                    if side == 0:
                        w = (-v[2], -v[3], 0.0)
                    elif side == 1:
                        w = (0.0, -v[2], -v[3])
                    else:
                        w = (-v[3], 0.0, -v[2])
                    s, r = m, q
    return w, s, r


@inner
def _at(u, a, v, b, w, c):
    return add(scale(u, a), add(scale(v, b), scale(w, c)))


@inner
def _side(half, axis):
    return half.x if axis == 0 else half.y if axis == 1 else half.z


@inner
def _corner(half, k):
    """Corner k of a box, whose bits say on which side it is."""
    return Vec3(half.x if k & 1 else -half.x, half.y if k & 2 else -half.y, half.z if k & 4 else -half.z)


@inner
def _twice(half, k):
    """Whether corner k is another one, too, as the box has no length along an axis."""
    return (k & 1 and half.x == 0.0) or (k & 2 and half.y == 0.0) or (k & 4 and half.z == 0.0)
