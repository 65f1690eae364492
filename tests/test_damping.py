"""What γ means: for one spring, for a mode of a cloth, and with the integrator's own damping taken off."""

import math

import msgspec
import numpy as np
import pytest

import sim
from sim.damping import apparent, damping_ratios
from sim.integrators import INTEGRATORS
from sim.ringdown import fit_ring_down
from sim.settings import Settings
from tests.worlds import chain, grid, irregular, scene

MEASURED = 1e-3
"""Mark of the notes for a damping ratio that is read from a run."""


def closed_form(gamma, omega, t):
    """Deflection over the first one of a damped oscillator that starts at rest."""
    root = np.sqrt(gamma * gamma - 1.0 + 0j)
    if root == 0.0:
        return (1.0 + omega * t) * np.exp(-omega * t)
    slow, fast = omega * (root - gamma), omega * (-root - gamma)
    return ((slow * np.exp(fast * t) - fast * np.exp(slow * t)) / (slow - fast)).real


SECOND_ORDER = 1e-4
"""SDIRK2 errs by about 0.04 (h ω)² of the deflection: 2e-5 at h ω = 0.02, more where γ is large."""


@pytest.mark.parametrize("pinned", [False, True], ids=["free", "pinned"])
@pytest.mark.parametrize("gamma", [0.0, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("masses", [(0.01, 0.03), (5.0, 0.005)])
def test_a_spring_between_unequal_masses_moves_as_its_reduced_mass_says(masses, gamma, pinned):
    """Two free ends have 1/μ = 1/m1 + 1/m2, and γ = 1 is critical; a pinned end is infinitely heavy."""
    reduced = masses[1] if pinned else masses[0] * masses[1] / sum(masses)
    omega, h, stretched = 10.0, 2e-3, 0.01
    cloth = chain([[0, 0, 0], [1.0 + stretched, 0, 0]], masses, pins=[0] if pinned else [])
    cloth["rest_vertices"] = [[0, 0, 0], [1, 0, 0]]
    settings = {"stretch": reduced * omega**2, "gamma": gamma, "dt": h, "tolerance": 1e-12}
    world = sim.Simulation(scene(cloth, integrator="sdirk2", **settings))
    for step in range(1, 101):
        world.step()
        length = world.positions[1, 0] - world.positions[0, 0]
        expected = closed_form(gamma, omega, step * h)
        assert (length - 1.0) / stretched == pytest.approx(expected, abs=SECOND_ORDER)


def test_every_spring_of_a_cloth_has_the_damping_of_its_own_reduced_mass():
    """The force at one vertex that moves, from a sum over its springs written out by hand."""
    cloth = {**irregular(4, count=20, noise=0.0), "masses": np.geomspace(1e-3, 1.0, 20).tolist()}
    world = sim.Simulation(scene(cloth, bend="none", gamma=0.0, stretch=30.0))
    elastic, gamma = world.forces(), 0.4
    velocities = np.random.default_rng(0).standard_normal(world.positions.shape)
    world.place(world.positions, velocities)
    world.update(gamma=gamma)
    expected = np.zeros_like(elastic)
    for i, j in world.edges:
        d = world.positions[j] - world.positions[i]
        n = d / np.linalg.norm(d)
        stiffness = 30.0 / np.linalg.norm(world.mesh.rest_vertices[j] - world.mesh.rest_vertices[i])
        reduced = 1.0 / (1.0 / world.masses[i] + 1.0 / world.masses[j])
        force = gamma * 2.0 * math.sqrt(reduced * stiffness) * (n @ (velocities[j] - velocities[i])) * n
        expected[i] += force
        expected[j] -= force
    # Sums of a dozen numbers, each good to 2e-16.
    np.testing.assert_allclose(world.forces() - elastic, expected, atol=1e-13 * np.abs(elastic).sum())


# Compensation


def spring(gamma, hw, **settings):
    """One spring with h ω = `hw` between free masses."""
    h, reduced = 0.01, 0.0075
    stretch = reduced * (hw / h) ** 2
    made = scene(chain([[0, 0, 0], [1, 0, 0]], [0.01, 0.03]), gamma=gamma, dt=h, stretch=stretch)
    return sim.modal_damping(made, mode=-1, **settings)


@pytest.mark.parametrize("gamma", [0.1, 0.3, 0.6, 0.9])
def test_compensation_gives_a_spring_the_damping_that_was_asked_for(gamma):
    """Backward Euler adds ½ h ω (1 − γ²), a tenth for γ = 0; SDIRK2 adds nothing that could be taken off."""
    assert spring(gamma, 0.2, compensate="on").measured == pytest.approx(gamma, abs=MEASURED)
    bare = spring(gamma, 0.2).measured
    assert bare - gamma == pytest.approx(0.1 * (1.0 - gamma * gamma), abs=0.01)  # the next term, ¼ (h ω)²
    on, off = (spring(gamma, 0.2, integrator="sdirk2", compensate=c).measured for c in ("on", "off"))
    assert on == pytest.approx(off, abs=MEASURED)
    assert on == pytest.approx(gamma, abs=2.0 * MEASURED)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_compensation_never_drives_a_spring_nor_adds_to_it(name):
    for gamma in (0.01, 0.1, 0.5, 0.9, 0.999):
        ratios = damping_ratios(Settings(integrator=name, compensate="on", gamma=gamma, dt=0.02))
        assert (ratios[:, 1] >= 0.0).all()
        assert (ratios[:, 1] <= gamma).all()
        assert (np.diff(ratios[:, 0]) > 0.0).all()  # frequencies, ascending, as they are searched


def test_compensation_takes_off_all_there_is_where_the_integrator_damps_too_much():
    """At h ω = 1 backward Euler has a damping ratio of 0.40 by itself, and keeps it."""
    found = spring(0.3, 1.0, compensate="on")
    assert found.modal == pytest.approx(0.0, abs=1e-9)
    assert found.measured == pytest.approx(0.40371, abs=MEASURED)


@pytest.mark.parametrize("gamma", [0.0, 1.0, 1.5, 30.0])
def test_compensation_leaves_springs_alone_that_do_not_ring_or_are_not_damped(gamma):
    for name in INTEGRATORS:
        ratios = damping_ratios(Settings(integrator=name, compensate="on", gamma=gamma))
        assert ratios[:, 1].tolist() == [gamma]


# Ring-down


FIT = 1e-9
"""Samples are good to 2e-16, of which the fit loses as much as its recurrence is near to a double root."""


@pytest.mark.parametrize("gamma", [0.0, 1e-4, 0.1, 0.5, 0.9, 1.2, 3.0])
@pytest.mark.parametrize("hw", [0.1, 0.5])
def test_the_ring_down_fit_finds_damping_and_frequency_of_a_motion_without_noise(gamma, hw):
    h = 0.01
    samples = 3e-5 * closed_form(gamma, hw / h, h * np.arange(30))
    found, frequency = fit_ring_down(samples, h)
    assert found == pytest.approx(gamma, abs=FIT)
    assert frequency == pytest.approx(hw / h, rel=FIT)


def test_the_ring_down_fit_sees_past_the_roots_that_a_two_step_method_adds():
    """With four roots it takes the two that fade last; with two it says that they are no such motion."""
    t = 0.01 * np.arange(30)
    samples = closed_form(0.2, 30.0, t) + 0.3 * 0.4 ** np.arange(30) * np.cos(2.0 * np.arange(30))
    assert fit_ring_down(samples, 0.01, roots=4) == pytest.approx((0.2, 30.0), rel=1e-6)
    with pytest.raises(ValueError, match="samples: expected the motion"):
        fit_ring_down(samples, 0.01)


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros(20),
        np.eye(20)[0],
        np.arange(20.0),
        np.ones(20),
        np.exp(-0.1 * np.arange(20)),
        closed_form(-0.1, 30.0, 0.01 * np.arange(30)),
        np.random.default_rng(0).standard_normal(40),
        np.full(20, np.nan),
        np.ones(3),
    ],
    ids=["nothing", "over at once", "drifting", "still", "one rate", "growing", "noise", "nan", "too few"],
)
def test_the_ring_down_fit_refuses_what_is_no_damped_oscillation(samples):
    with pytest.raises(ValueError, match="samples: expected the motion of a damped oscillator"):
        fit_ring_down(samples, 0.01)


