"""What accuracy costs: the study finds known orders, sees waste, and refuses what it cannot judge."""

import math
import statistics
import time
import tomllib
from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from small import FEW, WASTEFUL

import sim
from server.cli import main
from sim.integrators import INTEGRATORS
from sim.settings import change
from sim.studies.cost import plan as planning
from sim.studies.cost import study
from sim.studies.cost import trace as traces
from sim.studies.cost.ensemble import bands
from sim.studies.cost.front import cheapest, front
from sim.studies.cost.measures import Measures, distances, size
from sim.studies.cost.nested import nested
from sim.studies.cost.plan import SOLVED
from sim.studies.cost.reference import MARGIN, Reference, ReferenceError, refuse
from sim.studies.cost.report import Source
from sim.studies.cost.study import cost
from sim.studies.cost.trace import Case, Trace, run
from sim.studies.cost.verdict import dominant, notes, verdict
from sim.studies.cost.workers import workers
from tests.worlds import ball, grid, scene

pytestmark = pytest.mark.alone

SOLVED_ORDER = 0.15
"""An observed order may miss the theoretical one by this: steps of 17 ms are not yet short."""


def by_curve(report, curve):
    """The runs of a curve, longest step first."""
    return sorted((r for r in report.runs if curve in r.curves), key=lambda r: -r.settings.dt)


# The study


@pytest.mark.parametrize("name", FEW.integrators)
def test_errors_of_a_smooth_scene_fall_with_the_order_of_the_integrator(report, name):
    errors = [r.error_at_end for r in by_curve(report, f"{name}, {SOLVED}")]
    orders = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert orders[-1] == pytest.approx(INTEGRATORS[name].order, abs=SOLVED_ORDER)


def test_the_curve_of_an_integrator_says_which_order_was_seen_and_which_to_expect(report):
    curves = {curve.name: curve for curve in report.curves}
    assert curves[f"backward_euler, {SOLVED}"].expected == 1
    assert curves[f"sdirk2, {SOLVED}"].expected == 2
    assert curves[f"sdirk2, {SOLVED}"].order > 1.5 > curves[f"backward_euler, {SOLVED}"].order


def test_a_method_that_does_more_work_for_the_same_error_is_above_the_front(report):
    pairs = zip(by_curve(report, f"sdirk2, {SOLVED}"), by_curve(report, f"{WASTEFUL}, {SOLVED}"), strict=True)
    for good, bad in pairs:
        assert bad.error == pytest.approx(good.error, abs=report.floor)
        assert bad.matvecs > 1.2 * good.matvecs
        assert not bad.front_by_work


def test_nothing_on_the_front_is_beaten_by_what_costs_less(report):
    for on, cost_of in (("front", lambda r: r.ms), ("front_by_work", lambda r: r.matvecs)):
        best = [r for r in report.runs if getattr(r, on)]
        assert best
        for r in best:
            assert not any(o.error < r.error and cost_of(o) < cost_of(r) for o in report.runs)


def test_the_floor_is_a_tenth_of_the_smallest_error_and_the_larger_of_both_checks(report):
    assert MARGIN * report.floor <= min(r.error for r in report.runs)
    assert report.floor == max(report.reference.checks.values()) > 0.0
    assert report.reference.dt == pytest.approx(min(r.settings.dt for r in report.runs) / 16)


@pytest.mark.parametrize("finer", [1, 2, 4])
def test_a_reference_that_is_too_coarse_is_refused(swing, finer):
    with pytest.raises(ReferenceError, match=r"the reference is too coarse: .* expected a tenth"):
        cost(swing, seconds=0.2, effort=FEW, jobs=1, finer=finer)


@pytest.mark.parametrize("effort", [planning.QUICK, planning.USUAL])
def test_a_reference_that_is_too_coarse_at_first_is_refined_twice(swing, effort):
    effort = replace(effort, integrators=FEW.integrators, members=1, ensemble=0, minutes=math.inf)
    found = cost(swing, seconds=0.2, effort=effort, jobs=1, finer=3)
    assert found.reference.refined == 2
    assert MARGIN * found.floor <= min(r.error for r in found.runs)


