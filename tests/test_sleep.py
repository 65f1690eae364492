"""Sleep: what falls asleep, that nothing is missed while it sleeps, and where its energy went."""

from dataclasses import replace

import numpy as np
import pytest

import sim
from sim.contact.contacts import UNTOUCHED, touch
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


FLYING = grid((0.3, 0.3), (4, 4), position=[0.01, 0.15, 0.32], rotation=[np.pi / 2, 0, 0])
"""A sheet beside the panel, 15 cm in front of it."""


def visited(speed, panel=PANEL, **settings):
    """A panel at rest without weight, and another that comes up to it, in waves, at a speed [m/s]."""
    world = sim.Simulation(
        scene([panel, FLYING], contact="impulse", cloth_collision="auto", newton=2, **settings)
    )
    velocities = np.zeros_like(world.positions)
    flying = world.pieces == 1
    velocities[flying] = [0.0, -speed, 0.0]
    velocities[flying, 1] += 0.1 * speed * np.random.default_rng(0).standard_normal(flying.sum())
    world.place(world.positions, velocities)
    return world, flying


def test_a_piece_sleeps_alone_and_the_others_have_the_bits_of_a_scene_in_which_it_is_pinned():
    sleeper, flying = visited(0.1, sleep="auto")
    pinned, _ = visited(0.1, panel={**PANEL, "pins": list(range(25))})
    slept = 0
    for _ in range(round(1.2 * AFTER / sleeper.settings.dt)):
        report = sleeper.step()
        pinned.step()
        np.testing.assert_array_equal(sleeper.positions[~flying], sleeper.mesh.vertices[~flying])
        np.testing.assert_array_equal(sleeper.positions, pinned.positions)
        slept += report.sleeping
    assert slept > 0
    assert report.effects["sleep"] == "1 of 2 parts of the cloth sleep"
    assert not sleeper.sleeping[flying].any()
    assert not sleeper.asleep


@pytest.mark.parametrize("speed", [0.15, 4.0])
def test_cloth_that_touches_a_sleeping_piece_wakes_it_in_that_step_as_if_it_had_never_slept(speed):
    """Also where it comes faster than anything that looks ahead by a distance could allow for."""
    sleeper, flying = visited(speed, sleep="auto")
    awake, _ = visited(speed)
    asleep = sleeper.snapshot()
    sleeper.restore(replace(asleep, still=np.array([AFTER, 0.0])))
    while True:
        start = sleeper.snapshot()
        report = sleeper.step()
        if not sleeper.sleeping.any():
            break
        assert not report.contacts
        assert sleeper.time < 2.0
    awake.restore(start)
    awake.switch(sleep="off")
    for _ in range(5):
        awake.step()
        np.testing.assert_array_equal(sleeper.positions, awake.positions)
        sleeper.step()
    assert np.abs(sleeper.velocities[~flying]).max() > 0.01 * speed


LAYERS = [
    grid((0.3, 0.3), (4, 4)),
    grid((0.2, 0.2), (3, 3), position=[0.01, 0.0, 0.011]),
    grid((0.2, 0.2), (3, 3), position=[1.0, 0.0, 0.0]),
]
"""One sheet hardly farther from another than the thickness, and a third far away, all at rest."""


def layers(*more, **settings):
    made = scene(LAYERS, *more, sleep="auto", cloth_collision="auto", thickness=0.01, **settings)
    return sim.Simulation(made)


def asleep_by_piece(world):
    return [bool(world.sleeping[world.pieces == p].all()) for p in range(3)]


def test_layers_fall_asleep_together_and_a_ball_that_comes_near_one_wakes_both():
    path = [{"time": 0.7, "position": [0.0, 0.0, 0.5]}, {"time": 1.0, "position": [0.0, 0.0, 0.05]}]
    world = layers(ball((0, 0, 0), 0.05, path=path, motion="linear"))
    seen = []
    while world.time < 1.0:
        world.step()
        seen.append(asleep_by_piece(world))
        assert seen[-1][0] == seen[-1][1]
    assert [True, True, True] in seen
    assert seen[-1] == [False, False, True]


def test_a_layer_that_slides_keeps_the_one_below_awake():
    world = layers(friction=0.0)
    velocities = np.zeros_like(world.positions)
    velocities[world.pieces == 1, 0] = 1e-3
    world.place(world.positions, velocities)
    for _ in range(round(1.2 * AFTER / world.settings.dt)):
        world.step()
    assert asleep_by_piece(world) == [False, False, True]


def test_contacts_of_sleeping_cloth_go_on_with_the_force_that_they_had():
    old = touch(np.array([7, 3]), np.array([0.2, 0.4]), np.array([0.0, 0.1]), 0.02)
    new = touch(np.array([5, 3]), np.array([1.0, 2.0]), np.zeros(2), 0.01)
    both = new.and_also(old)
    np.testing.assert_array_equal(both.key, [3, 5, 7])
    np.testing.assert_allclose(both.pressed / both.lasted, [200.0, 100.0, 10.0])
    assert new.and_also(UNTOUCHED) is new
    np.testing.assert_array_equal(UNTOUCHED.and_also(old).pressed, old.pressed)


