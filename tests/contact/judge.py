"""What judges contact from outside: distances the obvious way, and ipctk on every step."""

from itertools import product

import ipctk
import numpy as np

import sim

VERTEX_TRIANGLE, EDGE_EDGE = "vertex-triangle", "edge-edge"

HALVINGS = 60
"""Parts of a way this small are told apart by nothing that float64 can tell."""


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


class Judge:
    """Whether the cloth of a world crosses itself."""

    def __init__(self, world):
        self.edges, self.triangles = world.edges.copy(), world.triangles.copy()
        self._mesh = ipctk.CollisionMesh(
            np.asfortranarray(world.mesh.vertices),
            np.asfortranarray(self.edges),
            np.asfortranarray(self.triangles),
        )

    def clean(self, x):
        """Whether nothing crosses at x (n, 3); ipctk and Muslin's exact test must both say so."""
        free = not ipctk.has_intersections(self._mesh, np.asfortranarray(x))
        return free and not len(sim.intersections(x, self.triangles))

    def meetings(self, x, y):
        """Pairs that touch on the way from x to y, (n, 3) both.

        `is_step_collision_free` flags what comes near, too, and tight inclusion what it did not finish; what
        both flag is told apart by separating planes, if there are any.
        """
        x, y = np.asfortranarray(x), np.asfortranarray(y)
        if ipctk.is_step_collision_free(self._mesh, x, y):
            return []
        near = ipctk.Candidates()
        near.build(self._mesh, x, y, 0.0)
        ccd, most = ipctk.tight_inclusion, {"min_distance": 0.0, "max_iterations": 20_000}
        found = []
        for pair in near.fv_candidates:
            i = [pair.vertex_id, *self.triangles[pair.face_id]]
            if ccd.point_triangle_ccd(*x[i], *y[i], **most)[0] and not surely_apart(x[i], y[i], (0,)):
                found.append((VERTEX_TRIANGLE, i))
        for pair in near.ee_candidates:
            i = [*self.edges[pair.edge0_id], *self.edges[pair.edge1_id]]
            if ccd.edge_edge_ccd(*x[i], *y[i], **most)[0] and not surely_apart(x[i], y[i], (0, 1)):
                found.append((EDGE_EDGE, i))
        return found


def surely_apart(x, y, one):
    """Whether a plane parts the vertices `one` of a pair from the others all the way from x to y, (4, 3).

    The plane may be another in each part of the way, but does not turn within it: so its ends tell all.
    """
    other = [k for k in range(4) if k not in one]
    parts = [(0.0, 1.0, 0)]
    while parts:
        low, high, depth = parts.pop()
        ends = x + low * (y - x), x + high * (y - x)
        for n in _axes(0.5 * (ends[0] + ends[1]), one, other):
            gaps = [np.subtract.outer((z - z[0])[list(one)] @ n, (z - z[0])[other] @ n).ravel() for z in ends]
            if np.min(gaps) > 1e-15 or np.max(gaps) < -1e-15:
                break
        else:
            if depth == HALVINGS:
                return False
            middle = 0.5 * (low + high)
            parts += [(low, middle, depth + 1), (middle, high, depth + 1)]
    return True


def _axes(x, one, other):
    """Unit vectors square to two edges, or to one and through a vertex, of the tetrahedron x."""
    a, b = x[list(one)], x[other]
    ways = [q - p for p, q in product(a, b)]
    sides = [q - p for half in (a, b) for k, p in enumerate(half) for q in half[k + 1 :]]
    if len(one) == 1:
        yield from _unit(np.cross(b[1] - b[0], b[2] - b[0]))
    else:
        yield from _unit(np.cross(a[1] - a[0], b[1] - b[0]))
    for side, way in product(sides, ways):
        yield from _unit(way - (way @ side) / max(side @ side, 1e-300) * side)
    for way in ways:
        yield from _unit(way)


def _unit(n):
    size = np.linalg.norm(n)
    return [n / size] if size > 0.0 else []


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