def test_a_reference_for_which_there_is_time_for_one_look_alone_is_none(swing, monkeypatch):
    left = {study.REFERENCE_SHARE: 0.0}
    monkeypatch.setattr(study._Study, "_limit", lambda _, share: left.get(share, 1e9))
    with pytest.raises(ReferenceError, match=r"comes no farther than 0.0167 s .*; ask for --full"):
        cost(swing, seconds=0.2, effort=replace(FEW, minutes=1.0), jobs=1)


def test_a_recommendation_from_a_part_of_the_time_says_so(swing, monkeypatch):
    monkeypatch.setattr(study, "comparable", lambda *_: 3)
    effort = planning.Effort(0, 0, ("backward_euler", "sdirk2"), 1, 1, 0, 0, math.inf)
    found = cost(swing, seconds=0.17, effort=effort, jobs=1)
    assert "in the first 0.05 s of this scene" in found.verdict.sentence


def test_a_refusal_is_of_a_look_that_could_have_been_used_and_names_both_numbers():
    """A floor that is good enough at one look alone is no reference, and is not told as one."""
    floor, smallest = np.array([0.0, 1e-6, 4e-4, 9e-4]), np.array([0.0, 2e-5, 1e-3, 1.5e-3])
    seen = Trace(np.arange(4) / 10, *[None] * 10)
    error = refuse(Reference(seen, 1e-3, floor, {}), [smallest], 3, 2, cut=False, more="")
    assert "known to 4.0e-04 at 0.2 s, where the smallest error is 1.0e-03; expected a tenth" in str(error)


@pytest.mark.parametrize(
    ("effort", "advice"),
    [
        (planning.QUICK, "later looks take more time than there is; ask for --full, or leave out --quick"),
        (planning.USUAL, "later looks take more time than there is; ask for --full"),
        (planning.FULL, "ask for more --seconds"),
    ],
)
def test_where_there_was_no_time_to_look_until_methods_differ_more_of_it_is_advised(effort, advice):
    """More --seconds would not help: those that were asked for were not reached."""
    exact = Reference(Trace(np.arange(4) / 10, *[None] * 10), 1e-3, np.zeros(4), {})
    error = refuse(exact, [np.zeros(4)], 3, 2, cut=True, more=planning.more_time(effort))
    assert f"there is nothing to compare; {advice}, or another scene" in str(error)


def test_a_scene_on_which_every_method_is_exact_is_refused():
    falls = scene(grid(size=(0.3, 0.3), resolution=(3, 3)), gravity=[0, 0, -9.81], contact="none")
    effort = planning.Effort(1, 0, ("bdf2", "sdirk2"), 1, 1, 0, 0, math.inf)
    with pytest.raises(ReferenceError, match="exact to rounding"):
        cost(falls, {"integrator": "midpoint", "newton": 3}, seconds=0.1, effort=effort, jobs=1)


def test_a_study_that_can_afford_only_the_fall_goes_on_until_the_cloth_lands(monkeypatch):
    monkeypatch.setattr(study._Study, "_affordable", lambda *_: study.FEWEST)
    below = ball((0.0, 0.0, -0.3), 0.2)  # no floor: what lands flat has fine runs as exact as the reference
    lands = scene(grid(size=(0.3, 0.3), resolution=(3, 3)), below, gravity=[0, 0, -9.81], contact="penalty")
    effort = planning.Effort(1, 0, ("bdf2", "sdirk2"), 1, 1, 0, 0, math.inf)
    found = cost(lands, {"integrator": "midpoint", "newton": 3}, seconds=0.17, effort=effort, jobs=1)
    assert max(run.error for run in found.runs) > 0.0


