"""Cloth on obstacles that are meshes: every step judged by ipctk, and what each kind of pair is for."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import sim
from sim.contact import pairs
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE
from tests.contact.judge import Judge
from tests.worlds import ball, grid, scene

G = 9.81
SHEET = {"size": (0.4, 0.4), "resolution": (15, 15)}
FALLING = grid(**SHEET, position=[0.004, 0.003, 0.015])
HELD = grid(**SHEET, pins=["left", "right"])


def body(mesh, **more):
    return {"vertices": mesh.vertices.tolist(), "triangles": mesh.faces.tolist(), **more}


def going(*keys, repeat=False):
    """A path of (time, place, rotation)."""
    path = [{"time": t, "position": p, "rotation": r} for t, p, r in keys]
    return {"path": path, "motion": "linear", "repeat": repeat}


STILL = [0.0, 0.0, 0.0]
NEEDLE = {
    "vertices": [[-0.03, -0.02, -0.4], [0.03, -0.02, -0.4], [0, 0.03, -0.4], [0.011, 0.006, 0]],
    "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
}
RIDGE = [-0.5, 0.006, 0], [0.5, 0.009, 0]
KNIFE = {
    "vertices": [[-0.5, -0.05, -0.3], [0.5, -0.05, -0.3], [-0.5, 0.05, -0.3], [0.5, 0.05, -0.3], *RIDGE],
    "triangles": [[0, 1, 5], [0, 5, 4], [2, 4, 5], [2, 5, 3]],
}
"""Open below and at its ends, which are out of reach."""

ROD = trimesh.creation.box((0.5, 0.01, 0.01))
CASES = {
    "a needle": (FALLING, NEEDLE),
    "a knife": (FALLING, KNIFE),
    "a ball": (FALLING, body(trimesh.creation.icosphere(2, 0.1), position=[0, 0, -0.1])),
    "an open sheet": (
        FALLING,
        {"vertices": [[-0.1, -0.1, 0], [0.1, -0.1, 0], [0, 0.12, 0.01]], "triangles": [[0, 1, 2]]},
    ),
    "a sheet wider than the cloth": (
        FALLING,
        {"vertices": [[-0.9, -0.6, 0], [0.9, -0.6, 0], [0, 1.0, 0.01]], "triangles": [[0, 1, 2]]},
    ),
    "a needle at 10 m/s": (HELD, {**NEEDLE, **going((0.0, [0, 0, -0.1], STILL), (0.03, [0, 0, 0.2], STILL))}),
    "a small ball at 10 m/s": (
        HELD,
        body(
            trimesh.creation.icosphere(1, 0.005),
            **going((0, [0.01, 0.005, 0.3], STILL), (0.06, [0.01, 0.005, -0.3], STILL)),
        ),
    ),
    "a turning rod": (
        HELD,
        body(ROD, **going((0.0, [0, 0, -0.2], STILL), (0.5, [0, 0, 0.05], [0.0, 0.0, 2 * np.pi]))),
    ),
}
STEPS = 40


def whole(world):
    """The cloth and the obstacles as one body, and where it is now."""
    obstacles = world.contact.obstacles
    corners = obstacles.corners(obstacles.poses(world.time))
    n, solid = len(world.positions), obstacles.solid
    x = np.concatenate([world.positions, corners])
    triangles = np.concatenate([world.triangles, solid.triangles + n])
    edges = np.concatenate([world.edges, solid.edges + n])
    return SimpleNamespace(mesh=SimpleNamespace(vertices=x), edges=edges, triangles=triangles), x


def run(case, steps=STEPS, **settings):
    """Steps until one ends with an intersection or went through something: why, or nothing; and reports."""
    world = sim.Simulation(
        scene(*CASES[case], **{"gravity": [0, 0, -G], "self_collision": "auto", **settings})
    )
    parts, x = whole(world)
    judge, reports = Judge(parts), []
    assert judge.clean(x)
    for _ in range(steps):
        before = x
        reports.append(world.step())
        x = whole(world)[1]
        assert np.isfinite(x).all()
        if not judge.clean(x):
            return "intersection", reports
        if reports[-1].substeps == 1 and judge.meetings(before, x):  # else the way had corners
            return "went through", reports
    return "", reports


@pytest.mark.parametrize("case", CASES)
def test_every_step_on_a_mesh_ends_and_is_free_of_intersections(case):
    wrong, reports = run(case)
    assert not wrong
    assert max(report.contacts + report.hits for report in reports) > 0


def without(which, monkeypatch):
    """Let nothing of this kind be found between cloth and obstacles: vertices `None` stand for any."""
    n = SHEET["resolution"][0] * SHEET["resolution"][1]
    measure, meet = pairs.measure, pairs.meet

    def unwanted(kind, node):
        if which == "edges":
            return (kind == EDGE_EDGE) & (node >= n).any(axis=1)
        corner = node[:, 0] >= n
        return (kind == VERTEX_TRIANGLE) & (corner if which == "corners" else ~corner & (node[:, 1] >= n))

    def measured(kind, node, listed, before, now, reach, distance, weight):
        measure(kind, node, listed, before, now, reach, distance, weight)
        distance[unwanted(kind, node)] = np.inf

    def met(kind, node, *rest):
        meet(kind, node, *rest)
        rest[4][unwanted(kind, node)] = np.inf

    monkeypatch.setattr(pairs, "measure", measured)
    monkeypatch.setattr(pairs, "meet", met)


@pytest.mark.parametrize(
    ("case", "which"),
    [
        ("a needle", "corners"),
        ("a needle at 10 m/s", "corners"),
        ("a knife", "edges"),
        ("a sheet wider than the cloth", "vertices"),
    ],
)
def test_each_kind_of_pair_is_needed(case, which, monkeypatch):
    """Corners of obstacles in triangles, edges across edges, vertices in triangles of obstacles."""
    without(which, monkeypatch)
    assert run(case)[0]


@pytest.mark.parametrize("contact", ["penalty", "postprocess"])
def test_other_responses_stay_finite_on_a_mesh(contact):
    world = sim.Simulation(scene(*CASES["a ball"], gravity=[0, 0, -G], contact=contact))
    for _ in range(STEPS):
        world.step()
    assert np.isfinite(world.positions).all()
    assert np.abs(world.velocities).max() < 10.0


def test_cloth_on_a_fine_ball_of_triangles_lies_where_it_does_on_a_ball():
    """After 2/3 s, but for what chords of cloth lift it: before a mesh, all of the cloth keeps its distance.

    Before a ball its vertices do. Diagonals of the sheet, 40 mm long, lift it by 40² / 8 / 105 = 1.9 mm, and
    the middle of a triangle of the mesh is 0.6 mm inside the ball.
    """
    radius, cloth = 0.1, grid(**SHEET, position=[0, 0, 0.11])
    height = {}
    for name, part in (
        ("ball", ball(radius=radius)),
        ("mesh", body(trimesh.creation.icosphere(3, radius))),
    ):
        world = sim.Simulation(scene(cloth, part, gravity=[0, 0, -G]))
        for _ in range(STEPS):
            world.step()
        height[name] = world.positions[:, 2].max()
    assert height["mesh"] == pytest.approx(height["ball"], abs=2.5e-3)
