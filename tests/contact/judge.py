"""What judges contact from outside: distances the obvious way, and the battery's judge on every step."""

import numpy as np

from sim.stress.judge import EDGE_EDGE, VERTEX_TRIANGLE, Judge

__all__ = ["EDGE_EDGE", "VERTEX_TRIANGLE", "Judge", "distances", "run_cleanly"]


def run_cleanly(world, steps):
    """Take `steps` steps and assert that each ends free of intersections; returns the reports."""
    judge, reports = Judge(world), []
    assert judge.clean(world.positions), "the scene starts tangled"
    for k in range(steps):
        before = world.positions.copy()
        reports.append(world.step())
        x = world.positions
        assert np.isfinite(x).all(), f"step {k} left something that is no number"
        assert judge.clean(x), f"step {k} ended with an intersection"
        if reports[-1].substeps == 1:  # else the way had corners
            met = judge.meetings(before, x)
            assert not met, f"step {k} went through {met[0]}"
    return reports


def distances(kind, x):
    """(p,) distances of pairs x (p, 4, 3), as the least of all that may be it."""
    a, b, c, d = np.moveaxis(np.asarray(x, dtype=float), 1, 0)
    if kind == VERTEX_TRIANGLE:
        sides = [_to_segment(a, b, c), _to_segment(a, c, d), _to_segment(a, d, b)]
        return np.minimum(np.min(sides, axis=0), _to_inside(a, b, c, d))
    ends = [_to_segment(a, c, d), _to_segment(b, c, d), _to_segment(c, a, b), _to_segment(d, a, b)]
    return np.minimum(np.min(ends, axis=0), _between_lines(a, b, c, d))


def _to_segment(p, a, b):
    way = b - a
    with np.errstate(invalid="ignore", divide="ignore"):
        t = np.nan_to_num(np.sum((p - a) * way, axis=1) / np.sum(way * way, axis=1))
    return np.linalg.norm(p - a - np.clip(t, 0.0, 1.0)[:, None] * way, axis=1)


def _to_inside(p, a, b, c):
    """Distance to the plane of a triangle, where it is inside; else inf."""
    n = np.cross(b - a, c - a)
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.sum((p - a) * n, axis=1) / np.linalg.norm(n, axis=1)
    inside = [np.sum(np.cross(v - u, p - u) * n, axis=1) >= 0 for u, v in ((a, b), (b, c), (c, a))]
    return np.where(np.all(inside, axis=0) & np.isfinite(height), np.abs(height), np.inf)


def _between_lines(a, b, c, d):
    """Distance of two lines, where the nearest points are on both segments; else inf."""
    u, v, w = b - a, d - c, c - a
    n = np.cross(u, v)
    square = np.sum(n * n, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        s = np.sum(np.cross(w, v) * n, axis=1) / square
        t = np.sum(np.cross(w, u) * n, axis=1) / square
        gap = np.abs(np.sum(w * n, axis=1)) / np.sqrt(square)
        inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    return np.where(inside & np.isfinite(gap), gap, np.inf)
