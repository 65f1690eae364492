"""Obstacles that appear inside cloth: it comes out quietly if it can, and is told by name until it has."""

import numpy as np
import pytest

import sim
from sim.contact.response import RECOVERY_SPEED
from tests.contact.judge import offending
from tests.worlds import ball, grid, scene

PINS = ["corner00", "corner10", "corner01", "corner11"]
SHAPES = {
    "box": lambda place: {"kind": "box", "name": "it", "center": place, "size": [0.1, 0.1, 0.1]},
    "ball": lambda place: ball(place, 0.05, name="it"),
    "capsule": lambda place: {
        "kind": "capsule",
        "name": "it",
        "start": [-0.1, 0.0, place[2]],
        "end": [0.1, 0.0, place[2]],
        "radius": 0.03,
    },
}


def appears(kind, place, switched):
    """A sheet on four pins that hangs through an obstacle which it has not felt so far."""
    sheet = grid((0.4, 0.4), (13, 13), pins=PINS)
    made = scene(sheet, SHAPES[kind](place), gravity=[0, 0, -9.81], self_collision="auto", **switched)
    world = sim.Simulation(made)
    for _ in range(15):
        world.step()
    assert offending(world)
    world.update(contact="impulse", obstacles="auto")
    return world


@pytest.mark.parametrize("switched", [{"contact": "none"}, {"obstacles": "off"}])
@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("box", [0.0, 0.0, 0.0]),
        ("box", [0.0, 0.0, -0.03]),
        ("ball", [0.0, 0.0, 0.0]),
        ("capsule", [0.0, 0.0, 0.0]),
    ],
)
def test_pinned_cloth_comes_out_quietly_of_what_appears_inside_it(kind, place, switched):
    """A box once pushed it to four sides at once, in 29 parts a step, and it trembled and stayed inside."""
    world, told = appears(kind, place, switched), 0
    while world.time < 1.75:
        report = world.step()
        assert report.substeps == 1
        assert np.abs(world.velocities).max() < 2.0 * RECOVERY_SPEED  # some of it slips off an edge
        if offending(world):
            told += 1
            assert report.overrun
            assert "overrun by obstacle it" in report.effects["contact"]
    assert told > 0
    assert not report.penetrations
    assert not report.overrun


@pytest.mark.parametrize("kind", ["box", "ball"])
def test_cloth_that_cannot_come_out_as_it_is_pinned_there_is_told_by_name(kind):
    world = appears(kind, [-0.15, -0.15, 0.0], {"contact": "none"})
    for _ in range(90):
        report = world.step()
    assert offending(world)
    assert report.overrun
    assert "overrun by obstacle it" in report.effects["contact"]
    assert np.abs(world.velocities).max() < RECOVERY_SPEED


def test_cloth_wholly_inside_a_box_leaves_it_by_one_side():
    """By the nearest, and keeps its shape."""
    sheet = grid((0.1, 0.1), (6, 6), position=[0.0, 0.0, 0.01])
    box = {"kind": "box", "center": [0.0, 0.0, 0.0], "size": [0.2, 0.2, 0.1]}
    world = sim.Simulation(scene(sheet, box, gravity=[0, 0, 0], contact="none"))
    world.update(contact="impulse")
    while world.time < 1.0:
        world.step()
    np.testing.assert_allclose(world.positions[:, :2], world.mesh.vertices[:, :2], atol=1e-3)
    assert world.positions[:, 2].min() > 0.05
    assert np.ptp(world.positions[:, 2]) < 1e-3
