"""The battery itself: what passes, what is planned, where it runs, and what it leaves behind."""

import contextlib
import json
import math
import time
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import sim
from server.cli import main
from server.drawing import drawing
from server.stress import as_html, as_json
from sim import stress
from sim.scene import load_scene
from sim.stress import Case, Figure, Task, at_least, at_most, reported
from sim.stress.executor import run_tasks
from sim.stress.keep import SCENE, load, pack, save
from sim.stress.probe import Fault, Outcome, Probe, run_task, take_picture
from sim.stress.scenes import crumple
from sim.stress.sweep import levels, move, rows
from sim.stress.verdict import Verdict
from sim.stress.worlds import ball, grid, scene
from tests.browser import WITHOUT_BROWSER, overflow
from tests.stress.dying import die_of, hold_to_nothing

QUICK = "N8"
"""A case that takes hardly any time."""


@pytest.fixture
def made_up(monkeypatch):
    """Cases by name that are there for one test only."""

    def add(name, run, runs=1):
        monkeypatch.setitem(
            stress.CASES, name, Case(name, f"made-up {name}", run, 0.1, runs, runs, "contact")
        )

    stress.cases()
    return add


# Figures and verdicts


@pytest.mark.parametrize(
    ("figure", "passed"),
    [
        (at_most("a", 1.0, 1.0), True),
        (at_most("a", 1.0 + 1e-12, 1.0), False),
        (at_most("a", 0.0, 0.0), True),
        (at_most("a", -2.0, 0.0), True),
        (at_most("a", 1e-300, 0.0), False),
        (at_most("a", math.nan, 1.0), False),
        (at_most("a", -math.inf, 1.0), False),
        (at_least("a", 1.0, 1.0), True),
        (at_least("a", 0.999, 1.0), False),
        (at_least("a", math.inf, 1.0), False),
        (reported("a", 1e9), True),
    ],
)
def test_a_figure_passes_up_to_its_mark_and_only_with_a_number(figure, passed):
    assert figure.passed is passed
    assert (figure.share > 1.0) is not passed


def outcome(seed, *figures, trouble=""):
    return Outcome(Task("x", seed), list(figures), trouble, seconds=1.0, steps=10)


def verdict(*outcomes, runs=None):
    made = Verdict(Case("x", "a title", lambda probe: iter(()), 1.0, 3, 1, "contact"), runs or len(outcomes))
    for one in outcomes:
        made.add(one)
    return made


def test_one_failure_in_ten_fails_and_its_seed_is_in_the_command():
    runs = [outcome(seed, at_most("a", 0.1 * seed, 0.85)) for seed in range(10)]
    found = verdict(*runs)
    assert not found.passed
    assert found.builtins()["failed_seeds"] == [9]
    assert found.command == "muslin stress --case x --seed 9 --runs 1"
    assert found.worst == at_most("a", 0.9, 0.85)
    assert verdict(*runs[:9]).passed
    assert verdict(*runs[:9]).command == "muslin stress --case x --seed 0 --runs 9"


def test_the_figure_shown_is_the_worst_and_the_one_nearest_to_its_mark():
    found = verdict(
        outcome(0, at_most("a", 1.0, 10.0), at_least("b", 20.0, 10.0), reported("c", 5.0)),
        outcome(1, at_most("a", 2.0, 10.0), at_least("b", 12.0, 10.0), reported("c", 7.0)),
    )
    assert [(f.what, f.value) for f in found.figures] == [("a", 2.0), ("b", 12.0), ("c", 7.0)]
    assert found.worst == at_least("b", 12.0, 10.0)


@pytest.mark.parametrize(
    "bad",
    [outcome(0), outcome(0, at_most("a", 0, 1), trouble="it fell over"), outcome(0, at_most("a", 2, 1))],
)
def test_a_run_without_figures_or_with_trouble_has_not_passed(bad):
    assert not bad.passed
    assert not verdict(bad).passed


def test_a_case_whose_runs_are_not_all_done_has_not_passed():
    assert not verdict(outcome(0, at_most("a", 0, 1)), runs=2).passed


# What is planned


def test_the_battery_has_every_case_of_the_list():
    """N17, which needs torsion, is optional."""
    known = {name.partition("-")[0] for name in stress.cases()}
    assert {f"N{k}" for k in range(1, 19) if k != 17} <= known
    assert {f"C{k}" for k in range(1, 13)} <= known


def test_every_case_says_what_it_does():
    for case in stress.cases().values():
        assert case.title
        assert len(case.about) > 30, case.name


