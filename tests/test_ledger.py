"""The energy ledger adds up, and its entries are what closed forms say."""

import numpy as np
import pytest

import sim
import sim.ledger
from tests.worlds import chain, grid, irregular, scene

G = 9.81
ROUND_OFF = 1e-12
DOWN = [0, 0, -G]


def kept(*about, **settings):
    world = sim.Simulation(scene(*about, **settings))
    world.keep_ledger()
    return world


def run(world, seconds):
    while world.time < seconds - ROUND_OFF:
        world.step()
    return world.ledger


def spring(**settings):
    """A mass of 1 kg on a spring of 50 N/m along z, held at the other end; deflected by 0.1 m."""
    held = chain([[0, 0, 0], [0, 0, 1.1]], [1.0, 1.0], pins=[0], rest_vertices=[[0, 0, 0], [0, 0, 1.0]])
    return kept(held, contact="none", stretch=50.0, newton=8, tolerance=1e-12, **settings)


DAMPS_BY_ITSELF = {
    "backward_euler": lambda z: 1.0 / (1.0 - z),
    "midpoint": lambda z: (1.0 + z / 2) / (1.0 - z / 2),
    "trapezoid": lambda z: (1.0 + z / 2) / (1.0 - z / 2),
    "sdirk2": lambda z: (1.0 + (np.sqrt(2) - 1) * z) / (1.0 - (1 - 0.5**0.5) * z) ** 2,
    "tr_bdf2": lambda z: (1.0 + (np.sqrt(2) - 1) * z) / (1.0 - (1 - 0.5**0.5) * z) ** 2,
}
"""By what a step multiplies x' = λ x, z = h λ."""


@pytest.mark.parametrize("integrator", DAMPS_BY_ITSELF)
def test_an_undamped_spring_loses_to_the_integrator_what_its_stability_function_says(integrator):
    h, steps = 0.02, 50
    world = spring(integrator=integrator, dt=h, gamma=0.0)
    start = sum(world.energy().values())
    assert start == pytest.approx(0.25, abs=1e-12)
    ledger = run(world, h * steps)
    left = abs(DAMPS_BY_ITSELF[integrator](1j * h * np.sqrt(50.0))) ** (2 * steps)
    assert ledger.dissipated["integrator"] == pytest.approx(start * (1.0 - left), abs=1e-9)
    assert ledger.dissipated["damping"] == 0.0
    assert abs(ledger.residual) < 1e-9


@pytest.mark.parametrize(
    "integrator", ["backward_euler", "bdf2", "midpoint", "trapezoid", "sdirk2", "tr_bdf2"]
)
def test_damping_takes_what_the_exact_motion_loses_and_the_rest_shrinks_with_the_step(integrator):
    """It is x = e^(−γωt) (cos ω_d t + γω/ω_d sin ω_d t): its energy after 0.4 s is known."""
    gamma, t, w = 0.2, 0.4, np.sqrt(50.0)
    wd = w * np.sqrt(1 - gamma**2)
    decay = 0.1 * np.exp(-gamma * w * t)
    x = decay * (np.cos(wd * t) + gamma * w / wd * np.sin(wd * t))
    v = -decay * w**2 / wd * np.sin(wd * t)
    lost = 0.25 - 0.5 * v**2 - 25.0 * x**2
    off = []
    for h in (0.008, 0.004):
        ledger = run(spring(integrator=integrator, dt=h, gamma=gamma), t)
        assert abs(ledger.residual) < 1e-9
        off.append((ledger.dissipated["damping"] - lost, ledger.dissipated["integrator"]))
    shrinks = 2.0 if integrator == "backward_euler" else 4.0  # first and second order
    for coarse, fine in zip(*off, strict=True):
        assert abs(coarse) < 0.2 * lost
        assert abs(fine) < 1.25 * abs(coarse) / shrinks + 1e-9  # the next order is still a part of it


def test_books_of_a_step_evaluate_no_spring_for_its_energy_that_their_forces_have_not(monkeypatch):
    """Where a step ends, and the next begins, forces have been tallied; the page asks for them there, too."""
    import sim.model

    world = kept(grid(pins=["corner00"]), contact="none", bend="angle", gravity=DOWN)
    run(world, 0.1)
    known = world.energy()
    measured = []
    energy = sim.model.elastic_energy
    monkeypatch.setattr(sim.model, "elastic_energy", lambda e: measured.append(1) or energy(e))
    for _ in range(5):
        world.step()
        assert world.ledger.energy == world.energy() != known
    assert not measured
    plain = sim.Simulation(world.scene)
    plain.place(world.positions)
    assert plain.model.energies(plain.positions) == world.model.energies(world.positions)
    assert measured


