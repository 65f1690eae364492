"""Obstacles that move, fast and in long steps: cloth that can give way is not run over, else it is told."""

import numpy as np
import pytest
import trimesh

import sim
from sim.contact import pipeline
from sim.stress.contact import loose_triangles
from sim.stress.keep import load, pack, save
from tests.contact.judge import offending
from tests.worlds import ball, grid, scene

DOWN = [0, 0, -9.81]


def body(mesh, **more):
    return {"vertices": mesh.vertices.tolist(), "triangles": mesh.faces.tolist(), **more}


SHAPES = {
    "sphere": lambda size, **path: ball(radius=size, **path),
    "capsule": lambda size, **path: {
        "kind": "capsule",
        "start": [-size, 0, 0],
        "end": [size, 0.3 * size, 0],
        "radius": 0.3 * size,
        **path,
    },
    "box": lambda size, **path: {
        "kind": "box",
        "center": [0, 0, 0],
        "size": [2 * size, size, 0.5 * size],
        **path,
    },
    "cone": lambda size, **path: body(trimesh.creation.cone(0.7 * size, 2 * size, sections=4), **path),
    "cylinder": lambda size, **path: body(
        trimesh.creation.cylinder(0.5 * size, 2 * size, sections=8), **path
    ),
    "torus": lambda size, **path: body(
        trimesh.creation.torus(size, 0.3 * size, major_sections=10, minor_sections=6), **path
    ),
}


def touched(world):
    """How much of the cloth crosses itself, or is not outside of every obstacle."""
    return len(offending(world))


def shot(kind, seed):
    """Loose triangles or small sheets, and one obstacle that flies through them and back, turning."""
    rng = np.random.default_rng(seed)
    if rng.random() < 0.5:
        x = 0.5 * loose_triangles(rng, 8)
        cloth = {
            "vertices": x.reshape(-1, 3).tolist(),
            "triangles": np.arange(3 * len(x)).reshape(-1, 3).tolist(),
        }
    else:
        cloth = [
            grid((0.3, 0.3), (5, 5), position=[0.02 * k, 0, 0.02 * k]) for k in range(rng.integers(1, 4))
        ]
    place, speed = rng.uniform([-0.1, -0.1, 0.3], [0.1, 0.1, 0.5]), 10 ** rng.uniform(0, 1.3)
    keys = [
        {
            "time": 0.8 * k / speed,
            "position": (place * [1, 1, (-1) ** k]).tolist(),
            "rotation": (k * rng.uniform(-2, 2, 3)).tolist(),
        }
        for k in range(4)
    ]
    part = SHAPES[kind](10 ** rng.uniform(-2, -0.8), path=keys, motion="linear")
    how = {
        "dt": rng.choice([1 / 60, 1 / 30, 0.1, 0.3]),
        "thickness": rng.choice([1e-4, 1e-3, 5e-3, 2e-2]),
        "friction": rng.choice([0.0, 0.3, 2.0]),
        "stretch": 10 ** rng.uniform(0, 3),
    }
    return scene(cloth, part, gravity=DOWN, self_collision="auto", **{k: float(v) for k, v in how.items()})


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("cylinder", 21),
        ("cone", 23),
        ("cylinder", 23),
        ("capsule", 23),
        ("sphere", 19),
        ("box", 20),
        ("torus", 19),
    ],
)
def test_cloth_that_can_give_way_is_not_run_over(kind, seed):
    """Not even where no impulse finds a way: it goes along with what comes."""
    world = sim.Simulation(shot(kind, seed))
    assert not touched(world)
    for _ in range(12):
        report = world.step()
        assert not touched(world)
        assert not report.overrun


