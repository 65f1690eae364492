"""Which contacts a surface has where it goes on: those square to it, and none with parts beside the nearest.

The nearest points of a pair may lie at the border of a triangle or at the end of an edge, as if the surface
ended there. Where it goes on, what lies beyond is nearer, unless the normal is in the normal cone of either
feature: no way along its surface comes nearer. A contact outside of one is slanted, and as its plane stays
for all of a step, it would be a ramp to what slides by (compare the offset blocks of Chen et al. 2025).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import dot, inner, kernel, norm, row, scale, sub

SLANT = 0.01
"""Sine of the angle by which a normal may be outside of a cone. With five times as much, a flat mesh still is
a ramp now and then; with a tenth of it contacts in creases come and go, and a tight knot slips (measured)."""


class Around(NamedTuple):
    """The elements at each vertex.

    Attributes:
        faces: (f, 3) as of `sim.contact.surface.Surface`.
        first: (n + 1,) where those of each vertex begin in `element`.
        element: (3 f,) indices of elements.
    """

    faces: np.ndarray
    first: np.ndarray
    element: np.ndarray


def around(faces: np.ndarray, n: int) -> Around:
    """Of `faces` (f, 3) on n vertices."""
    corner = faces.ravel()
    first = np.append(0, np.cumsum(np.bincount(corner, minlength=n)))
    return Around(faces, first, np.argsort(corner, kind="stable") // 3)


@kernel
def in_cones(around, node, weight, normal, positions):
    """(c,) bool, whether each normal (c, 3), toward positive weights, is in the cones of both its features.

    Where nearest points lie within a triangle, within two edges, or within an edge that no triangle has, the
    normal is square to what is there, and the pair always counts: at a crease nothing else may hold.
    """
    found = np.ones(len(node), dtype=np.bool_)
    for c in range(len(node)):
        above = _nearest(node, weight, c, 1.0)
        below = _nearest(node, weight, c, -1.0)
        if above[2] + below[2] == 4 or _is_bare(around, above) or _is_bare(around, below):
            continue
        up = row(normal, c)
        down = scale(-1.0, up)
        found[c] = _in_cone(around, above, up, positions) and _in_cone(around, below, down, positions)
    return found


@inner
def _nearest(node, weight, c, side):
    """The first two vertices of one side of pair c that weigh something, and how many do."""
    one, other, count = -1, -1, 0
    for a in range(4):
        if side * weight[c, a] > 0.0:
            other = node[c, a] if count == 1 else other
            one = node[c, a] if count == 0 else one
            count += 1
    return one, other, count


@inner
def _is_bare(around, nearest):
    """Whether the nearest point of a side lies within an edge that no triangle has."""
    one, other, count = nearest
    if count != 2:
        return False
    for k in range(around.first[one], around.first[one + 1]):
        i, j, m = row(around.faces, around.element[k])
        if other in (i, j, m) and j != m:
            return False
    return True


@inner
def _in_cone(around, nearest, n, positions):
    """Whether no way along the surface of a side leads against `n`, nearer to the other side."""
    one, other, count = nearest
    p = row(positions, one)
    along = sub(row(positions, other), p) if count == 2 else n
    for k in range(around.first[one], around.first[one + 1]):
        i, j, m = row(around.faces, around.element[k])
        if count == 2 and other not in (i, j, m):
            continue
        for corner in (i, j, m):
            if corner in (one, other):
                continue
            way = sub(row(positions, corner), p)
            if count == 2:
                way = sub(way, scale(dot(way, along) / max(dot(along, along), 1e-300), along))
            if dot(n, way) < -SLANT * norm(way):
                return False
    return True
