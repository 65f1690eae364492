"""Tried at random within fixed times: triangle soups, mutated scenes and extreme settings, never a crash."""

import itertools
import json
from functools import reduce
from operator import getitem

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import sim
from sim.mesh import build_mesh
from sim.meshclaims import SUFFIXES
from sim.meshfile import read_mesh
from sim.safe import safe_changes
from sim.scene import SceneError, load_scene
from sim.settings import FIELDS, Settings, change, convert
from tests.fuzz import within

STEPS = 30
RESPONSES = list(itertools.product(["penalty", "impulse", "postprocess"], ["static", "continuous"]))
BALL = {"kind": "sphere", "center": [0.0, 0.0, -0.6], "radius": 0.5}


@st.composite
def soups(draw):
    """1 to 50 triangles that share vertices at random: crossing, flat, doubled, wound anyhow."""
    n = draw(st.integers(3, 40))
    seed = draw(st.integers(0, 2**32 - 1))
    scale = draw(st.sampled_from([1e-3, 0.1, 1.0, 100.0]))
    rng = np.random.default_rng(seed)
    flat = draw(st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 1e-6, 1)]))
    vertices = scale * rng.uniform(-1.0, 1.0, (n, 3)) * flat
    corners = [rng.choice(n, 3, replace=False) for _ in range(draw(st.integers(1, 50)))]
    return {
        "vertices": vertices.tolist(),
        "triangles": np.array(corners).tolist(),
        "pins": draw(st.lists(st.integers(0, n - 1), max_size=2)),
    }


@pytest.mark.parametrize(("contact", "detection"), RESPONSES)
@within(4.0)
@given(cloth=soups())
def test_a_soup_of_triangles_stays_finite_or_a_step_is_refused_and_undone(contact, detection, cloth):
    settings = {"contact": contact, "detection": detection, "tangled": "keep"}
    world = sim.Simulation({"cloth": cloth, "obstacle": [BALL]}, **settings)
    for _ in range(STEPS):
        before = world.positions.copy()
        try:
            world.step()
        except sim.StepError as error:
            assert error.setting in FIELDS  # noqa: PT017
            assert np.array_equal(world.positions, before)
            break
        assert np.isfinite(world.positions).all()
        assert np.isfinite(world.velocities).all()
    assert np.array_equal(world.positions[world.pinned], world.mesh.vertices[world.pinned])


EXTREMES = [10.0**power for power in range(-12, 13, 3)] + [0.0, -1.0, float("nan"), float("inf")]
NUMBERS = [name for name, field in FIELDS.items() if field.type == "number"]
CHOICES = {name: list(field.choices()) for name, field in FIELDS.items() if field.choices}


def allowed(name, value):
    try:
        convert(name, value)
    except ValueError:
        return False
    return True


@within(2.0)
@given(name=st.sampled_from(NUMBERS), value=st.sampled_from(EXTREMES) | st.floats())
def test_a_setting_is_accepted_within_its_bounds_alone_and_refused_with_name_value_and_range(name, value):
    low, high = FIELDS[name].minimum, FIELDS[name].maximum
    if low <= value <= high:
        assert getattr(change(Settings(), **{name: value}), name) == value
    else:
        with pytest.raises(ValueError, match="^" + name) as refused:
            change(Settings(), **{name: value})
        assert repr(value) in str(refused.value)
        assert FIELDS[name].allowed in str(refused.value)


@st.composite
def extreme_settings(draw):
    """Any numbers that are allowed, mostly far out, with any choices."""
    changed = {name: draw(st.sampled_from(options)) for name, options in CHOICES.items()}
    for name in draw(st.lists(st.sampled_from(NUMBERS), max_size=5, unique=True)):
        changed[name] = draw(st.sampled_from([v for v in EXTREMES if allowed(name, v)]))
    return changed


SHEET = {"kind": "grid", "size": [0.5, 0.5], "resolution": [6, 6], "pins": ["corner00"]}


@within(8.0)
@given(changed=extreme_settings())
def test_extreme_settings_give_finite_steps_or_a_refusal_that_leaves_the_state_and_can_be_got_out_of(changed):
    world = sim.Simulation({"cloth": SHEET, "obstacle": [BALL]}, **changed)
    for _ in range(8):
        before = world.positions.copy(), world.velocities.copy(), world.time
        try:
            world.step()
        except sim.StepError as error:
            assert error.setting in FIELDS  # noqa: PT017
            now = world.positions, world.velocities, world.time
            assert all(np.array_equal(a, b) for a, b in zip(before, now, strict=True))
            world.update(**safe_changes(world.settings))
        assert np.isfinite(world.positions).all()
        assert np.isfinite(world.velocities).all()


WORDS = st.sampled_from(
    rb"""element vertex 3
element face 1
element edge 2
format ascii 1.0
format binary_little_endian 1.0
property float x
property list uchar int vertex_indices
facet normal 0 0 1
outer loop
vertex 0 1 0
endloop
endfacet
3 0 1 2
0 0 0
\
""".splitlines(keepends=True)
    + b"v |f |1 |-1 |0 |nan |1e999 |#|\n|ply\n|OFF\n|solid\n|end_header\n|\xff\0".split(b"|")
)


@pytest.mark.parametrize("suffix", SUFFIXES)
@within(2.0)
@given(words=st.lists(WORDS | st.binary(max_size=8), max_size=60))
def test_words_of_mesh_files_in_any_order_give_a_mesh_or_one_line(tmp_path, suffix, words):
    (tmp_path / f"m{suffix}").write_bytes(b"".join(words))
    try:
        vertices, triangles, _ = read_mesh(f"m{suffix}", str(tmp_path))
    except ValueError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
        return
    assert np.isfinite(vertices).all()
    assert len(triangles)
    assert 0 <= triangles.min() <= triangles.max() < len(vertices)


SCENE = {
    "cloth": [{**SHEET, "position": [0.0, 0.0, 0.3]}],
    "obstacle": [BALL, {"kind": "box", "center": [0.0, 0.0, -1.0], "size": [1.0, 1.0, 0.1]}],
    "settings": {"gamma": 0.2, "dt": 0.01, "thickness": 0.005, "contact": "impulse"},
}
NASTY = st.sampled_from(
    [0, 1, 2, 3, -1, 1e-4, 1e4, 1e9, 1e-9, 0.5, float("nan"), None, True, "", "left", [], {}]
)


def spots(table, path=()):
    """Every place of nested tables and arrays."""
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from spots(value, (*path, key))


@within(6.0)
@given(changes=st.lists(st.tuples(st.sampled_from(list(spots(SCENE))), NASTY), min_size=1, max_size=3))
def test_a_mutated_scene_is_refused_in_one_line_or_built_and_stepped(changes):
    scene = json.loads(json.dumps(SCENE))
    for path, value in changes:
        try:
            target = reduce(getitem, path[:-1], scene)
            target[path[-1]] = value
        except (LookupError, TypeError):  # what another change has taken away
            assume(False)
    try:
        mesh = build_mesh(load_scene(scene))
    except SceneError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
        return
    assume(len(mesh.vertices) < 5000)
    world = sim.Simulation(scene)
    for _ in range(3):
        try:
            world.step()
        except sim.StepError:
            break
    assert np.isfinite(world.positions).all()
