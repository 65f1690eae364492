"""A spring kind from outside the package: one module and one line in the registry, and it is everywhere."""

import textwrap
from pathlib import Path

import numpy as np
import pytest

import sim
from sim.docs import settings_page
from sim.settings import FIELDS, parse
from sim.springs import BENDING, SpringKind
from tests.worlds import grid, irregular, scene

LINE = SpringKind("half_sine", "bounded sine of half the angle", "hinges", (0, 1, 2, 3), "bending", memory=1)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(BENDING, "half sine", LINE)


def test_it_is_the_one_that_contributors_are_shown():
    shown = (Path(__file__).parent.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    module = (Path(__file__).parent / "half_sine.py").read_text(encoding="utf-8")
    assert textwrap.indent(module, "   ", lambda line: bool(line.strip())) in shown
    assert f'"{LINE.summary}", "{LINE.stencil}", {LINE.vertices}, "{LINE.stiffness}", memory=1' in shown


def test_it_can_be_chosen_wherever_settings_are_read():
    assert parse("bend", "half sine") == "half sine"
    assert "half sine" in FIELDS["bend"].allowed
    assert LINE.summary in settings_page()
    assert sim.load_scene(scene(grid(), bend="half sine")).settings.bend == "half sine"


@pytest.mark.parametrize("integrator", ["backward_euler", "sdirk2"])
@pytest.mark.parametrize("newton", [1, 6])
def test_it_is_simulated_with_every_solver(integrator, newton):
    settings = {"bending": 1e-2, "rest_angle": 0.5, "gamma": 0.5, "integrator": integrator, "newton": newton}
    world = sim.Simulation(scene(irregular(), bend="half sine", **settings))
    before = world.energy()["half sine"]
    for _ in range(60):
        world.step()
    assert world.energy()["half sine"] < 0.5 * before
    assert np.abs(world.momentum()[0]).max() < 1e-12  # no outer force, so momentum stays what it was: none


def test_its_forces_are_the_slope_of_its_energy_and_turn_nothing():
    world = sim.Simulation(scene(irregular(4), bend="half sine", bending=1e-2, rest_angle=0.3))
    forces, step = world.forces(), 1e-6
    direction = np.random.default_rng(1).standard_normal(forces.shape)
    ahead, behind = (
        sum(world.model.energies(world.positions + s * step * direction).values()) for s in (1, -1)
    )
    slope = (ahead - behind) / (2 * step)
    assert slope == pytest.approx(-np.sum(forces * direction), rel=1e-6)  # truncation 1e-12, rounding 1e-10
    torque = np.cross(world.positions, forces).sum(axis=0)
    assert np.abs(torque).max() < 1e-12 * np.abs(forces).sum()


def test_it_resists_a_small_fold_like_the_others():
    """Equal energy at a small deflection, without a formula of its own for stiffness or rest value."""
    bent = grid(size=(1, 0.5), resolution=(9, 5))
    energies = {}
    for kind in ("angle", "half sine"):
        world = sim.Simulation(scene(bent, bend=kind, bending=1e-2))
        x = world.positions.copy()
        x[:, 2] = 0.01 * x[:, 0] ** 2
        world.place(x)
        energies[kind] = world.energy()[kind]
    assert energies["half sine"] == pytest.approx(energies["angle"], rel=1e-4)  # θ² against 4 sin²(θ/2)
    assert energies["angle"] > 0.0


def test_it_finds_its_equilibrium_without_a_second_derivative():
    cloth = {**grid(size=(0.4, 0.2), resolution=(9, 5)), "pins": ["left"]}
    settings = {"gravity": [0, 0, -9.81], "stretch": 500.0, "bending": 1e-3, "jitter": 1e-4}
    world = sim.equilibrium(scene(cloth, bend="half sine", **settings))
    forces = world.forces()[world.model.free]
    assert np.abs(forces).max() < 1e-6 * 0.2 * 9.81 * 0.08  # of its whole weight