def test_names_mean_a_case_or_all_that_begin_with_them():
    assert [case.name for case in stress.choose(["N8"])] == ["N8"]
    assert {case.name for case in stress.choose(["C2"])} == {"C2-wire", "C2-needle", "C2-box", "C2-blind"}
    assert [case.name for case in stress.choose(["C1"])] == ["C1-queries", "C1-sphere"]
    assert {case.theme for case in stress.choose(["numerics"])} == {"numerics"}
    with pytest.raises(ValueError, match=r"--case: expected one of .*N8.*got 'N99'"):
        stress.choose(["N99"])


def test_the_short_battery_is_a_part_of_the_full_one():
    short, full = (stress.plan(stress.choose((), full), full) for full in (False, True))
    assert set(short) < set(full)
    assert len(full) == len(set(full))
    assert len([task for task in full if task.name == "C8-crumple"]) == 10
    assert stress.plan(stress.choose(["N8"]), seed=7, runs=2) == [Task("N8", 7), Task("N8", 8)]


# The sweep


def test_any_two_values_of_any_two_settings_meet_in_some_row():
    known = levels()
    assert all(row.keys() == known.keys() for row in rows())
    for a, b in combinations(known, 2):
        met = {(row[a], row[b]) for row in rows()}
        assert met == {(x, y) for x in known[a] for y in known[b]}


def test_the_rows_are_not_many_more_than_two_settings_with_most_values_need():
    sizes = sorted(map(len, levels().values()))
    assert sizes[-1] * sizes[-2] <= len(rows()) <= 1.5 * sizes[-1] * sizes[-2]


def test_every_setting_with_choices_or_a_slider_is_swept():
    from sim.settings import FIELDS

    swept = {name for name, field in FIELDS.items() if field.choices or field.slider} - {"threads", "tangled"}
    assert set(levels()) == swept | {"gravity", "wind"}
    assert levels()["dt"] == list(FIELDS["dt"].slider)


def test_moves_are_allowed_and_the_same_from_the_same_seed():
    world = sim.Simulation(scene(grid()))
    first, second = ([move(np.random.default_rng(3)) for _ in range(1)] for _ in range(2))
    assert first == second
    random = np.random.default_rng(0)
    moved = [move(random) for _ in range(200)]
    for change in moved:
        world.update(**change)
    assert {name for change in moved for name in change} == set(levels())


# What a run sees


def test_a_run_ends_at_a_step_that_leaves_a_tangle_and_keeps_the_state_before_it(made_up, tmp_path):
    def tangle(probe):
        """Two sheets fly through each other, as cloth does not feel cloth."""
        pieces = [
            grid((0.4, 0.4), (6, 6)),
            grid((0.4, 0.4), (6, 6), position=[0.01, 0.03, 0.08], rotation=[0.1, 0.2, 0.3]),
        ]
        trial = probe.start(scene(pieces, jitter=1e-4), judged=True)
        trial.world.place(trial.world.positions, np.outer(trial.world.pieces == 1, [0, 0, -2.0]))
        trial.step(30)
        yield at_most("never", 0, 0)

    made_up("tangle", tangle)
    found = run_task(Task("tangle", 3))
    assert not found.passed
    assert "after step" in found.figures[-1].what or "in step" in found.figures[-1].what
    assert found.steps < 30
    files = save(found.kept, tmp_path / "kept")
    world = load(files[0])
    assert world.time == pytest.approx((found.steps - 1) * world.settings.dt)
    world.step()
    np.testing.assert_array_equal(world.positions, found.picture.positions)


def test_a_step_that_is_refused_and_a_case_that_falls_over_are_failures_with_a_reason(made_up):
    def refused(probe):
        """An explicit step far beyond its limit."""
        trial = probe.start(scene(grid(), stretch=1e8), integrator="symplectic_euler", dt=1.0, jitter=1e-3)
        trial.step(50)
        yield at_most("never", 0, 0)

    def wrong(probe):
        """It divides by zero."""
        yield at_most("before", 0.0, 0.0)
        raise ZeroDivisionError("no")

    made_up("refused", refused)
    made_up("wrong", wrong)
    assert "a step could not be done" in run_task(Task("refused", 0)).trouble
    found = run_task(Task("wrong", 0))
    assert found.trouble.startswith("ZeroDivisionError: no")
    assert [figure.what for figure in found.figures] == ["before"]