# Modes


@pytest.mark.parametrize("name", ["backward_euler", "sdirk2"])
@pytest.mark.parametrize("mode", [0, 1])
def test_a_hanging_strip_rings_down_as_its_springs_and_its_integrator_say(name, mode):
    """The two slowest modes, in which it swings as a pendulum and as a chain; a coarse mesh is quicker."""
    strip = sim.load_scene("strip")
    coarse = msgspec.structs.replace(strip.cloth[0], resolution=(12, 3))
    found = sim.modal_damping(
        msgspec.structs.replace(strip, cloth=[coarse]), mode=mode, integrator=name, dt=1 / 30
    )
    assert found.measured == pytest.approx(found.stepped, abs=MEASURED)
    assert found.modal < 0.1 * found.gamma  # a pendulum's springs hardly move
    _, slower = apparent(name, found.frequency / 30, found.modal)
    assert found.measured_frequency == pytest.approx(found.frequency * slower, rel=MEASURED)


@pytest.mark.parametrize("mode", [0, -1])
def test_springs_that_are_critical_one_by_one_make_modes_that_are_not(mode):
    """32 equal masses in a row, γ = 1: mode j has √2 sin(j π/64), from 0.069 to √2."""
    row = chain([[0.1 * i, 0, 0] for i in range(32)], [0.01] * 32)
    found = sim.modal_damping(scene(row, gamma=1.0, stretch=1.0, dt=0.1, integrator="sdirk2"), mode=mode)
    j = 1 if mode == 0 else 31
    assert found.modal == pytest.approx(math.sqrt(2.0) * math.sin(j * math.pi / 64), rel=1e-9)
    assert found.modal == pytest.approx({0: 0.069, -1: math.sqrt(2.0)}[mode], rel=0.01)  # as the notes say
    assert found.measured == pytest.approx(found.stepped, abs=MEASURED)


