"""Sleep: what falls asleep, that nothing is missed while it sleeps, and where its energy went."""

import numpy as np
import pytest

import sim
from sim.sleep import AFTER, SPEED
from tests.worlds import ball, grid, scene

EARTH = [0, 0, -9.81]

SIDE = 0.4

PANEL = grid((SIDE, SIDE), (5, 5), pins=["top"], position=[0.0, 0.0, 0.32], rotation=[np.pi / 2, 0, 0])


def settle(made, **settings):
    """A world that sleeps, and one like it that is never left alone, where the first has fallen asleep."""
    sleeper, awake = (sim.Simulation(made, sleep=how, **settings) for how in ("auto", "off"))
    for _ in range(3000):
        report = sleeper.step()
        awake.step()
        np.testing.assert_array_equal(sleeper.positions, awake.positions)
        if sleeper.asleep:
            return sleeper, awake, report
    pytest.fail("it never fell asleep")


def hanging(*more, **settings):
    """A panel that hangs from its top, and comes to rest within a second."""
    return scene([PANEL, *more], gravity=EARTH, gamma=2.0, **settings)


def test_an_awake_cloth_has_the_bits_of_one_that_may_not_sleep_and_falls_asleep_when_it_is_still():
    sleeper, awake, _ = settle(hanging())
    assert np.abs(awake.velocities).max() <= SPEED * SIDE
    assert not sleeper.velocities.any()
    where, time = sleeper.positions.copy(), sleeper.time
    for _ in range(60):
        report = sleeper.step()
        awake.step()
    np.testing.assert_array_equal(sleeper.positions, where)
    assert sleeper.time == pytest.approx(time + 1.0)
    assert report.asleep
    assert report.effects["sleep"] == "asleep"
    assert report.effects["bending"] == "skipped: all cloth is at rest"
    assert report.effects["wind"].startswith("off")
    assert report.ms["total"] < 1.0  # no solve
    assert np.abs(awake.positions - where).max() < 1.1 * SPEED * SIDE * 1.0  # as far as it creeps in a second


def test_what_sleep_takes_is_booked():
    sleeper = sim.Simulation(hanging(), sleep="auto")
    sleeper.keep_ledger()
    for _ in range(3000):
        before = sleeper.energy()["kinetic"]
        report = sleeper.step()
        if sleeper.asleep:
            break
    assert 0.0 < report.discarded == sleeper.ledger.dissipated["sleep"] < 10.0 * before + 1e-12
    assert abs(sleeper.ledger.residual) < 1e-3 * sleeper.ledger.turnover
    sleeper.step()
    assert sleeper.ledger.dissipated["sleep"] == report.discarded


# What wakes it


WAKERS = {
    "gravity": {"gravity": [0.0, 0.5, -9.81]},
    "wind": {"drag": 1.2, "wind": [0.0, 1.0, 0.0]},
    "stiffness": {"stretch": 20.0},
    "an obstacle felt": {"each_obstacle": ""},
}


@pytest.mark.parametrize("name", WAKERS)
def test_a_setting_that_is_moved_wakes_cloth_as_if_it_had_never_slept(name):
    """From the same state it goes the way of one that was awake all along, to the bit."""
    within = ball((0.0, 0.02, 0.3), 0.1, name="within")
    made = {**hanging(), "obstacle": [within]}
    sleeper, awake, _ = settle(made, each_obstacle="within=off")
    for _ in range(20):
        sleeper.step()
    where = sleeper.positions.copy()
    awake.restore(sleeper.snapshot())
    awake.update(sleep="off", **WAKERS[name])
    sleeper.update(**WAKERS[name])
    for _ in range(30):
        assert not sleeper.step().asleep
        awake.step()
    np.testing.assert_array_equal(sleeper.positions, awake.positions)
    assert np.abs(sleeper.positions - where).max() > 1e-4


def test_another_cloth_that_comes_however_slowly_keeps_all_awake():
    """Slow, but twice as fast as what counts as still."""
    cloth = grid((0.3, 0.3), (4, 4), position=[2.0, 0.0, 0.32], rotation=[np.pi / 2, 0, 0])
    sleeper = sim.Simulation(scene([PANEL, cloth], sleep="auto", self_collision="auto"))
    velocities = np.zeros_like(sleeper.positions)
    velocities[sleeper.pieces == 1, 0] = -2.0 * SPEED * np.ptp(sleeper.mesh.rest_vertices, axis=0).max()
    sleeper.place(sleeper.positions, velocities)
    for _ in range(round(3.0 * AFTER / sleeper.settings.dt)):
        assert not sleeper.step().asleep


def turning(first):
    """A ball against which the panel leans, and that begins to turn about its height at a time [s]."""
    path = [{"time": first}, {"time": first + 10.0, "rotation": [0.0, 0.0, 3.0]}]
    return ball((0.0, 0.09, 0.2), 0.1, path=path, motion="linear")


def test_a_ball_that_turns_under_a_sleeping_sheet_wakes_it_and_takes_it_along():
    """Nothing but friction moves it: the ball fills the same space as before."""
    made = scene(PANEL, turning(20.0), gravity=[0, 0.5, -9.81], gamma=2.0, friction=0.8, contact="penalty")
    sleeper, awake, report = settle(made)
    assert report.contacts > 0
    start = sleeper.snapshot()
    while sleeper.step().asleep:
        start = sleeper.snapshot()
    assert sleeper.time == pytest.approx(20.0, abs=0.02)
    awake.restore(start)
    awake.switch(sleep="off")
    awake.step()
    where = start.positions
    for _ in range(30):
        assert not sleeper.step().asleep
        awake.step()
    np.testing.assert_array_equal(sleeper.positions, awake.positions)
    assert np.abs(sleeper.positions - where)[:, 0].max() > 1e-4


def test_an_obstacle_that_moves_out_of_reach_wakes_nobody_and_one_that_comes_does_in_time():
    path = [{"time": 0.0, "position": [0.0, 0.05, -1.5]}, {"time": 30.0, "position": [0.0, 0.05, 1.5]}]
    made = {**hanging(), "obstacle": [ball((0, 0, 0), 0.1, path=path, motion="linear")]}
    sleeper, _, _ = settle(made)
    slept = 0
    while not (report := sleeper.step()).contacts:
        slept += report.asleep
        assert report.penetrations == 0
        assert sleeper.time < 30.0
    assert slept > 100


def test_gusts_let_nobody_sleep():
    sleeper = sim.Simulation(scene(PANEL, sleep="auto", drag=1e-3, wind=[1e-3, 0, 0], gust=1e-3))
    for _ in range(round(3.0 * AFTER / sleeper.settings.dt)):
        assert not sleeper.step().asleep


def test_sleep_is_part_of_a_snapshot():
    sleeper, _, _ = settle(hanging())
    start = sleeper.snapshot()
    sleeper.update(gravity=[1.0, 0.0, 0.0])
    for _ in range(10):
        sleeper.step()
    sleeper.restore(start)
    assert sleeper.asleep
    other = sim.Simulation(hanging(), sleep="auto")
    other.restore(start)
    assert other.step().asleep
    np.testing.assert_array_equal(other.positions, start.positions)
