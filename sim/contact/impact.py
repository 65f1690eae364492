"""Continuous detection: the first time at which two primitives of cloth meet, on straight paths.

Directional conservative advancement. Take the unit vector n between the nearest points and project every
pair of a vertex of one primitive and a vertex of the other on it: while all projections exceed a gap, the
primitives are farther apart than that. Each projection is linear in time, so jump to the first time at
which one reaches the gap, and repeat there. Where none does before the end, the pair misses.

A pair that turns as it moves would need many such jumps. From the third on, n also turns: from n here to
the m between the nearest points a little later, linearly. It is no longer than one, so the projections,
now quadratic in time, bound the distance as before; the first time at which one reaches the gap has a
closed form. That doubles the digits of a plain hit, and makes geometric what crept towards a graze.

No contact is missed, and none is found late, by construction: whatever n and m are, the way jumped over is
free. Poor ones cost another jump, and where none leads on, the time reached is the answer. Coplanar,
parallel and degenerate pairs are no special cases. Not promised: a hit is a distance of at most twice the
gap, so a pair that passes closer than that without touching is one, too.

Compare conservative advancement (Mirtich 1996; Zhang, Lee, Kim 2006), which bounds the motion along n, and
additive CCD (Li, Kaufman, Jiang 2021), which jumps by distance over speed.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sim.compiled import CHUNKS, Vec3, cross, dot, inner, parallel_kernel, scale, share, sub
from sim.contact.closest import edge_edge, separation, vertex_triangle
from sim.threads import processor_threads

VERTEX_TRIANGLE = 0
EDGE_EDGE = 1
KINDS = {"vertex-triangle": VERTEX_TRIANGLE, "edge-edge": EDGE_EDGE}

ROUNDING = 2.0**-47
"""Least gap as a part of the pair's size, the largest difference of a coordinate at the start or the end:
eight times what the projections are off by."""

NEAR = 2.0
"""A distance of up to so many gaps is a contact, so that the last jump need not be exact."""

STRAIGHT = 2
"""Jumps before n turns: nearly all misses need one, and a hit along a fixed normal two."""

WINDOW = 2.0
"""How far ahead m is looked for at first, in jumps along a fixed n."""

MOST = 256
"""Jumps after which `time_of_impact` takes the time reached for the contact."""


def time_of_impact(kind: str, x: np.ndarray) -> np.ndarray:
    """When pairs of primitives first meet, as their vertices go straight from their start to their end.

    Args:
        kind: "vertex-triangle" or "edge-edge".
        x: (n, 8, 3) float64, in any unit: of each pair the vertex and the triangle's three, or the ends of
            one edge and of the other, at time 0, then the same four at time 1.

    Returns:
        (n,) earliest times in [0, 1], inf where the pair does not meet.

    Raises:
        ValueError: Unknown kind, wrong shape, or a number that is not finite.

    No contact is missed, and no time is later than the truth. A pair counts as meeting where it comes closer
    than 2⁻⁴⁶ (1.4e-14) of its size, which is the largest difference of a coordinate between two of its
    vertices, at the start or the end; the time is that at which it does. Neither the order of a triangle's
    vertices, of the edges or of their ends, nor a power of two that scales everything changes a bit. Whether
    they meet does not change either when start and end are swapped.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    try:
        x = np.ascontiguousarray(x, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"x: expected numbers, got {error}") from None
    if x.ndim != 3 or x.shape[1:] != (8, 3):
        raise ValueError(f"x: expected an array of shape (n, 8, 3), got {x.shape}")
    wrong = np.flatnonzero(~np.isfinite(x).all(axis=(1, 2)))
    if len(wrong):
        raise ValueError(f"x[{wrong[0]}]: expected finite numbers, got {x[wrong[0]].tolist()}")
    times = np.empty(len(x))
    with processor_threads(numba.get_num_threads()):
        _times(KINDS[kind], x, times)
    return times


@parallel_kernel
def _times(kind, x, times):
    for chunk in numba.prange(CHUNKS):
        _times_share(kind, x, times, chunk)


@inner
def _times_share(kind, x, times, chunk):
    first, last = share(chunk, len(x))
    pair = np.empty((8, 3))
    for i in range(first, last):
        times[i] = math.inf
        for end in (4, 0):  # a miss in either direction of time is none: neither overlooks a contact
            _normalise(kind, x[i], 4 - end, end, pair)
            t = impact(kind, *_rows(pair), 0.0, MOST)[0]
            if t == math.inf:
                times[i] = t
                break
            if end == 4:
                times[i] = t


