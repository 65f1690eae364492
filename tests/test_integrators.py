"""The time integrators: order, damping of their own, stability, and what none of them may do to a cloth.

A spring of two vertices on a line is a linear oscillator, so closed forms and published numbers hold there to
rounding; the elastic pendulum and a small cloth show the orders where nothing is linear.
"""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import sim
from sim.damping import apparent
from sim.integrators import INTEGRATORS
from sim.ringdown import fit_ring_down
from sim.stress.scenes import one_pair
from tests.worlds import ball, chain, grid, irregular, scene

FOLDER = Path(__file__).parent / "vectors"
VECTORS = json.loads((FOLDER / "methods.json").read_text())
REFERENCE = json.loads((FOLDER / "reference.json").read_text())

RIGHT = ["none", "cross", "modified", "angle"]
"""Bending springs that are not wrong on purpose."""

EARTH = [0.0, 0.0, -9.81]

CONVERGED = {"newton": 50, "tolerance": 1e-12}
"""Steps whose equations are solved to rounding, so that all the error is the integrator's."""

ROUNDING = 1e-12
"""Part of Σ|f|, or of the motion, that thousands of operations good to 2e-16 each may lose together."""


def spring(masses=(1.0, 1.0), pins=(), deflection=0.0, **settings):
    """Two vertices a metre apart on the x axis, the second moved outwards by `deflection` [m]."""
    cloth = chain([[0, 0, 0], [1.0 + deflection, 0, 0]], masses, pins=list(pins))
    cloth["rest_vertices"] = [[0, 0, 0], [1, 0, 0]]
    return scene(cloth, **settings)


def steps(world, count):
    """The reports of so many steps."""
    return [world.step() for _ in range(count)]


def orders(errors):
    """Observed orders between errors at h, h/2, h/4 and so on."""
    return [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]


def is_order(name):
    """What an observed order of integrator `name` must equal: as the notes have it, 1 ± 0.05 or 2 ± 0.1."""
    order = INTEGRATORS[name].order
    return pytest.approx(order, abs=0.05 * order)


# Damping of their own

TABULATED = {
    "BE": ["backward_euler"],
    "TR": ["trapezoid", "midpoint"],
    "BDF2": ["bdf2"],
    "TRBDF2": ["tr_bdf2"],
    "SDIRK2": ["sdirk2"],
}

DIGITS = 0.5e-5 + 1e-9
"""The table of the notes is rounded to five decimals."""


@pytest.mark.parametrize("case", VECTORS["apparent_damping"], ids=lambda c: f"{c['gamma']}-{c['hw']}")
def test_apparent_damping_and_frequency_are_those_of_the_notes(case):
    for key, names in TABULATED.items():
        for name in names:
            assert apparent(name, case["hw"], case["gamma"]) == pytest.approx(case[key], abs=DIGITS)


