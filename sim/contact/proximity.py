"""Where candidate pairs are: how far apart at the start of a step, and whether they meet on the way.

One pass over the list of candidates each. Most pairs are told apart by bounds that cost no square root of
their own: how far vertices have moved since the list was made, and how far they move past each other.
"""

from __future__ import annotations

import math

import numba

from sim.compiled import CHUNKS, dot, inner, norm, parallel_kernel, row, share, sub
from sim.contact.closest import edge_edge, separation, vertex_triangle
from sim.contact.impact import VERTEX_TRIANGLE, impact

MOST_JUMPS = 64
"""Jumps of continuous detection after which the time reached counts as the time of contact."""

ROOM = 0.25
"""Part of the distance at the start that may count as contact later: else a pair would begin in contact."""


@parallel_kernel
def measure(kind, node, listed, places, positions, reach, distance, weight):
    """Fill the `distance` (p,) of pairs [m]: exact with weights where below `reach`, else a lower bound.

    `listed` (p,) is each one's distance with vertices at `places` (n, 3) [m].
    """
    for chunk in numba.prange(CHUNKS):
        _measure(kind, node, listed, places, positions, reach, distance, weight, share(chunk, len(kind)))


@inner
def _measure(kind, node, listed, places, positions, reach, distance, weight, part):
    for p in range(part[0], part[1]):
        i, j, k, m = node[p, 0], node[p, 1], node[p, 2], node[p, 3]
        a, b, c, d = row(positions, i), row(positions, j), row(positions, k), row(positions, m)
        e, f, g, h = row(places, i), row(places, j), row(places, k), row(places, m)
        bound = listed[p] - passing(kind[p], sub(a, e), sub(b, f), sub(c, g), sub(d, h))
        if bound > reach:
            distance[p] = bound
            continue
        w = nearest(kind[p], a, b, c, d)
        distance[p] = norm(separation(w, a, b, c, d))
        weight[p, 0], weight[p, 1], weight[p, 2], weight[p, 3] = w


@inner
def nearest(kind, a, b, c, d):
    """Weights of the nearest points of a pair."""
    return vertex_triangle(a, b, c, d) if kind == VERTEX_TRIANGLE else edge_edge(a, b, c, d)


@parallel_kernel
def meet(kind, node, distance, start, end, gap, time, normal, weight):
    """Fill the `time` (p,) in [0, 1] at which pairs come within `gap` [m] on the way, or inf.

    `distance` (p,) is a lower bound of each one's distance at the start. Nearer pairs have a gap of their
    own, a part of that. Of a pair that meets, `normal` (p, 3), `weight` (p, 4) and the exact distance are
    filled, too.
    """
    for chunk in numba.prange(CHUNKS):
        _meet(kind, node, distance, start, end, gap, time, normal, weight, share(chunk, len(kind)))


@inner
def _meet(kind, node, distance, start, end, gap, time, normal, weight, part):
    for p in range(part[0], part[1]):
        time[p] = math.inf
        i, j, k, m = node[p, 0], node[p, 1], node[p, 2], node[p, 3]
        a, b, c, d = row(start, i), row(start, j), row(start, k), row(start, m)
        e, f, g, h = row(end, i), row(end, j), row(end, k), row(end, m)
        past = passing(kind[p], sub(e, a), sub(f, b), sub(g, c), sub(h, d))
        if past == 0.0 or distance[p] - past > gap:
            continue
        apart = norm(separation(nearest(kind[p], a, b, c, d), a, b, c, d))
        own = min(gap, ROOM * apart)
        if not apart > 0.0 or apart - past > own:
            continue
        t, n, s = impact(kind[p], a, b, c, d, e, f, g, h, own, MOST_JUMPS)
        if t <= 1.0:
            time[p], distance[p] = t, apart
            normal[p, 0], normal[p, 1], normal[p, 2] = n.x, n.y, n.z
            weight[p, 0], weight[p, 1], weight[p, 2], weight[p, 3] = s


@inner
def passing(kind, a, b, c, d):
    """How far, at most, points of a pair's features move past each other, by the ways of the vertices."""
    if kind == VERTEX_TRIANGLE:
        return math.sqrt(max(_square(a, b), _square(a, c), _square(a, d)))
    return math.sqrt(max(_square(a, c), _square(a, d), _square(b, c), _square(b, d)))


@inner
def _square(a, b):
    c = sub(a, b)
    return dot(c, c)