def test_the_recommendation_is_the_cheapest_run_that_meets_the_target(report):
    fit = [
        r
        for r in report.runs
        if r.error <= report.verdict.target and r.error_energy <= 10 * report.verdict.target
    ]
    assert report.verdict.error <= report.verdict.target
    assert report.verdict.ms == min(r.ms for r in fit)
    assert report.verdict.pays == pytest.approx(report.runs[0].ms / report.verdict.ms)


def test_the_block_in_place_of_the_scenes_settings_gives_the_recommended_run_and_what_was_overridden(report):
    """TOML has no two tables of one name: without the scene's own settings no block could be pasted."""
    best = next(r for r in report.runs if r.ms == report.verdict.ms)
    assert report.chosen.gamma == 0.05
    pasted = sim.load_scene({"cloth": grid(), **tomllib.loads(report.verdict.toml)})
    assert pasted.settings == best.settings
    elsewhere = msgspec.structs.replace(best, settings=change(best.settings, friction=0.7))
    other = verdict(elsewhere, [elsewhere], [], 1e-3)
    assert tomllib.loads(other.toml)["settings"]["friction"] == 0.7
    assert other.settings == elsewhere.changed


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("Newton iterations", "iterations dominate: turned from 1 to 2 they move the cloth by 1 %."),
        ("contact thickness", "thickness dominates: turned from 1 to 2 it moves the cloth by 1 %."),
    ],
)
def test_the_sentence_on_the_largest_source_agrees_in_number(source, words):
    assert dominant([Source(source=source, what="1 to 2", change=0.01, observables={})]).endswith(words)


def test_sources_turn_one_knob_each_and_the_step_dominates_a_long_step(report):
    sources = {source.source: source for source in report.sources}
    assert set(sources) == {"time step", "Newton iterations", "linear solve", "mesh"}
    assert sources["time step"].change == max(s.change for s in report.sources if s.change is not None)
    assert "time step dominates" in report.verdict.dominates
    assert sources["mesh"].change is None  # vertices of another mesh are not compared
    assert sources["mesh"].observables["sag"] != 0.0


def test_a_study_without_a_nested_mesh_says_that_the_meshs_part_is_not_told(report):
    untold = "What the mesh itself is wrong by is not told"
    others = [source for source in report.sources if source.source != "mesh"]
    assert not any(note.startswith(untold) for note in report.notes)
    assert any(note.startswith(untold) for note in notes(report.runs, False, 1, others))


def test_the_error_of_a_run_is_its_distance_from_a_run_made_directly(report, swing):
    """SDIRK2 at the longest step against a run at the reference's step, both stepped by hand."""
    chosen = by_curve(report, f"sdirk2, {SOLVED}")[0].settings
    ends = []
    for dt in (chosen.dt, report.reference.dt):
        world = sim.Simulation(swing, integrator="sdirk2", dt=dt, newton=8, tolerance=1e-12)
        for _ in range(round(report.horizon / dt)):
            world.step()
        ends.append(world.positions.copy())
    apart = distances(ends[0][None], ends[1][None], world.masses, size(world))[0]
    found = by_curve(report, f"sdirk2, {SOLVED}")[0].error_at_end
    assert found == pytest.approx(apart, rel=1e-2)  # solved to 1e-12 m here, to a part of the error there


def test_a_scene_with_contact_sweeps_responses_and_says_that_order_is_lost(landing):
    effort = planning.Effort(1, 0, ("backward_euler", "sdirk2"), 1, 1, 2, 1, math.inf)
    found = cost(landing, seconds=0.17, effort=effort, jobs=1)
    responses = {
        (r.settings.contact, r.settings.detection) for r in found.runs if planning.RESPONSE in r.curves
    }
    assert responses == {
        (c, d) for c in ("penalty", "impulse", "postprocess") for d in ("static", "continuous")
    }
    assert max(r.stood_in for r in found.runs if r.settings.integrator == "sdirk2") > 0.0
    assert any("backward Euler whatever the integrator" in note for note in found.notes)
    assert {s.source for s in found.sources} >= {"contact thickness", "mesh"}
    assert found.horizon <= found.growth.horizon + 1e-9


