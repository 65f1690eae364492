"""Clearance at load: fcl's answers against closed forms, and what `check` says of them."""

import numpy as np
import pytest

from sim.check import check_scene
from sim.clearance import clearance_warnings
from sim.mesh import build_mesh
from sim.scene import load_scene

FCL = 2e-5  # GJK between a box or capsule and a triangle stops at about a hundredth of a millimetre
SIZE, HEIGHT = 1.0, 0.8


def warnings(*obstacles, thickness=1e-5, **cloth):
    piece = {"kind": "grid", "size": [SIZE, SIZE], "resolution": [6, 6], "position": [0, 0, HEIGHT], **cloth}
    scene = load_scene({"cloth": piece, "obstacle": list(obstacles), "settings": {"thickness": thickness}})
    return clearance_warnings(build_mesh(scene), scene)


def standing(gap):
    """One obstacle of each kind that ends `gap` below the cloth at HEIGHT."""
    top = HEIGHT - gap
    return {
        "sphere": {"kind": "sphere", "name": "it", "center": [0.1, 0.05, top - 0.3], "radius": 0.3},
        "box": {"kind": "box", "name": "it", "center": [0.1, 0.0, top - 0.1], "size": [0.3, 0.4, 0.2]},
        "capsule": {
            "kind": "capsule",
            "name": "it",
            "start": [-0.2, 0.1, top - 0.1],
            "end": [0.3, 0.0, top - 0.1],
            "radius": 0.1,
        },
        "plane": {"kind": "plane", "name": "it", "point": [3.0, 0.0, top]},
        "leaning plane": {
            "kind": "plane",
            "name": "it",
            "point": [SIZE / 2, 0.0, HEIGHT - 2**0.5 * gap],
            "normal": [-1.0, 0.0, 1.0],
        },
        "turned box": {
            "kind": "box",
            "name": "it",
            "center": [9.0, 9.0, 9.0],
            "size": [0.2, 0.2, 0.2],
            "path": [{"time": 1, "position": [0, 0, top - 0.02**0.5], "rotation": [np.pi / 4, 0, 0]}],
        },
    }


KINDS = list(standing(0.0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gap", [0.003, 0.05])
def test_the_distance_of_cloth_and_obstacle_is_that_of_the_closed_form(kind, gap):
    """Thickness just above and just below the gap brackets the distance that was measured."""
    obstacle = standing(gap)[kind]
    assert warnings(obstacle, thickness=gap - FCL) == []
    shape = obstacle["kind"]
    said = f'cloth[0] starts {gap:.2g} m from obstacle[0] ({shape} "it"), nearer than the thickness of '
    assert [w.startswith(said) for w in warnings(obstacle, thickness=gap + FCL)] == [True]


@pytest.mark.parametrize("kind", KINDS)
def test_cloth_that_starts_in_an_obstacle_is_named(kind):
    obstacle = standing(-0.02)[kind]
    assert warnings(obstacle) == [f'cloth[0] starts inside obstacle[0] ({obstacle["kind"]} "it")']


@pytest.mark.parametrize(
    "obstacle",
    [
        {"kind": "sphere", "center": [0, 0, HEIGHT], "radius": 5.0},
        {"kind": "box", "center": [0, 0, HEIGHT], "size": [5, 5, 5]},
        {"kind": "capsule", "start": [0, 0, -1], "end": [0, 0, 3], "radius": 5.0},
        {"kind": "plane", "point": [0, 0, 5]},
    ],
)
def test_cloth_wholly_inside_an_obstacle_that_its_shell_never_meets_is_named(obstacle):
    assert warnings(obstacle) == [f"cloth[0] starts inside obstacle[0] ({obstacle['kind']})"]


def test_an_obstacle_that_pokes_through_between_vertices_is_named():
    needle = {"kind": "capsule", "start": [0.03, 0.02, 0.0], "end": [0.03, 0.02, 1.5], "radius": 0.001}
    assert warnings(needle) == ["cloth[0] starts inside obstacle[0] (capsule)"]


def test_each_piece_of_cloth_is_measured_by_itself():
    ball = {"kind": "sphere", "center": [0, 0, 2.0], "radius": 0.1}
    pieces = [{"kind": "grid", "resolution": [3, 3], "position": [0, 0, z]} for z in (0.0, 2.0)]
    scene = load_scene({"cloth": pieces, "obstacle": [ball]})
    assert clearance_warnings(build_mesh(scene), scene) == ["cloth[1] starts inside obstacle[0] (sphere)"]


PAIRS = {
    "sphere on plane": ({"kind": "sphere", "center": [9, 0, 0.5], "radius": 0.5}, {"kind": "plane"}),
    "box on plane": ({"kind": "box", "center": [9, 0, 0.5], "size": [1, 1, 1]}, {"kind": "plane"}),
    "spheres": (
        {"kind": "sphere", "center": [9, 0, 0.8], "radius": 0.5},
        {"kind": "sphere", "center": [9.6, 0, 0.0], "radius": 0.5},
    ),
    "capsule on box": (
        {"kind": "capsule", "start": [9, 0, 0.7], "end": [9.4, 0, 0.7], "radius": 0.2},
        {"kind": "box", "center": [9, 0, 0], "size": [1, 1, 1]},
    ),
}


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize(("by", "overlap"), [(0.01, True), (0.0, False), (-0.01, False)])
def test_obstacles_overlap_exactly_where_they_reach_into_each_other(pair, by, overlap):
    upper, lower = PAIRS[pair]
    if pair == "spheres":  # along the line of their centres, 1 m apart
        upper = {**upper, "center": [9 + 0.6 * by, 0, 0.8 - 0.8 * by]}
    else:
        lower = {**lower, "path": [{"time": 0, "position": [lower.get("center", [0])[0], 0, by]}]}
    found = [w for w in warnings(upper, lower) if "overlap" in w]
    kinds = upper["kind"], lower["kind"]
    assert found == [f"obstacle[0] ({kinds[0]}) and obstacle[1] ({kinds[1]}) overlap"] * overlap


def test_cloth_without_triangles_is_passed_over():
    chain = {"vertices": [[0, 0, 0], [0, 0, 1]], "edges": [[0, 1]]}
    scene = load_scene({"cloth": chain, "obstacle": [{"kind": "plane"}]})
    assert clearance_warnings(build_mesh(scene), scene) == []


def test_check_counts_slivers():
    vertices = [[0, 0, 0], [1, 0, 0], [0.5, 0.005, 0], [0.5, 1, 0]]
    scene = load_scene({"cloth": {"vertices": vertices, "triangles": [[0, 1, 2], [0, 2, 3]]}})
    assert check_scene(scene)[1] == ["1 triangle has an angle below 1°"]
