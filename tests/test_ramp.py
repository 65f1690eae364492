"""Live changes of stiffness and rest angle: gentle, booked to the joule, and undone as a whole."""

import math

import numpy as np
import pytest

import sim
from sim import ramp
from sim import simulation as module
from sim.solve.implicit import SolveError
from tests.worlds import grid, scene

EARTH = [0.0, 0.0, -9.81]

STEPS = 6
"""Steps of 1/60 s in the tenth of a second that a change takes."""

ROUNDING = 1e-9
"""Part of the energy moved that differs by how often it was added up; each sum is good to 1e-13."""


def curtain(steps=12, **settings):
    """A sheet that hangs from its top and swings a little."""
    sheet = grid(size=(0.6, 0.6), resolution=(7, 7), rotation=[1.2, 0, 0], pins=["top"])
    springs = {"stretch": 20.0, "altitudes": "all", "altitude": 20.0, "bending": 1e-4, "rest_angle": 0.05}
    world = sim.Simulation(scene(sheet, gravity=EARTH, **{**springs, **settings}))
    for _ in range(steps):
        world.step()
    return world


def state(world):
    """Positions and velocities to the bit."""
    return world.positions.tobytes(), world.velocities.tobytes()


def potential(world, **settings):
    """Energy [J] of the springs at the world's positions, in a simulation that never knew other settings."""
    twin = curtain(steps=0, **settings)
    twin.place(world.positions)
    return sum(twin.energy().values())


def between(name, first, last, step, steps=STEPS):
    """The value after so many steps: stiffnesses go by equal factors, an angle by equal parts."""
    part = min(step / steps, 1.0)
    return first + part * (last - first) if name == "rest_angle" else first * (last / first) ** part


CHANGES = [
    ("stretch", 20.0, 20_000.0),
    ("stretch", 20.0, 2.0),
    ("altitude", 20.0, 500.0),
    ("bending", 1e-4, 1e-2),
    ("rest_angle", 0.05, -0.6),
]


# The way


def hanging_speeds(duration, monkeypatch):
    """Largest speed [m/s] of a sheet that becomes a thousand times as stiff, and how far it goes [m]."""
    sheet = grid(size=(0.6, 0.6), resolution=(7, 7), rotation=[math.pi / 2, 0, 0], pins=["top"])
    hanging = scene(sheet, gravity=EARTH, dt=1 / 240, newton=20, tolerance=1e-8)
    world = sim.equilibrium(hanging, stretch=20.0)
    begin = world.positions.copy()
    world.step()
    monkeypatch.setattr(ramp, "DURATION", duration)
    world.update(stretch=20_000.0)
    speeds = []
    while world.time < 0.3:
        world.step()
        speeds.append(np.linalg.norm(world.velocities, axis=1).max())
    return max(speeds), np.linalg.norm(world.positions - begin, axis=1).max()


def test_stiffening_a_hanging_cloth_a_thousandfold_does_not_jerk_it(monkeypatch):
    """The rest shape itself, a stretch of `way` / stiffness, leaves at way · ln 1000 / 0.1 s and slows down.

    Cloth that goes over lags behind that and is no faster; changed at once, it is thrown.
    """
    speed, way = hanging_speeds(ramp.DURATION, monkeypatch)
    gentle = way * math.log(1000.0) / 0.1
    assert 0.1 * gentle < speed < gentle
    assert hanging_speeds(1e-9, monkeypatch)[0] > 2.0 * gentle


@pytest.mark.parametrize(("name", "first", "last"), CHANGES)
def test_a_change_goes_over_in_a_tenth_of_a_second(name, first, last):
    world = curtain()
    world.update(**{name: last})
    for step in range(STEPS + 2):
        now = sum(world.energy().values()) - world.energy()["kinetic"]
        value = between(name, first, last, step)
        assert now == pytest.approx(potential(world, **{name: value}), rel=ROUNDING)
        world.step()


@pytest.mark.parametrize(("name", "first", "last"), CHANGES)
def test_the_energy_booked_is_what_each_part_of_a_change_puts_in(name, first, last):
    """Against twins that have the settings before and after each part, at the positions where it acted."""
    world = curtain()
    world.update(**{name: last})
    found, expected = [], []
    for step in range(1, STEPS + 3):
        before, after = (between(name, first, last, s) for s in (step - 1, step))
        expected.append(potential(world, **{name: after}) - potential(world, **{name: before}))
        found.append(world.step().energy_injected)
    size = np.abs(expected).max()
    assert found == pytest.approx(expected, abs=ROUNDING * size + 1e-14)
    assert found[STEPS:] == [0.0, 0.0]
    assert size > 0.0


def test_settings_show_the_target_at_once():
    world = curtain()
    world.update(stretch=20_000.0, rest_angle=-0.6, gamma=0.7)
    assert (world.settings.stretch, world.settings.rest_angle, world.settings.gamma) == (20_000.0, -0.6, 0.7)


def test_a_change_at_time_zero_acts_at_once():
    world = curtain(steps=0)
    before = potential(world)
    world.update(stretch=20_000.0, rest_angle=-0.6)
    fresh = curtain(steps=0, stretch=20_000.0, rest_angle=-0.6)
    assert world.energy() == fresh.energy()
    put_in = sum(fresh.energy().values()) - before
    assert put_in > 1e-6  # the angle's: nothing is stretched yet
    assert world.step().energy_injected == pytest.approx(put_in, rel=ROUNDING)
    fresh.step()
    assert state(world) == state(fresh)


