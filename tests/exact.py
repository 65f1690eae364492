"""Slow, obvious twins in rational numbers, for tests of closest points, impacts and intersections."""

from fractions import Fraction
from itertools import combinations, product

import numpy as np


def rational(points):
    """The same numbers, without any rounding from here on."""
    return [tuple(Fraction(float(value)) for value in point) for point in points]


def squared_distance(first, second):
    """Of two simplices with vertices in rational numbers, such as a vertex and a triangle.

    Whatever points are nearest, some choice of vertices has them inside, with independent edges: so the least
    of the feasible solutions of all least-squares problems is the distance.
    """
    best = None
    for p, q in product(_faces(first), _faces(second)):
        weights = _least_squares([_minus(e, p[0]) for e in p[1:]], [_minus(q[0], e) for e in q[1:]], p, q)
        if weights is not None:
            r = _combine(p, q, *weights)
            best = _dot(r, r) if best is None else min(best, _dot(r, r))
    return best


def distance_at(kind, x, t):
    """Exact distance, as a float, of a pair (8, 3) at the float time t."""
    t, points = Fraction(float(t)), rational(x)
    now = [
        tuple((1 - t) * a + t * b for a, b in zip(*ends, strict=True))
        for ends in zip(points[:4], points[4:], strict=True)
    ]
    split = 1 if kind == "vertex-triangle" else 2
    return float(squared_distance(now[:split], now[split:])) ** 0.5


def surely_apart(kind, x, start=0.0, end=1.0, depth=40):
    """Whether halving the time proves a pair (8, 3) apart, exactly.

    Each part has an axis on which the pair is apart at both ends, as projections are linear in time; or the
    volume of the four vertices, a cubic in time, has Bernstein coefficients of one sign.
    """
    split = 1 if kind == "vertex-triangle" else 2
    points = rational(x)
    differences = [
        (_minus(points[i], points[j]), _minus(points[i + 4], points[j + 4]))
        for i in range(split)
        for j in range(split, 4)
    ]
    return _apart(kind, np.asarray(x), points, differences, Fraction(start), Fraction(end), depth)


def _apart(kind, x, points, differences, start, end, depth):
    if _never_coplanar(points, start, end):
        return True
    middle = float((start + end) / 2)
    for axis in _axes(kind, (1 - middle) * x[:4] + middle * x[4:]):
        sides = [(1 - t) * _dot(axis, a) + t * _dot(axis, b) for a, b in differences for t in (start, end)]
        if min(sides) > 0 or max(sides) < 0:
            return True
    if depth == 0:
        return False
    half = (start + end) / 2
    parts = ((start, half), (half, end))
    return all(_apart(kind, x, points, differences, a, b, depth - 1) for a, b in parts)


def _never_coplanar(points, start, end):
    a, b, c, d = (_volume(points, start + (end - start) * k / 3) for k in range(4))
    inner = (-5 * a + 18 * b - 9 * c + 2 * d, 2 * a - 9 * b + 18 * c - 5 * d)
    return min(a, d, *inner) > 0 or max(a, d, *inner) < 0


def _volume(points, t):
    p = [tuple((1 - t) * a + t * b for a, b in zip(points[k], points[k + 4], strict=True)) for k in range(4)]
    (a, b, c), (d, e, f), (g, h, i) = (_minus(q, p[0]) for q in p[1:])
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _axes(kind, p):
    """Every axis that can be the direction between two nearest points."""
    if kind == "vertex-triangle":
        edges, pairs = p[[2, 3, 1]] - p[[1, 2, 3]], p[0] - p[1:]
        normals = [np.cross(edges[0], edges[1])]
    else:
        edges, pairs = p[[1, 3]] - p[[0, 2]], (p[:2, None] - p[None, 2:]).reshape(-1, 3)
        normals = [np.cross(edges[0], edges[1])]
    square = [np.cross(np.cross(e, d), e) for e in edges for d in pairs]
    return rational([*normals, *square, *pairs])


def _faces(simplex):
    return [face for size in range(1, len(simplex) + 1) for face in combinations(simplex, size)]


def _least_squares(u, v, p, q):
    """Weights of p's and q's further vertices that make Σ shortest, if unique and not outside; else None."""
    columns, rhs = u + v, _minus(q[0], p[0])
    rows = [[_dot(a, b) for b in columns] + [_dot(a, rhs)] for a in columns]
    n = len(columns)
    for i in range(n):
        pivot = next((k for k in range(i, n) if rows[k][i]), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(n):
            if k != i:
                rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    s, t = [row[n] for row in rows[: len(u)]], [row[n] for row in rows[len(u) :]]
    inside = min(s + t, default=0) >= 0 and sum(s) <= 1 and sum(t) <= 1
    return (s, t) if inside else None


def _combine(p, q, s, t):
    a = [p[0][k] + sum(w * (e[k] - p[0][k]) for w, e in zip(s, p[1:], strict=True)) for k in range(3)]
    b = [q[0][k] + sum(w * (e[k] - q[0][k]) for w, e in zip(t, q[1:], strict=True)) for k in range(3)]
    return _minus(a, b)


def _minus(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))
