"""What a step says about its effects: here, when something may have gone through unseen or unstopped."""

import numpy as np
import pytest

import sim
from tests.worlds import ball, chain, grid, scene

SURE = {"contact": "impulse", "detection": "continuous"}
UNSURE = [
    ({"contact": "impulse", "detection": "static"}, "looked for once per step"),
    ({"contact": "penalty", "detection": "static"}, "looked for once per step"),
    ({"contact": "penalty", "detection": "continuous"}, "springs give way"),
    ({"contact": "postprocess", "detection": "continuous"}, "put right once"),
]


def passing(way, **settings):
    """The report of a step in which a sheet far from a ball goes by `way` [m]."""
    world = sim.Simulation(scene(grid(position=[0, 0, 1]), ball(), dt=0.01, thickness=5e-3, **settings))
    world.place(world.positions.copy(), np.full_like(world.positions, way / 0.01 / 3**0.5))
    return world.step()


@pytest.mark.parametrize(("settings", "why"), UNSURE)
def test_a_step_says_that_it_may_tunnel_where_cloth_goes_farther_than_its_thickness(settings, why):
    fast, slow = passing(6e-3, **settings), passing(4e-3, **settings)
    assert fast.moved == pytest.approx(6e-3)
    assert f"may tunnel: moved 6 mm, thickness 5 mm, {why}" in fast.effects["contact"]
    assert "tunnel" not in slow.effects["contact"]


@pytest.mark.parametrize("settings", [SURE, {"contact": "none"}])
def test_nothing_is_said_where_nothing_is_let_through_or_everything(settings):
    assert not any("tunnel" in words for words in passing(6e-3, **settings).effects.values())


def test_self_collision_says_it_by_its_own_thickness():
    """0.4 of an edge of 2 mm is 0.8 mm."""
    cloth = grid(size=(0.02, 0.02), resolution=(11, 11))
    settings = {"contact": "penalty", "self_collision": "on", "dt": 0.01, "thickness": 5e-3}
    world = sim.Simulation(scene(cloth, **settings))
    world.place(world.positions.copy(), np.full_like(world.positions, 0.2 / 3**0.5))
    words = world.step().effects
    assert "may tunnel: moved 2 mm, thickness 0.8 mm" in words["self-collision"]
    assert "tunnel" not in words["contact"]


STEP = {"dt": 0.01}
THERE = [{"time": 0.0}, {"time": 0.01, "rotation": [0.0, 0.0, 0.1]}]
MOVING = {
    "a sphere that goes": (ball(path=[{"time": 0.0}, {"time": 0.01, "position": [0.3, 0.0, 0.4]}]), 0.5),
    "a sphere that turns": (ball(path=THERE), 0.0),
    "a box that turns": (
        {"kind": "box", "center": [0, 0, 0], "size": [0.6, 0.8, 0.0001], "path": THERE},
        0.5 * 2 * np.sin(0.05),
    ),
    "a mesh that turns": (
        {"vertices": [[0.3, 0.4, 0], [0, 0, 0], [0, 0, 1]], "triangles": [[0, 1, 2]], "path": THERE},
        0.5 * 2 * np.sin(0.05),
    ),
}


@pytest.mark.parametrize("name", MOVING)
def test_the_way_of_an_obstacle_counts(name):
    """A point at distance r from the axis goes 2 r sin(φ/2) in a turn by φ."""
    obstacle, way = MOVING[name]
    still = chain([[2, 0, 0], [2.1, 0, 0]], [0.1, 0.1], pins=[0, 1])
    report = sim.Simulation(scene(still, {"motion": "linear", **obstacle}, **STEP)).step()
    assert report.moved == pytest.approx(way, rel=1e-6, abs=1e-12)
