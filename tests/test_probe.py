"""The local-error probe: what it measures is the error, and it leaves no trace."""

import numpy as np
import pytest

import sim
from sim.probe import FRAME, QUICK, REFINED, Probe
from tests.worlds import ball, chain, grid, scene

G = 9.81


def probe_of(world, **options):
    return Probe(sim.Simulation(world.scene), **options)


LONE = {"points": [[0, 0, 1], [0.3, 0, 1]], "masses": [1.0, 1.0]}


def falling(**settings):
    """Two vertices that fall side by side: L is 0.3 m."""
    return sim.Simulation(scene(chain(**LONE), gravity=[0, 0, -G], contact="none", **settings))


@pytest.mark.parametrize("dt", [1 / 30, 1 / 60, 1 / 120, 1 / 240])
def test_the_error_of_free_fall_is_half_g_h_squared_for_each_step(dt):
    """Backward Euler falls g h² n (n + 1)/2 in n steps; the truth, and SDIRK2, ½ g (n h)²."""
    world = falling(dt=dt, tolerance=1e-10)
    found = probe_of(world).measure(world.snapshot())
    steps = max(1, round(FRAME / dt))
    assert found.seconds == pytest.approx(steps * dt)
    assert found.error == pytest.approx(0.5 * G * dt**2 * steps / 0.3, rel=1e-6)
    assert found.sure
    assert found.took > 0.0


def test_a_frame_of_whole_steps_is_no_shorter_than_a_frame():
    world = falling(dt=0.01)
    assert probe_of(world).measure(world.snapshot()).seconds == pytest.approx(0.02)


def test_a_more_accurate_integrator_has_a_smaller_error_at_the_same_state():
    world = sim.Simulation("curtain", contact="none", newton=3, tolerance=1e-7)
    for _ in range(20):
        world.step()
    probe, state = probe_of(world), world.snapshot()
    truth = probe.truth(state, world.settings, FRAME)
    first = probe.error(state, {}, truth)
    second = probe.error(state, {"integrator": "sdirk2"}, truth)
    assert first.sure
    assert second.error < 0.2 * first.error


def landing(**settings):
    """A sheet that has begun to lie on a ball."""
    sheet = grid((0.6, 0.6), (13, 13), position=[0.0, 0.0, 0.22])
    about = {"gravity": [0, 0, -G], "newton": 2, "self_collision": "auto", **settings}
    world = sim.Simulation(scene(sheet, ball(radius=0.2), **about))
    while world.time < 0.15:
        report = world.step()
    assert report.contacts > 0
    return world


TOUCHING = [
    ({"altitudes": "shortest"}, {"stretch": 90.0, "rest_angle": 0.3}),
    ({"integrator": "bdf2", "altitudes": "all"}, {"gamma": 0.5}),
    ({"contact": "penalty", "newton": 1}, {"dt": 1 / 90}),
]


@pytest.mark.parametrize(("settings", "changes"), TOUCHING)
def test_a_probe_leaves_the_state_untouched_to_the_bit(settings, changes):
    """Contacts, springs that choose, memory, settings on their way: a probe every fourth step."""
    alone, probed = landing(**settings), landing(**settings)
    probed.keep_ledger()
    probe = probe_of(probed)
    for k in range(16):
        if k == 6:
            alone.update(**changes)
            probed.update(**changes)
        if k % 4 == 0:
            before = probed.ledger
            probe.measure(probed.snapshot())
            assert probed.ledger == before
        alone.step()
        probed.step()
    assert np.array_equal(alone.positions, probed.positions)
    assert np.array_equal(alone.velocities, probed.velocities)
    assert alone.settings == probed.settings


UNEVEN = 2.0
"""Contacts come and go at other moments in each run: a finer run may be off by so many times the floor."""


def test_the_floor_says_how_far_the_finer_run_may_be_off():
    """Where cloth lands, against a run eight times finer still, which is off by an eighth as much."""
    world = landing()
    probe, state = probe_of(world), world.snapshot()
    truth = probe.truth(state, world.settings, FRAME)
    world.update(integrator="sdirk2", dt=FRAME / 128, newton=4, tolerance=1e-9)
    for _ in range(128):
        world.step()
    away = probe._apart(truth.positions, world.positions)
    assert 0.0 < away <= UNEVEN * truth.floor
    assert probe.error(state, {}, truth).error > 2.0 * away


def test_a_quick_measurement_stops_at_a_run_that_is_less_fine_and_says_how_vague_it_is(monkeypatch):
    world, steps = landing(), []
    probe, state = probe_of(world), world.snapshot()
    step = sim.Simulation.step
    monkeypatch.setattr(sim.Simulation, "step", lambda self: steps.append(self) or step(self))
    whole, of_whole = probe.measure(state), len(steps)
    quick = probe.measure(state, QUICK)
    assert (of_whole, len(steps) - of_whole) == (1 + sum(REFINED), 1 + 2 + QUICK)
    assert not quick.sure
    assert quick.floor > whole.floor
    assert abs(quick.error - whole.error) <= UNEVEN * quick.floor
    assert quick.took < 0.6 * whole.took


def test_what_is_not_known_well_enough_says_so():
    from sim.probe import LocalError

    vague = LocalError(error=2e-4, floor=1e-4, seconds=FRAME, ms=1.0)
    assert not vague.sure
    assert (vague.least, vague.most) == pytest.approx((1e-4, 3e-4))
    assert LocalError(error=2e-4, floor=1e-5, seconds=FRAME, ms=1.0).sure
    assert LocalError(error=0.0, floor=0.0, seconds=FRAME, ms=1.0).sure


def test_what_comes_between_steps_ends_a_measurement():
    class EnoughError(Exception):
        pass

    asked = []

    def between():
        asked.append(True)
        if len(asked) > 5:
            raise EnoughError

    world = falling()
    with pytest.raises(EnoughError):
        probe_of(world, between=between).measure(world.snapshot())


def test_a_step_that_cannot_be_done_is_said():
    world = falling()
    world.place(world.positions, np.full((2, 3), 1e7))
    with pytest.raises(sim.StepError, match="beyond"):
        probe_of(world).measure(world.snapshot())
