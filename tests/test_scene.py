"""Scenes: what is refused, with which words, and that nothing but SceneError ever comes out."""

import math
import tomllib

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.scene import LONGEST_LINE, MAX_BYTES, MAX_VERTICES, SceneError, find_scene, load_scene, scene_files

GRID = {"kind": "grid", "size": [1.0, 1.0], "resolution": [4, 4]}
BALL = {"kind": "sphere", "center": [0.0, 0.0, 0.0], "radius": 0.5}


def refusal(table):
    """What a table is refused with, or nothing."""
    try:
        load_scene(table)
    except SceneError as error:
        return str(error)
    return ""


def ball(**changes):
    return {"cloth": GRID, "obstacle": [{**BALL, **changes}]}


def body(**changes):
    return {"cloth": GRID, "obstacle": [{"kind": "mesh", "file": "body.obj", **changes}]}


def grid(**changes):
    return {"cloth": {**GRID, **changes}}


REFUSED = [
    ({}, "cloth: expected at least one piece, got none"),
    ({"cloth": []}, "cloth: expected at least one piece, got none"),
    ({"cloth": [3]}, "cloth[0]: expected a table, got 3"),
    ({"cloth": {}}, "cloth[0]: expected a key 'kind', got []"),
    ({"cloth": GRID, "format": 2}, "format: expected 1, got 2"),
    ({"cloth": GRID, "setings": {}}, "setings: no such key; did you mean settings?"),
    ({"cloth": GRID, 3: 4}, "expected keys that are strings"),
    (
        grid(kind="gird"),
        'cloth[0].kind: expected one of "grid", "equilateral", "mesh", "arrays", got \'gird\'',
    ),
    (grid(sise=[1, 1]), "cloth[0].sise: no such key; did you mean size?"),
    (
        grid(xyz=1),
        "cloth[0].xyz: no such key; "
        "expected one of name, position, rotation, pins, density, size, resolution",
    ),
    (grid(size=[1.0, 0]), "cloth[0].size[1]: expected ≥ 0.0001 and ≤ 1000, got 0"),
    (grid(size=[1.0, math.nan]), "cloth[0].size[1]: expected ≥ 0.0001 and ≤ 1000, got nan"),
    (grid(size=[1.0]), "cloth[0].size: expected an array of length 2, got [1.0]"),
    (grid(resolution=[1, 4]), "cloth[0].resolution[0]: expected a whole number ≥ 2 and ≤ 2000, got 1"),
    (grid(resolution=[4, 2.5]), "cloth[0].resolution[1]: expected a whole number ≥ 2 and ≤ 2000, got 2.5"),
    (
        grid(resolution=[2000, 2000]),
        f"cloth[0].resolution: expected at most {MAX_VERTICES} vertices, got 4000000",
    ),
    (grid(position=[1e5, 0, 0]), "cloth[0].position[0]: expected ≥ -10000 and ≤ 10000, got 100000.0"),
    (
        grid(rotation=[math.inf, 0.0, 0.0]),
        "cloth[0].rotation[0]: expected ≥ -10000 and ≤ 10000, got inf",
    ),
    (grid(density=0), "cloth[0].density: expected ≥ 0.0001 and ≤ 1000, got 0"),
    (grid(pins=[-1]), "cloth[0].pins[0]: expected a vertex index ≥ 0 or the name of a side, got -1"),
    (grid(pins=[1.5]), "cloth[0].pins[0]: expected a whole number or a string, got 1.5"),
    ({"cloth": {"kind": "mesh"}}, "cloth[0]: expected a key 'file', got ['kind']"),
    (
        ball(kind="ball"),
        'obstacle[0].kind: expected one of "sphere", "plane", "box", "capsule", "mesh", "arrays", '
        "got 'ball'",
    ),
    (ball(radius=-1), "obstacle[0].radius: expected ≥ 0.0001 and ≤ 1000, got -1"),
    (ball(center=[0.0, 0.0]), "obstacle[0].center: expected an array of length 3, got [0.0, 0.0]"),
    (ball(motion="jerky"), 'obstacle[0].motion: expected one of "linear", "smooth", got \'jerky\''),
    (ball(path=[{"time": -1}]), "obstacle[0].path[0].time: expected ≥ 0 and ≤ 1e+06, got -1"),
    (
        ball(path=[{"time": 1}, {"time": 1}]),
        "obstacle[0].path: expected times that increase, got [1.0, 1.0]",
    ),
    (
        ball(path=[{"time": 1, "rotation": [math.inf, 0, 0]}]),
        "obstacle[0].path[0].rotation[0]: expected ≥ -10000 and ≤ 10000, got inf",
    ),
    (ball(repeat=True), "obstacle[0].repeat: expected a path of at least two keys to repeat"),
    (
        {"cloth": GRID, "obstacle": [{"kind": "plane", "normal": [0, 0, 0]}]},
        "obstacle[0].normal: expected a direction, got [0.0, 0.0, 0.0]",
    ),
    (body(file=None), "obstacle[0].file: expected a string, got None"),
    (body(scale=0.0), "obstacle[0].scale: expected ≥ 1e-06 and ≤ 1e+06, got 0.0"),
    (body(position=[0.0, 0.0]), "obstacle[0].position: expected an array of length 3, got [0.0, 0.0]"),
    (body(position=[0, 0, math.nan]), "obstacle[0].position[2]: expected ≥ -10000 and ≤ 10000, got nan"),
    (body(foils=1), "obstacle[0].foils: no such key; did you mean file?"),
    ({"cloth": GRID, "obstacle": [{"kind": "mesh"}]}, "obstacle[0]: expected a key 'file', got ['kind']"),
    (
        {"cloth": GRID, "obstacle": [{"vertices": [[0, 0, 0]]}]},
        "obstacle[0]: expected a key 'triangles', got ['kind', 'vertices']",
    ),
    ({"cloth": GRID, "obstacle": [3]}, "obstacle[0]: expected a table, got 3"),
    ({"cloth": GRID, "settings": 3}, "settings: expected a table of settings, got 3"),
    ({"cloth": GRID, "settings": {"gamma": -1}}, "settings.gamma: expected ≥ 0 and ≤ 1000, got -1"),
    ({"cloth": GRID, "settings": {"gamma": math.nan}}, "settings.gamma: expected ≥ 0 and ≤ 1000, got nan"),
    ({"cloth": GRID, "settings": {"dt": 0}}, "settings.dt: expected ≥ 1e-06 and ≤ 1, got 0"),
    (
        {"cloth": GRID, "settings": {"contact": "glue"}},
        "settings.contact: expected one of",
    ),
    ({"cloth": GRID, "settings": {"gama": 1}}, "settings.gama: no such setting; did you mean gamma?"),
    ({"cloth": GRID, "compare": {"by": "gama"}}, "compare.by: 'gama' is no setting; did you mean gamma?"),
    (
        {"cloth": GRID, "settings": {"seed": 16**9000}},
        "settings.seed: expected a whole number ≥ 0 and ≤ 2.14748e+09, got a number of thousands of digits",
    ),
    (
        {"cloth": GRID, "settings": {"dt": 10**400}},
        f"settings.dt: expected ≥ 1e-06 and ≤ 1, got 1{'0' * 76}…",
    ),
    ({"cloth": GRID, "format": "1"}, "format: expected 1, got '1'"),
    (
        {"cloth": {"kind": 3}},
        'cloth[0].kind: expected one of "grid", "equilateral", "mesh", "arrays", got 3',
    ),
    ({"cloth": GRID, "\x1b[2J\n": 1}, "\N{REPLACEMENT CHARACTER}[2J : no such key; "),
    (
        {"cloth": GRID, "compare": {"by": "gamma", "values": []}},
        "compare.values: expected 1 to 4 values, got 0",
    ),
    (
        {"cloth": GRID, "compare": {"by": "gamma", "values": [1, 2], "fails": [3]}},
        "compare.fails[0]: expected one of compare.values, got 3",
    ),
    (
        {"cloth": GRID, "compare": {"by": "gamma", "values": [1, "a"]}},
        "compare.values[1]: gamma: expected ≥ 0 and ≤ 1000, got 'a'",
    ),
    ({"cloth": GRID, "lesson": {}}, "lesson: expected a key 'title', got []"),
]