def test_what_can_move_of_a_triangle_is_not_run_over_where_its_pinned_edge_is_passed_closely():
    """Nothing can help that the edge comes nearer than the gap; what meets then lies beside it."""
    x = [[0.248, 0.08, -0.006], [0.248, 0.132, -0.006], [0.145, 0.132, -0.006]]
    keys = (
        (0.0, [0.297, 0.075, 0.156], [0, 0, 0]),
        (0.0703, [-0.318, 0.007, -0.274], [-2.348, -0.231, -0.756]),
    )
    path = [dict(zip(("time", "position", "rotation"), key, strict=True)) for key in keys]
    plate = {"kind": "box", "center": [0, 0, 0], "size": [0.01, 0.179, 0.198]}
    cloth = {"vertices": x, "triangles": [[0, 1, 2]], "pins": [0, 1]}
    how = {"gravity": DOWN, "dt": 1 / 266, "thickness": 0.0115}
    world, hits = sim.Simulation(scene(cloth, {**plate, "path": path, "motion": "linear"}, **how)), 0
    for _ in range(4):
        hits += world.step().hits
        assert not touched(world)
    assert hits


def check_the_last_resort_alone(made, monkeypatch):
    """Without rounds of impulses, and in whole steps; returns the world at the end."""
    monkeypatch.setattr(pipeline, "MOST_ROUNDS", 0)
    monkeypatch.setattr(pipeline, "MOST_HALVINGS", 0)
    world, reports = sim.Simulation(made), []
    for _ in range(6):
        reports.append(world.step())
        assert not touched(world)
    assert max(report.held_back for report in reports) > 0
    assert max(report.overrun for report in reports) == 0
    return world


@pytest.mark.parametrize("kind", ["sphere", "capsule", "box", "cone", "torus"])
def test_the_last_resort_alone_takes_cloth_along(kind, monkeypatch):
    path = [{"time": 0.0, "position": [0.01, 0.02, 0.2]}, {"time": 0.1, "position": [0.0, 0.0, -0.8]}]
    part, sheet = SHAPES[kind](0.06, path=path, motion="linear"), grid((0.3, 0.3), (7, 7))
    check_the_last_resort_alone(scene(sheet, part, friction=0.0, self_collision="auto"), monkeypatch)


def test_the_last_resort_alone_takes_cloth_along_before_a_plane(monkeypatch):
    """The lower sheet is not stopped for the upper one's sake while the plane goes on."""
    path = [{"time": 0.0, "position": [0, 0, -0.3]}, {"time": 0.1, "position": [0, 0, 0.2]}]
    sheets = [grid((0.3, 0.3), (5, 5), position=[0.01 * k, 0.0, 0.02 * k]) for k in range(2)]
    plane = {"kind": "plane", "path": path, "motion": "linear"}
    check_the_last_resort_alone(scene(sheets, plane, friction=0.0, self_collision="auto"), monkeypatch)


def test_the_last_resort_takes_cloth_along_within_its_plane(monkeypatch):
    """A strip that may not move sideways, where what comes does."""
    path = [{"time": 0.0, "position": [0.01, 0.02, -0.3]}, {"time": 0.1, "position": [0.0, 0.22, 0.7]}]
    box = {"kind": "box", "center": [0, 0, 0], "size": [0.1, 0.8, 0.1], "path": path, "motion": "linear"}
    made = scene(grid((0.56, 0.04), (15, 2)), box, friction=0.0, self_collision="auto")
    world = check_the_last_resort_alone(made | {"plane": "xz"}, monkeypatch)
    np.testing.assert_array_equal(world.positions[:, 1], world.mesh.vertices[:, 1])
    assert not world.velocities[:, 1].any()


def through_pins(kind):
    """A sheet on two pins, and an obstacle that comes up through both of them and goes down again."""
    low, high = [-0.2, -0.2, -0.3], [-0.2, -0.2, 0.02]
    path = [{"time": t, "position": p} for t, p in ((0.0, low), (0.3, high), (0.4, high), (0.7, low))]
    shape = {"kind": "plane", "path": path} if kind == "plane" else SHAPES[kind](0.05, path=path)
    sheet = grid((0.4, 0.4), (6, 6), pins=["corner00", "corner11"])
    return sim.Simulation(scene(sheet, shape, self_collision="auto"))


