"""The project's own files: that they are up to date with the code, and that what they show runs."""

import re
import tomllib
from pathlib import Path

import sim
from sim.docs import SETTINGS_PAGE, settings_page
from sim.scene import scene_files
from sim.settings import FIELDS

ROOT = Path(__file__).resolve().parent.parent


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_table_of_settings_is_up_to_date():
    assert SETTINGS_PAGE.read_text(encoding="utf-8") == settings_page(), "run `uv run python -m sim.docs`"


def test_the_table_of_settings_has_a_row_of_five_cells_for_each():
    rows = [line for line in settings_page().splitlines() if line.startswith("| `")]
    assert [re.match(r"\| `(\w+)`", row)[1] for row in rows] == list(FIELDS)
    assert {len(re.split(r"(?<!\\)\|", row)) for row in rows} == {7}


def test_the_readme_lists_the_scenes_that_there_are():
    section = text("README.md").partition("## Scenes")[2].partition("\n## ")[0]
    assert sorted(re.findall(r"^\| `(\w+)`", section, re.M)) == [path.stem for path in scene_files()]


def test_the_readmes_example_in_python_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    (example,) = re.findall(r"```python\n(.*?)```", text("README.md"), re.S)
    names = {}
    exec(example.replace("range(120)", "range(3)"), names)  # three steps are enough to see that it runs
    assert names["world"].settings.rest_angle == 0.3
    assert names["report"].ms["total"] > 0


def test_links_in_the_docs_lead_somewhere():
    for page in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        for link in re.findall(r"\]\(([^)#]+)\)", text(page)):
            assert link.startswith("https://") or (ROOT / link).exists(), f"{page}: {link}"


def test_the_layout_names_files_that_exist():
    layout = re.search(r"    sim/ .*?\n\n", text("CONTRIBUTING.md"), re.S)[0]
    folder = ROOT
    for line in layout.splitlines():
        indent, name = re.match(r"( *)(\S*)", line).groups()
        if len(indent) == 4:
            folder = ROOT / name
        path = folder if len(indent) == 4 else folder / name
        assert not name or path.exists(), f"CONTRIBUTING.md: {name}"


def test_constraints_are_exact_versions_and_name_no_address():
    lines = text("constraints.txt").splitlines()
    assert all(re.match(r"[a-z0-9-]+==[0-9][^\s;/]*( ; .*)?$", line) for line in lines)
    project = tomllib.loads(text("pyproject.toml"))
    wanted = project["project"]["dependencies"] + project["dependency-groups"]["test"]
    wanted += [d for d in project["dependency-groups"]["dev"] if isinstance(d, str)]
    pinned = {line.partition("==")[0] for line in lines}
    assert {re.match(r"[\w-]+", d)[0] for d in wanted} <= pinned


def test_the_version_is_that_of_the_project():
    assert sim.__version__ == tomllib.loads(text("pyproject.toml"))["project"]["version"]


def test_the_core_never_imports_the_page():
    for path in (ROOT / "sim").rglob("*.py"):
        found = re.findall(r"^\s*(?:from|import) (server|viser|matplotlib)\b", text(path), re.M)
        assert not found, f"{path} imports {found}"