def test_progress_goes_from_nothing_to_all_and_never_back(swing):
    told = []
    effort = planning.Effort(0, 0, ("backward_euler", "sdirk2"), 1, 1, 0, 0, math.inf)
    cost(swing, seconds=0.17, effort=effort, jobs=1, progress=lambda done, what: told.append(done))
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert told == sorted(told)


# Its parts


def test_bands_are_the_spread_of_seeded_runs_past_the_horizon_and_the_same_wherever_they_are_made(landing):
    found = []
    for jobs in (1, 2):
        cases = [Case(sim.load_scene(landing), {}, 1 / 60, 6, ((1e-3, 1 + m),)) for m in range(3)]
        with workers(jobs) as run_all:
            found.append(list(bands("chosen", list(run_all(cases)), 2)))
    assert found[0] == found[1]
    radius = next(b for b in found[0] if b.observable == "drape radius")
    ends = [run(case).observables["drape radius"][-1] for case in cases]
    assert radius.members == 3
    assert radius.mean[-1] == pytest.approx(statistics.mean(ends), rel=1e-12)
    assert radius.deviation[-1] == pytest.approx(statistics.stdev(ends), rel=1e-6)


def test_runs_that_end_before_the_horizon_or_stand_alone_make_no_band(swing):
    short, long = (run(Case(sim.load_scene(swing), {}, 1 / 60, looks)) for looks in (2, 4))
    assert list(bands("chosen", [short, long], 2)) == []
    assert all((b.members, len(b.times)) == (2, 5) for b in bands("chosen", [short, long, long], 2))


def test_runs_are_the_same_to_the_bit_in_other_processes(swing):
    cases = [Case(sim.load_scene(swing), {"dt": 1 / 60}, 1 / 30, 2, ((1e-3, m),)) for m in range(2)]
    with workers(2) as run_all:
        found = list(run_all(cases))
    for case, trace in zip(cases, found, strict=True):
        assert np.array_equal(trace.positions, run(case).positions)
    assert not np.array_equal(found[0].positions, found[1].positions)


def test_a_step_that_fails_ends_a_run_with_its_reason_and_keeps_what_was_seen(swing):
    case = Case(
        sim.load_scene(swing), {"integrator": "symplectic_euler", "stretch": 1e7, "dt": 1 / 30}, 1 / 30, 30
    )
    trace = run(case)
    assert "velocity of vertex" in trace.stopped
    assert 1 <= len(trace) < 31


def test_what_a_simulation_builds_at_its_first_step_is_no_part_of_what_its_steps_cost(monkeypatch, swing):
    class Builds(sim.Simulation):
        built = False

        def step(self):
            if not self.built:
                time.sleep(0.2)
                self.built = True
            return super().step()

    monkeypatch.setattr(traces, "Simulation", Builds)
    assert run(Case(swing, {}, 1 / 60, 3)).ms.sum() < 200.0


def test_work_is_summed_and_depth_is_the_largest_between_looks(landing):
    settings, steps = {"contact": "penalty", "dt": 1 / 60}, 4
    trace = run(Case(sim.load_scene(landing), settings, steps / 60, 4))
    world = sim.Simulation(landing, **settings)
    reports = [world.step() for _ in range(4 * steps)]
    parts = [reports[i : i + steps] for i in range(0, 4 * steps, steps)]
    assert trace.work["matvecs"][1:].tolist() == [sum(r.iterations for r in part) for part in parts]
    assert trace.contact["deepest"][1:].tolist() == [max(r.deepest for r in part) for part in parts]
    assert any(max(r.deepest for r in part) > part[-1].deepest for part in parts)
    assert np.array_equal(trace.positions[-1], world.positions)