@pytest.mark.parametrize("kind", ["sphere", "box", "plane", "cone", "cylinder"])
def test_what_is_pinned_is_run_over_and_that_is_told_until_the_obstacle_is_gone(kind):
    world, reports = through_pins(kind), []
    while world.time < 1.0:
        reports.append(world.step())
        if touched(world):
            assert reports[-1].overrun
            assert "overrun" in reports[-1].effects["contact"]
    assert any(report.overrun for report in reports)
    assert not reports[-1].overrun
    assert not touched(world)


def test_what_is_run_over_is_part_of_a_snapshot(tmp_path):
    world = through_pins("cone")
    while not world.step().overrun:
        pass
    middle, files = world.snapshot(), save(pack(world, world.snapshot()), tmp_path / "cone")
    kept = load(files[0])
    ends = []
    for each in (world, kept, world):
        if ends:
            each.restore(middle)
        while each.time < 1.0:
            report = each.step()
        ends.append(each.positions.copy())
        assert not report.overrun
    for end in ends[1:]:
        np.testing.assert_array_equal(ends[0], end)


@pytest.mark.parametrize("kind", ["sphere", "box", "cone", "cylinder"])
def test_vertices_without_edges_are_not_run_over(kind):
    """Bare points meet mesh obstacles, too, and have the same last resort as all cloth."""
    x = np.random.default_rng(5).uniform([-0.1, -0.1, -0.02], [0.1, 0.1, 0.02], (30, 3))
    points = {"vertices": x.tolist(), "edges": [], "masses": [1e-3] * len(x)}
    path = [
        {"time": 0.0, "position": [0, 0, -0.3]},
        {"time": 0.1, "position": [0, 0, 0.4], "rotation": [1, 1, 0]},
    ]
    world = sim.Simulation(scene(points, SHAPES[kind](0.1, path=path, motion="linear")))
    for _ in range(8):
        report = world.step()
        assert not report.overrun
        assert not report.penetrations
        for shell, (position, rotation) in zip(world.mesh.shells, world.obstacle_poses(), strict=True):
            if shell is not None:
                local = (world.positions - position) @ rotation
                assert not any(shell.encloses(place) for place in local)
    assert world.positions[:, 2].max() > 0.1  # some of them were met


@pytest.mark.parametrize("cloth", ["points", "sheet"])
def test_a_pinch_is_told_as_long_as_it_lasts_and_nothing_is_left_of_it(cloth):
    """Two boxes close on cloth, overlap, and part again."""
    points = {"vertices": [[0, 0, 0], [0.01, 0, 0], [0.02, 0.01, 0]], "edges": [], "masses": [1e-3] * 3}
    jaws = [
        {
            "kind": "box",
            "center": [0, 0, 0],
            "size": [0.4, 0.4, 0.12],
            "path": [
                {"time": t, "position": [0, 0, side * z]}
                for t, z in ((0.0, 0.3), (0.2, 0.05), (0.4, 0.05), (0.6, 0.3))
            ],
            "motion": "linear",
        }
        for side in (1, -1)
    ]
    about = points if cloth == "points" else grid((0.1, 0.1), (4, 4))
    world, overlapped = sim.Simulation(scene(about, *jaws, self_collision="auto")), 0
    while world.time < 0.6:
        report = world.step()
        if report.penetrations:
            overlapped += 1
            assert report.overrun
            assert "pinched" in report.effects["contact"]
    assert overlapped > 10
    assert not report.overrun
    assert np.abs(world.positions).max() < 0.2


