"""Which obstacles are out of reach of all cloth on its way: boxes tell, without a look at any vertex alone.

All that cloth fills on a straight way lies in the hull of where its vertices start and end, and that in the
hull of two boxes. Seen from an obstacle that moves, these are boxes again, and their distance from the
obstacle is a bound for that of every vertex, edge and triangle. Where it exceeds the reach nothing is in it.
"""

from __future__ import annotations

import numpy as np

from sim.compiled import kernel
from sim.contact.obstacles import PLANE, ROUNDED, Poses, Shapes

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


def within_reach(
    shapes: Shapes, before: Poses, after: Poses, start: np.ndarray, end: np.ndarray, reach: float
) -> np.ndarray:
    """(o,) bool, which shapes may come within `reach` [m] of cloth that goes from one box to another.

    Args:
        shapes: Those that are meshes never do.
        before: Where they are at the start.
        after: And at the end.
        start: (8, 3) corners of the box around the vertices at the start [m].
        end: (8, 3) and at the end.
        reach: [m].
    """
    corners = np.concatenate([_seen(start, before), _seen(end, after)], axis=1)
    here = (shapes.kind == ROUNDED) | (shapes.kind == PLANE)
    if not np.isfinite(corners).all():
        return here
    low, high = corners.min(axis=1), corners.max(axis=1)
    aside = np.maximum(np.maximum(low - shapes.half, -shapes.half - high), 0.0)
    distance = np.where(shapes.kind == PLANE, low[:, 2], np.linalg.norm(aside, axis=1) - shapes.radius)
    size = (
        np.abs(corners).max(initial=0.0)
        + np.abs(shapes.half).max(initial=0.0)
        + shapes.radius.max(initial=0.0)
    )
    return here & ~(distance > reach + MARGIN * size)


def _seen(corners: np.ndarray, poses: Poses) -> np.ndarray:
    """(o, 8, 3) corners in the frame of each obstacle."""
    return np.einsum("oij,oki->okj", poses.rotation, corners[None] - poses.position[:, None])
