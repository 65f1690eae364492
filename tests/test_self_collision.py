"""Cloth that feels cloth: whole steps, judged by exact intersections and by conservation laws."""

import numpy as np
import pytest

import sim
from tests.worlds import ball, chain, grid, scene

EARTH = [0, 0, -9.81]


def stack(**settings):
    """Three sheets that fall on a ball, one on the other."""
    sheets = [
        grid(resolution=(14, 14), position=[0, 0, 0.31 + 0.01 * i], rotation=[0, 0, 0.3 * i])
        for i in range(3)
    ]
    return {"cloth": sheets, "obstacle": [ball()], "settings": {"thickness": 4e-3, **settings}}


def crumple(**settings):
    """A sheet that falls on its edge."""
    cloth = grid(resolution=(16, 16), rotation=[1.3, 0.2, 0.1], position=[0, 0, 0.6])
    return scene(cloth, {"kind": "plane"}, gravity=EARTH, self_collision="auto", **settings)


def crossings(world):
    return len(sim.intersections(world.positions, world.triangles))


@pytest.mark.parametrize("made", [stack, crumple])
def test_impulses_leave_no_edge_across_a_triangle_at_any_step(made):
    world = sim.Simulation(made())
    met = 0
    for _ in range(90):
        report = world.step()
        met += report.contacts + report.hits
        assert crossings(world) == 0
    assert met > 100  # it was put to the test


def test_without_cloth_collision_the_same_sheets_pass_through_each_other():
    world = sim.Simulation(stack(), cloth_collision="off")
    assert max(crossings(world) for _ in range(60) if world.step()) > 0


def collide(speed, **settings):
    """A free sheet shot at another that lies askew to it."""
    sheets = [
        grid(resolution=(10, 10)),
        grid(resolution=(10, 10), position=[0.1, 0.05, 0.2], rotation=[0.2, 0.1, 0]),
    ]
    world = sim.Simulation({"cloth": sheets, "settings": {"gravity": [0, 0, 0], **settings}})
    velocities = np.zeros_like(world.positions)
    velocities[world.pieces == 1, 2] = -speed
    world.place(world.positions.copy(), velocities)
    return world


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_an_impact_of_free_sheets_keeps_their_momentum(speed):
    world = collide(speed)
    before = world.momentum()[0]
    met = sum(report.contacts + report.hits for report in (world.step() for _ in range(40)))
    assert met > 0
    assert (
        np.abs(world.momentum()[0] - before).max() < 1e-10 * np.abs(before).max() * 40
    )  # per step, relative
    assert crossings(world) == 0


def test_the_bits_do_not_depend_on_the_number_of_threads():
    ends = []
    for threads in (1, 2):
        world = sim.Simulation(stack(threads=threads))
        for _ in range(30):
            world.step()
        ends.append(world.positions.copy())
    assert (ends[0] == ends[1]).all()


def test_confined_to_a_plane_nothing_leaves_it_and_chains_do_not_pass_each_other():
    """Two chains side by side in the plane y = 0 stay one above the other where they rest on a ball."""
    x = np.linspace(-0.4, 0.4, 33)
    low = np.column_stack([x, 0 * x, 0 * x + 0.32])
    chains = [chain(low, [0.01] * 33), chain(low + np.array([0, 0, 0.05]), [0.01] * 33)]
    world = sim.Simulation(
        {
            "plane": "xz",
            "cloth": chains,
            "obstacle": [ball()],
            "settings": {"thickness": 4e-3, "gravity": EARTH},
        }
    )
    for _ in range(60):
        world.step()
        assert (world.positions[:, 1] == 0.0).all()
    top = np.abs(world.positions[:33, 0]) < 0.1
    lower, upper = world.positions[:33][top], world.positions[33:][top]
    assert (np.linalg.norm(upper, axis=1).min() > np.linalg.norm(lower, axis=1)).all()


