"""The `muslin` command, run as people run it: answers, refusals of one line, and what it does not import."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import sim
from server.cli import main
from server.commands.options import parse_settings, scene_and_settings
from server.commands.scenes import count_vertices
from sim.effects import find_effect
from sim.mesh import build_mesh
from sim.scene import load_scene, scene_files
from sim.simulation import StepError

HEAVY = ["numba", "scipy", "trimesh", "viser"]
SMALL = """
[cloth]
kind = "grid"
resolution = [4, 4]
pins = ["left"]
"""


def muslin(*arguments, cwd=None):
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "server", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", cwd=cwd, timeout=120, check=False
    )


def imported(*arguments):
    """Names of the modules that the command imports."""
    probe = (
        "import sys\nfrom server.cli import main\n"
        f"try: main({list(arguments)!r})\nexcept SystemExit: pass\n"
        "sys.stderr.write(' '.join(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", probe],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=120,
        check=True,
    )
    return set(done.stderr.split())


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["run", "--help"], ["--version"], ["scenes"], ["check"]],
    ids=" ".join,
)
def test_quick_commands_import_nothing_heavy(arguments):
    modules = imported(*arguments)
    assert "server.cli" in modules
    assert [name for name in HEAVY if name in modules] == []


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["scenes"]], ids=" ".join)
def test_commands_that_need_no_mesh_import_no_numpy(arguments):
    assert "numpy" not in imported(*arguments)


def test_help_names_every_command():
    done = muslin("--help")
    assert done.returncode == 0
    for name in ("lab", "run", "check", "scenes"):
        assert f"• {name}" in done.stdout


def test_version_is_said():
    assert muslin("--version").stdout == f"muslin {sim.__version__}\n"


def test_scenes_lists_each_scene_with_its_vertices():
    listing = muslin("scenes").stdout
    for path in scene_files():
        row = next(line for line in listing.splitlines() if line[1:].split("│")[0].strip() == path.stem)
        assert f"{len(build_mesh(load_scene(path)).vertices):,}" in row


def test_vertices_are_counted_without_building_them():
    for scene in (
        {"cloth": {"kind": "grid", "resolution": [5, 7]}},
        {
            "cloth": [
                {"kind": "equilateral", "resolution": [5, 7]},
                {"kind": "equilateral", "resolution": [4, 6]},
            ]
        },
        {"cloth": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}},
    ):
        loaded = load_scene(scene)
        assert count_vertices(loaded) == len(build_mesh(loaded).vertices)


def test_an_output_without_greek_letters_is_no_error(tmp_path):
    (tmp_path / "γ.toml").write_text(SMALL, encoding="utf-8")
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "server", "check", str(tmp_path / "γ.toml")]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert done.returncode == 0
    assert "?.toml: fine: 16 vertices" in done.stdout


def test_check_says_that_scenes_are_fine_and_exits_with_zero(small):
    done = muslin("check", small, "drape")
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        f"{small}: fine: 16 vertices, 18 triangles, 4 pinned, some 200 MB to simulate",
        "drape: fine: 1,089 vertices, 2,048 triangles, 0 pinned, some 213 MB to simulate",
    ]


def test_check_without_a_name_checks_all_scenes_that_come_with_muslin():
    done = muslin("check")
    assert done.returncode == 0
    assert done.stdout.count(": fine: ") == len(scene_files())


def test_check_goes_on_after_a_bad_scene_and_exits_with_one(tmp_path, small):
    bad = tmp_path / "bad.toml"
    bad.write_text(SMALL + "[settings]\ngamma = -1\n", encoding="utf-8")
    done = muslin("check", bad, small)
    assert done.returncode == 1
    assert done.stderr == f"muslin: {bad}: settings.gamma: expected ≥ 0 and ≤ 1000, got -1\n"
    assert ": fine: " in done.stdout


def test_check_warns_of_cloth_that_starts_in_an_obstacle(tmp_path, small):
    ball = '[[obstacle]]\nkind = "sphere"\nname = "ball"\ncenter = [0, 0, 0]\nradius = 0.1\n'
    small.write_text(SMALL + ball, encoding="utf-8")
    done = muslin("check", small)
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        f'{small}: cloth[0] starts inside obstacle[0] (sphere "ball")',
        f"{small}: fine: 16 vertices, 18 triangles, 4 pinned, some 200 MB to simulate, 1 warning",
    ]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["chek"], 2, "chek: no such command; expected one of lab, run, check, scenes"),
        (["--prot", "3"], 2, "lab: Unrecognized options: --prot, 3; see muslin lab --help"),
        (["--port", "99999"], 1, "--port: expected 0 to 65535, got 99999"),
        (["--scene", "nowhere"], 1, "nowhere: cannot be read: No such file or directory"),
        (["check", "."], 1, ".: cannot be read: expected a regular file\n"),
        (["run", "drape", "--set", "dt=1/0"], 1, "dt: expected ≥ 1e-06 and ≤ 1, got '1/0'"),
        (["run", "drape", "--set", "newton=3/2"], 1, "newton: expected"),
        (["run"], 2, "run: Missing from muslin run: SCENE"),
        (["run", "nowhere"], 1, "nowhere: cannot be read: No such file or directory"),
        (["run", "drape", "--seconds", "q"], 2, "run: Error parsing --seconds: could not convert"),
        (["run", "drape", "--seconds", "0"], 1, "--seconds: expected > 0 and ≤ 100000, got 0"),
        *(
            ([study, "drape", "--seconds", time], 1, f"--seconds: expected > 0 and ≤ 3600, got {time}")
            for study in ("cost", "compare", "audit")
            for time in ("nan", "inf", "1e+09")
        ),
        (["run", "drape", "--seconds", "nan"], 1, "--seconds: expected > 0 and ≤ 100000, got nan"),
        (["run", "drape", "--fps", "-1"], 1, "--fps: expected > 0 and ≤ 1e+06, got -1"),
        (["run", "drape", "--set", "gamma=-1"], 1, "gamma: expected ≥ 0 and ≤ 1000, got -1"),
        (["run", "drape", "--set", "gamma=x"], 1, "gamma: expected ≥ 0 and ≤ 1000, got 'x'"),
        (["run", "drape", "--set", "gamma=" + "[" * 100_000], 1, "gamma: expected ≥ 0 and ≤ 1000, got '[[[["),
        (["run", "drape", "--set", "gamma"], 1, "--set: expected name=value, got 'gamma'"),
        (["run", "drape", "--set", "gama=1"], 1, "gama: no such setting; "),
        (["run", "drape", "--out", "nowhere/x.npz"], 1, "nowhere/x.npz: cannot be written: No such file"),
        (["run", "drape", "--json", "."], 1, ".: cannot be written: it is not a file"),
        (
            ["run", "drape", "--seconds", "99999", "--out", "x.npz"],
            1,
            "5,999,941 frames would take 157 GB, more than 2 GB",
        ),
    ],
    ids=lambda value: " ".join(value)[:60] if isinstance(value, list) else "",
)
def test_a_wrong_call_is_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    try:
        ended = main(arguments)
    except SystemExit as ending:
        ended = ending.code
    said = capsys.readouterr()
    assert ended == code
    assert said.err.startswith(f"muslin: {words}")
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert os.listdir(tmp_path) == []


def test_a_refusal_of_the_command_itself_has_no_traceback():
    done = muslin("run", "drape", "--set", "gamma=-1")
    assert done.returncode == 1
    assert done.stderr == "muslin: gamma: expected ≥ 0 and ≤ 1000, got -1\n"


def test_numbers_may_be_quotients_as_lessons_have_them():
    told = {"dt": 1 / 240, "gravity": (0.0, 0.0, -4.905)}
    assert parse_settings(["dt=1/240", "gravity=0,0,-9.81/2"]) == told


def test_settings_may_be_given_together_or_one_by_one():
    assert parse_settings(["gamma=0.5", "bend=cross", "gravity=(0,0,-1)", "gamma = 2"]) == {
        "gamma": 2.0,
        "bend": "cross",
        "gravity": (0.0, 0.0, -1.0),
    }


def test_run_prints_a_table_and_writes_a_recording_and_the_numbers(tmp_path, small):
    out, numbers = tmp_path / "out.npz", tmp_path / "out.json"
    call = ["run", small, "--seconds", "0.1", "--set", "gamma=0.5", "bend=cross", "--set", "dt=0.01"]
    done = muslin(*call, "--out", out, "--json", numbers)
    assert done.returncode == 0
    assert done.stderr == ""  # no progress where nobody watches
    for words in ("10 steps", "solve [ms per step, median]", "contacts", "penetrations", "kinetic energy"):
        assert words in done.stdout
    with np.load(out) as file:
        assert file["positions"].shape == (7, 16, 3)
        assert json.loads(str(file["settings"]))["bend"] == "cross"
    summary = json.loads(numbers.read_text(encoding="utf-8"))
    assert summary["steps"] == 10
    assert summary["settings"]["gamma"] == 0.5
    assert summary["ms"]["total"] > 0
    assert set(summary["energy"]) >= {"kinetic", "gravity", "edge", "cross"}


SPOILT = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nf 1 2 3\nf 1 2 2\n"
MENDED = [
    "left out 1 triangle without area: 1",
    "left out 1 vertex that no triangle uses: 3; pins count the others",
]


@pytest.fixture
def mended(tmp_path):
    (tmp_path / "spoilt.obj").write_bytes(SPOILT)
    path = tmp_path / "mended.toml"
    path.write_text('[cloth]\nkind = "mesh"\nfile = "spoilt.obj"\n', encoding="utf-8")
    return path


def test_check_says_what_was_mended_and_names_the_file_once(mended, capsys):
    assert main(["check", str(mended)]) == 0
    fine = f"{mended}: fine: 3 vertices, 1 triangle, 0 pinned, some 200 MB to simulate, 2 warnings"
    assert capsys.readouterr().out.splitlines() == [*(f"{mended}: cloth[0]: {line}" for line in MENDED), fine]


def test_a_run_and_a_study_say_what_was_mended(mended, capsys):
    said = [f"muslin: {mended}: cloth[0]: {line}" for line in MENDED]
    assert main(["run", str(mended), "--seconds", "0.01"]) == 0
    assert capsys.readouterr().err.splitlines() == said
    assert scene_and_settings(str(mended), ())[1] == {}
    assert capsys.readouterr().err.splitlines() == said


def test_a_run_says_that_the_start_was_untangled(tmp_path, capsys):
    path = tmp_path / "tangled.toml"
    crossed = "vertices = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -0.01], [0.5, 0.5, 1], [0.6, 0.7, 1]]"
    cloth = f"[cloth]\n{crossed}\ntriangles = [[0, 1, 2], [3, 4, 5]]\n"
    path.write_text(f'{cloth}[settings]\ntangled = "untangle"\n', encoding="utf-8")
    assert main(["run", str(path), "--seconds", "0.01"]) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"muslin: {path}: untangled the start, by up to 0.")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("problem", "code", "words"),
    [
        (StepError("beyond all bounds", "solve", "dt"), 1, "solve: beyond all bounds"),
        (KeyboardInterrupt(), 0, "interrupted"),  # as Ctrl-C raises it
    ],
    ids=["a step that fails", "Ctrl-C"],
)
def test_a_run_that_ends_early_keeps_what_was_recorded(
    tmp_path, small, capsys, monkeypatch, problem, code, words
):
    step = sim.Simulation.step

    def step_for_a_while(world):
        if world.time > 0.05:
            raise problem
        return step(world)

    monkeypatch.setattr(sim.Simulation, "step", step_for_a_while)
    out = tmp_path / "out.npz"
    assert main(["run", str(small), "--seconds", "1", "--out", str(out)]) == code
    said = capsys.readouterr()
    assert said.err.startswith(f"muslin: stopped at 0.06667 s: {words}")
    assert said.err.count("\n") == 1
    assert "kinetic energy" in said.out
    with np.load(out) as file:
        assert len(file["times"]) == len(file["positions"]) == 5


def test_a_run_tells_the_share_of_every_effect(tmp_path, capsys):
    file = tmp_path / "numbers.json"
    assert main(["run", "oscillator", "--seconds", "0.1", "--json", str(file)]) == 0
    written = json.loads(file.read_text())
    assert written["shares"].keys() == written["does"].keys() == written["effects"].keys()
    assert written["does"]["gravity"] == find_effect("gravity").changes
    assert all(share["why"] and share["text"] for share in written["shares"].values())
    assert written["shares"]["stretch"]["ms"] > 0.0
    assert written["shares"]["wind"] == {
        "ms": 0.0,
        "at_most": False,
        "text": "0",
        "why": "nothing of it is computed",
    }
    assert "stretch [part of the step, median]" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["cost", "compare", "audit", "study"])
def test_help_has_no_default_that_is_nothing(command):
    assert "(default: '')" not in muslin(command, "--help").stdout