# That nothing which acts is slept through


def at_rest(seed):
    """Sheets at rest without weight, some of them thrown, and obstacles that begin to move, all at random."""
    random = np.random.default_rng(seed)
    cloth = [
        grid((0.2, 0.2), (4, 4), position=random.uniform(-0.3, 0.3, 3).tolist(), rotation=turn.tolist())
        for turn in random.uniform(-3.0, 3.0, (3, 3))
    ]
    obstacles = [moving_thing(random) for _ in range(random.integers(1, 4))]
    settings = {
        "contact": random.choice(["penalty", "impulse", "postprocess"]),
        "detection": random.choice(["static", "continuous"]),
        "each_obstacle": ", ".join(f"{k}=off" for k in range(len(obstacles)) if random.random() < 0.2),
        "thickness": float(10 ** random.uniform(-3.5, -2)),
        "edge_edge": random.choice(["auto", "off"], p=[0.8, 0.2]),
        "tangled": "keep",
        "cloth_collision": "auto",
    }
    return scene(cloth, *obstacles, **settings), random


def moving_thing(random):
    """A ball, box, plane, capsule or triangle that goes from one place at random to another."""
    path = [
        {
            "time": t,
            "position": random.uniform(-0.6, 0.6, 3).tolist(),
            "rotation": [0.0, 0.0, random.normal()],
        }
        for t in (0.02, float(random.uniform(0.05, 0.3)))
    ]
    kinds = [
        ball((0.0, 0.0, 0.0), 0.1),
        {"kind": "box", "center": [0, 0, 0], "size": [0.2, 0.1, 0.05]},
        {"kind": "plane", "normal": random.normal(size=3).tolist()},
        {"kind": "capsule", "start": [0, 0, 0], "end": [0.2, 0, 0], "radius": 0.05},
        {"vertices": [[0.2, 0, 0], [0, 0.2, 0], [0, 0, 0]], "triangles": [[0, 1, 2]]},
    ]
    return {**kinds[random.integers(len(kinds))], "path": path}


def attack(seed, steps=12):
    """Step sheets that sleep beside the same ones awake: in how many steps one slept, and one was woken."""
    made, random = at_rest(seed)
    sleeper, twin = sim.Simulation(made, sleep="auto"), sim.Simulation(made)
    size = np.ptp(sleeper.mesh.rest_vertices, axis=0).max()
    first = random.integers(0, 6)  # half the time none is thrown
    thrown, aim = sleeper.pieces == first, sleeper.pieces == (first + 1) % 3
    way = sleeper.positions[aim].mean(axis=0) - sleeper.positions[sleeper.pieces == first % 3].mean(axis=0)
    speed = way / (sleeper.settings.dt * random.uniform(1.0, steps))
    sleeper.place(sleeper.positions, np.where(thrown[:, None], speed, 0.0))
    start = sleeper.snapshot()
    twin.restore(start)
    try:  # those that something pushes from the first are not at rest
        twin.step()
    except sim.StepError:
        return 0, 0
    moves = np.unique(sleeper.pieces[np.linalg.norm(twin.velocities, axis=1) > SPEED * size])
    sleeper.restore(replace(start, still=np.where(np.isin(np.arange(3), moves), 0.0, AFTER)))
    slept = woken = 0
    for _ in range(steps):
        start, before = sleeper.snapshot(), sleeper.sleeping
        twin.restore(start)
        twin.switch(sleep="off")
        try:
            sleeper.step()
            twin.step()
        except sim.StepError:
            break
        asleep = before & (sleeper.positions == start.positions).all(axis=1)  # all through the step
        slept, woken = slept + asleep.any(), woken + (before & ~sleeper.sleeping).any()
        assert np.abs(twin.velocities[asleep]).max(initial=0.0) <= SPEED * size
        if not asleep.any():
            np.testing.assert_array_equal(sleeper.positions, twin.positions)
    return slept, woken


SEEDS = range(12)


def test_no_state_that_an_adversary_makes_is_slept_through():
    """And it makes states of all sorts: else it would test nothing."""
    slept, woken = np.sum([attack(seed) for seed in SEEDS], axis=0)
    assert slept > 20
    assert woken > 3


@pytest.mark.parametrize("bound", ["touched", "driven"])
def test_cloth_that_slept_through_what_wakes_it_would_be_noticed(monkeypatch, bound):
    """By this search: pieces that nobody wakes, and obstacles that nobody sees coming."""
    nobody = lambda self, *about: np.zeros(3, dtype=bool)  # noqa: E731
    if bound == "touched":
        monkeypatch.setattr(sim.sleep.Rest, bound, nobody)
    else:
        monkeypatch.setattr(sim.simulation, bound, nobody)
    with pytest.raises(AssertionError):
        sum(attack(seed)[0] for seed in SEEDS)


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