def test_free_fall_in_steps_of_backward_euler_loses_half_m_g_squared_h_squared_each():
    world = kept(chain([[0, 0, 1]], [2.0]), contact="none", dt=0.01, gravity=DOWN)
    ledger = run(world, 0.5)
    assert ledger.dissipated["integrator"] == pytest.approx(50 * 0.5 * 2.0 * (G * 0.01) ** 2, rel=1e-9)
    assert abs(ledger.residual) < ROUND_OFF
    ledger = run(kept(chain([[0, 0, 1]], [2.0]), contact="none", integrator="midpoint", gravity=DOWN), 0.5)
    assert abs(ledger.dissipated["integrator"]) < ROUND_OFF


TILT = 0.6


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
def test_friction_on_an_incline_takes_its_force_times_the_way(contact):
    """μ m g cosα d, where friction is too weak to hold; off by less than a step's way."""
    mu, down = 0.3, np.array([-np.sin(TILT), 0.0, -np.cos(TILT)])
    cloth = grid((0.2, 0.2), (4, 4), position=[0, 0, 5e-3])
    settings = {
        "contact": contact,
        "friction": mu,
        "gravity": (G * down).tolist(),
        "dt": 1 / 240,
        "newton": 4,
    }
    world = kept(cloth, {"kind": "plane"}, **settings, tolerance=1e-8)
    at = world.positions.copy()
    ledger = run(world, 0.5)
    mass, way = world.masses.sum(), float(world.masses @ (at - world.positions)[:, 0]) / world.masses.sum()
    assert way > 0.3
    speed = -float(world.velocities[:, 0].mean())
    force = mu * mass * G * np.cos(TILT)
    assert ledger.dissipated["friction"] == pytest.approx(force * way, abs=force * speed / 240)
    assert abs(ledger.dissipated["contact"]) < 1e-3 * force * way
    assert abs(ledger.residual) < 1e-5 * ledger.turnover


def test_a_belt_puts_in_twice_what_the_cloth_has_when_it_moves_along():
    """Its force does m u² of work on the way of the belt: ½ m u² became heat while it slipped."""
    belt = {"kind": "plane", "motion": "linear", "path": [{"time": 0.0, "position": [0, 0, 0]}]}
    belt["path"].append({"time": 1.0, "position": [0.5, 0, 0]})
    cloth = grid((0.2, 0.2), (4, 4), position=[0, 0, 5e-3])
    world = kept(cloth, belt, friction=0.5, gravity=DOWN, dt=1 / 240, newton=4, tolerance=1e-8)
    ledger = run(world, 0.5)
    energy = 0.5 * world.masses.sum() * 0.5**2
    assert ledger.energy["kinetic"] == pytest.approx(energy, rel=1e-3)
    assert ledger.injected["obstacles"] == pytest.approx(2.0 * energy, rel=0.03)  # a step is 4 % of the slip
    assert ledger.dissipated["friction"] == pytest.approx(energy, rel=0.03)
    assert abs(ledger.residual) < 1e-5 * ledger.turnover


@pytest.mark.parametrize("contact", ["penalty", "impulse", "postprocess"])
def test_a_sheet_that_lands_flat_loses_its_kinetic_energy_to_contact(contact):
    """½ m v² at 2 m/s, and, as its last way is cut short, less than one step's fall of another."""
    world = kept(grid((0.2, 0.2), (4, 4)), {"kind": "plane"}, contact=contact, gravity=DOWN, dt=1 / 240)
    above = world.positions + np.array([0.0, 0.0, 0.02])
    world.place(above, np.tile([0.0, 0.0, -2.0], (len(above), 1)))
    ledger = run(world, 0.2)
    before = world.masses.sum() * (0.5 * 2.0**2 + G * 0.015)
    assert ledger.energy["kinetic"] < 0.01 * before
    assert ledger.dissipated["contact"] == pytest.approx(before, rel=0.1)
    assert abs(ledger.residual) < 1e-3 * ledger.turnover


