"""Continuous detection: the first time at which two primitives of cloth meet, on straight paths.

Directional conservative advancement. Take the unit vector n between the nearest points and project every
pair of a vertex of one primitive and a vertex of the other on it: while all projections exceed a gap, the
primitives are farther apart than that. Each projection is linear in time, so jump to the first time at
which one reaches the gap, and repeat there. Where none does before the end, the pair misses.

A pair that turns as it moves would need thousands of such jumps. From the third on, n also turns: it is the
product of the two edges that it is square to, so it stays square to them. Each projection is then a cubic in
time, which the hull of its Bézier control points bounds. Simple roots are approached quadratically, grazes
geometrically, and what turns close by for long is passed in a few jumps.

No contact is missed, and none is found late, by construction: whatever n is, the way jumped over is free. A
poor n costs another jump, and where none leads on, the time reached is the answer. Coplanar, parallel and
degenerate pairs are no special cases. Not promised: a hit is a distance of at most twice the gap, so a pair
that passes closer than that without touching is one, too.

Compare conservative advancement (Mirtich 1996; Zhang, Lee, Kim 2006), which bounds the motion along n, and
additive CCD (Li, Kaufman, Jiang 2021), which jumps by distance over speed.
"""

from __future__ import annotations

import math

from sim.compiled import Vec3, add, cross, dot, inner, scale, sub
from sim.contact.closest import edge_edge, separation, vertex_triangle

VERTEX_TRIANGLE = 0
EDGE_EDGE = 1

ROUNDING = 2.0**-47
"""Least gap as a part of the pair's size, the largest difference of a coordinate between two of its vertices
at the start or the end. Projections, and the jumps made of them, are off by less than two thirds of it."""

NEAR = 2.0
"""A distance of up to so many gaps is a contact, so that the last jump need not be exact."""

STRAIGHT = 2
"""Jumps before n turns: nearly all misses need one, and most hits along a fixed n two."""

WINDOW = 2.0
"""How far ahead a turning n is tried at first, in jumps along a fixed n."""

PARALLEL = 1e-20
"""Squared sine of the angle of two edges below which their product is mostly rounding."""


@inner
def impact(kind, a0, a1, a2, a3, b0, b1, b2, b3, gap, most):
    """Earliest time in [0, 1] at which a pair touches, or inf; with its normal and weights there.

    `kind` is VERTEX_TRIANGLE of vertex 0 and triangle 1, 2, 3, or EDGE_EDGE of 0, 1 and 2, 3; a0 … a3 are
    their places [m] at time 0, b0 … b3 at time 1. `gap` is the distance [m] to keep; where that is less than
    rounding needs, what it needs is kept. After `most` jumps the time reached counts as contact.

    Returns:
        The time; a unit vector n; the weights w of the nearest points then (`sim.contact.closest`).
        Until the time the distance is at least `gap`; at it, it is no more than NEAR times that, unless
        jumps ran out or, of a degenerate pair, no direction led on. A pair as near as that from the start
        has the time 0. n is the direction in which the pair was last seen apart, so that n · Σ wᵢ xᵢ > 0;
        if it touches from the start, n is square to it.
    """
    p1, p2, p3, q1, q2, q3 = sub(a1, a0), sub(a2, a0), sub(a3, a0), sub(b1, b0), sub(b2, b0), sub(b3, b0)
    gap = max(gap, ROUNDING * max(_size(p1), _size(p2), _size(p3), _size(q1), _size(q2), _size(q3)))
    t, window = 0.0, WINDOW
    x1, x2, x3 = p1, p2, p3
    w, r = _nearest(kind, x1, x2, x3)
    n = _normal(kind, w, r, x1, x2, x3)
    for jumps in range(most):
        if not dot(r, r) > (NEAR * gap) * (NEAR * gap):
            return t, n, w
        if jumps > 0:
            n = _normal(kind, w, r, x1, x2, x3)
        reached = _straight(kind, n, p1, p2, p3, q1, q2, q3, t, gap)
        if jumps >= STRAIGHT and reached < math.inf:
            end = min(t + window * (reached - t), 1.0)
            y1, y2, y3 = _between(p1, q1, end), _between(p2, q2, end), _between(p3, q3, end)
            part = _turning(kind, w, r, x1, x2, x3, y1, y2, y3, gap)
            if part > 1.0:
                window *= 4.0
            elif part < 0.25:
                window = max(0.5 * window, WINDOW)
            reached = max(reached, math.inf if part > 1.0 and end == 1.0 else t + min(part, 1.0) * (end - t))
        if not reached > t:
            reached = _any(kind, r, x1, x2, x3, p1, p2, p3, q1, q2, q3, t, gap)
        if reached == math.inf:
            return reached, n, w
        if not reached > t:
            return t, n, w
        t = min(reached, 1.0)
        x1, x2, x3 = _between(p1, q1, t), _between(p2, q2, t), _between(p3, q3, t)
        w, r = _nearest(kind, x1, x2, x3)
    return t, n, w