@pytest.mark.parametrize("detection", ["static", "continuous"])
def test_putting_right_afterwards_keeps_a_sheet_out_of_the_ball(detection):
    cloth = grid(resolution=(14, 14), position=[0, 0, 0.31])
    settings = {"contact": "postprocess", "detection": detection, "self_collision": "auto"}
    world = sim.Simulation(scene(cloth, ball(), gravity=EARTH, **settings))
    reports = [world.step() for _ in range(60)]
    assert max(r.contacts for r in reports) > 0
    assert all(r.penetrations == 0 for r in reports)


@pytest.mark.parametrize("detection", ["static", "continuous"])
def test_what_sheets_push_each_other_into_is_put_right_as_well(detection):
    """Three of them hit the ball at 5 m/s, where the upper push the lowest; the ball has the last word."""
    sheets = [grid((0.4, 0.4), (6, 6), position=[0.013 * k, 0.007 * k, 0.03 + 0.012 * k]) for k in range(3)]
    how = {"contact": "postprocess", "detection": detection, "self_collision": "auto", "dt": 1 / 30}
    world = sim.Simulation(scene(sheets, ball((0, 0, -0.2), 0.2), gravity=EARTH, **how))
    speed = 5.0 + 0.5 * np.random.default_rng(0).standard_normal(len(world.positions))
    world.place(world.positions, np.outer(speed, [0, 0, -1]))
    for _ in range(15):
        assert world.step().deepest == 0.0


@pytest.mark.parametrize("newton", [1, 2])
@pytest.mark.parametrize("contact", ["impulse", "penalty"])
@pytest.mark.parametrize(("rows", "turned"), [(6, 0.3), (9, 0.3), (14, 0.0)])
def test_cloth_slides_on_flat_cloth_without_friction(rows, turned, contact, newton):
    """By gravity along it: what lies beside nearest points is no ramp, neither to borders nor to edges.

    At the border of the upper sheet a little of one is left. It was all of it, and half with penalty.
    """
    below = grid((1.2, 0.5), (13, 6), position=[0.3, 0, 0], pins=list(range(78)))
    above = grid((0.2, 0.2), (rows, rows), position=[0.003, 0.001, 4e-3], rotation=[0, 0, turned])
    assert 0.98 < slides([below, above], contact=contact, newton=newton) < 1.001


@pytest.mark.parametrize("contact", ["impulse", "penalty"])
@pytest.mark.parametrize("kind", ["strip", "chain"])
def test_strips_and_chains_slide_on_flat_ones_in_their_plane(kind, contact):
    """A chain has few contacts, which come and go as its ends swing."""
    if kind == "strip":
        below = grid((1.2, 0.05), (33, 2), position=[0.3, 0, 0], pins=list(range(66)))
        above = grid((0.2, 0.05), (8, 2), position=[0.003, 0, 4e-3])
    else:
        below, above = (
            {
                "vertices": [[x, 0.0, z] for x in ticks.tolist()],
                "edges": [[k, k + 1] for k in range(len(ticks) - 1)],
            }
            for ticks, z in ((np.linspace(-0.3, 0.9, 33), 0.0), (np.linspace(-0.097, 0.103, 8), 4e-3))
        )
        below["pins"] = list(range(33))
    assert 0.95 < slides([below, above], contact=contact, newton=4, plane="xz") < 1.01


def slides(cloth, plane=None, **more):
    """What the second piece gains of the speed that gravity along it should give it on the first, pinned."""
    along, h, speeds = 2.9, 1 / 60, []
    how = {"friction": 0.0, "thickness": 4e-3, "dt": h, "self_collision": "auto", **more}
    made = scene(cloth, gravity=[along, 0, -9.4], **how) | ({"plane": plane} if plane else {})
    world = sim.Simulation(made)
    for _ in range(20):
        world.step()
        speeds.append(world.velocities[world.pieces == 1, 0].mean())
    return (speeds[-1] - speeds[4]) / (along * 15 * h)