@pytest.mark.parametrize("switched", [{"contact": "none"}, {"obstacles": "off"}])
def test_cloth_found_across_a_mesh_is_told_and_let_go_of_as_the_mesh_leaves(switched):
    """It is not hung up on the edges that it was across when contact was switched on."""
    path = [{"time": t, "position": [0, 0, z]} for t, z in ((0.0, 0.0), (0.1, 0.0), (0.2, 2.0))]
    shape = body(trimesh.creation.icosphere(1, 0.1), path=path)
    sheet = grid((0.3, 0.3), (9, 9), position=[0, 0, 0.12])
    world = sim.Simulation(scene(sheet, shape, gravity=DOWN, self_collision="auto", **switched))
    for _ in range(6):
        world.step()
    assert touched(world)
    world.update(contact="impulse", obstacles="auto")
    while world.time < 0.45:
        report = world.step()
        assert report.overrun or not touched(world)
    assert not report.overrun
    assert world.positions[:, 2].max() < 0.12  # it falls on, and is not taken along


def test_cloth_that_belongs_inside_a_mesh_stays_inside():
    room = trimesh.creation.box((1.0, 1.0, 1.0))
    world = sim.Simulation(scene(grid((0.3, 0.3), (5, 5)), body(room), gravity=DOWN))
    while world.time < 1.0:
        assert not world.step().overrun
    assert world.positions[:, 2].min() > -0.5


def test_what_passes_closely_by_a_pin_runs_over_nothing():
    """Nearer than continuous detection lets cloth that can move."""
    path = [
        {"time": 0.0, "position": [-0.25 - 1e-4, -0.2, -0.3]},
        {"time": 0.1, "position": [-0.25 - 1e-4, -0.2, 0.3]},
    ]
    world = sim.Simulation(
        scene(grid((0.4, 0.4), (6, 6), pins=["corner00"]), ball(radius=0.05, path=path, motion="linear"))
    )
    for _ in range(8):
        assert not world.step().overrun
        assert not touched(world)


def test_what_is_pressed_to_nothing_is_not_thrown():
    """A mesh and a plane close on a soft sheet close to its pins: contacts ask for more than there is.

    Their impulses once threw it aside at 118 m/s, and what they had thrown the next ones threw further.
    """
    down, up = (
        {"path": [{"time": 0.0, "position": a}, {"time": 1.0, "position": b}], "motion": "linear"}
        for a, b in (([0.12, 0.03, 0.24], [0.12, 0.03, -0.25]), ([0, 0, -0.3], [0, 0, 0.1]))
    )
    mesh, plane = body(trimesh.creation.icosphere(1, 0.1), **down), {"kind": "plane", **up}
    sheets = [
        grid((0.4, 0.4), (7, 9), pins=["right"]),
        grid((0.3, 0.3), (6, 6), position=[0.02, 0.0, 0.03]),
    ]
    how = {"density": 2.9, "stretch": 7.0, "bending": 6e-3, "gamma": 0.0, "friction": 0.0}
    made = scene(sheets, mesh, plane, gravity=DOWN, self_collision="auto", dt=0.1, thickness=5e-3, **how)
    world, reports = sim.Simulation(made), []
    while world.time < 1.0:
        reports.append(world.step())
        assert np.abs(world.velocities).max() < 9.81 * world.time + 0.5  # it fell, and what came had 0.49 m/s
    assert sum(report.held_back for report in reports) > 0  # else nothing is shown


def test_a_strain_limit_does_not_have_a_box_run_over_cloth_that_could_stretch():
    """The cloth is held all around, so that its limit leaves the box no way; contact has the last word."""
    start, end = [-0.08, 0.001, 0.35], [-0.08, 0.001, -0.32]
    way = [{"time": 0.06, "position": start}, {"time": 0.175, "position": end, "rotation": [5.4, -4.5, 8.3]}]
    box = {"kind": "box", "center": start, "size": [0.123, 0.073, 0.123], "path": way, "motion": "linear"}
    cloth = grid((0.6, 0.6), (7, 7), position=[0.033, -0.029, 0.0], pins=["left", "right", "top", "bottom"])
    more = {"thickness": 1e-3, "friction": 1.0, "stretch": 20.0, "gamma": 1.0, "bend": "cross"}
    world = sim.Simulation(scene(cloth, box, dt=1 / 30, strain_limit=0.1, **more))
    assert sum(world.step().overruns for _ in range(14)) == 0