@pytest.mark.skipif(not hasattr(__import__("signal"), "SIGALRM"), reason="the system has no alarm")
def test_a_run_that_does_not_end_is_ended(made_up, monkeypatch):
    def endless(probe):
        """It goes on."""
        while True:
            yield reported("on and on", 0.0)

    monkeypatch.setattr("sim.stress.probe.LONGEST", 0.2)
    made_up("endless", endless)
    monkeypatch.setattr("sim.stress.probe.PATIENCE", 0.0)
    assert "not done after" in run_task(Task("endless", 0)).trouble


def test_a_run_is_ended_though_the_first_call_to_end_goes_nowhere(made_up, monkeypatch):
    """As one does that comes while the garbage collector calls somebody back."""

    def deaf(probe):
        """It hears the second call."""
        with contextlib.suppress(TimeoutError):
            time.sleep(60.0)
        while True:
            time.sleep(0.01)
            yield reported("on and on", 0.0)

    monkeypatch.setattr("sim.stress.probe.LONGEST", 0.1)
    monkeypatch.setattr("sim.stress.probe.PATIENCE", 0.0)
    monkeypatch.setattr("sim.stress.probe.AGAIN", 0.1)
    made_up("deaf", deaf)
    assert "not done after" in run_task(Task("deaf", 0)).trouble


def test_a_scene_that_starts_tangled_is_a_fault():
    probe = Probe(0)
    with pytest.raises(Fault, match="crossings at the start"):
        probe.start(scene([grid(), grid(rotation=[0.5, 0.1, 0])]), judged=True)


@pytest.mark.parametrize("changes", [{}, {"bend": "modified", "integrator": "bdf2"}, {"stretch": 500.0}])
def test_what_is_kept_goes_on_to_the_same_bits(tmp_path, changes):
    """Contacts, ramps, and what springs and integrators remember included; also through the files."""
    world = sim.Simulation(crumple(jitter=2e-4))
    for _ in range(15):
        world.step()
    world.update(**changes)
    for _ in range(2):
        world.step()
    files = save(pack(world, world.snapshot()), tmp_path / "a" / "kept")
    other = load(files[0])
    assert files[0].suffix == SCENE
    assert other.settings == world.settings
    for _ in range(10):
        world.step()
        other.step()
    np.testing.assert_array_equal(other.positions, world.positions)
    np.testing.assert_array_equal(other.velocities, world.velocities)


# Where tasks run


def same(a, b):
    """Whether two outcomes are the same but for the time that they took."""
    return (a.task, a.figures, a.steps, a.trouble) == (b.task, b.figures, b.steps, b.trouble)


TASKS = [Task("C2-wire", 1), Task("N9", 0), Task("C2-box", 0)]


def test_two_processes_find_what_one_after_the_other_finds():
    parallel = {outcome.task: outcome for outcome in run_tasks(TASKS, jobs=2)}
    assert parallel.keys() == set(TASKS)
    for task in TASKS:
        here = run_task(task)
        assert same(parallel[task], here)
        if here.picture is not None:
            np.testing.assert_array_equal(parallel[task].picture.positions, here.picture.positions)


def test_a_worker_that_dies_takes_only_its_own_task_with_it(monkeypatch):
    monkeypatch.setattr("sim.stress.executor.run_here", die_of)
    found = {
        outcome.task.seed: outcome.trouble for outcome in run_tasks([Task("x", 0), Task("x", 1)], jobs=2)
    }
    assert found == {0: "fine", 1: "the process that ran it died"}


def test_the_workers_of_a_cluster_find_the_same():
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        found = list(run_tasks(TASKS[:2], cluster=cluster.scheduler_address))
    assert {outcome.task for outcome in found} == set(TASKS[:2])
    assert all(same(outcome, run_task(outcome.task)) for outcome in found)


def test_a_cluster_that_is_not_there_is_refused_in_one_line(monkeypatch, capsys):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setattr("sim.workers.CONNECT", "1s")
    assert main(["stress", "--case", QUICK, "--cluster", "tcp://127.0.0.1:9"]) == 1
    assert "--cluster: no scheduler at tcp://127.0.0.1:9" in capsys.readouterr().err


# The command


