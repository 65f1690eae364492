"""Which obstacles are out of reach of all cloth on its way: boxes tell, without a look at any vertex alone.

All that cloth fills on a straight way lies in the hull of where its vertices start and end, and that in the
hull of two boxes. Seen from an obstacle that moves, these are boxes again, and their distance from the
obstacle is a bound for that of every vertex, edge and triangle. Where it exceeds the reach nothing is in it.
"""

from __future__ import annotations

import math

import numpy as np

from sim.compiled import inner, kernel, row
from sim.contact.detect import into_frame
from sim.contact.obstacles import PLANE, ROUNDED

MARGIN = 1e-9
"""Part of the largest coordinate that rounding may have taken off a distance, and far more than it does."""

SIDES = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
"""Corners of a box, as parts of its sides."""


def box(points: np.ndarray) -> np.ndarray:
    """(8, 3) corners of the box around `points` (n, 3) [m]; not finite where any of them is not."""
    low, high = _extent(points)
    return low + SIDES * (high - low)


@kernel
def _extent(points):
    """The least and the largest coordinates; many times as fast as NumPy's along rows of three."""
    low, high, wild = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for i in range(len(points)):
        for r in range(3):
            value = points[i, r]
            low[r], high[r] = min(low[r], value), max(high[r], value)
            wild += 0.0 * value  # not a number as soon as one of them is none, or infinite
    return low + wild, high + wild


@kernel
def within_reach(shapes, before, after, start, end, reach):
    """(o,) bool, which shapes may come within `reach` [m] of cloth that goes from one box to another.

    Args:
        shapes: Those that are meshes never do.
        before: Where they are at the start.
        after: And at the end.
        start: (8, 3) corners of the box around the vertices at the start [m].
        end: (8, 3) and at the end.
        reach: [m].
    """
    found, low, high = np.zeros(len(shapes.kind), dtype=np.bool_), np.empty(3), np.empty(3)
    for o in range(len(found)):
        if shapes.kind[o] != ROUNDED and shapes.kind[o] != PLANE:
            continue
        low[:], high[:], wild = np.inf, -np.inf, 0.0
        for k in range(8):
            _include(into_frame(before.position[o], before.rotation[o], row(start, k)), low, high)
            _include(into_frame(after.position[o], after.rotation[o], row(end, k)), low, high)
            wild += 0.0 * (start[k].sum() + end[k].sum())  # not a number where a corner is none
        square, size = 0.0, shapes.radius[o]
        for r in range(3):
            half = shapes.half[o, r]
            square += max(low[r] - half, -half - high[r], 0.0) ** 2
            size += max(abs(low[r]), abs(high[r])) + half
        distance = low[2] if shapes.kind[o] == PLANE else math.sqrt(square) - shapes.radius[o]
        found[o] = not distance + wild > reach + MARGIN * size
    return found


@inner
def _include(point, low, high):
    """Let the box reach as far as a point."""
    low[0], low[1], low[2] = min(low[0], point.x), min(low[1], point.y), min(low[2], point.z)
    high[0], high[1], high[2] = max(high[0], point.x), max(high[1], point.y), max(high[2], point.z)
