"""`muslin study`: what it lists, runs, writes and refuses."""

import io
import json
import os
import subprocess
import sys

import pytest
from rich.console import Console

import sim
from server.cli import main
from server.study import _printed, as_json, cell_text
from sim.scene import scene_files
from sim.studies import STUDIES, Result, Study, Table, watched

SMALL = Result(
    "A study",
    (Table("A table", ("name", "value [m]", "count"), (("one", 0.125, 1200), ("two", None, 2))),),
    ("A note that says <more>.",),
)


@pytest.fixture
def small(monkeypatch):
    """A study that takes no time, and what it is told of a progress."""
    told = []

    def run(study, progress=None):
        for word in watched("ab", progress, lambda letter: letter):
            told.append(word)
        return SMALL

    monkeypatch.setattr(Study, "run", run)
    return told


def test_listing_names_every_study_and_imports_nothing_heavy():
    probe = (
        "import sys\nfrom server.cli import main\nmain(['study'])\n"
        "heavy = {'numba', 'scipy', 'numpy', 'viser', 'trimesh'} & sys.modules.keys()\n"
        "sys.stderr.write(str(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, encoding="utf-8", check=True)
    assert done.stderr == "set()"
    for name, study in STUDIES.items():
        assert name in done.stdout
        assert study.summary in done.stdout


def test_every_study_has_its_scene_and_a_module():
    assert {study.scene for study in STUDIES.values()} <= {path.stem for path in scene_files()}
    for study in STUDIES.values():
        assert callable(study.load().run)


def test_a_run_prints_tables_and_notes(small, capsys):
    assert main(["study", "ghost"]) == 0
    said = capsys.readouterr()
    assert said.err == ""  # no progress where nobody watches
    for words in ("A study", "A table", "value [m]", "0.125", "1,200", "–", "A note that says <more>."):
        assert words in said.out
    assert small == ["a", "b"]


def test_a_run_writes_its_numbers_as_json(small, tmp_path):
    path = tmp_path / "ghost.json"
    assert main(["study", "ghost", "--json", str(path)]) == 0
    written = json.loads(path.read_text(encoding="utf-8"))
    assert written == {
        "study": "ghost",
        "title": "A study",
        "tables": [
            {
                "caption": "A table",
                "columns": ["name", "value [m]", "count"],
                "rows": [["one", 0.125, 1200], ["two", None, 2]],
            }
        ],
        "notes": ["A note that says <more>."],
        "version": sim.__version__,
    }


def test_a_run_writes_a_page_that_needs_nothing_else(small, tmp_path):
    path = tmp_path / "ghost.html"
    assert main(["study", "ghost", "--html", str(path)]) == 0
    page = path.read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    for words in ("<title>A study</title>", "A table", "value [m]", "0.125", "–", "says &lt;more&gt;."):
        assert words in page
    for reference in ("http", "src=", "href=", "@import", "url("):
        assert reference not in page


def test_a_real_study_runs_from_the_command_line_and_its_page_holds_its_tables(tmp_path):
    files = {name: tmp_path / f"x.{name}" for name in ("json", "html")}
    command = [sys.executable, "-m", "server", "study", "interference"]
    command += [word for name, path in files.items() for word in (f"--{name}", str(path))]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    written = json.loads(files["json"].read_text(encoding="utf-8"))
    page = files["html"].read_text(encoding="utf-8")
    for table in written["tables"]:
        assert table["rows"]
        assert all(len(row) == len(table["columns"]) for row in table["rows"])
        for heading in table["columns"]:
            assert heading in done.stdout
            assert heading in page
    assert "1.177" in done.stdout
    assert "1.177" in page
    assert "http" not in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gost"], f"gost: no such study; expected one of {', '.join(STUDIES)}"),
        (["--json", "x.json"], "STUDY: expected the name of a study to write, got none"),
        (
            ["ghost", "--json", "nowhere/x.json"],
            "nowhere/x.json: cannot be written: No such file or directory",
        ),
        (["ghost", "--html", "."], ".: cannot be written: it is not a file"),
        (["ghost", "--html", ""], "--html: expected a file, got an empty name"),
        (["ghost", "--html", "x", "--json", "x"], "--html: expected another file than --json, got x"),
    ],
)
def test_a_wrong_call_is_refused_in_one_line_before_anything_runs(
    small, monkeypatch, tmp_path, capsys, arguments, words
):
    monkeypatch.chdir(tmp_path)
    assert main(["study", *arguments]) == 1
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"muslin: {words}\n")
    assert small == []
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "error", [lambda: sim.EquilibriumError("no rest"), lambda: sim.StepError("too fast", "solve", "dt")]
)
def test_a_study_that_fails_says_so_in_one_line(monkeypatch, tmp_path, capsys, error):
    def run(study, progress=None):
        raise error()

    monkeypatch.setattr(Study, "run", run)
    assert main(["study", "ghost", "--json", str(tmp_path / "x.json")]) == 1
    said = capsys.readouterr()
    assert said.err.startswith("muslin: ghost: ")
    assert said.err.count("\n") == 1
    assert os.listdir(tmp_path) == []


def test_numbers_that_are_not_finite_are_null_in_json_and_cells_are_read_as_people_do():
    odd = Result("", (Table("", ("x",), ((float("inf"),), (float("nan"),), (1.0,))),), ())
    assert as_json(odd, {"study": "odd"})["tables"][0]["rows"] == [[None], [None], [1.0]]
    assert [cell_text(c) for c in (None, 1234, 1234.5678, "a", 0.0)] == ["–", "1,234", "1235", "a", "0"]


def test_a_column_is_found_by_its_heading():
    assert SMALL.tables[0].column("count") == (1200, 2)


def test_progress_is_told_of_each_item_before_its_turn():
    told = []
    seen = [(item, list(told)) for item in watched("xy", lambda *args: told.append(args), str.upper)]
    assert seen == [("x", [(0.0, "X")]), ("y", [(0.0, "X"), (0.5, "Y")])]


def test_no_word_of_a_table_is_cut_short_where_there_is_room_for_it():
    columns = ("integrator", "other", *("matvecs / s" for _ in range(9)))
    table = Table("wide", columns, (("backward_euler", "as it was chosen", *(1234.5 for _ in range(9))),))
    console = Console(width=120, file=io.StringIO())
    for wide, boxed in (table, True), (Table("wider", (*columns, "more"), ((*table.rows[0], "x"),)), False):
        console.print(_printed(wide, console))
        lines = console.file.getvalue().splitlines()
        assert max(map(len, lines)) <= 120
        assert any("backward_euler" in line and line.count("1234") == 9 for line in lines)
        assert any("│" in line for line in lines) == boxed
        assert "…" not in console.file.getvalue()
        console.file = io.StringIO()


def test_where_a_line_is_too_short_for_all_columns_they_share_lines_and_nothing_is_cut():
    names = ("integrator", "other", *(f"matvecs {k}" for k in range(9)))
    rows = (("backward_euler", "as it was chosen", *(1234.5 + k for k in range(9))),) * 2
    for width in (80, 60, 40):
        console = Console(width=width, file=io.StringIO())
        console.print(_printed(Table("wide", names, rows), console))
        text = console.file.getvalue()
        lines = text.splitlines()
        assert "…" not in text
        assert max(map(len, lines)) <= width
        for words in (*names, *(cell_text(cell) for cell in rows[0])):
            assert any(words in line for line in lines)