def test_the_front_is_what_nothing_beats():
    costs, errors = [1.0, 2.0, 3.0, 4.0, 4.0], [9.0, 5.0, 6.0, 1.0, 1.0]
    assert front(costs, errors) == [True, True, False, True, False]
    assert front(costs, errors, floor=4.5) == [True, False, False, True, False]
    assert cheapest(costs, errors, 5.5) == 1
    assert cheapest(costs, errors, 0.5) is None


def test_a_nested_mesh_has_the_old_vertices_pins_and_stiffness():
    """A uniform pull stretches both meshes alike: their energy per strain is the same."""
    pins = ["left", 5]
    coarse = sim.load_scene(scene(grid(size=(1.0, 0.5), resolution=(5, 3), pins=pins), stretch=30.0))
    fine, changes = nested(coarse, coarse.settings, 1)
    a, b = sim.Simulation(coarse), sim.Simulation(fine, **changes)
    at = [int(np.argmin(np.linalg.norm(b.positions - x, axis=1))) for x in a.positions]
    assert np.abs(b.positions[at] - a.positions).max() < 1e-15
    assert set(np.array(at)[a.pinned]) <= set(b.pinned.tolist())
    inner = grid(size=(1.0, 1.0), resolution=(9, 9))
    energies = []
    for level in (0, 1):
        case = sim.load_scene(scene(inner, stretch=30.0))
        other, scaled = nested(case, case.settings, level)
        world = sim.Simulation(other, **scaled)
        pulled = world.positions * [1.01, 1.0, 1.0]
        world.place(pulled)
        energies.append(world.energy()["edge"])
    # edges along the hem carry half of what inner ones do: one part in the number of rows
    assert energies[1] == pytest.approx(energies[0], rel=0.1)
    assert nested(fine, a.settings, -1)[0].cloth[0].resolution == (5, 3)
    assert nested(sim.load_scene(scene(grid(resolution=(4, 4)))), a.settings, -1) is None


CURLED = {"kind": "equilateral", "size": (1.0, 0.5), "resolution": (11, 8), "pins": ["left"]}
TRIANGLES = {"vertices": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "triangles": [[0, 1, 2], [2, 3, 0]]}


@pytest.mark.parametrize(
    ("cloth", "pinned", "energy"),
    [
        (CURLED, 15, "angle"),
        ({**CURLED, "pins": [0, 11]}, 2, "angle"),
        ({**TRIANGLES, "pins": [1]}, 1, "edge"),
    ],
)
def test_triangles_that_are_no_grid_are_cut_into_four_for_the_same_cloth(cloth, pinned, energy):
    """The same mass, each old vertex where it was, and the same energy where it is flat, or is pulled."""
    rest_angle, pull = (0.1, 1.0) if energy == "angle" else (0.0, 1.01)
    coarse = sim.load_scene(scene(cloth, stretch=30.0, bend="angle", rest_angle=rest_angle))
    fine, changes = nested(coarse, coarse.settings, 1)
    a, b = sim.Simulation(coarse), sim.Simulation(fine, **changes)
    n = len(a.positions)
    assert len(b.mesh.triangles) == 4 * len(a.mesh.triangles)
    assert np.array_equal(b.positions[:n], a.positions)
    assert len(b.pinned) == pinned
    assert b.masses.sum() == pytest.approx(a.masses.sum())
    for world in (a, b):
        world.place(world.positions * [pull, 1.0, 1.0])
    # hinges and edges along the hem count half or not at all: one part in the number of rows
    assert b.energy()[energy] == pytest.approx(a.energy()[energy], rel=0.35 if energy == "edge" else 0.2)
    assert nested(coarse, coarse.settings, -1) is None