@pytest.mark.parametrize(("table", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_a_wrong_scene_is_refused_with_its_path_value_and_allowed_range(table, words):
    message = refusal(table)
    assert message.startswith(f"scene: {words}") if words[-1] in ", ;f" else message == f"scene: {words}"


@pytest.mark.parametrize(
    "table",
    [
        grid(),
        {"cloth": [GRID, {**GRID, "position": [0.0, 0.0, 1.0], "pins": ["left", 3]}]},
        {"cloth": {"kind": "equilateral"}},
        {"cloth": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}},
        ball(path=[{"time": 0.0}, {"time": 1.0, "position": [1.0, 0.0, 0.0]}], repeat=True, motion="linear"),
        {"cloth": GRID, "settings": {"gamma": 1, "gravity": [0, 0, 0], "contact": "none"}},
    ],
)
def test_a_right_scene_is_accepted(table):
    assert load_scene(table).cloth


def test_a_file_is_named_in_the_error(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text('[cloth]\nkind = "grid"\n[settings]\ngamma = -1\n')
    with pytest.raises(SceneError) as refused:
        load_scene(path)
    assert str(refused.value) == f"{path}: settings.gamma: expected ≥ 0 and ≤ 1000, got -1"


def test_a_file_may_not_say_where_its_meshes_are(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text('folder = "/"\n[cloth]\nkind = "grid"\n')
    with pytest.raises(SceneError, match="folder: no such key"):
        load_scene(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe", "not TOML"),
        (b"[cloth", "not TOML"),
        (b"a = " + b"[" * 100_000, "not TOML: expected tables and arrays within few others"),
        (b"a = " + b"9" * 5000, "not TOML: expected whole numbers of at most 4,300 digits, got more"),
        (b"\na" + b".a" * 8000 + b" = 1", "line 2: expected keys of at most 32 parts, got more"),
        (b"[a" + b"  . 'a\"b'" * 40 + b"]", "line 1: expected keys of at most 32 parts, got more"),
        (b'[a.b]\nc."d.\\"e"' + b' ."d.\\"e"' * 40 + b" = 1", "line 2: expected keys of at most 32 parts"),
        (b"#" * (MAX_BYTES + 1), "expected at most 1 MB, got more"),
    ],
)
def test_a_file_that_is_no_scene_is_refused(tmp_path, content, words):
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(SceneError) as refused:
        load_scene(path)
    assert str(refused.value).startswith(f"{path}: {words}")


@pytest.mark.parametrize("name", ["nowhere.toml", "no\0name", "x" * 300, "."])
def test_a_path_that_cannot_be_read_is_refused(tmp_path, name):
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(tmp_path / name)


@pytest.mark.parametrize("path", scene_files(), ids=lambda path: path.stem)
def test_every_scene_that_comes_with_muslin_says_what_to_see(path):
    scene = load_scene(path.stem)
    assert find_scene(path.stem) == path
    assert scene.name == path.stem
    assert scene.camera is not None
    assert scene.lesson is not None
    assert scene.lesson.title
    assert scene.lesson.look_for.endswith(".")
    assert 2 <= len(scene.lesson.tries) <= 3
    assert len(scene.compare.values) >= 2


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_random_bytes_never_raise_anything_else(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "bytes.toml"
    path.write_bytes(data)
    with pytest.raises(SceneError):
        load_scene(path)


EXAMPLE = tomllib.loads(find_scene("curtain").read_text(encoding="utf-8"))
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just(10**400), st.just([])
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


def places(table, path=()):
    """Paths of everything in nested tables and arrays."""
    yield path
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        yield from places(value, (*path, key))


def changed(table, path, value):
    """A copy with the place at `path` replaced."""
    if not path:
        return value
    copy = dict(table) if isinstance(table, dict) else list(table)
    copy[path[0]] = changed(table[path[0]], path[1:], value)
    return copy


@given(st.sampled_from([p for p in places(EXAMPLE) if p]), VALUES)
@settings(max_examples=500, deadline=None)
def test_mutated_scenes_load_or_raise_scene_errors_of_one_line(path, value):
    message = refusal(changed(EXAMPLE, path, value))
    assert len(message.splitlines()) <= 1
    assert len(message) <= LONGEST_LINE


TABLES = ["cloth", "settings", "obstacle", "lesson", "camera", "compare", "effects"]


@given(st.sampled_from(TABLES), st.text(max_size=8), VALUES)
@settings(max_examples=300, deadline=None)
def test_keys_that_nobody_knows_are_refused(table, key, value):
    scene = {**EXAMPLE, table: EXAMPLE.get(table, {})}
    target = scene[table][0] if isinstance(scene[table], list) else scene[table]
    if key in target or key in ("name", "density", "threads", "seed", "values"):
        return
    scene[table] = {**target, key: value}
    if table == "obstacle":
        scene[table] = [scene[table]]
    assert len(refusal(scene).splitlines()) == 1


def test_what_a_scene_writes_out_it_reads_back(tmp_path):
    path = tmp_path / "curtain.toml"
    path.write_text(tomli_w.dumps(EXAMPLE), encoding="utf-8")
    assert load_scene(path).obstacle == load_scene("curtain").obstacle
