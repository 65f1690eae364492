"""Safe settings: what is blamed, what is put right, and that steps can be done again with them."""

import numpy as np
import pytest

import sim
from sim.safe import DOUBTFUL, out_of_range, safe, safe_changes, suspect
from sim.settings import FIELDS, Settings, change
from sim.simulation import beyond_bounds
from tests.worlds import grid

WILD = {
    "integrator": "symplectic_euler",
    "dt": 1.0,
    "stretch": 1e8,
    "altitude": 1e8,
    "bending": 1e4,
    "gamma": 1000.0,
    "density": 1e-4,
    "thickness": 0.1,
    "friction": 10.0,
    "gravity": (0.0, 0.0, -1e3),
}


def test_usual_settings_are_blamed_for_nothing():
    assert out_of_range(Settings()) == []
    assert suspect(Settings()) == "dt", "which is at least what can be halved"


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_setting_far_out_of_the_ordinary_is_blamed_and_put_where_its_slider_ends(name):
    settings = change(Settings(altitudes="all"), **{name: WILD[name]})
    assert suspect(settings) == name
    assert set(safe_changes(settings)) == {name}
    if FIELDS[name].slider:
        assert getattr(safe(settings), name) in FIELDS[name].slider
    assert out_of_range(safe(settings)) == []


def test_settings_that_do_not_act_are_blamed_for_nothing():
    idle = change(
        Settings(), altitudes="none", altitude=1e8, bend="none", bending=1e4, contact="none", thickness=0.1
    )
    assert out_of_range(idle) == []


def test_none_of_something_is_moderate():
    assert out_of_range(change(Settings(), stretch=0.0, bending=0.0, gamma=0.0, friction=0.0)) == []


def test_safe_settings_of_the_explicit_integrator_are_implicit():
    assert safe(Settings(integrator="symplectic_euler")).integrator == "backward_euler"


def test_where_nothing_is_out_of_the_ordinary_the_step_is_halved_down_to_the_end_of_the_slider():
    low = FIELDS["dt"].slider[0]
    settings = Settings(dt=4.5 * low)
    seen = []
    while changes := safe_changes(settings):
        settings = change(settings, **changes)
        seen.append(settings.dt / low)
    assert seen == pytest.approx([2.25, 1.125, 1.0])


def until_refused(world, steps=200):
    """The state before the step that could not be done, and the refusal."""
    for _ in range(steps):
        before = world.positions.copy(), world.velocities.copy(), world.time
        try:
            world.step()
        except sim.StepError as error:
            return before, error
    raise AssertionError("every step was done")


def test_a_step_that_blows_up_names_its_quantity_and_the_same_cloth_goes_on_with_safe_settings():
    """The transaction of a step, and the way out that the page offers."""
    scene = {"cloth": grid(resolution=(8, 8), pins=["left"]), "settings": {"integrator": "symplectic_euler"}}
    world = sim.Simulation(scene, stretch=1e6, dt=0.02)
    before, refused = until_refused(world)
    assert "vertex" in refused.reason
    assert (refused.phase, refused.setting) == ("solve", "integrator")
    assert all(
        np.array_equal(a, b)
        for a, b in zip(before, (world.positions, world.velocities, world.time), strict=True)
    )
    world.update(**safe_changes(world.settings))
    for _ in range(60):
        world.step()
    assert np.isfinite(world.positions).all()


def test_the_quantity_that_is_beyond_all_bounds_is_named_with_its_vertex():
    calm, wild = np.zeros((3, 3)), np.zeros((3, 3))
    assert beyond_bounds(calm, calm) == ""
    wild[1, 2] = -2e7
    assert beyond_bounds(calm, wild) == "velocity of vertex 1 is 2e+07 m/s, beyond 1e+06 m/s"
    wild[0, 0] = np.nan
    assert beyond_bounds(wild, calm) == "position of vertex 0 is nan m, which is not finite"