def test_a_mode_that_a_cloth_does_not_have_is_refused():
    """Two free masses have one mode besides their motion as a whole."""
    pair = scene(chain([[0, 0, 0], [1, 0, 0]], [1.0, 1.0]))
    with pytest.raises(ValueError, match="mode: expected -1 to 0, got 1"):
        sim.modal_damping(pair, mode=1)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"mode": 1.5}, "mode: expected a whole number"),
        ({"longest": 0.0}, "longest: expected > 0 s"),
        ({"longest": 1e-9}, "longest: there is no mode with a period"),
    ],
)
def test_a_mode_that_cannot_be_had_is_refused_in_one_line(wrong, words):
    with pytest.raises(ValueError, match=words):
        sim.modal_damping(scene(grid(resolution=(3, 3), pins=["left"]), gravity=[0, 0, -9.81]), **wrong)


def test_cloth_that_is_pinned_all_over_has_no_mode():
    with pytest.raises(ValueError, match="vertices that can move"):
        sim.modal_damping(scene(grid(resolution=(2, 2), pins=["left", "right"])))


def test_a_ring_down_that_rounding_hides_is_refused():
    with pytest.raises(ValueError, match="expected"):
        sim.modal_damping(scene(grid(resolution=(4, 4))), stretch=1e8)


def test_critically_damped_bdf2_has_the_pair_of_roots_that_fades_last():
    """γ = 1 and h ω = 1: the roots are (2 ± i)/5, whose logarithms give 0.8665."""
    rate = -np.log((2 + 1j) / 5)
    assert apparent("bdf2", 1.0, 1.0)[0] == pytest.approx(rate.real / abs(rate), rel=1e-12)
