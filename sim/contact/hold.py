"""Vertices that are held back: they go no farther than they may."""

from __future__ import annotations

import numpy as np

ROUNDING = 1e-12
"""Part of the largest coordinate below which no part of a distance is gone: rounding might go the rest."""


def go_at_most(start: np.ndarray, end: np.ndarray, which: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Let the vertices `which` (k,) go no farther from `start` to `end` than is `allowed` (k,) [m].

    Args:
        start: (n, 3) [m], or more rows.
        end: (n, 3) [m]; those that would go farther are moved.
        which: (k,) vertices.
        allowed: (k,) [m].

    Returns:
        The vertices that would have gone farther.
    """
    way = end[which] - start[which]
    size = max(np.abs(start).max(initial=0.0), np.abs(end).max(initial=0.0))
    allowed = np.where(allowed < ROUNDING * size, 0.0, allowed)
    length = np.linalg.norm(way, axis=1)
    far = length > (1.0 + 1e-9) * allowed  # else it has been shortened before
    which = which[far]
    end[which] = start[which] + (allowed[far] / length[far])[:, None] * way[far]
    return which


def slow(velocities: np.ndarray, which: np.ndarray, most: np.ndarray) -> None:
    """Let the vertices `which` (k,) of `velocities` (n, 3) [m/s] be no faster than `most` (k,) [m/s]."""
    speed = np.linalg.norm(velocities[which], axis=1)
    fast = speed > most
    velocities[which[fast]] *= (most[fast] / speed[fast])[:, None]
