"""Scenes of cloth that meets cloth, for cases of the battery and for tests."""

from __future__ import annotations

import numpy as np

from sim.compiled import Vec3
from sim.contact.closest import edge_edge, vertex_triangle
from sim.simulation import Simulation
from sim.stress.worlds import ball, chain, grid, scene

DOWN = [0, 0, -9.81]

LIMP = {"stretch": 0.0, "altitudes": "none", "bend": "none"}
"""Vertices that nothing holds together: a pair of features is then all alone in the world."""


def felt(cloth, *obstacles, **more):
    """A scene whose cloth feels itself."""
    return scene(cloth, *obstacles, **{"self_collision": "auto", **more})


def one_pair(kind, speed, friction, thickness=2e-3):
    """A vertex above a triangle, or an edge above one that it crosses; unlike masses, and a slanting way."""
    upper = chain([[0.05, 0.02, 0.01], [0.05, 0.02, 1.0]], [0.3, 0.2])
    lower = {
        "vertices": [[-0.4, -0.3, 0], [0.5, -0.3, 0], [0.1, 0.6, 0]],
        "triangles": [[0, 1, 2]],
        "masses": [0.1, 0.4, 1.0],
    }
    if kind == "edge-edge":
        upper = chain([[0.05, -0.4, 0.01], [0.05, 0.5, 0.01]], [0.3, 0.2])
        lower = chain([[-0.4, 0.1, 0], [0.5, 0.1, 0]], [0.1, 0.4])
    world = Simulation(felt([upper, lower], friction=friction, thickness=thickness, **LIMP))
    v = np.zeros_like(world.positions)
    v[:2] = [0.4 * speed, -0.1 * speed, -speed]
    world.place(world.positions, v)
    return world


def parting(kind, world):
    """Speed at which the nearest points of the pair part [m/s]."""
    node, nearest = (
        ([0, 2, 3, 4], vertex_triangle) if kind == "vertex-triangle" else ([0, 1, 2, 3], edge_edge)
    )
    w = np.array(nearest(*(Vec3(*p) for p in world.positions[node])))
    gap = w @ world.positions[node]
    return float((w @ world.velocities[node]) @ gap / np.linalg.norm(gap))


def two_sheets(speed, **more):
    """Two free sheets, the upper one turned, that fly at each other."""
    cloth = [
        grid((0.5, 0.5), (10, 10)),
        grid((0.5, 0.5), (10, 10), position=[0.06, 0.05, 0.06], rotation=[0.1, 0.15, 0.6]),
    ]
    world = Simulation(felt(cloth, **{"friction": 0.4, "jitter": 1e-3, **more}))
    v = np.zeros_like(world.positions)
    v[100:] = [0.3 * speed, 0.0, -speed]
    world.place(world.positions, v)
    return world


def shaped(x, rest, **more):
    """A grid cloth that is put elsewhere at first."""
    flat = Simulation(scene(rest))
    shape = {"vertices": x.tolist(), "rest_vertices": flat.positions.tolist()}
    return {**shape, "triangles": flat.triangles.tolist(), **more}


def extruded(profile, width, rows):
    """The points of a profile (n, 2) in the xz-plane, row after row along y."""
    lines = [np.insert(profile, 1, y, axis=1) for y in np.linspace(0.0, width, rows)]
    return np.concatenate(lines)


def stack(support, **more):
    """Three sheets that fall on something, one above the other."""
    cloth = [grid((0.4, 0.4), (12, 12), position=[0.004 * k, 0.003 * k, 0.01 + 0.02 * k]) for k in range(3)]
    return felt(cloth, support, **{"gravity": DOWN, "thickness": 6e-3, **more})


def fold(**more):
    """A strip bent back over itself, that falls shut."""
    s = np.linspace(0.0, 0.8, 20)
    turn = np.clip((s - 0.35) / 0.1, 0.0, 1.0) * np.pi
    profile = np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1) * (0.8 / 19), axis=0)
    profile[:, 1] += 0.02
    cloth = shaped(extruded(profile, 0.2, 6), grid((0.8, 0.2), (20, 6)))
    return felt(cloth, {"kind": "plane"}, gravity=DOWN, **more)


def crumple(**more):
    """A sheet that falls edge first."""
    cloth = grid((0.6, 0.6), (13, 13), rotation=[1.5, 0.1, 0.0], position=[0, 0, 0.35])
    return felt(cloth, {"kind": "plane"}, **{"gravity": DOWN, "bending": 1e-5, **more})


def roll(**more):
    """A strip rolled up, let go above the floor."""
    angle = np.linspace(0.0, 5.0 * np.pi, 36)
    radius = 0.04 + 0.012 * angle / (2.0 * np.pi)
    profile = np.stack([radius * np.cos(angle), radius * np.sin(angle) + 0.09], axis=1)
    cloth = shaped(extruded(profile, 0.2, 5), grid((1.0, 0.2), (36, 5)))
    return felt(cloth, {"kind": "plane"}, gravity=DOWN, bending=1e-3, **more)


def curtain(**more):
    """A sheet held along its top in tight waves, blown so that its folds lie on each other."""
    t = np.linspace(0.0, 1.0, 30)
    rail = np.stack([0.25 * t, 0.05 * np.sin(14.0 * np.pi * t)], axis=1)
    x = np.concatenate([np.column_stack([rail, np.full(30, 0.4 * k / 7)]) for k in range(8)])
    cloth = shaped(x, grid((1.2, 0.4), (30, 8)), pins=list(range(210, 240)))
    return felt(cloth, gravity=[6.0, 0.0, -9.81], **more)


def tube(**more):
    """A tube on the floor under a ball that comes down on it."""
    n, rows = 24, 8
    turn = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    x = extruded(np.stack([0.1 * np.cos(turn), 0.115 + 0.1 * np.sin(turn)], axis=1), 0.4, rows)
    a = np.arange(n * (rows - 1)).reshape(rows - 1, n)
    b = np.roll(a, -1, axis=1)
    corners = [np.stack([a, b, b + n], axis=-1), np.stack([a, b + n, a + n], axis=-1)]
    cloth = {"vertices": x.tolist(), "triangles": np.concatenate(corners).reshape(-1, 3).tolist()}
    way = [{"time": 0, "position": [0, 0.2, 0.55]}, {"time": 0.5, "position": [0, 0.2, 0.36]}]
    return felt(cloth, {"kind": "plane"}, ball(radius=0.3, path=way, motion="linear"), gravity=DOWN, **more)


SCENES = {
    "stack on a plane": lambda **more: stack({"kind": "plane"}, **more),
    "stack on a ball": lambda **more: stack(ball((0, 0, -0.1), 0.1), **more),
    "fold": fold,
    "crumple": crumple,
    "roll": roll,
    "curtain": curtain,
    "tube": tube,
}
