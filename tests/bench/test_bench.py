"""`muslin bench`: what it plans, prints, writes and refuses."""

import json
import os

import pytest

import sim
from server.benchmark import as_markdown, conditions
from server.cli import main
from sim import bench
from sim.bench.contact import WAYS, measure_contact
from sim.bench.peers import MUSLIN, PEERS
from sim.bench.scenes import measure_scenes
from sim.bench.sheet import KINDS
from sim.bench.tables import tabulate
from sim.studies import Result, Table

pytestmark = pytest.mark.alone

STEP = {"kernels": 1.0, "build": 0.1, "memory": 200.0, "layer": "omp", "errors": [1e-5, 3e-5]}
TRIAL = {"settings": "substeps 1", "ms": 8.0, "error": 0.005}


def made_up(case):
    """A measurement, as a case's process would print it."""
    if case.measure == "steps":
        scale = case.size / 1024
        return {**STEP, "ms": [2.0 * scale**1.5, 4.0 * scale**1.5], "iterations": [10, 30]}
    times = 1.0 if case.solver == MUSLIN else 5.0
    if case.measure == "frames":
        ms = [10.0 * times] * (4 if case.solver == MUSLIN else 2)
        return {"settings": "own", "start_up": 1.0, "ms": ms, "memory": 300.0, "strain": 0.02}
    met = [{**TRIAL, "ms": 8.0 * times}, None]
    strains = {"own_strain": 0.03, "strain": 0.02}
    return {"settled": 1e-3, "reference": "r", "own": TRIAL, "met": met, "best": TRIAL, **strains}


@pytest.fixture
def measured(monkeypatch):
    """Nothing is measured; the cases that would have been."""
    asked = []

    def measure(case):
        asked.append(case)
        return made_up(case)

    monkeypatch.setattr("sim.bench.process.measure_apart", measure)
    monkeypatch.setattr("sim.bench.peers.Peer.missing", ())
    return asked


def test_scenes_are_stepped_with_effects_forced_on_as_they_are_and_as_audited():
    (table,) = measure_scenes(("oscillator",), 8).tables
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["effects"].split(":")[0] for row in rows] == ["on", "auto", "audited"]
    assert rows[0]["moved by [%]"] == rows[1]["moved by [%]"] == 0.0
    assert rows[2]["moved by [%]"] < 1.0
    assert all(row["ms, median"] > 0.0 for row in rows)
    assert [row["steps without a list [%]"] for row in rows[:2]] == [0.0, 100.0]  # auto skips all of them


def test_sheets_are_draped_with_each_response_and_each_detection():
    sheets, queries = measure_contact((256,), (1,), 30).tables
    rows = [dict(zip(sheets.columns, row, strict=True)) for row in sheets.rows]
    assert [(row["response"], row["detection"]) for row in rows] == WAYS
    assert [row["crossings, most"] for row in rows if row["response"] == "impulse"] == [0, 0]
    assert [row["deepest [mm]"] > 100.0 for row in rows] == [False] * 6 + [True]  # it falls through the ball
    assert all(row[phase] > 0.0 for row in rows for phase in ("ms, median", "solve", "else"))
    touching = [row["response"] != "none" for row in rows]  # else nothing is looked for, nor answered
    assert [[row[phase] > 0.0 for row in rows] for phase in ("detect", "respond")] == [touching] * 2
    assert [row[0] for row in queries.rows] == ["vertex-triangle", "edge-edge"]
    assert all(1.0 < row[2] < 99.0 for row in queries.rows), "some meet, and some do not"


def test_a_plan_has_both_sheets_at_each_size_and_number_of_threads():
    cases = bench.plan([4096, 1024], [1, 2])
    assert [(c.kind, c.size, c.threads) for c in cases] == [
        (kind, size, threads) for kind in ("hang", "drape") for size in (1024, 4096) for threads in (1, 2)
    ]
    assert {(c.measure, c.solver) for c in cases} == {("steps", MUSLIN)}


def test_a_plan_with_peers_has_every_solver_up_to_their_size_and_muslin_among_them(measured):
    cases = [c for c in bench.plan([1024, 40000], [1, 2], peers=True) if c.measure != "steps"]
    assert {c.solver for c in cases} == {MUSLIN, *PEERS}
    assert {c.size for c in cases} == {1024}
    assert {c.threads for c in cases} == {2}
    for name in (MUSLIN, *PEERS):
        mine = [(c.measure, c.kind, c.setting) for c in cases if c.solver == name]
        frames = [("frames", kind, i) for kind in KINDS for i in range(bench.solvers()[name].settings)]
        assert mine == [*frames, ("accuracy", "hang", 0)]


def test_steps_are_tabulated_with_growth(measured):
    result = tabulate(bench.run(bench.plan([1024, 4096], [1])))
    steps, growth = result.tables
    assert steps.column("ms, median") == (3.0, 24.0, 3.0, 24.0)
    assert steps.column("error [mm]") == (pytest.approx(0.03),) * 4
    assert steps.column("iterations") == (20.0,) * 4
    assert steps.column("most") == (30,) * 4
    assert growth.column("iterations ×") == (1.0, 1.0)
    assert growth.column("cost per vertex ×") == (pytest.approx(2.0), pytest.approx(2.0))


