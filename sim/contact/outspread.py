"""Cloth that, seen from one side, nowhere covers itself cannot meet itself: a proof that needs no pairs.

Where along one direction every triangle of a sheet shows the same face, the sheet's shadow on the plane
across it is wound one way all over, and goes round each point as often as the shadow of its border does. If
that border is one loop that does not meet itself, it goes round no point twice: the shadow is a plane mesh
without overlap. (Volino and Magnenat-Thalmann 1994; their two conditions, normals in a cone and a contour
that does not cross itself, are these.)

Here it also says how far features are apart. In a plane mesh without overlap the way from a vertex to
anything that it is no corner of leaves the triangles around the vertex through the side opposite to it, so
that it is no shorter than one of their altitudes; or, from a vertex of the border, it leaves the sheet and
comes in again elsewhere, and is no shorter than two border edges without a common vertex are apart. Two edges
that do not cross are nearest at an end of one. And nothing is nearer in space than its shadows are.

On a straight way all shadows move along straight lines. Twice a triangle's area is then a polynomial of
degree two in time, nowhere less than the least of its three Bernstein coefficients, and its sides are nowhere
longer than at one end; what a fixed direction tells apart at both ends it tells apart all along. So the proof
holds for the whole way, however far cloth goes, for about the price of looking at each triangle once.

What it does not prove: that cloth with a fold in it, of several pieces, or with holes, does not meet itself.
"""

from __future__ import annotations

import numpy as np

from sim.compiled import Vec3, add, cross, dot, inner, kernel, norm, row, scale, sub
from sim.mesh import Mesh, bare_edges

MARGIN = 1e-9
"""Part of a length that rounding may have taken off it, and far more than it does."""


def border_of(mesh: Mesh) -> np.ndarray | None:
    """(b,) int32 the vertices around the cloth's border, in order; None unless it is one sheet with one loop.

    That is: there is nothing but triangles, each side is of one or of two that are wound alike, and those of
    one make a single loop of at least four edges that comes to no vertex twice.
    """
    n, t = len(mesh.vertices), mesh.triangles.astype(np.int64)
    if not len(t) or len(bare_edges(mesh)) or len(np.unique(t)) < n:
        return None
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    forth, back = sides @ [n, 1], sides @ [1, n]
    if len(np.unique(forth)) < len(forth):  # of two that are not wound alike, or of three
        return None
    start, end = sides[~np.isin(forth, back)].T
    if len(start) < 4 or len(np.unique(start)) < len(start):
        return None
    following = dict(zip(start.tolist(), end.tolist(), strict=True))
    loop = [int(start[0])]
    while (vertex := following[loop[-1]]) != loop[0]:
        loop.append(vertex)
    return np.array(loop, dtype=np.int32) if len(loop) == len(start) else None


@kernel
def clearance(triangles, border, places, after, room):
    """What no two features without a common vertex come within on the way [m]; 0 where nothing is proven.

    Args:
        triangles: (m, 3) of a sheet.
        border: (b,) of it, as `border_of` has it.
        places: (n, 3) at the start of the way [m].
        after: (n, 3) at its end [m].
        room: What is of no use [m]: no more than that is as good as nothing.
    """
    normal = Vec3(0.0, 0.0, 0.0)
    for k in range(len(border)):  # twice a surface's area vector is that of any other with the same border
        i, j = border[k], border[(k + 1) % len(border)]
        normal = add(normal, cross(_from_first(places, i), _from_first(places, j)))
        normal = add(normal, cross(_from_first(after, i), _from_first(after, j)))
    size = norm(normal)
    if not size > 0.0:
        return 0.0
    one, other = _across(scale(1.0 / size, normal))
    shadows, wild = np.empty((len(places), 4)), 0.0
    for i in range(len(places)):
        start, end = _from_first(places, i), _from_first(after, i)
        shadows[i, 0], shadows[i, 1] = dot(one, start), dot(other, start)
        shadows[i, 2], shadows[i, 3] = dot(one, end), dot(other, end)
        wild += 0.0 * (norm(start) + norm(end))  # not a number where one is none, which min and max may lose
    least = np.inf
    for f in range(len(triangles)):
        altitude = _altitude(shadows, triangles, f) + wild
        if not altitude > room:
            return 0.0
        least = min(least, altitude)
    return _apart(shadows, border, room, least)