def test_cloth_at_rest_moves_nothing_in_the_books():
    world = kept(grid((0.2, 0.2), (4, 4), position=[0, 0, 5e-3]), {"kind": "plane"}, gravity=DOWN)
    run(world, 1.0)
    before = world.ledger.turnover
    assert run(world, 2.0).turnover - before < 1e-6 * world.masses.sum() * G * 0.2


def test_settings_that_put_energy_in_are_booked_and_so_is_stopping():
    world = spring(integrator="sdirk2", dt=0.01, gamma=0.0)
    run(world, 0.05)
    before = sum(world.energy().values())
    world.update(stretch=200.0)
    run(world, 0.4)
    injected = world.ledger.injected["settings"]
    assert abs(injected) > 0.1 * before
    assert abs(world.ledger.residual) < 1e-9
    world.stop()
    assert world.ledger.injected["settings"] < injected
    assert abs(world.ledger.residual) < 1e-9, "before a step has booked it"
    run(world, 0.6)
    assert abs(world.ledger.residual) < 1e-9


def test_springs_that_are_wrong_on_purpose_and_springs_that_are_switched_have_entries():
    ghost = sim.Simulation("ghost", bend="adhoc", tolerance=1e-9)  # what a solve leaves is in the residual
    ghost.keep_ledger()
    ledger = run(ghost, 0.6)
    assert ledger.injected["wrong springs"] > 0.1 * ledger.energy["kinetic"]
    assert abs(ledger.residual) < 1e-9 * ledger.turnover
    mesh = irregular(noise=0.1)
    fallen = kept(mesh, altitudes="shortest", bend="none", contact="none", dt=0.01)
    switched = sum(fallen.step().energy_jump for _ in range(40))
    assert abs(fallen.ledger.residual) < 1e-3 * fallen.ledger.turnover
    assert fallen.ledger.injected["switched springs"] == pytest.approx(switched, rel=1e-12)
    assert switched != 0.0


MADE = [
    ("drape", {}),
    ("bullet", {"contact": "penalty"}),
    ("drape", {"contact": "postprocess", "detection": "static"}),
    ("curtain", {"integrator": "bdf2", "newton": 3}),
    ("ghost", {"integrator": "tr_bdf2", "bend": "adhoc"}),
    ("drape2d", {"integrator": "symplectic_euler", "dt": 5e-5}),
    ("flag", {}),
]


@pytest.mark.parametrize(("name", "settings"), MADE)
def test_a_step_is_the_same_to_the_bit_with_books_and_without(name, settings):
    plain, booked = sim.Simulation(name, **settings), sim.Simulation(name, **settings)
    booked.keep_ledger()
    for k in range(45):
        if k == 20:
            plain.update(stretch=70.0)
            booked.update(stretch=70.0)
        plain.step()
        booked.step()
    assert np.array_equal(plain.positions, booked.positions)
    assert np.array_equal(plain.velocities, booked.velocities)
    assert plain.ledger is None


def test_books_go_back_with_a_snapshot_and_begin_anew_where_cloth_is_placed():
    world = sim.Simulation("curtain", integrator="bdf2", contact="none")
    world.keep_ledger()
    run(world, 0.2)
    state = world.snapshot()
    first = run(world, 0.4)
    world.restore(state)
    assert run(world, 0.4) == first
    world.place(world.positions)
    assert world.ledger.turnover == world.ledger.residual == 0.0


@pytest.mark.parametrize("lost", ["friction", "normal"])
def test_a_force_that_no_entry_knows_is_a_residual(monkeypatch, lost):
    """The residual is no definition: books that leave out a force do not add up."""
    after = sim.ledger.Tally.after

    def forgetful(self, stage, v_hat, h):
        x, end = after(self, stage, v_hat, h)
        n = len(stage.positions)
        end[3 * n : 4 * n] *= lost != "normal"
        end[4 * n : 5 * n] *= lost != "friction"
        return x, end

    monkeypatch.setattr(sim.ledger.Tally, "after", forgetful)
    world = kept(grid((0.2, 0.2), (4, 4)), {"kind": "plane"}, gravity=DOWN, dt=1 / 240)
    above = world.positions + np.array([0.0, 0.0, 0.02])
    world.place(above, np.tile([2.0, 0.0, -2.0], (len(above), 1)))
    assert abs(run(world, 0.2).residual) > 0.1 * world.ledger.turnover