@inner
def _rows(x):
    return (
        Vec3(x[0, 0], x[0, 1], x[0, 2]),
        Vec3(x[1, 0], x[1, 1], x[1, 2]),
        Vec3(x[2, 0], x[2, 1], x[2, 2]),
        Vec3(x[3, 0], x[3, 1], x[3, 2]),
        Vec3(x[4, 0], x[4, 1], x[4, 2]),
        Vec3(x[5, 0], x[5, 1], x[5, 2]),
        Vec3(x[6, 0], x[6, 1], x[6, 2]),
        Vec3(x[7, 0], x[7, 1], x[7, 2]),
    )


@inner
def _normalise(kind, x, start, end, pair):
    """Fill `pair` with rows `start` + k of x, then `end` + k: relative to the first vertex, ½ to 1 in size.

    The order of k depends on their values only, and the scale is a power of two.
    """
    a, b, c, d = 0, 1, 2, 3
    if kind == VERTEX_TRIANGLE:
        if _after(x, b, c, start, end):
            b, c = c, b
        if _after(x, c, d, start, end):
            c, d = d, c
        if _after(x, b, c, start, end):
            b, c = c, b
    else:
        if _after(x, a, b, start, end):
            a, b = b, a
        if _after(x, c, d, start, end):
            c, d = d, c
        if _after(x, a, c, start, end) or (not _after(x, c, a, start, end) and _after(x, b, d, start, end)):
            a, b, c, d = c, d, a, b
    largest = 0.0
    for k in range(8):
        for axis in range(3):
            largest = max(largest, abs(x[k, axis]))
    down = math.frexp(largest)[1] + 1  # so that differences do not overflow
    size = 0.0
    for row, k in enumerate((a, b, c, d)):
        for axis in range(3):
            for base, time in ((0, start), (4, end)):
                value = math.ldexp(x[time + k, axis], -down) - math.ldexp(x[time + a, axis], -down)
                pair[base + row, axis] = value
                size = max(size, abs(value))
    up = math.frexp(size)[1]
    for k in range(8):
        for axis in range(3):
            pair[k, axis] = math.ldexp(pair[k, axis], -up)


@inner
def _after(x, j, k, start, end):
    """Whether the path of vertex j comes after that of k in lexicographic order."""
    for time in (start, end):
        for axis in range(3):
            if x[time + j, axis] != x[time + k, axis]:
                return x[time + j, axis] > x[time + k, axis]
    return False


@inner
def impact(kind, a0, a1, a2, a3, b0, b1, b2, b3, gap, most):
    """Earliest time in [0, 1] at which a pair touches, or inf; with its normal and weights there.

    `kind` is VERTEX_TRIANGLE of vertex 0 and triangle 1, 2, 3, or EDGE_EDGE of 0, 1 and 2, 3; a0 … a3 are
    their places [m] at time 0, b0 … b3 at time 1. `gap` is the distance [m] to keep; where that is less than
    rounding needs, what it needs is kept. After `most` jumps the time reached counts as contact.

    Returns:
        The time; the unit vector n along which the pair was last apart; the weights w of the nearest points.
        Up to the time, the distance is at least `gap`; there it is at most NEAR times that, unless jumps ran
        out. A pair as near as this at the start has the time 0. n · Σ wᵢ xᵢ > 0, but where the pair
        touches at the start already: there n is square to the primitives.
    """
    p1, p2, p3, q1, q2, q3 = sub(a1, a0), sub(a2, a0), sub(a3, a0), sub(b1, b0), sub(b2, b0), sub(b3, b0)
    gap = max(gap, ROUNDING * max(_size(p1), _size(p2), _size(p3), _size(q1), _size(q2), _size(q3)))
    t, window = 0.0, WINDOW
    x1, x2, x3 = p1, p2, p3
    w, r = _nearest(kind, x1, x2, x3)
    n = _direction(kind, w, r, x1, x2, x3)
    for jumps in range(most):
        if not dot(r, r) > (NEAR * gap) * (NEAR * gap):
            return t, n, w
        if jumps > 0:
            n = _direction(kind, w, r, x1, x2, x3)
        step = _free(kind, n, n, x1, x2, x3, q1, q2, q3, gap)
        if step == math.inf:
            return step, n, w
        reached = t + step * (1.0 - t)
        if jumps >= STRAIGHT:
            end = min(t + window * (reached - t), 1.0)
            y1, y2, y3 = _between(p1, q1, end), _between(p2, q2, end), _between(p3, q3, end)
            v, s = _nearest(kind, y1, y2, y3)
            m = _direction(kind, v, s, y1, y2, y3)
            if dot(m, n) < 0.0:
                m = scale(-1.0, m)
            step = _free(kind, n, m, x1, x2, x3, y1, y2, y3, gap)
            if step == math.inf and end == 1.0:
                return step, n, w
            if step > 1.0:
                window *= 4.0
            elif step < 0.25:
                window = max(0.5 * window, WINDOW)
            reached = max(reached, t + min(step, 1.0) * (end - t))
        reached = min(reached, 1.0)
        if not reached > t:
            return t, n, w
        t = reached
        x1, x2, x3 = _between(p1, q1, t), _between(p2, q2, t), _between(p3, q3, t)
        w, r = _nearest(kind, x1, x2, x3)
    return t, n, w


