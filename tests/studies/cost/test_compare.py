"""`muslin compare`: its numbers are those of runs made directly."""

import numpy as np
import pytest

import sim
from sim.studies.cost import timing
from sim.studies.cost.compare import common_multiple, compare, makes_another_cloth
from sim.studies.cost.measures import distances, size
from sim.studies.cost.reference import MARGIN
from sim.studies.cost.trace import run

pytestmark = pytest.mark.alone


def test_energies_penetrations_and_stretch_are_those_of_direct_runs(compared, landing):
    for variant in compared.variants:
        world = sim.Simulation(landing, contact=variant.settings.contact)
        ends = world.mesh.rest_vertices[world.edges]
        rest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        start, reports, strains, crossed = sum(world.energy().values()), [], [], [0]
        for _ in range(round(compared.seconds / world.settings.dt)):
            reports.append(world.step())
            crossed.append(len(sim.intersections(world.positions, world.triangles)))
            ends = world.positions[world.edges]
            strains.append((np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / rest).max() - 1.0)
        assert variant.energy == world.energy()
        assert variant.energy_start == start
        assert variant.energy_change == sum(world.energy().values()) - start
        assert variant.penetrations == max(report.penetrations for report in reports)
        assert variant.deepest == max(report.deepest for report in reports)
        assert variant.stretch == max(strains)
        assert variant.crossings == max(crossed)
        assert variant.matvecs * compared.seconds == pytest.approx(sum(r.iterations for r in reports))
        assert variant.ms == pytest.approx(sum(variant.phases.values()), rel=0.5)  # phases are most of a step


def test_where_energy_went_is_that_of_direct_runs_that_keep_books(compared, landing):
    for variant in compared.variants:
        world = sim.Simulation(landing, contact=variant.settings.contact)
        world.keep_ledger()
        for _ in range(round(compared.seconds / world.settings.dt)):
            world.step()
        found, ledger = variant.balance, world.ledger
        assert (found.start, found.turnover) == (ledger.start, ledger.turnover)
        assert (found.injected, found.dissipated) == (ledger.injected, ledger.dissipated)
        assert found.residual == ledger.residual
        assert found.energy == variant.energy  # the run that was timed, without books, is the same to the bit
        assert found.dissipated["integrator"] > 0.0


def test_no_timed_run_keeps_books(swing, monkeypatch):
    timed = []
    monkeypatch.setattr(timing, "run", lambda case: timed.append(case) or run(case))
    compare(swing, "newton", [1, 2], seconds=0.1, repeats=1, jobs=1)
    assert timed
    assert not any(case.booked for case in timed)


def test_the_penalty_cloth_goes_deeper_than_the_impulse_cloth(compared):
    penalty, impulse = compared.variants
    assert (penalty.name, impulse.name) == ("penalty", "impulse")
    assert penalty.deepest > 0.0
    assert impulse.deepest == 0.0


def test_errors_are_told_against_one_reference_up_to_the_horizon(compared):
    assert compared.reference.startswith("SDIRK2")
    assert "the scene's settings" in compared.reference
    assert 0.0 < compared.horizon <= compared.seconds
    for variant in compared.variants:
        assert variant.error >= MARGIN * variant.floor > 0.0


def test_an_error_is_the_distance_from_a_much_finer_run(swing):
    """Of two time steps, against SDIRK2 at a 32nd of the finer one, stepped by hand."""
    steps = [1 / 30, 1 / 60]
    found = compare(swing, "dt", steps, seconds=0.2, repeats=1, jobs=1)
    assert found.horizon == pytest.approx(0.2)
    positions = []
    for settings in (*({"dt": dt} for dt in steps), {"dt": 1 / 1920, "integrator": "sdirk2", "newton": 8}):
        world = sim.Simulation(swing, tolerance=1e-4 if settings["dt"] > 1e-3 else 1e-12, **settings)
        seen = [world.positions.copy()]
        for i in range(round(0.2 / settings["dt"])):
            world.step()
            if (i + 1) % round(1 / 30 / settings["dt"]) == 0:
                seen.append(world.positions.copy())
        positions.append(np.array(seen))
    for variant, own in zip(found.variants, positions, strict=False):
        apart = distances(own, positions[-1], world.masses, size(world)).max()
        assert variant.error == pytest.approx(apart, abs=2 * variant.floor)
    # half the step, half the error: backward Euler is first order, and 33 ms are far from short
    assert found.variants[0].error / found.variants[1].error == pytest.approx(2.0, abs=0.5)


def test_cloths_that_differ_have_a_reference_each(swing):
    """Against one common reference the stiffer cloth's error would be its other motion: many per cent."""
    found = compare(swing, "stretch", [2.0, 8.0], seconds=0.2, repeats=1, jobs=1)
    assert "its own settings" in found.reference
    assert any("stretch makes another cloth" in note for note in found.notes)
    soft, stiff = found.variants
    assert soft.floor != stiff.floor
    assert makes_another_cloth("friction")
    assert not makes_another_cloth("contact")


def test_steps_are_compared_at_times_that_all_of_them_divide():
    assert common_multiple([1 / 60, 1 / 120]) == pytest.approx(1 / 60)
    assert common_multiple([1 / 60, 1 / 100]) == pytest.approx(1 / 20)
    assert common_multiple([0.01, 0.025]) == pytest.approx(0.05)
    with pytest.raises(ValueError, match="common multiple"):
        common_multiple([0.0166661, 0.0171113])


def test_a_variant_that_fails_says_why_and_leaves_the_others_their_numbers(swing):
    found = compare(
        swing, "integrator", ["backward_euler", "symplectic_euler"], {"stretch": 1e7}, 0.5, 1, jobs=1
    )
    fine, failed = found.variants
    assert (fine.stopped, fine.ms is None) == ("", False)
    assert "velocity of vertex" in failed.stopped
    assert failed.error is None


def test_where_errors_end_before_variants_part_it_is_said(swing, compared):
    """Without anything to touch, responses are the same."""
    same = compare(swing, "contact", ["none", "penalty"], seconds=0.2, repeats=1, jobs=1)
    assert any("all variants err alike" in note for note in same.notes)
    apart = np.ptp([v.error for v in compared.variants]) > max(v.floor for v in compared.variants)
    assert any("all variants err alike" in note for note in compared.notes) != apart