def test_a_change_from_zero_and_to_zero_goes_by_equal_parts():
    """Which has no logarithm."""
    world = curtain(altitude=0.0)
    world.update(altitude=60.0)
    for _ in range(3):
        world.step()
    half = world.energy()["altitude"]
    twin = curtain(steps=0, altitude=30.0)
    twin.place(world.positions)
    assert half == pytest.approx(twin.energy()["altitude"], rel=ROUNDING)
    world.update(altitude=0.0)
    for _ in range(STEPS):
        world.step()
    assert world.energy()["altitude"] == 0.0


def test_what_a_change_has_still_to_book_is_part_of_a_snapshot():
    world = curtain(steps=0)
    world.update(rest_angle=-0.6)
    saved, put_in = world.snapshot(), world.step().energy_injected
    assert put_in > 1e-6
    other = curtain()
    other.restore(saved)
    assert other.step().energy_injected == put_in
    assert other.step().energy_injected == 0.0


def test_a_second_change_starts_from_where_the_first_was():
    """Halfway from 20 to 20,000 N is 632 N; from there to 5 N, with the energy as it was."""
    world = curtain()
    world.update(stretch=20_000.0)
    for _ in range(STEPS // 2):
        world.step()
    energy, halfway = world.energy(), math.sqrt(20.0 * 20_000.0)
    world.update(stretch=5.0)
    assert world.energy() == pytest.approx(energy, rel=ROUNDING)
    for step in range(1, STEPS + 1):
        before, after = (between("stretch", halfway, 5.0, s) for s in (step - 1, step))
        put_in = potential(world, stretch=after) - potential(world, stretch=before)
        assert world.step().energy_injected == pytest.approx(put_in, rel=1e-6, abs=1e-12)
    now = sum(world.energy().values()) - world.energy()["kinetic"]
    assert now == pytest.approx(potential(world, stretch=5.0), rel=ROUNDING)


def test_changes_between_two_steps_are_booked_together():
    """Two that act at once: cloth of another weight is lifted and moves, and altitudes let go."""
    world = curtain()
    before = sum(world.energy().values())
    world.update(density=0.4)
    world.update(altitudes="none")
    put_in = sum(world.energy().values()) - before
    assert world.step().energy_injected == pytest.approx(put_in, rel=ROUNDING)


def test_a_step_longer_than_the_way_takes_it_at_once():
    world = curtain(dt=0.2, steps=1)
    world.update(stretch=200.0)
    put_in = potential(world, stretch=200.0) - potential(world)
    assert world.step().energy_injected == pytest.approx(put_in, rel=ROUNDING)


# Transactions


def midway(**settings):
    """A world in the third of six steps of a change."""
    world = curtain(**settings)
    world.update(stretch=20_000.0, rest_angle=-0.6)
    for _ in range(2):
        world.step()
    return world


def goes_on(world, steps=8):
    """What follows to the bit: states, and energies booked."""
    booked = [world.step().energy_injected for _ in range(steps)]
    return state(world), booked


@pytest.mark.parametrize("integrator", ["backward_euler", "bdf2"])
def test_a_snapshot_during_a_change_restores_it_to_the_bit(integrator):
    world = midway(integrator=integrator)
    saved, settings = world.snapshot(), world.settings
    once = goes_on(world)
    world.update(stretch=3.0)
    world.restore(saved)
    assert world.settings == settings
    assert goes_on(world) == once
    other = curtain(steps=0)
    other.restore(saved)
    assert goes_on(other) == once


@pytest.mark.parametrize("refusals", [1, 3])
def test_a_refused_step_leaves_a_change_where_it_was(refusals, monkeypatch):
    def refuse(*args):
        raise SolveError("refused")

    world, once = midway(), goes_on(midway())
    energy, settings, time = world.energy(), world.settings, world.time
    with monkeypatch.context() as patch:
        patch.setattr(module, "take_step", refuse)
        for _ in range(refusals):
            with pytest.raises(sim.StepError, match="refused"):
                world.step()
            assert (world.energy(), world.settings, world.time) == (energy, settings, time)
    assert goes_on(world) == once


def test_a_refused_step_keeps_what_a_change_at_time_zero_has_to_book(monkeypatch):
    def refuse(*args):
        raise SolveError("refused")

    world = curtain(steps=0)
    world.update(rest_angle=-0.6)
    put_in = potential(world, rest_angle=-0.6) - potential(world)
    assert put_in > 1e-6
    with monkeypatch.context() as patch:
        patch.setattr(module, "take_step", refuse)
        with pytest.raises(sim.StepError, match="refused"):
            world.step()
    assert world.step().energy_injected == pytest.approx(put_in, rel=ROUNDING)


def test_a_change_of_something_else_does_not_hold_the_ramp_up():
    world, twin = curtain(), curtain()
    world.update(stretch=2000.0)
    twin.update(stretch=2000.0)
    for k in range(STEPS + 2):
        world.update(friction=0.1 + 0.01 * k)  # acts on nothing here
        world.step()
        twin.step()
    assert world.model.settings.stretch == 2000.0
    assert state(world) == state(twin)


def test_cloth_that_is_put_elsewhere_has_its_new_settings_at_once():
    world = curtain()
    world.update(stretch=2000.0)
    world.place(world.positions)
    assert world.model.settings.stretch == 2000.0
    assert world.step().energy_injected == 0.0
