"""A budget that can be met is met, by measured work; one that cannot is refused with the nearest."""

from dataclasses import replace

import pytest

import sim
from sim.budget import candidates, choose_settings
from sim.probe import FRAME, Probe
from sim.ramp import Ramp
from sim.settings import change
from tests.worlds import grid, scene

pytestmark = pytest.mark.alone


def work(report):
    """Counted, so that a busy machine changes nothing: about a millisecond for a hundred iterations."""
    return 0.01 * report.iterations + 0.1 * report.newton


@pytest.fixture(scope="module")
def hanging():
    """A sheet on its way down from two pins."""
    sheet = grid(pins=["corner00", "corner10"])
    world = sim.Simulation(scene(sheet, gravity=[0, 0, -9.81], contact="none", newton=2, tolerance=1e-5))
    for _ in range(15):
        world.step()
    return Probe(sim.Simulation(world.scene), cost=work), world.snapshot(), world.settings


@pytest.fixture(scope="module")
def unbounded(hanging):
    """Everything that was tried, the fastest first."""
    probe, state, _ = hanging
    choice = choose_settings(probe, state, ms=1e6)
    assert choice.met
    return sorted(choice.tried, key=lambda tried: tried.found.ms)


def test_a_time_that_can_be_met_is_met_by_the_most_accurate_of_the_fast_enough(hanging, unbounded):
    probe, state, settings = hanging
    most = unbounded[len(unbounded) // 2].found.ms
    choice = choose_settings(probe, state, ms=most)
    assert choice.met
    again = probe.error(state, choice.changes, probe.truth(state, settings, FRAME))
    assert again.ms <= most
    least = min(tried.found.error for tried in unbounded if tried.found.ms <= most)
    assert again.error <= least + again.floor


def test_an_error_that_can_be_met_is_met_by_the_fastest_of_the_accurate_enough(hanging, unbounded):
    probe, state, settings = hanging
    most = sorted(tried.found.error for tried in unbounded)[len(unbounded) // 3]
    choice = choose_settings(probe, state, error=most)
    assert choice.met
    again = probe.error(state, choice.changes, probe.truth(state, settings, FRAME))
    assert again.error <= most
    fastest = min(tried.found.ms for tried in unbounded if tried.found.error <= most - again.floor)
    assert again.ms <= fastest


def test_what_it_gives_up_is_said(hanging, unbounded):
    probe, state, _ = hanging
    pair = [tried for tried in unbounded if tried.changes.get("dt") == 1 / 240][:1]
    state_then = replace(state, ramp=Ramp.done(change(state.ramp.target, **pair[0].changes)))
    fast = choose_settings(probe, state_then, ms=0.5 * pair[0].found.ms)
    assert fast.chosen.error > 1.05 * fast.present.error
    assert "gives up accuracy: the error was" in fast.sentence
    exact = choose_settings(probe, state, error=1.01 * min(tried.found.error for tried in unbounded))
    assert exact.chosen.ms > exact.present.ms
    assert "gives up time: a frame took" in exact.sentence
    assert all(name in exact.sentence for name in ("integrator =", "dt =", "newton =", "tolerance ="))


@pytest.mark.parametrize("budget", [{"ms": 1e-6}, {"error": 1e-14}])
def test_a_budget_that_cannot_be_met_is_refused_with_the_nearest(hanging, unbounded, budget):
    probe, state, _ = hanging
    choice = choose_settings(probe, state, **budget)
    assert not choice.met
    assert choice.changes == {}
    assert choice.sentence.startswith("Nothing tried")
    assert f"{choice.chosen.ms:.3g} ms per frame" in choice.sentence.partition("The nearest: ")[2]
    if "ms" in budget:
        assert choice.chosen.ms == unbounded[0].found.ms
    else:
        assert choice.chosen.error == min(tried.found.error for tried in unbounded)


def test_what_is_fixed_is_left_alone_and_nothing_is_tried_twice():
    settings = sim.Settings(dt=1 / 120)
    for fixed in ((), ("dt",), ("newton", "integrator")):
        options = candidates(settings, fixed)
        assert options[0] == {}
        assert not any(set(option) & set(fixed) for option in options)
        assert all(options.count(option) == 1 for option in options)


@pytest.mark.parametrize("budget", [{}, {"ms": 1.0, "error": 0.1}, {"ms": 0.0}, {"error": -1.0}])
def test_a_budget_is_one_positive_number(hanging, budget):
    probe, state, _ = hanging
    with pytest.raises(ValueError, match="budget"):
        choose_settings(probe, state, **budget)