def test_ratios_are_of_this_run_and_of_frames_that_both_made(measured):
    frames, accuracy = tabulate(bench.run(bench.plan([1024], [1], peers=True))).tables[1:]
    assert all(len(row) == len(table.columns) for table in (frames, accuracy) for row in table.rows)
    assert set(frames.column("/ Muslin")) == {1.0, 5.0}
    assert set(accuracy.column("1 cm: / Muslin")) == {1.0, 5.0}
    assert set(accuracy.column("1 mm: / Muslin")) == {None}
    assert set(accuracy.column("1 mm: ms")) == {"not reached"}
    assert set(accuracy.column("1 mm: by")) == {"substeps 1: 5 mm, 8 ms"}


def test_an_interrupted_run_has_what_was_found(measured):
    def measure(case):
        if case.kind == "drape":
            raise KeyboardInterrupt
        return made_up(case)

    found = bench.run(bench.plan([1024, 4096], [1]), measure=measure)
    assert [(case.kind, case.size) for case, _ in found] == [("hang", 1024), ("hang", 4096)]


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ({"settings": "own", "start_up": 2.0, "ms": [], "stopped": 130.0}, "more than 10,000"),
        ({"stopped": 130.0}, "nothing within 130 s"),
        ({"failed": "ValueError: no"}, "failed: ValueError: no"),
        ({}, "not done in time"),
    ],
)
def test_a_case_without_numbers_says_why(result, words):
    case = bench.Case("frames", MUSLIN, "hang", 1024, 1, 1, 10.0)
    (table,) = tabulate([(case, result)]).tables
    (row,) = table.rows
    assert len(row) == len(table.columns)
    assert words in row
    for measure in ("steps", "accuracy"):
        case = bench.Case(measure, MUSLIN, "hang", 1024, 1, 1, 10.0)
        (row,) = tabulate([(case, result)]).tables[0].rows
        assert any(isinstance(cell, str) and cell.split()[0] in ("nothing", "failed:", "not") for cell in row)


def test_a_run_writes_numbers_hardware_and_versions_as_json(measured, tmp_path, capsys):
    path, page, text = (tmp_path / name for name in ("x.json", "x.html", "x.md"))
    files = ["--json", str(path), "--html", str(page), "--markdown", str(text)]
    assert main(["bench", "--sizes", "64", "256", "--threads", "1", *files]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "Whole steps of Muslin" in said.out
    written = json.loads(path.read_text(encoding="utf-8"))
    assert written["bench"] == "steps"
    command = "muslin bench --sizes 64 256 --threads 1 --steps 120 --seconds 6"
    assert written["command"] == command
    assert {"processor", "cores", "memory_gb", "threading_layer"} <= written["hardware"].keys()
    assert written["hardware"]["threading_layer"] == "omp"
    assert written["versions"]["muslin"] == sim.__version__
    assert {"python", "numpy", "numba"} <= written["versions"].keys()
    for table in written["tables"]:
        assert table["rows"]
        assert all(len(row) == len(table["columns"]) for row in table["rows"])
    assert "cloth feels cloth" in " ".join(written["notes"])
    assert "Whole steps of Muslin" in page.read_text(encoding="utf-8")
    markdown = text.read_text(encoding="utf-8")
    assert written["date"] in markdown
    assert command in markdown
    assert written["hardware"]["processor"] in markdown


def test_markdown_has_a_table_with_as_many_cells_as_headings():
    text = as_markdown(Result("T", (Table("C", ("a", "b"), (("x|y", None), (1.5, 2000))),), ("N",)))
    assert text == (
        "# T\n\n## C\n\n| a | b |\n| --- | --- |\n| x\\|y | – |\n| 1.5 | 2,000 |\n\n## What this means\n\nN\n"
    )


@pytest.mark.parametrize(("load", "count"), [(0.0, 2), (None, 2), (1.5, 3)])
def test_a_busy_computer_is_spoken_of(load, count):
    about = {"date": "2026-01-01", "command": "c", "hardware": {"load": load}, "versions": {}}
    assert len(conditions(about)) == count


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--sizes", "1000"], "--sizes: expected square numbers from 16 to 1,000,000, got 1000"),
        (["--sizes", "4"], "--sizes: expected square numbers from 16 to 1,000,000, got 4"),
        (["--threads", "0"], f"--threads: expected 1 to {os.cpu_count()}, the cores of this computer, got 0"),
        (["--steps", "1"], "--steps: expected 2 to 100,000, got 1"),
        (["--seconds", "0"], "--seconds: expected > 0 and ≤ 3600, got 0"),
        (["--contact", "--peers"], "--contact, --scenes, --peers: expected one of them, got several"),
        (["--contact", "--steps", "11"], "--steps: expected 12 to 100,000, got 11"),
        (["--json", ""], "--json: expected a file, got an empty name"),
        (["--html", "x", "--markdown", "x"], "--markdown: expected another file than --html, got x"),
        (["--markdown", "no/x"], "no/x: cannot be written: No such file or directory"),
    ],
)
def test_a_wrong_call_is_refused_in_one_line_before_anything_runs(
    measured, monkeypatch, tmp_path, capsys, arguments, words
):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *arguments]) == 1
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"muslin: {words}\n")
    assert measured == []
    assert os.listdir(tmp_path) == []