@inner
def _nearest(kind, x1, x2, x3):
    """Weights of the nearest points, and their separation; here and below the vertex 0 is the origin."""
    origin = Vec3(0.0, 0.0, 0.0)
    w = vertex_triangle(origin, x1, x2, x3) if kind == VERTEX_TRIANGLE else edge_edge(origin, x1, x2, x3)
    return w, separation(w, origin, x1, x2, x3)


@inner
def _inside(w):
    """Inside how many edges the nearest points lie; two as well where one lies inside the triangle."""
    return (w[0] != 0.0) + (w[1] != 0.0) + (w[2] != 0.0) + (w[3] != 0.0) - 2


@inner
def _sides(kind, w, x1, x2, x3):
    """Two vectors that give the direction between the nearest points, by which of their weights are zero.

    Inside two edges, these; inside one, it and the difference of the vertex and an end of it; otherwise any
    edge and the difference of the two vertices.
    """
    if kind == VERTEX_TRIANGLE:
        if w[1] != 0.0 and w[2] != 0.0 and w[3] != 0.0:
            return sub(x2, x1), sub(x3, x1)
        if w[3] == 0.0:
            return sub(x2, x1), scale(-1.0, x1 if w[1] != 0.0 else x2)
        if w[2] == 0.0:
            return sub(x3, x1), scale(-1.0, x1 if w[1] != 0.0 else x3)
        return sub(x3, x2), scale(-1.0, x2)
    first, second = w[0] != 0.0 and w[1] != 0.0, w[2] != 0.0 and w[3] != 0.0
    if first and second:
        return x1, sub(x3, x2)
    c = x2 if w[2] != 0.0 else x3
    return x1 if first else sub(x3, x2), scale(-1.0, c) if w[0] != 0.0 else sub(x1, c)


@inner
def _normal(kind, w, r, x1, x2, x3):
    """Unit vector along the separation r, of the sides: they are exact where r is all rounding."""
    u, v = _sides(kind, w, x1, x2, x3)
    inside = _inside(w)
    if inside == 2:
        n = cross(u, v)
        if not dot(n, n) > PARALLEL * dot(u, u) * dot(v, v):
            n = cross(cross(u, r), u)
        n, e = _unit(n), _unit(u)
        n = sub(n, scale(dot(n, e), e))
    elif inside == 1:
        n = cross(cross(u, v), u)
    else:
        n = v
    if not dot(n, n) > 0.0:
        n = r
    return _towards(r, _unit(n))


@inner
def _towards(r, n):
    """Whichever of n and −n points along r."""
    return n if dot(n, r) >= 0.0 else scale(-1.0, n)


@inner
def _unit(a):
    """A / |a|, or zero."""
    square = dot(a, a)
    return scale(1.0 / math.sqrt(square), a) if square > 0.0 else a


@inner
def _straight(kind, n, p1, p2, p3, q1, q2, q3, t, gap):
    """First time from t on when a projection on n is at most the gap, or inf; p are at time 0, q at 1."""
    f1, f2, f3 = dot(n, p1), dot(n, p2), dot(n, p3)
    g1, g2, g3 = dot(n, q1), dot(n, q2), dot(n, q3)
    if kind == VERTEX_TRIANGLE:
        return min(_reached(-f1, -g1, t, gap), _reached(-f2, -g2, t, gap), _reached(-f3, -g3, t, gap))
    return min(
        _reached(-f2, -g2, t, gap),
        _reached(-f3, -g3, t, gap),
        _reached(f1 - f2, g1 - g2, t, gap),
        _reached(f1 - f3, g1 - g3, t, gap),
    )


@inner
def _reached(f, g, t, gap):
    """First time from t on at which the way from f at time 0 to g at time 1 is at most the gap, or inf."""
    if not f + t * (g - f) > gap:
        return t
    if g > gap:
        return math.inf
    return (f - gap) / (f - g)


