"""What is refused, mended, or accepted with a warning: one row for each kind of mistake people make.

Finer points are in the tests of scenes, meshes, mesh files and settings; this is the list as a whole.
"""

import re
from pathlib import Path

import numpy as np
import pytest

import sim
from sim import scene as scenes
from sim.check import check_scene
from sim.mesh import build_mesh
from sim.meshclaims import MAX_BYTES
from sim.meshfile import read_mesh
from sim.scene import MAX_PARTS, SceneError, load_scene

GRID = {"kind": "grid", "size": [1.0, 1.0], "resolution": [4, 4]}
TRIANGLE = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}
BALL = {"kind": "sphere", "center": [0, 0, -2], "radius": 0.5}
STACK = [{**GRID, "resolution": [400, 499], "position": [0.0, 0.0, float(i)]} for i in range(3)]


def cloth(**changes):
    return {"cloth": {**TRIANGLE, **changes}}


def setting(**changes):
    return {"cloth": GRID, "settings": changes}


REFUSED = {
    "key that is no text": ({"cloth": GRID, "effects": {1: "on"}}, "effects.1: no such effect"),
    "non-finite coordinate": (cloth(vertices=[[0, 0, np.nan]] * 3), r"cloth\[0\].vertices\[0\]: .*nan"),
    "index below zero": (
        cloth(triangles=[[0, 1, -1]]),
        r"triangles\[0\]: .*from 0 to 2, got \[0, 1, -1\]",
    ),
    "index too large": (cloth(triangles=[[0, 1, 3]]), r"triangles\[0\]: .*from 0 to 2"),
    "face with a repeated index": (
        cloth(triangles=[[0, 1, 1]]),
        r"triangles\[0\]: expected distinct vertices",
    ),
    "no cloth at all": ({"cloth": []}, "cloth: expected at least one piece"),
    "no vertex": (cloth(vertices=[]), r"cloth\[0\].vertices"),
    "text for numbers": (cloth(vertices=[["1", 0, 0]] * 3), r"vertices\[0\]: expected 3 finite numbers"),
    "truth for numbers": (cloth(vertices=[[True] * 3] * 3), r"vertices\[0\]: expected 3 finite numbers"),
    "nothing for a number": (
        cloth(vertices=[[0, 0, 0], [0, None, 0]]),
        r"vertices\[1\]: .*None",
    ),
    "ragged rows": (cloth(vertices=[[0, 0, 0], [1, 0]]), r"vertices\[1\]: .*got \[1, 0\]"),
    "ragged faces": (cloth(triangles=[[0, 1, 2], [0, 1]]), r"triangles\[1\]: .*got \[0, 1\]"),
    "coordinate that no float holds": (cloth(vertices=[[10**400, 0, 0]] * 3), r"vertices\[0\]: .*numbers"),
    "index that no float holds": (cloth(triangles=[[0, 1, 10**400]]), r"triangles\[0\]: .*numbers"),
    "too many vertices": ({"cloth": {**GRID, "resolution": [2000, 2000]}}, r"resolution: .*at most 200000"),
    "too many in several pieces": ({"cloth": STACK}, "cloth: expected at most 200000 vertices"),
    "too many pieces": ({"cloth": [GRID] * (MAX_PARTS + 1)}, f"cloth: expected at most {MAX_PARTS}"),
    "too many obstacles": (
        {"cloth": GRID, "obstacle": [BALL] * (MAX_PARTS + 1)},
        f"obstacle: expected at most {MAX_PARTS}",
    ),
    "too far away": (
        cloth(vertices=[[2e4, 0, 0]] * 3),
        r"cloth\[0\].vertices\[0\]: expected coordinates within ±1e4 m, got 20000",
    ),
    "mass that has no inverse": (
        cloth(masses=[1, 1, 5e-324]),
        r"masses\[2\]: expected ≥ 1e-18 and ≤ 1e\+18 kg",
    ),
    "masses that have no sum": (cloth(masses=[1e308] * 3), r"masses\[0\]: expected .* kg, got 1e\+308"),
    "too small": (
        cloth(vertices=[[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0]]),
        r"cloth\[0\].vertices: expected a size of at least 0.0001 m, got 1e-09",
    ),
    "too small at rest": (
        cloth(rest_vertices=[[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0]]),
        r"cloth\[0\].rest_vertices: expected a size of at least 0.0001 m, got 1e-05",
    ),
    "too small an obstacle": (
        {"cloth": GRID, "obstacle": [{**TRIANGLE, "vertices": [[0, 0, 0], [1e-5, 0, 0], [0, 1e-5, 0]]}]},
        r"obstacle\[0\].vertices: expected a size of at least 0.0001 m, got 1e-05",
    ),
    "array of billions": (
        cloth(vertices=np.broadcast_to(0.0, (10**9, 3))),
        "expected arrays of at most 1,200,000 numbers, got 3,000,000,000",
    ),
    "mass of zero": (cloth(masses=[1, 1, 0]), r"masses\[2\]: expected ≥ 1e-18 and ≤ 1e\+18 kg, got 0"),
    "density of zero": (setting(density=0.0), r"settings.density: expected ≥ 0.0001 and ≤ 1000, got 0"),
    "negative stiffness": (setting(stretch=-1.0), "settings.stretch: expected ≥ 0 and"),
    "negative damping": (setting(gamma=-1.0), "settings.gamma: expected ≥ 0 and"),
    "time step of zero": (setting(dt=0.0), "settings.dt: expected ≥ 1e-06 and ≤ 1, got 0"),
    "time step of minutes": (setting(dt=60.0), "settings.dt: expected ≥ 1e-06 and ≤ 1, got 60"),
    "negative friction": (setting(friction=-0.1), "settings.friction: expected ≥ 0"),
    "thickness of zero": (setting(thickness=0.0), "settings.thickness: expected ≥ 1e-05"),
    "no number": (setting(gamma=float("nan")), "settings.gamma: .*nan"),
    "pin that is no vertex": ({"cloth": {**GRID, "pins": [16]}}, r"pins\[0\]: .*from 0 to 15, got 16"),
    "unknown key": ({"cloth": GRID, "setings": {}}, "setings: no such key; did you mean settings"),
    "unknown setting": (setting(gama=1.0), "settings.gama: no such setting"),
    "unknown version": ({"cloth": GRID, "format": 2}, "format: expected 1, got 2"),
    "times that go back": (
        {"cloth": GRID, "obstacle": [{**BALL, "path": [{"time": 1}, {"time": 0}]}]},
        r"obstacle\[0\].path: expected times that increase",
    ),
    "file outside of the folder": (
        {"cloth": {"kind": "mesh", "file": "../../etc/passwd.obj"}},
        r"cloth\[0\].file: expected a file inside the scene's folder",
    ),
    "archive": ({"cloth": {"kind": "mesh", "file": "m.zip"}}, r"cloth\[0\].file: expected one of .obj"),
    "pickle": ({"cloth": {"kind": "mesh", "file": "m.npy"}}, r"cloth\[0\].file: expected one of .obj"),
}