@pytest.mark.parametrize("gamma", [0.0, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("hw", [0.1, 0.5])
def test_apparent_damping_of_symplectic_euler_is_that_of_a_plain_simulation(hw, gamma):
    """Two lines of it, h = 1; at γ = 0.9 and h ω = 0.5 the spring that should ring creeps."""
    x, v, samples = 1.0, 0.0, []
    for _ in range(20):
        samples.append(x)
        v -= hw * hw * x + 2.0 * gamma * hw * v
        x += v
    measured, frequency = fit_ring_down(np.array(samples), 1.0)
    # The fit loses digits where the faster of two decays is over within a few samples.
    assert apparent("symplectic_euler", hw, gamma) == pytest.approx((measured, frequency / hw), abs=1e-9)


MEASURED = 1e-3
"""Mark of the notes for a damping ratio read from a run; where motion is linear 1e-6 is reached."""

FREE, HEAVY = ((0.01, 0.01), ()), ((10.0, 0.01), ())
HELD, HEAVY_HELD = ((0.01, 0.01), (0,)), ((10.0, 0.01), (0,))
CASES = [
    (FREE, 0.1, 0.1),
    (FREE, 0.0, 0.5),
    *((FREE, gamma, 1.0) for gamma in (0.1, 0.5, 0.95)),
    (HEAVY, 0.5, 0.5),
    *((masses, 0.1, 1.0) for masses in (HEAVY, HELD, HEAVY_HELD)),
]
"""Masses and pins, γ, h ω."""

ENDS_AT_ONCE = [("symplectic_euler", 0.5, 1.0), ("symplectic_euler", 0.95, 1.0)]
"""At γ = 0.5 its step multiplies the motion by zero, and beyond it is unstable: nothing to measure."""


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_spring_rings_down_with_its_own_damping_and_the_integrators(name):
    """Mass ratios 1 and 1000, both ends free or one held: γ is of the reduced mass in all of them."""
    h = 0.01
    for (masses, pins), gamma, hw in CASES:
        if (name, gamma, hw) in ENDS_AT_ONCE:
            continue
        reduced = 1.0 / ((0.0 if pins else 1.0 / masses[0]) + 1.0 / masses[1])
        settings = {"stretch": reduced * (hw / h) ** 2, "dt": h, "integrator": name, "gamma": gamma}
        found = sim.modal_damping(spring(masses, pins, **settings), mode=-1)
        expected = apparent(name, hw, gamma)
        assert found.modal == pytest.approx(gamma, abs=1e-9)
        assert (found.measured, found.measured_frequency * h / hw) == pytest.approx(expected, abs=MEASURED)


@pytest.mark.parametrize("case", VECTORS["oscillator"], ids=lambda c: f"gamma={c['gamma']}")
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_damped_oscillator_goes_to_the_closed_form(name, case):
    """Under-, critically and overdamped; from two step sizes the leading error is taken off (Richardson)."""

    def run(h, end):
        settings = {"stretch": case["K"], "gamma": case["gamma"], "tolerance": 1e-12}
        world = sim.Simulation(spring((1.0, case["m"]), (0,), case["x0"], dt=h, integrator=name, **settings))
        steps(world, round(end / h))
        return world.positions[1, 0] - 1.0

    if name == "backward_euler":
        for end, expected in case["backward_euler"]:
            assert run(case["be_h"], end) == pytest.approx(expected, abs=1e-6 * case["x0"])
    for end, exact in case["exact"][:2]:
        coarse, fine = run(1 / 400, end), run(1 / 800, end)
        order = INTEGRATORS[name].order
        limit = fine + (fine - coarse) / (2**order - 1)
        # What is left is h^(p + 1): (h ω)² = 6e-4 of x0 for the first order, (h ω)³ = 2e-5 for the second.
        assert limit == pytest.approx(exact, abs=case["x0"] * (1 / 800 * case["omega"]) ** (order + 1))


@pytest.mark.parametrize("hw", REFERENCE["oscillator_amplification_per_step"])
@pytest.mark.parametrize("name", ["backward_euler", "trapezoid", "midpoint", "bdf2"])
def test_one_step_multiplies_an_oscillation_by_the_published_factor(name, hw):
    """Of u = v + i ω x, for which u_{k+2} = a u_{k+1} + b u_k without damping, b = 0 of one-step methods."""
    short = {"backward_euler": "BE", "trapezoid": "TR", "midpoint": "TR", "bdf2": "BDF2"}[name]
    given = REFERENCE["oscillator_amplification_per_step"][hw]
    h, omega, hw = 0.01, float(hw) / 0.01, float(hw)
    settings = {"stretch": omega**2, "dt": h, "gamma": 0.0, "integrator": name, **CONVERGED}
    world = sim.Simulation(spring((1.0, 1.0), (0,), 0.1, solver="direct", **settings))
    u = []
    for _ in range(4):
        u.append(world.velocities[1, 0] + 1j * omega * (world.positions[1, 0] - 1.0))
        world.step()
    if name == "bdf2":
        a, b = np.linalg.solve([[u[1], u[0]], [u[2], u[1]]], u[2:])
        factor = max(np.roots([1.0, -a, -b]), key=abs)
    else:
        factor = u[1] / u[0]
    assert abs(factor) == pytest.approx(given[short], abs=1e-10)
    if f"{short}_phase_over_wh" in given:
        assert np.angle(factor) / hw == pytest.approx(given[f"{short}_phase_over_wh"], abs=1e-10)


# Orders

PENDULUM = VECTORS["integrators_elastic_pendulum"]
KEYS = {
    "backward_euler": "BE",
    "midpoint": "IM",
    "trapezoid": "TR",
    "bdf2": "BDF2(SDIRK2 start)",
    "sdirk2": "SDIRK2",
    "tr_bdf2": "TRBDF2",
}
TABLE = 0.02
"""Errors are tabulated to four digits; what differs beyond is how far a step is solved."""


def pendulum_error(h, **settings):
    """Distance [m] from the reference of a mass on a spring, dropped from the side, after a second."""
    cloth = chain([[0, 0, 0], [PENDULUM["x0"][0], 0, PENDULUM["x0"][1]]], [1.0, PENDULUM["m"]], pins=[0])
    cloth["rest_vertices"] = [[0, 0, 0], [PENDULUM["l0"], 0, 0]]
    stiffness = PENDULUM["K"] * PENDULUM["l0"]
    gamma = PENDULUM["b"] / (2.0 * math.sqrt(PENDULUM["K"] * PENDULUM["m"]))
    swinging = {"gravity": [0, 0, -PENDULUM["g"]], "stretch": stiffness, "gamma": gamma, "dt": h}
    world = sim.Simulation(scene(cloth, **swinging, **settings))
    steps(world, round(PENDULUM["T"] / h))
    return math.dist(world.positions[1, [0, 2]], PENDULUM["x_ref"])


@pytest.mark.parametrize("name", INTEGRATORS)
def test_an_elastic_pendulum_has_the_errors_of_the_notes_and_the_order_of_its_integrator(name):
    errors = [pendulum_error(1 / n, integrator=name, **CONVERGED) for n in (32, 64, 128, 256)]
    if name in KEYS:
        assert errors == pytest.approx(PENDULUM["errors_h_1_32_64_128_256"][KEYS[name]], rel=TABLE)
    assert orders(errors) == [is_order(name)] * 3


def test_one_newton_iteration_has_the_errors_of_linearised_backward_euler():
    errors = [pendulum_error(1 / n, newton=1, tolerance=1e-12) for n in (32, 64, 128, 256)]
    assert errors == pytest.approx(PENDULUM["errors_h_1_32_64_128_256"]["LinBE"], rel=TABLE)
    assert orders(errors) == [is_order("backward_euler")] * 3


DURATION = 0.15
"""How long the small cloth moves [s]."""


def small_cloth(count, name):
    """A sheet held by two corners after DURATION in so many steps; a little stretched and bent at first."""
    cloth = grid(size=(0.4, 0.4), resolution=(5, 5), pins=["corner00", "corner10"])
    springs = {"bend": "modified", "bending": 1e-3, "stretch": 1.0, "altitudes": "all", "altitude": 1.0}
    settings = {"gamma": 0.3, "density": 0.5, "gravity": EARTH, "integrator": name, "dt": DURATION / count}
    exact = {"newton": 50, "tolerance": 1e-10}  # errors are 1e-6 m and more
    world = sim.Simulation(scene(cloth, **springs, **settings, **exact))
    x = 1.03 * world.positions
    x[:, 2] = 0.02 * np.sin(9.0 * x[:, 0]) * np.cos(5.0 * x[:, 1])
    x[world.pinned] = world.positions[world.pinned]
    world.place(x)
    assert all(report.converged for report in steps(world, count))
    return world


@pytest.fixture(scope="module")
def fine_cloth():
    """Positions without the leading error of SDIRK2, good to a hundredth of the smallest error below."""
    coarse, fine = (small_cloth(count, "sdirk2").positions for count in (120, 240))
    return fine + (fine - coarse) / 3.0


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_small_cloth_has_the_order_of_its_integrator(name, fine_cloth):
    errors = []
    for count in (30, 60, 120):
        world = small_cloth(count, name)
        off = ((world.positions - fine_cloth) ** 2).sum(axis=1)
        errors.append(math.sqrt(world.masses @ off / world.masses.sum()))
    assert orders(errors) == [is_order(name)] * 2


# What no integrator and no spring may do


def crumpled(name="backward_euler", **settings):
    """A crumpled irregular cloth without anything to hold it, at a step that suits any integrator."""
    gentle = {"stretch": 5.0, "altitude": 5.0, "bending": 1e-5, "dt": 1 / 100}
    if not INTEGRATORS[name].implicit:
        gentle["dt"] = 1e-5
    return sim.Simulation(scene(irregular(7), integrator=name, **{**gentle, **settings}))


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("gamma", [0.0, 0.7, 20.0])
def test_damping_never_slows_free_fall(name, gamma):
    """First-order steps add h v up, g h² / 2 each too much; second-order ones are exact for a parabola."""
    world = crumpled(name, gamma=gamma, gravity=EARTH, altitudes="all")
    center = world.masses @ world.positions / world.masses.sum()
    h, n = world.settings.dt, 20
    first = sum(INTEGRATORS[world.step().integrator].order == 1 for _ in range(n))
    assert first in ((n,) if INTEGRATORS[name].order == 1 else (0, 1))  # the start may be too wild for others
    fallen = 0.5 * EARTH[2] * h * h * (n * n + first)
    moved = world.masses @ world.positions / world.masses.sum() - center
    np.testing.assert_allclose(moved, [0.0, 0.0, fallen], atol=1e-12)
    assert np.ptp(world.velocities, axis=0).max() > 1e-3  # it deforms as it falls


@pytest.mark.parametrize("altitudes", ["none", "shortest", "all"])
@pytest.mark.parametrize("bend", RIGHT)
def test_damping_resists_no_rigid_motion(bend, altitudes):
    world = crumpled(bend=bend, altitudes=altitudes, gamma=0.0, rest_angle=0.2)
    motion = np.cross([0.3, -2.0, 1.1], world.positions) + np.array([1.0, -0.5, 0.3])
    world.place(world.positions, motion)
    elastic = world.forces()
    world.update(gamma=1.0)
    assert np.abs(world.forces() - elastic).max() <= ROUNDING * np.abs(elastic).sum()
    stretching = world.positions * [1.0, 0.0, 0.0]
    world.place(world.positions, motion + stretching)
    assert np.abs(world.forces() - elastic).max() > 1e-3 * np.abs(elastic).max()


@pytest.mark.parametrize("bend", RIGHT)
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_free_cloth_keeps_its_linear_momentum_at_every_step(name, bend):
    world = crumpled(name, bend=bend, altitudes="all", gamma=0.5)
    noise = np.random.default_rng(1).standard_normal(world.positions.shape)
    world.place(world.positions, noise + np.array([1.0, 2.0, -0.5]))
    for _ in range(5):
        before, _ = world.momentum()
        world.step()
        size = world.masses @ np.linalg.norm(world.velocities, axis=1)
        assert np.abs(world.momentum()[0] - before).max() <= ROUNDING * size


@pytest.mark.parametrize("altitudes", ["none", "shortest", "all"])
@pytest.mark.parametrize("bend", RIGHT)
def test_spring_forces_neither_push_nor_turn_a_cloth(bend, altitudes):
    world = crumpled(bend=bend, altitudes=altitudes, gamma=0.5, rest_angle=0.2)
    world.place(world.positions, np.random.default_rng(2).standard_normal(world.positions.shape))
    forces, x = world.forces(), world.positions
    sizes = np.linalg.norm(forces, axis=1)
    assert np.abs(forces.sum(axis=0)).max() <= ROUNDING * sizes.sum()
    torque = np.cross(x, forces).sum(axis=0)
    assert np.abs(torque).max() <= ROUNDING * (sizes @ np.linalg.norm(x, axis=1))


# Live


def state(world):
    """Positions and velocities to the bit."""
    return world.positions.tobytes(), world.velocities.tobytes()


def hanging(name, *obstacles, **settings):
    """A sheet held by two corners that has begun to swing."""
    cloth = grid(size=(0.4, 0.4), resolution=(5, 5), pins=["corner00", "corner10"])
    world = sim.Simulation(scene(cloth, *obstacles, integrator=name, gravity=EARTH, dt=0.002, **settings))
    steps(world, 5)
    return world


@pytest.mark.parametrize("name", INTEGRATORS)
def test_changing_the_integrator_keeps_the_state_to_the_bit_and_goes_on(name):
    for other in INTEGRATORS:
        world = hanging(other, stretch=10.0)
        before, time = state(world), world.time
        world.update(integrator=name)
        assert (state(world), world.time) == (before, time)
        assert world.step().integrator == name
        assert 0.0 < np.abs(world.velocities).max() < 1.0  # 6 steps of free fall make 0.12 m/s


def after_a_step(world, snapshot, **changes):
    """What one step from `snapshot` gives with `changes`, which are no reason to restart by themselves."""
    world.restore(snapshot)
    if changes:
        world.update(**changes)
    world.step()
    return state(world)


@pytest.mark.parametrize("restart", ["update", "stop", "place"])
def test_bdf2_starts_anew_with_sdirk2_where_the_step_before_means_nothing(restart):
    world = hanging("bdf2")
    running = world.snapshot()
    gone_on = after_a_step(world, running)
    world.restore(running)
    if restart == "update":
        world.update(friction=0.7)  # a setting that this cloth does not feel
    elif restart == "stop":
        world.stop()
    else:
        world.place(world.positions, world.velocities)
    fresh = world.snapshot()
    started = after_a_step(world, fresh)
    assert started == after_a_step(world, fresh, integrator="sdirk2")
    assert started != gone_on


def test_bdf2_starts_anew_after_a_step_that_felt_a_contact():
    """A ball comes up to the sheet and goes: the first step without it is one of SDIRK2."""
    way = [{"time": t, "position": [0, 0, z]} for t, z in ((0.0, -0.2), (0.03, -0.13), (0.08, -0.5))]
    world = hanging("bdf2", ball((0, 0, -0.2), 0.13, path=way), contact="penalty")
    names = ["bdf2"]
    while names[-2:] != ["backward_euler", "bdf2"]:
        before = world.snapshot()
        names.append(world.step().integrator)
        assert world.time < 0.1
    restarted, after = state(world), world.snapshot()
    assert restarted == after_a_step(world, before, integrator="sdirk2")
    assert after_a_step(world, after) != after_a_step(world, after, integrator="sdirk2")


def stopped(by):
    """What flies at 3 m/s, or at 100, into what the integrator knows nothing of, just after it did."""
    if by == "impulse":
        world = one_pair("edge-edge", 100.0, 0.0)
        world.update(integrator="bdf2")
    else:
        how = {"contact": "postprocess", "strain_limit": 0.1 if by == "limit" else 0.0, "stretch": 1e-2}
        how |= {"integrator": "bdf2", "dt": 0.01, "gravity": [0, 0, 0]}
        wall = {"kind": "plane", "point": [1.05, 0, 0], "normal": [-1, 0, 0]}
        world = sim.Simulation(spring(pins=(0,), **how) | {"obstacle": [wall] if by == "projection" else []})
        world.place(world.positions, [[0, 0, 0], [3, 0, 0]])
    speed = np.abs(world.velocities).max()
    names = []
    while np.abs(world.velocities).max() > 0.9 * speed:
        names.append(world.step().integrator)
    assert names[-1] == ("backward_euler" if by == "projection" else "bdf2")
    return world


@pytest.mark.parametrize("by", ["impulse", "projection", "limit"])
def test_bdf2_does_not_look_back_across_what_stopped_it(by):
    """It would be thrown back, as if the speed that it had lost went on changing."""
    world = stopped(by)
    after = world.snapshot()
    assert after_a_step(world, after) == after_a_step(world, after, integrator="sdirk2")


@pytest.mark.parametrize("after", [1, 2, 7])
def test_a_snapshot_in_the_middle_of_a_bdf2_run_goes_on_with_the_same_bits(after):
    """From the first step, which only has a start, from the second, and later: also in another simulation."""
    world = hanging("bdf2")
    world.update(gamma=0.3)
    steps(world, after)
    saved = world.snapshot()
    steps(world, 5)
    once = state(world)
    world.restore(saved)
    steps(world, 5)
    assert state(world) == once
    other = hanging("backward_euler")
    other.restore(saved)
    steps(other, 5)
    assert state(other) == once


# The longest stable step

BELOW, ABOVE = 0.98, 1.1
"""Parts of the limit that must hold, and must not."""

SHAKE = 1e-7
"""Start offsets [m]: small enough for springs to stay linear until the motion has grown a thousandfold."""

BOUNDED, BLOWN_UP = 30.0, 1e3
"""Growth of the offsets in 2000 steps: some modes of cloth are free, and go where they were pushed."""


def still_cloth(kind, **settings):
    """Cloth at its rest shape but for SHAKE."""
    common = {"integrator": "symplectic_euler", "altitudes": "all", "stretch": 20.0, "dt": 1e-5}
    cloth = {"grid": grid(resolution=(5, 5)), "irregular": irregular(3)}.get(kind)
    made = spring((0.01, 0.03)) if kind == "spring" else scene(cloth)
    world = sim.Simulation(made, **{**common, **settings})
    noise = SHAKE * np.random.default_rng(0).standard_normal(world.positions.shape)
    world.place(world.mesh.rest_vertices + noise)
    return world


def growth(world):
    """How far the motion goes in 2000 steps, over SHAKE; inf where it blows up."""
    begin = world.positions.copy()
    for _ in range(2000):
        try:
            world.step()
        except sim.StepError:
            return math.inf
        if (moved := np.abs(world.positions - begin).max() / SHAKE) > BLOWN_UP:
            return moved
    return moved


@pytest.mark.parametrize("gamma", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["spring", "grid", "irregular"])
def test_the_stability_limit_parts_steps_that_hold_from_steps_that_blow_up(kind, gamma):
    limit = still_cloth(kind, gamma=gamma).stability_limit()
    assert growth(still_cloth(kind, gamma=gamma, dt=BELOW * limit)) < BOUNDED
    assert growth(still_cloth(kind, gamma=gamma, dt=ABOVE * limit)) > BLOWN_UP


@pytest.mark.parametrize("gamma", [0.0, 0.3, 1.0])
def test_the_stability_limit_of_a_spring_is_the_closed_form(gamma):
    world = still_cloth("spring", gamma=gamma)
    reduced = 1.0 / (1.0 / 0.01 + 1.0 / 0.03)
    omega = math.sqrt(20.0 / reduced)
    closed = 2.0 * (math.sqrt(1.0 + gamma * gamma) - gamma) / omega
    assert closed * (1.0 - 1e-2) <= world.stability_limit() <= closed  # rounded to the safe side


@pytest.mark.parametrize("kind", ["spring", "grid", "irregular"])
def test_the_report_calls_a_step_unstable_exactly_beyond_the_limit(kind):
    limit = still_cloth(kind).stability_limit()
    for part in (0.5, BELOW, 1.001, ABOVE):
        words = still_cloth(kind, dt=part * limit).step().effects["integrator"]
        assert words.startswith("unstable") == (part > 1.0)
        assert f"stable up to {1e3 * limit:.3g} ms" in words
    implicit = still_cloth(kind, dt=ABOVE * limit, integrator="sdirk2")
    assert implicit.step().effects["integrator"] == "sdirk2"


# Contact


@pytest.mark.parametrize("contact", ["penalty", "impulse", "postprocess"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_every_integrator_drops_a_sheet_on_a_ball(name, contact):
    """A second of falling, hitting at 1.4 m/s and draping; impulses leave nothing inside at any step."""
    cloth = grid(size=(0.5, 0.5), resolution=(6, 6), position=[0.01, 0.02, 0.31])
    springs = {"stretch": 5.0, "altitudes": "all", "altitude": 5.0, "density": 0.3, "dt": 1 / 100}
    made = scene(cloth, ball(radius=0.2), gravity=EARTH, contact=contact, **springs)
    world = sim.Simulation(made, integrator=name)
    if not INTEGRATORS[name].implicit:
        world.update(dt=0.5 * world.stability_limit())
    energy, names = sum(world.energy().values()), set()
    while world.time < 1.0:
        report = world.step()
        names.add(report.integrator)
        if contact == "impulse":
            assert report.penetrations == 0
        assert report.deepest < 0.01  # what a penalty lets in is of the size of the thickness, 5 mm
    stand_in = {"backward_euler"} if INTEGRATORS[name].implicit else set()
    assert names == {name} | stand_in
    assert np.linalg.norm(world.positions, axis=1).min() < 0.21  # it lies on the ball
    assert sum(world.energy().values()) < energy
    assert np.abs(world.velocities).max() < 2.0  # what projection stretches is not kept to swing by