@inner
def _any(kind, r, x1, x2, x3, p1, p2, p3, q1, q2, q3, t, gap):
    """Farthest jump from t along any direction square to two edges, or to one and through a vertex.

    For a vertex that lands on a side, say: the direction between them is rounding, the triangle's normal not.
    """
    farthest = t
    for k in range(1 if kind == VERTEX_TRIANGLE else 0, 5):
        w = (float(k), k - 1.0, k - 2.0, k - 3.0)
        n = _normal(kind, w, r, x1, x2, x3)
        farthest = max(farthest, _straight(kind, n, p1, p2, p3, q1, q2, q3, t, gap))
    return farthest


@inner
def _turning(kind, w, r, x1, x2, x3, y1, y2, y3, gap):
    """Part of the way from x to y on which no projection on a turning n reaches the gap, or inf if all of it.

    n is quadratic in time with control points n0, n1, n2, of which the longest is made one: so |n| ≤ 1.
    """
    u, v = _sides(kind, w, x1, x2, x3)
    s, t = _sides(kind, w, y1, y2, y3)
    inside = _inside(w)
    if inside == 0:
        n0 = _unit(v)
        n2 = _towards(n0, _unit(t))
        n1 = scale(0.5, add(n0, n2))
    else:
        if inside == 1:  # square to the edge and, at either end, to what is square to edge and difference
            k = _unit(cross(u, v))
            u, v, s, t = k, u, _towards(k, _unit(cross(s, t))), s
        n0, n1, n2 = cross(u, v), scale(0.5, add(cross(u, t), cross(s, v))), cross(s, t)
    longest = math.sqrt(max(dot(n0, n0), dot(n1, n1), dot(n2, n2)))
    if not longest > 0.0:
        return 0.0
    unit = 1.0 / longest if dot(n0, r) >= 0.0 else -1.0 / longest
    n0, n1, n2 = scale(unit, n0), scale(unit, n1), scale(unit, n2)
    a1, b1, c1, d1 = _cubic(n0, n1, n2, x1, y1)
    a2, b2, c2, d2 = _cubic(n0, n1, n2, x2, y2)
    a3, b3, c3, d3 = _cubic(n0, n1, n2, x3, y3)
    if kind == VERTEX_TRIANGLE:
        return min(
            _above(-a1, -b1, -c1, -d1, gap), _above(-a2, -b2, -c2, -d2, gap), _above(-a3, -b3, -c3, -d3, gap)
        )
    return min(
        _above(-a2, -b2, -c2, -d2, gap),
        _above(-a3, -b3, -c3, -d3, gap),
        _above(a1 - a2, b1 - b2, c1 - c2, d1 - d2, gap),
        _above(a1 - a3, b1 - b3, c1 - c3, d1 - d3, gap),
    )


@inner
def _cubic(n0, n1, n2, x, y):
    """Bézier control points of n · (the way from x to y)."""
    b, c = dot(n0, y) + 2.0 * dot(n1, x), 2.0 * dot(n1, y) + dot(n2, x)
    return dot(n0, x), b / 3.0, c / 3.0, dot(n2, y)


@inner
def _above(a, b, c, d, gap):
    """Part of the way on which the hull of control points at 0, ⅓, ⅔ and 1 exceeds the gap, or inf.

    It first meets the gap on a line from a point above to a later one that is not, whichever comes first.
    """
    a, b, c, d = a - gap, b - gap, c - gap, d - gap
    if not a > 0.0:
        return 0.0
    part = min(_crossing(0.0, a, 1.0, b), _crossing(0.0, a, 2.0, c), _crossing(0.0, a, 3.0, d))
    if b > 0.0:
        part = min(part, _crossing(1.0, b, 2.0, c), _crossing(1.0, b, 3.0, d))
    if c > 0.0:
        part = min(part, _crossing(2.0, c, 3.0, d))
    return part


@inner
def _crossing(i, a, j, b):
    """Where the line from the i-th control point a > 0 to the j-th, b, is zero, or inf."""
    return math.inf if b > 0.0 else (i + (j - i) * (a / (a - b))) / 3.0


@inner
def _between(a, b, t):
    """The place at time t on the way from a to b; exactly a and b at its ends."""
    s = 1.0 - t
    return Vec3(s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z)


@inner
def _size(a):
    return max(abs(a.x), abs(a.y), abs(a.z))
