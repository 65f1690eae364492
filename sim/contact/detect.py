"""Which vertices touch which obstacle in a step, and the plane that the obstacle shows each of them.

Mesh obstacles are not met here but as pairs of features (`sim.contact.pairs`).

Static detection looks at the start of the step only. Continuous detection follows each vertex, in the
obstacle's own frame, from its start to where it is predicted to go. The distance to a convex shape is a
convex function along a line, so Newton's method from the start approaches the first contact and never
passes it.
"""

from __future__ import annotations

import numpy as np

from sim.compiled import Vec3, add, dot, inner, kernel, put, row, scale, sub
from sim.contact.contacts import Contacts, make_contacts
from sim.contact.obstacles import MESH, Poses, Shapes, shape_of, signed_distance

NEAR = 1e-3
"""A vertex this part of the thickness short of contact counts as touching."""

MOST_ADVANCES = 50
"""Newton steps after which the place reached counts as the contact: never too late, as each one is safe."""


SAME_SIDE = 0.5
"""Least cosine of the normals where a vertex touches and where it goes, for the latter to be used."""


def detect(
    shapes: Shapes,
    before: Poses,
    after: Poses,
    start: np.ndarray,
    end: np.ndarray,
    free: np.ndarray,
    h: float,
    thickness: float,
    continuous: bool,
) -> Contacts:
    """Contacts closer than `thickness` [m] of vertices on their way from `start` to `end`, both (n, 3) [m].

    Obstacles move from the poses `before` to those `after` in the time `h` [s]; fixed vertices touch nothing.
    """
    room = make_contacts(len(start) * len(shapes.kind))
    count = _sweep(shapes, before, after, start, end, free, h, thickness, continuous, room)
    return room.only(slice(0, count))


@kernel
def _sweep(shapes, before, after, start, end, free, h, thickness, continuous, found):
    count = 0
    for i in range(len(start)):
        if not free[i]:
            continue
        for o in range(len(shapes.kind)):
            shape = shape_of(shapes, o)
            if shape.kind == MESH:
                continue
            a = into_frame(before.position[o], before.rotation[o], row(start, i))
            b = into_frame(after.position[o], after.rotation[o], row(end, i))
            at_start = signed_distance(shape, a)[0]
            touches, c = _first_contact(shape, a, b, thickness, continuous)
            if not touches:
                continue
            distance, n = signed_distance(shape, c)
            ahead, m = signed_distance(shape, b)
            if dot(m, n) > SAME_SIDE:  # the vertex slides on: the plane where it is going is nearer the truth
                c, distance, n = b, ahead, m
            normal = turn(after.rotation[o], n)
            was = add(turn(before.rotation[o], c), row(before.position, o))
            now = add(turn(after.rotation[o], c), row(after.position, o))
            speed = scale(1.0 / h, sub(now, was))
            found.key[count] = i * len(shapes.kind) + o
            found.node[count, 0], found.weight[count, 0] = i, 1.0
            found.start[count], found.thickness[count] = at_start, thickness
            put(found.normal, count, normal)
            found.offset[count] = dot(normal, now) - distance
            put(found.speed, count, speed)
            count += 1
    return count


@inner
def _first_contact(shape, a, b, thickness, continuous):
    """Whether the way from a to b comes within `thickness`, and the first point that does."""
    if signed_distance(shape, a)[0] < thickness:
        return True, a
    if not continuous:
        return False, a
    way, t, c = sub(b, a), 0.0, a
    for _ in range(MOST_ADVANCES):
        distance, n = signed_distance(shape, c)
        approach = -dot(n, way)
        if distance - thickness < NEAR * thickness:
            return True, c
        if not distance - thickness <= (1.0 - t) * approach:
            return False, c
        t += (distance - thickness) / approach
        c = add(a, scale(t, way))
    return True, c


@inner
def into_frame(position, rotation, p):
    """Rᵀ (p − position)."""
    x, y, z = p.x - position[0], p.y - position[1], p.z - position[2]
    r = rotation
    return Vec3(
        r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
        r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
        r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
    )


@inner
def turn(rotation, p):
    """R p."""
    r = rotation
    return Vec3(
        r[0, 0] * p.x + r[0, 1] * p.y + r[0, 2] * p.z,
        r[1, 0] * p.x + r[1, 1] * p.y + r[1, 2] * p.z,
        r[2, 0] * p.x + r[2, 1] * p.y + r[2, 2] * p.z,
    )


@kernel
def deepest(shapes, poses, positions, depths):
    """Fill depths (n,) with how far each vertex is inside any obstacle [m], zero where it is in none."""
    for i in range(len(positions)):
        depths[i] = 0.0
        for o in range(len(shapes.kind)):
            shape = shape_of(shapes, o)
            if shape.kind == MESH:
                continue
            local = into_frame(poses.position[o], poses.rotation[o], row(positions, i))
            depths[i] = max(depths[i], -signed_distance(shape, local)[0])