def test_the_command_prints_writes_and_fails_with_a_case(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("sim.stress.executor.run_here", hold_to_nothing)
    numbers, page, kept = tmp_path / "x.json", tmp_path / "x.html", tmp_path / "kept"
    files = ["--json", str(numbers), "--html", str(page), "--keep", str(kept)]
    assert main(["stress", "--case", QUICK, "C8-at-rest", "--runs", "1", "--jobs", "1", *files]) == 1
    printed = capsys.readouterr().out
    assert "passed  N8" in printed
    assert "2 cases, 2 runs, " in printed
    assert "FAILED  C8-at-rest" in printed
    assert "muslin stress --case C8-at-rest --seed 0 --runs 1" in printed
    found = json.loads(numbers.read_text())
    good, bad = found["cases"]
    assert {"name", "passed", "figure", "mark", "command"} <= good.keys()
    assert (good["name"], good["passed"], bad["name"], bad["passed"]) == ("N8", True, "C8-at-rest", False)
    assert bad["figure"] > bad["mark"]
    assert all(Path(file).exists() for file in bad["kept"])
    assert len(bad["kept"]) == 2
    text = page.read_text()
    assert text.count('<section class="card') == 2
    assert "<svg" in text
    assert "http" not in text  # it needs nothing but itself


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--case", "N99"], "--case: expected one of"),
        (["--seed", "-1"], "--seed: expected 0 to"),
        (["--runs", "0"], "--runs: expected 1 to 10,000, got 0"),
        (["--jobs", "0"], "--jobs: expected 1 to 10,000, got 0"),
        (["--short", "--full"], "only one of --short and --full"),
        (["--json", "/nowhere/x.json"], "/nowhere/x.json: cannot be written"),
        (["--keep", "/proc/nowhere"], "--keep: /proc/nowhere: no folder can be there"),
    ],
)
def test_a_call_that_makes_no_sense_is_refused_in_one_line(arguments, words, capsys):
    assert main(["stress", *arguments]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_ctrl_c_leaves_what_was_found(monkeypatch, capsys, tmp_path):
    def some(tasks, jobs, cluster):
        yield Outcome(tasks[0], [at_most("a", 0, 1)])
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.stress.executor.run_tasks", some)
    path = tmp_path / "x.json"
    assert main(["stress", "--case", "N8", "N9", "--json", str(path)]) == 130
    assert len(json.loads(path.read_text())["cases"]) == 1
    assert "not done" in capsys.readouterr().out


# Pictures and pages


def picture(obstacle=(), **more):
    world = sim.Simulation(
        {"cloth": grid((0.4, 0.4), (5, 5), position=[0, 0, 0.4], **more), "obstacle": list(obstacle)}
    )
    return take_picture(world)


@pytest.mark.parametrize(
    "obstacle",
    [
        ball(radius=0.1),
        {"kind": "plane"},
        {"kind": "box", "center": [0, 0, 0.2], "size": [0.3, 0.2, 0.1]},
        {"kind": "capsule", "start": [-0.1, 0, 0.2], "end": [0.1, 0, 0.2], "radius": 0.05},
        {
            "vertices": [[-0.2, -0.2, 0.1], [0.2, -0.2, 0.1], [0, 0.2, 0.1], [0, 0, 0.3]],
            "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        },
    ],
)
def test_a_picture_shows_every_triangle_of_cloth_and_some_of_an_obstacle(obstacle):
    alone, both = (drawing(picture(parts), "<title>") for parts in ((), (obstacle,)))
    assert alone.count("<polygon") == 32
    assert both.count("<polygon") > 40
    assert "&lt;title&gt;" in both


def test_edges_without_triangles_are_lines():
    world = load_scene(scene({"vertices": [[0, 0, 0], [1, 0, 0]], "edges": [[0, 1]], "masses": [1, 1]}))
    text = drawing(take_picture(sim.Simulation(world)), "x")
    assert text.count("<line") > 0
    assert text.count("<polygon") == 0


def test_a_page_escapes_what_it_is_told():
    bad = Outcome(Task("x", 0), [Figure("<b>", 2.0, 1.0)], trouble="<script>")
    about = {"battery": "short", "date": "today", "seed": 0, "versions": {"muslin": "1"}}
    page = as_html([verdict(bad)], about)
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert not as_json([verdict(bad)], about)["passed"]


@pytest.mark.browser
@WITHOUT_BROWSER
def test_a_page_is_no_wider_than_a_phone(tmp_path):
    figure = Figure("pairs near, most in a step", 123456.0, 1.0, unit="per second", least=True)
    path = tmp_path / "page.html"
    about = {"battery": "short", "date": "today", "seed": 0, "versions": {"muslin": "1"}}
    path.write_text(as_html([verdict(Outcome(Task("x", 0), [figure]))], about), encoding="utf-8")
    beyond, (table,) = overflow(path, 390)
    assert beyond <= 0
    assert table > 0