def endless():
    pins = []
    pins.append(pins)
    return {"cloth": {**GRID, "pins": pins}}


NO_SCENE = {
    "nothing": (None, "expected a file, the name of a scene or a dict, got None"),
    "without an end": (endless(), "expected tables and arrays within few others"),
}


@pytest.mark.parametrize(("source", "words"), NO_SCENE.values(), ids=NO_SCENE)
def test_what_is_no_scene_at_all_is_refused_in_one_line(source, words):
    with pytest.raises(SceneError, match=f"^scene: {words}"):
        load_scene(source)


@pytest.mark.parametrize(("table", "words"), REFUSED.values(), ids=REFUSED)
def test_it_is_refused_in_one_line_that_names_key_value_and_range(table, words):
    with pytest.raises(SceneError, match=rf"^scene: .*{words}") as refused:
        build_mesh(load_scene(table))
    assert "\n" not in str(refused.value)


def test_many_pieces_of_an_allowed_size_are_refused_before_all_of_them_are_built(monkeypatch):
    built = []
    monkeypatch.setattr(sim.mesh, "_grid", lambda c, grid=sim.mesh._grid: built.append(c) or grid(c))
    with pytest.raises(SceneError, match="at most 200000 vertices"):
        build_mesh(load_scene({"cloth": STACK * 300}))
    assert len(built) == 2


SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
MENDED = {
    "duplicate face": (b"f 1 2 3\nf 1 3 4\nf 2 3 1\n", "left out 1 repeated triangle"),
    "unreferenced vertex": (b"f 1 2 3\nf 1 3 4\nv 9 9 9\n", "left out 1 vertex that no triangle uses"),
    "inconsistent winding": (b"f 1 2 3\nf 1 4 3\n", "turned 1 triangle round"),
    "face without area": (b"f 1 2 3\nf 1 3 4\nf 1 1 2\n", "left out 1 triangle without area"),
    "polygon": (b"f 1 2 3 4\n", "cut 1 polygon into triangles"),
}


@pytest.mark.parametrize(("faces", "words"), MENDED.values(), ids=MENDED)
def test_it_is_mended_and_said(tmp_path, faces, words):
    (tmp_path / "m.obj").write_bytes(SQUARE + faces)
    _, triangles, warnings = read_mesh("m.obj", str(tmp_path))
    assert len(triangles) == 2
    assert words in " ".join(warnings)


BOOK = {
    "vertices": [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0], [0.5, 0, 1]],
    "triangles": [[0, 1, 2], [1, 0, 3], [0, 1, 4]],
}
APART = {
    "vertices": [*TRIANGLE["vertices"], [5, 0, 0], [6, 0, 0], [5, 1, 0]],
    "triangles": [[0, 1, 2], [3, 4, 5]],
}
CROSSED = {"vertices": [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.5, -1], [0.5, 0.5, 1], [0.6, 0.7, 1]]}
WARNED = {
    "edge of three faces": (
        {"cloth": BOOK},
        r"cloth\[0\]: 1 edge of three or more triangles, between vertices \d and \d: no bending there",
    ),
    "several components": ({"cloth": APART}, r"cloth\[0\] is in 2 parts that nothing joins"),
    "open obstacle": ({"cloth": GRID, "obstacle": [{**TRIANGLE, "position": [0, 0, -3]}]}, "no inside"),
    "sliver": (cloth(vertices=[[0, 0, 0], [1, 0, 0], [0.5, 1e-3, 0]]), "1 triangle has an angle below 1°"),
    "crossing at the start": (
        {"cloth": {**CROSSED, "triangles": [[0, 1, 2], [3, 4, 5]]}, "settings": {"contact": "penalty"}},
        "cloth crosses itself .* at the start.*0 and 1",
    ),
    "inside an obstacle": ({"cloth": GRID, "obstacle": [{**BALL, "center": [0, 0, 0]}]}, "starts inside"),
    "too near an obstacle": (
        {"cloth": GRID, "obstacle": [{**BALL, "center": [0, 0, -0.501]}]},
        "nearer than the thickness",
    ),
    "too thick": (
        setting(thickness=0.1) | {"cloth": {**GRID, "resolution": [20, 20]}},
        "thickness: .*got 0.1 m",
    ),
}


@pytest.mark.parametrize(("table", "words"), WARNED.values(), ids=WARNED)
def test_it_is_accepted_with_a_warning(table, words):
    _, warnings = check_scene(load_scene(table))
    assert re.search(words, "\n".join(warnings))


LINES = {
    ".obj": [b"\n", b"#\n", b"\\\n", b"v 0 0 0 \\\n"],
    ".ply": [b"\n", b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 1\nend_header\n"],
    ".stl": [b"\n", b"solid\n", b" \n"],
    ".off": [b"\n", b"#\n", b"OFF\n"],
}


@pytest.mark.parametrize(("suffix", "line"), [(s, line) for s, lines in LINES.items() for line in lines])
@pytest.mark.timeout(60)
def test_ten_megabytes_of_the_same_line_are_refused_soon(tmp_path, suffix, line):
    """Some of these took minutes, as each blank line was read to the end of all of them."""
    head = {".ply": LINES[".ply"][1], ".off": b"OFF\n"}.get(suffix, b"")
    (tmp_path / f"m{suffix}").write_bytes((head + line * (MAX_BYTES // len(line)))[:MAX_BYTES])
    with pytest.raises(ValueError, match=f"^m{suffix}: "):
        read_mesh(f"m{suffix}", str(tmp_path))


def test_nothing_unpickles_or_reads_yaml():
    root = Path(scenes.__file__).parent.parent
    sources = [path for folder in ("sim", "server") for path in (root / folder).rglob("*.py")]
    assert len(sources) > 50
    for path in sources:
        assert not re.search(
            r"allow_pickle=True|^\s*(import|from) (yaml|pickle)", path.read_text("utf-8"), re.M
        ), path
