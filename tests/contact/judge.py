"""What judges contact from outside: distances the obvious way, and the battery's judge on every step."""

from types import SimpleNamespace

import numpy as np

import sim
from sim.contact.obstacles import MESH, PLANE
from sim.mesh import distinct_edges, elements
from sim.scene import Box
from sim.stress.judge import EDGE_EDGE, FACES, VERTEX_TRIANGLE, Judge

__all__ = ["EDGE_EDGE", "VERTEX_TRIANGLE", "Judge", "distances", "offending", "passing", "run_cleanly"]

NONE = np.zeros((0, 2), dtype=np.int64)
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


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


def offending(world):
    """Elements of cloth that are not outside of an obstacle, or cross cloth.

    Of each its vertices (k,), if it crosses cloth those of both; and whether it does.
    """
    x, faces, obstacles, found = world.positions, elements(world.mesh), world.contact.obstacles, []
    poses = obstacles.poses(world.time)
    y, every = np.concatenate([x, obstacles.corners(poses)]), obstacles.solid.triangles + len(x)
    for o, part in enumerate(world.scene.obstacle):
        local = (x - poses.position[o]) @ poses.rotation[o]
        kind, half = obstacles.shapes.kind[o], obstacles.shapes.half[o]
        if kind == PLANE:
            inside = faces[(local[faces][:, :, 2] < 0.0).any(axis=1)]
        elif isinstance(part, Box):
            y = np.concatenate([y, CORNERS * part.size @ poses.rotation[o].T + poses.position[o]])
            every = np.concatenate([every, FACES + len(y) - 8])
            inside = faces[(np.abs(local) < half).all(axis=1)[faces].any(axis=1)]
        elif kind == MESH:
            shell = world.mesh.shells[o]
            enclosed = np.array([not shell.open_edges and shell.encloses(place) for place in local])
            inside = faces[enclosed[faces].any(axis=1)]
        else:
            inside = faces[_to_axis(local[faces], half[2]) <= part.radius]
        found += [(nodes, False) for nodes in inside]
    every = np.concatenate([faces, every]).astype(np.int64)
    crossing, sides = sim.intersections(y, every), distinct_edges(every, NONE, len(y))
    for e, f in crossing:
        found.append(_ours(np.concatenate([sides[e], every[f]]), len(x)))
    return [(nodes, cloth) for nodes, cloth in found if len(nodes)]


def passing(world, x, time):
    """The same of pairs that passed through each other since cloth was at x (n, 3) and it was `time`."""
    obstacles, n = world.contact.obstacles, len(x)
    solid = obstacles.solid
    before, after = (
        np.concatenate([each, obstacles.corners(obstacles.poses(t))])
        for each, t in ((x, time), (world.positions, world.time))
    )
    both = SimpleNamespace(
        edges=np.concatenate([world.edges, solid.edges + n]),
        triangles=np.concatenate([world.triangles, solid.triangles + n]),
        mesh=SimpleNamespace(vertices=before),
    )
    met = (_ours(np.array(nodes), n) for _, nodes in Judge(both).each_meeting(before, after))
    return [(nodes, cloth) for nodes, cloth in met if len(nodes)]


def _ours(nodes, n):
    """Those of the cloth's n vertices, and whether that is all of them."""
    return nodes[nodes < n], bool((nodes < n).all())


def _to_axis(triangles, half):
    """(m,) distances of triangles (m, 3, 3) from the line from −half to half on the z axis."""
    ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    points = [np.concatenate([end[None], t]) for end in ends for t in triangles]
    lines = [np.concatenate([ends, t[side]]) for t in triangles for side in ([0, 1], [1, 2], [2, 0])]
    return np.minimum(
        distances(VERTEX_TRIANGLE, points).reshape(2, -1).min(axis=0),
        distances(EDGE_EDGE, lines).reshape(-1, 3).min(axis=1),
    )


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