@inner
def _nearest(kind, x1, x2, x3):
    """Weights of the nearest points, and their separation; the vertex 0 is the origin."""
    origin = Vec3(0.0, 0.0, 0.0)
    w = vertex_triangle(origin, x1, x2, x3) if kind == VERTEX_TRIANGLE else edge_edge(origin, x1, x2, x3)
    return w, separation(w, origin, x1, x2, x3)


@inner
def _direction(kind, w, r, x1, x2, x3):
    """Unit vector along the separation r, made square to both primitives where the points lie inside them.

    There r, the difference of two nearly equal points, is all rounding just when it matters most.
    """
    n = r
    if kind == VERTEX_TRIANGLE:
        if w[1] != 0.0 and w[2] != 0.0 and w[3] != 0.0:
            n = cross(sub(x2, x1), sub(x3, x1))
    elif w[0] != 0.0 and w[1] != 0.0 and w[2] != 0.0 and w[3] != 0.0:
        n = cross(x1, sub(x3, x2))
    square = dot(n, n)
    if not square > 0.0:
        n, square = r, dot(r, r)
    if not square > 0.0:
        return Vec3(0.0, 0.0, 1.0)
    length = math.sqrt(square)
    return scale(1.0 / length if dot(n, r) >= 0.0 else -1.0 / length, n)


@inner
def _free(kind, n, m, x1, x2, x3, y1, y2, y3, gap):
    """Part of the way from x to y on which all projections exceed the gap, or inf if they do to its end.

    The direction turns from n to m on the way, and the vertex 0 is the origin.
    """
    a1, a2, a3 = dot(n, x1), dot(n, x2), dot(n, x3)
    b1, b2, b3 = dot(n, y1) + dot(m, x1), dot(n, y2) + dot(m, x2), dot(n, y3) + dot(m, x3)
    c1, c2, c3 = dot(m, y1), dot(m, y2), dot(m, y3)
    if kind == VERTEX_TRIANGLE:
        return min(_first(-a1, -b1, -c1, gap), _first(-a2, -b2, -c2, gap), _first(-a3, -b3, -c3, gap))
    return min(
        _first(-a2, -b2, -c2, gap),
        _first(-a3, -b3, -c3, gap),
        _first(a1 - a2, b1 - b2, c1 - c2, gap),
        _first(a1 - a3, b1 - b3, c1 - c3, gap),
    )


@inner
def _first(a, b, c, gap):
    """Least τ in [0, 1] at which a (1 − τ)² + b τ (1 − τ) + c τ² is at most the gap, or inf."""
    a, b, c = a - gap, 0.5 * b - gap, c - gap
    if not a > 0.0:
        return 0.0
    square = b * b - a * c
    if c > 0.0 and (b > 0.0 or square < 0.0):
        return math.inf
    return a / (a - b + math.sqrt(max(square, 0.0)))


@inner
def _between(a, b, t):
    """The place at time t on the way from a to b; exactly a and b at its ends."""
    s = 1.0 - t
    return Vec3(s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z)


@inner
def _size(a):
    return max(abs(a.x), abs(a.y), abs(a.z))
