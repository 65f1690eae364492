"""What the studies of cost write: JSON to the published schema, pages that need nothing, plots, tables."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import jsonschema
import msgspec
import numpy as np
import pytest
from rich.progress import Progress
from small import WASTEFUL

from server import pages
from server.cli import main
from server.cost import Remaining
from server.figures import png, svg
from sim.integrators import INTEGRATORS
from sim.studies.cost.report import REPORTS, schema
from tests.browser import WITHOUT_BROWSER, errors_of, launched, overflow

pytestmark = pytest.mark.alone

PAPER = {"command": "muslin cost <swing>", "date": "2026-01-01"}


@pytest.fixture(scope="module")
def reports(report, compared, audited):
    """All, as the commands write them."""
    return {
        "cost": msgspec.structs.replace(report, **PAPER),
        "compare": msgspec.structs.replace(compared, **PAPER),
        "audit": msgspec.structs.replace(audited, **PAPER),
    }


@pytest.fixture(scope="module")
def written(reports):
    """Both as pages, with the names of their figures."""
    made = {}
    for name, report in reports.items():
        figures = pages.figures(report)
        made[name] = pages.page(report, pages.result(report), figures), figures
    return made


@pytest.mark.parametrize("study", REPORTS)
def test_the_json_is_what_the_published_schema_says(reports, study, monkeypatch):
    monkeypatch.setitem(INTEGRATORS, WASTEFUL, INTEGRATORS["sdirk2"])  # a name that settings may have
    plain = json.loads(json.dumps(msgspec.to_builtins(reports[study]), allow_nan=False))
    validator = jsonschema.Draft202012Validator(schema(study))
    validator.validate(plain)
    assert msgspec.convert(plain, REPORTS[study]) == reports[study]
    key, number = {"cost": ("runs", "ms"), "compare": ("variants", "ms"), "audit": ("effects", "own_ms")}[
        study
    ]
    plain[key][0][number] = "fast"
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(plain)
    del plain[key]
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(plain)


@pytest.mark.parametrize("study", REPORTS)
def test_the_schema_is_printed_on_demand(study, capsys):
    assert main([study, "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(schema(study)))


def test_the_json_has_what_other_programs_rely_on(reports):
    cost = msgspec.to_builtins(reports["cost"])
    assert {"runs", "floor", "horizon", "hardware", "versions"} <= cost.keys()
    assert all({"settings", "ms", "error"} <= run.keys() for run in cost["runs"])
    assert {"processor", "cores"} <= cost["hardware"].keys()
    assert {"muslin", "numpy", "numba"} <= cost["versions"].keys()
    compare = msgspec.to_builtins(reports["compare"])
    assert all({"settings", "ms", "error", "energy", "penetrations"} <= v.keys() for v in compare["variants"])


DRAWN = """name => [...document.querySelectorAll(`#${name} svg use`)]
    .map(use => use.getBoundingClientRect()).filter(box => box.width > 2 && box.height > 2).length"""
"""How many references within a figure show something."""


class _Links(HTMLParser):
    """Everything in a page that refers to something."""

    def __init__(self):
        super().__init__()
        self.found, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.found += [
            value for name, value in attrs if name in ("src", "href", "xlink:href", "data", "action")
        ]


@pytest.mark.parametrize("study", REPORTS)
def test_the_page_refers_to_nothing_outside_itself(written, study):
    text, figures = written[study]
    links = _Links()
    links.feed(text)
    assert all(link.startswith("#") for link in links.found)
    assert not {"script", "link", "iframe", "img", "object"} & set(links.tags)
    assert "http" not in text
    assert set(re.findall(r"url\((.)", text)) <= {"#"}
    assert links.tags.count("svg") == len(figures)


def test_the_page_begins_with_what_to_do_and_escapes_what_was_typed(written, reports):
    text, _ = written["cost"]
    wanted = reports["cost"].verdict
    first, second = (text.index(words.split(":")[0]) for words in (wanted.sentence, wanted.dominates))
    assert first < second < text.index("<figure")
    assert "muslin cost &lt;swing&gt;" in text
    assert "<swing>" not in text
    assert "[settings]" in text


@pytest.mark.parametrize("study", REPORTS)
def test_commands_in_notes_are_set_as_such(written, study):
    page, _ = written[study]
    assert "<code>muslin cost &lt;swing&gt;</code>" in page
    assert "`" not in page.partition("What this means")[2]


def test_a_terminal_ends_with_what_to_do_and_the_block_to_paste(reports):
    for study in ("cost", "audit"):
        block = pages.result(reports[study]).notes[-1]
        table = next(line for line in block.splitlines() if not line.startswith("#"))
        assert table in ("[settings]", "[effects]")
    assert pages.result(reports["cost"]).notes[-2] == reports["cost"].verdict.sentence


def test_the_table_of_energies_adds_up(reports):
    report = reports["compare"]
    (table,) = (t for t in pages.result(report).tables if t.caption.startswith("Where energy went"))
    titles, *columns = zip(*table.rows, strict=True)
    end = titles.index("= at the end")
    for column, variant in zip(columns, report.variants, strict=True):
        signs = [-1.0 if title.startswith("−") else 1.0 for title in titles[:end]]
        assert np.dot(signs, column[:end]) == pytest.approx(column[end], rel=1e-9)
        assert sum(column[end + 1 :]) == pytest.approx(column[end])
        assert column[titles.index("− damping")] == variant.balance.dissipated["damping"]
    assert not any("wind" in title for title in titles)  # nothing blows


@pytest.mark.browser
@WITHOUT_BROWSER
@pytest.mark.parametrize("study", REPORTS)
def test_the_page_opens_in_a_browser_without_server_and_network(written, study, tmp_path):
    text, figures = written[study]
    path = tmp_path / "page.html"
    path.write_text(text, encoding="utf-8")
    with launched() as browser:
        page, asked = browser.new_context(offline=True).new_page(), []
        page.on("request", lambda request: asked.append(request.url))
        errors = errors_of(page)
        page.goto(path.as_uri())
        assert asked == [path.as_uri()]
        assert errors == []
        assert page.locator("figure svg").count() == len(figures)
        for figure in page.locator("figure svg").all():
            box = figure.bounding_box()
            assert box["width"] > 600
            assert box["height"] > 100
        for name in figures:  # markers and letters are drawn: what they refer to is found within the page
            assert page.evaluate(DRAWN, name) > 10
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.browser
@WITHOUT_BROWSER
@pytest.mark.parametrize("study", REPORTS)
def test_a_page_shows_whole_tables_on_a_laptop_and_scrolls_them_alone_on_a_phone(written, study, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(written[study][0], encoding="utf-8")
    beyond, tables = overflow(path, 1100)
    assert beyond <= 0
    assert max(tables) <= 0
    beyond, tables = overflow(path, 390)
    assert beyond <= 0
    assert max(tables) > 0


def test_every_plot_is_a_picture_of_its_own_and_the_same_each_time(reports):
    figures, again = (pages.figures(reports["cost"]) for _ in range(2))
    assert {
        "work-precision",
        "work-precision-matvecs",
        "knobs",
        "sources",
        "phases",
        "horizon",
    } <= figures.keys()
    for name, (caption, figure) in figures.items():
        assert caption.endswith(".")
        assert svg(figure) == svg(again[name][1])
        assert png(figure).startswith(b"\x89PNG")


def test_curves_are_told_apart_without_colour(reports):
    """Lines of different integrators differ in marker and dash, not in colour alone."""
    figure = pages.figures(reports["cost"])["work-precision"][1]
    lines = [
        line for line in figure.axes[0].lines if "," not in line.get_label() and len(line.get_xdata()) > 2
    ]
    lines = [line for line in lines if line.get_marker() not in ("None", None)]
    looks = {(line.get_marker(), line.get_linestyle()) for line in lines}
    assert len(lines) >= 4
    assert len(looks) == len(lines)


def test_the_command_writes_everything_and_prints_a_sentence_to_act_on(tmp_path):
    scene = tmp_path / "tiny.toml"
    scene.write_text(
        'format = 1\n[cloth]\nkind = "grid"\nsize = [0.3, 0.3]\nresolution = [3, 3]\npins = ["left"]\n'
        '[settings]\nstretch = 2.0\nbend = "none"\ncontact = "none"\n'
    )
    command = [
        sys.executable,
        "-m",
        "server",
        "cost",
        str(scene),
        "--quick",
        "--seconds",
        "0.2",
        "--jobs",
        "1",
    ]
    files = {name: tmp_path / f"x.{name}" for name in ("json", "html")}
    command += [word for name, path in files.items() for word in (f"--{name}", str(path))]
    command += ["--plots", str(tmp_path / "plots"), "--set", "newton=2"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=240, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    plain = json.loads(files["json"].read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema("cost")).validate(plain)
    assert plain["chosen"]["newton"] == 2
    assert plain["command"].endswith("--set newton=2")
    assert "[settings]" in done.stdout
    assert "error on this scene the cheapest setting is" in " ".join(done.stdout.split())
    assert files["html"].read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert len(list((tmp_path / "plots").glob("*.png"))) == len(list((tmp_path / "plots").glob("*.svg"))) >= 6


def test_bars_of_runs_say_method_step_and_what_else_was_changed(reports):
    report = reports["cost"]
    labels = [tick.get_text() for tick in pages.figures(report)["phases"][1].axes[0].get_yticklabels()]
    assert labels[0] == "chosen now"
    assert all(" %: " in words and ", h = 1/" in words for words in labels[1:])
    counts = {run.settings.newton for run in report.runs if run.front} - {report.chosen.newton}
    assert all(any(words.endswith(f"newton = {count}") for words in labels) for count in counts)


def test_remaining_time_is_told_of_the_whole_run_and_grows_while_nothing_comes_of_it():
    clock = iter([0.0, 30.0, 90.0])
    now = [next(clock)]
    with Progress(get_time=lambda: now[0], disable=True) as progress:
        progress.add_task("", total=1.0)
        (task,) = progress.tasks
        assert Remaining().render(task).plain == ""
        progress.update(task.id, completed=0.25)
        for words in ("1:30 left", "4:30 left"):
            now[0] = next(clock)
            assert Remaining().render(task).plain == words
