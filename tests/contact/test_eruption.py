"""Steps of contact that would put in energy."""

import numpy as np
import pytest

from sim.contact.contacts import make_contacts
from sim.contact.eruption import erupts
from sim.scene import load_scene
from sim.simulation import Simulation
from sim.solve import implicit, stepping
from sim.solve.implicit import Solution
from tests.worlds import grid, scene

FINE = {
    "cloth": {"kind": "grid", "size": [0.4, 0.4], "resolution": [41, 41], "position": [0.0, 0.0, 0.02]},
    "obstacle": [{"kind": "sphere", "center": [0.0, 0.0, -0.15], "radius": 0.15}],
    "settings": {"density": 0.2, "stretch": 10.0, "altitude": 10.0, "bending": 1e-4, "thickness": 3e-3},
}
"""Cloth that falls by three edges' lengths a step when it meets the ball."""


def total(sim):
    return sum(sim.energy().values())


def test_fine_cloth_that_is_stopped_is_asked_twice_and_not_halved():
    sim = Simulation(load_scene(FINE))
    twice, start = 0, total(sim)
    for _ in range(12):
        report = sim.step()
        assert report.substeps == 1
        twice += report.newton > 1
        assert total(sim) < start
    assert twice > 0  # else the linearised step was good enough, and nothing is shown


def test_a_step_that_lands_softly_is_linearised():
    soft = FINE | {"settings": FINE["settings"] | {"stretch": 0.1, "altitude": 0.1}}
    sim = Simulation(load_scene(soft))
    assert [sim.step().newton for _ in range(5)] == [1] * 5


def test_cloth_that_impulses_would_throw_is_held_by_stiffer_gap_springs():
    """Finer and stiffer than before: the springs along the cloth are 10⁵ times the masses over h²."""
    cloth = FINE["cloth"] | {"resolution": [61, 61]}
    settings = FINE["settings"] | {"stretch": 100.0, "altitude": 100.0}
    sim = Simulation(load_scene(FINE | {"cloth": cloth, "settings": settings}))
    reports = [sim.step() for _ in range(14)]
    assert sum(report.newton > 1 for report in reports) > 5  # else nothing is shown
    assert all(report.substeps == 1 for report in reports[5:])  # the first ones meet the ball head-on


@pytest.mark.parametrize("detection", ["static", "continuous"])
def test_penalties_put_no_more_into_stiff_cloth_than_it_had(detection):
    """It lands with some tenths of a joule; a linearised step had put in 430 J, or 50."""
    cloth = {"kind": "equilateral", "size": [0.6, 0.5], "resolution": [13, 12], "position": [0, 0, 0.15]}
    ball = {"kind": "sphere", "center": [0.0, 0.0, -0.2], "radius": 0.18}
    stiff = {"contact": "penalty", "detection": detection, "stretch": 2000.0}
    sim = Simulation({"cloth": {**cloth, "rotation": [0.2, 0.1, 0.4]}, "obstacle": [ball], "settings": stiff})
    energies, repeated = [total(sim)], 0
    for _ in range(40):
        repeated += sim.step().newton > 1
        energies.append(total(sim))
    assert max(np.diff(energies)) < 0.02  # what penetrated is pushed out, which takes some millijoules
    assert 0 < repeated < 20


def test_a_step_that_is_solved_again_begins_where_it_was(monkeypatch):
    """Its linear model is the same at first, with the same contacts."""
    begun, solve, tried = [], implicit._solve, stepping.backward_euler

    def try_anew(*args, **more):
        begun.append([])
        return tried(*args, **more)

    def counted(*args, **more):
        found = solve(*args, **more)
        begun[-1].append(found.iterations)
        return found

    monkeypatch.setattr(stepping, "backward_euler", try_anew)
    monkeypatch.setattr(implicit, "_solve", counted)
    sim = Simulation(load_scene(FINE))
    while sim.step().newton == 1:
        begun.clear()
    first, again = begun
    assert again[0] < 0.5 * first[0]


def test_what_strain_limiting_puts_in_is_not_held_against_contacts():
    """It does so in halves of the step, too; 32 parts each moved a cloth of 70 vertices for seconds."""
    world = Simulation(scene(grid(resolution=(4, 4))))
    h, x, v = world.settings.dt, world.positions, np.zeros_like(world.positions)
    contacts = make_contacts(1)
    contacts.node[0], contacts.weight[0] = [0, 1, 2, 3], [1.0, 0.0, 0.0, 0.0]

    def verdict(moved, limited):
        end = Solution(x + h * moved, moved, 1, 1, 0.0, True, limited=limited)
        return erupts(world.model, world.settings, contacts, np.zeros(1), x, v, end, end)

    thrown = np.random.default_rng(0).standard_normal(x.shape)
    assert verdict(thrown, None) == "solve"
    assert verdict(thrown, world.masses[:, None] * thrown) == ""
    assert verdict(2.0 * thrown, world.masses[:, None] * thrown) == "solve"