def test_links_and_masses_of_their_own_have_no_nested_mesh():
    links = {"vertices": [[0, 0, 0], [0, 0, 1]], "edges": [[0, 1]]}
    for cloth in (links, {**TRIANGLES, "masses": [1.0, 1.0, 1.0, 1.0]}, {**TRIANGLES, "edges": [[1, 3]]}):
        case = sim.load_scene(scene(cloth))
        assert nested(case, case.settings, 1) is None


def test_observables_are_those_of_shapes_that_are_known():
    flat = scene(grid(size=(2.0, 1.0), resolution=(21, 11), pins=["top"]), gravity=[0, 0, -9.81])
    world = sim.Simulation(flat)
    measures = Measures(world)
    found = measures.look().observables
    assert found["area"] == pytest.approx(2.0)
    assert found["projected area"] == pytest.approx(2.0)
    assert found["sag"] == pytest.approx(0.0, abs=1e-15)
    assert found["hinge angle"] == pytest.approx(0.0, abs=1e-15)
    # ∫(x² + y²) over the rectangle; lumping to vertices puts mass outwards by a part of a cell squared
    assert found["drape radius"] == pytest.approx(math.sqrt((4.0 + 1.0) / 12.0), rel=1e-2)
    tilted = world.positions.copy()
    tilted[:, 2], tilted[:, 1] = -0.6 * (0.5 - tilted[:, 1]), 0.8 * tilted[:, 1]
    world.place(tilted)
    found = measures.look().observables
    assert found["sag"] == pytest.approx(0.6)
    assert found["projected area"] == pytest.approx(1.6)
    assert measures.look().strain == pytest.approx(0.0, abs=1e-12)


def test_closed_cloth_has_a_volume():
    corners = [[x, y, z] for z in (0.0, 2.0) for y in (0.0, 1.0) for x in (0.0, 1.0)]
    sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    triangles = [t for a, b, c, d in sides for t in ([a, b, c], [a, c, d])]
    world = sim.Simulation(scene({"vertices": corners, "triangles": triangles}, gravity=[0, 0, -1.0]))
    found = Measures(world).look().observables
    assert found["volume"] == pytest.approx(2.0)
    assert found["projected area"] == pytest.approx(2.0)  # above and below


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["cost"], "SCENE: expected a scene file, or one of `muslin scenes`, got none"),
        (["cost", "drape", "--quick", "--full"], "--quick: expected one of --quick and --full, got both"),
        (
            ["cost", "drape", "--seconds", "0.01"],
            "--seconds: expected at least 2 steps of 0.0333 s, got 0.01",
        ),
        (["cost", "drape", "--target", "2"], "--target: expected a relative error > 0 and < 1, got 2"),
        (["cost", "drape", "--set", "gamma=-1"], "gamma: expected ≥ 0 and ≤ 1000, got -1"),
        (
            ["cost", "drape", "--json", "nowhere/x.json"],
            "nowhere/x.json: cannot be written: No such file or directory",
        ),
        (["compare", "drape", "--by", "contact"], "--by: expected name=a,b,c, got 'contact'"),
        (
            ["compare", "drape", "--by", "contact=penalty"],
            "--by: expected two or more different values of contact, got penalty",
        ),
        (
            ["compare", "drape", "--by", "gamma=1,1"],
            "--by: expected two or more different values of gamma, got 1, 1",
        ),
        (
            ["compare", "drape", "--by", "gamma=1,2", "--repeats", "-2"],
            "--repeats: expected 1 or more, got -2",
        ),
        (["compare", "drape", "--by", "gamma=1,2", "--jobs", "-3"], "--jobs: expected 0 or more, got -3"),
        (["cost", "drape", "--jobs", "-3"], "--jobs: expected 0 or more, got -3"),
        (
            ["compare", "drape", "--by", "dt=0.016,0.0170001"],
            "dt: expected time steps with a common multiple",
        ),
    ],
)
def test_a_wrong_call_is_refused_in_one_line(monkeypatch, tmp_path, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"muslin: {words}")
    assert said.err.count("\n") == 1