@inner
def _from_first(x, i):
    return sub(row(x, i), row(x, 0))


@inner
def _across(normal):
    """Two directions that make a right-handed frame with a third (Duff et al. 2017)."""
    sign = 1.0 if normal.z >= 0.0 else -1.0
    a = -1.0 / (sign + normal.z)
    b = normal.x * normal.y * a
    one = Vec3(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x)
    return one, Vec3(b, sign + normal.y * normal.y * a, -normal.y)


@inner
def _altitude(shadows, triangles, f):
    """What all altitudes of a triangle's shadow are above all along; negative where it is ever wound back."""
    i, j, k = triangles[f, 0], triangles[f, 1], triangles[f, 2]
    ax, ay = shadows[j, 0] - shadows[i, 0], shadows[j, 1] - shadows[i, 1]
    bx, by = shadows[k, 0] - shadows[i, 0], shadows[k, 1] - shadows[i, 1]
    cx, cy = shadows[j, 2] - shadows[i, 2], shadows[j, 3] - shadows[i, 3]
    dx, dy = shadows[k, 2] - shadows[i, 2], shadows[k, 3] - shadows[i, 3]
    start, end = ax * by - ay * bx, cx * dy - cy * dx
    middle = 0.5 * (ax * dy - ay * dx + cx * by - cy * bx)
    square = max(ax * ax + ay * ay, bx * bx + by * by, (bx - ax) ** 2 + (by - ay) ** 2)
    square = max(square, cx * cx + cy * cy, dx * dx + dy * dy, (dx - cx) ** 2 + (dy - cy) ** 2)
    longest = np.sqrt(square)
    return min(start, end, middle) / longest - MARGIN * longest


@inner
def _apart(shadows, border, room, least):
    """How far apart border edges without a common vertex stay, or `least` [m] if less; 0 if not `room`."""
    b = len(border)
    boxes = np.empty((b, 4))
    for k in range(b):
        i, j = border[k], border[(k + 1) % b]
        for r in range(2):
            boxes[k, r] = min(shadows[i, r], shadows[i, r + 2], shadows[j, r], shadows[j, r + 2])
            boxes[k, r + 2] = max(shadows[i, r], shadows[i, r + 2], shadows[j, r], shadows[j, r + 2])
    for k in range(2, b):
        for m in range(1 if k == b - 1 else 0, k - 1):
            aside = max(boxes[k, 0] - boxes[m, 2], boxes[m, 0] - boxes[k, 2])
            if max(aside, boxes[k, 1] - boxes[m, 3], boxes[m, 1] - boxes[k, 3]) <= least:
                apart = _edges_apart(shadows, border, k, m)
                if not apart > room:
                    return 0.0
                least = min(least, apart)
    return least


@inner
def _edges_apart(shadows, border, k, m):
    """How far the direction between their middles tells two border edges' shadows apart all along."""
    a, b = border[k], border[(k + 1) % len(border)]
    c, d = border[m], border[m + 1]
    x = y = 0.0
    for r in (0, 2):
        x += shadows[a, r] + shadows[b, r] - shadows[c, r] - shadows[d, r]
        y += shadows[a, r + 1] + shadows[b, r + 1] - shadows[c, r + 1] - shadows[d, r + 1]
    size, least = np.sqrt(x * x + y * y), np.inf
    if not size > 0.0:
        return 0.0
    for r in (0, 2):
        near = min(x * shadows[a, r] + y * shadows[a, r + 1], x * shadows[b, r] + y * shadows[b, r + 1])
        far = max(x * shadows[c, r] + y * shadows[c, r + 1], x * shadows[d, r] + y * shadows[d, r + 1])
        least = min(least, (near - far) / size)
    return least - MARGIN * size
