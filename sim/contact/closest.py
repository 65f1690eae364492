"""Where two primitives of cloth are nearest: a vertex and a triangle, or two edges.

The pair is written as four signed weights w, one for each vertex, so that the separation is Σ wᵢ xᵢ: for a
vertex and a triangle (1, −β₁, −β₂, −β₃), for two edges (1 − s, s, −(1 − t), −t). The points are those of the
primitives, not of the plane or lines that hold them, and a weight that a side or end clamps is exactly zero.
Whatever the rounding, each half of the weights sums to one within an ulp or two: the points found lie on
the primitives, and where those are almost degenerate they are at worst not quite the nearest.

Coordinates may be between 1e-70 and 1e70 in size; beyond, their products leave float64.

Regions of the triangle and clamping of edges after Ericson (2005, Real-Time Collision Detection, §5.1).
"""

from __future__ import annotations

from sim.compiled import Vec3, add, cross, dot, inner, scale, sub

THIN = 1e-8
"""Squared sine of an angle below which a triangle's sides, or two edges, are also taken for parallel."""


@inner
def separation(w, x0, x1, x2, x3):
    """Σ wᵢ xᵢ: from the second primitive's nearest point to the first's [m]."""
    return Vec3(
        w[0] * x0.x + w[1] * x1.x + w[2] * x2.x + w[3] * x3.x,
        w[0] * x0.y + w[1] * x1.y + w[2] * x2.y + w[3] * x3.y,
        w[0] * x0.z + w[1] * x1.z + w[2] * x2.z + w[3] * x3.z,
    )


@inner
def vertex_triangle(p, a, b, c):
    """Weights (1, −β₁, −β₂, −β₃) of the vertex p and the point of triangle abc nearest to it."""
    ab, ac, ap = sub(b, a), sub(c, a), sub(p, a)
    normal = cross(ab, ac)
    area = dot(normal, normal)
    v, w = dot(normal, cross(ap, ac)), dot(normal, cross(ab, ap))
    u = area - v - w
    best, weights = -1.0, (1.0, -1.0, 0.0, 0.0)
    if u > 0.0 and v > 0.0 and w > 0.0:
        v, w = v / area, w / area
        weights = (1.0, -(1.0 - v - w), -v, -w)
        if area > THIN * dot(ab, ab) * dot(ac, ac):
            return weights
        r = separation(weights, p, a, b, c)
        best = dot(r, r)
    s, d = _along(p, a, b)
    if best < 0.0 or d < best:
        best, weights = d, (1.0, s - 1.0, -s, 0.0)
    s, d = _along(p, b, c)
    if d < best:
        best, weights = d, (1.0, 0.0, s - 1.0, -s)
    s, d = _along(p, c, a)
    if d < best:
        best, weights = d, (1.0, -s, 0.0, s - 1.0)
    return weights


@inner
def edge_edge(a, b, c, d):
    """Weights (1 − s, s, −(1 − t), −t) of the points of edges ab and cd that are nearest to each other."""
    u, v, w = sub(b, a), sub(d, c), sub(c, a)
    normal = cross(u, v)
    sine, uu, vv = dot(normal, normal), dot(u, u), dot(v, v)
    best, weights = -1.0, (1.0, 0.0, -1.0, 0.0)
    if sine > 0.0:
        s, t = dot(cross(w, v), normal) / sine, dot(cross(w, u), normal) / sine
        if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
            t = _clamp((_clamp(s) * dot(u, v) - dot(w, v)) / vv)
            s = _clamp((t * dot(u, v) + dot(w, u)) / uu)
            t = _clamp((s * dot(u, v) - dot(w, v)) / vv)
        weights = (1.0 - s, s, t - 1.0, -t)
        if sine > THIN * uu * vv:
            return weights
        r = separation(weights, a, b, c, d)
        best = dot(r, r)
    s, distance = _along(a, c, d)
    if best < 0.0 or distance < best:
        best, weights = distance, (1.0, 0.0, s - 1.0, -s)
    s, distance = _along(b, c, d)
    if distance < best:
        best, weights = distance, (0.0, 1.0, s - 1.0, -s)
    s, distance = _along(c, a, b)
    if distance < best:
        best, weights = distance, (1.0 - s, s, -1.0, 0.0)
    s, distance = _along(d, a, b)
    if distance < best:
        best, weights = distance, (1.0 - s, s, 0.0, -1.0)
    return weights


@inner
def _along(p, a, b):
    """How far along the edge ab, from 0 to 1, it is nearest to p, and the squared distance there."""
    e, r = sub(b, a), sub(p, a)
    length = dot(e, e)
    s = _clamp(dot(e, r) / length) if length > 0.0 else 0.0
    r = sub(p, add(scale(1.0 - s, a), scale(s, b)))
    return s, dot(r, r)


@inner
def _clamp(s):
    return min(max(s, 0.0), 1.0)
