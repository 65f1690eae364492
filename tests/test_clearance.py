"""Clearance at load: fcl's answers against closed forms, and what `check` says of them."""

import re

import ipctk
import numpy as np
import pytest
import trimesh

import sim
from sim.check import check_scene
from sim.clearance import clearance_warnings
from sim.mesh import build_mesh
from sim.rotation import rotation_matrix
from sim.scene import load_scene
from tests.worlds import grid

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
    assert check_scene(scene)[1] == ["1 triangle has an angle below 1°: 0"]


def test_check_tells_of_a_repeated_path_that_jumps():
    keys = [{"time": time, "position": [0, 0, z]} for time, z in ((0.0, -2.0), (0.5, -1.0), (1.0, -2.0))]
    told = []
    for path, repeat in ((keys[:2], True), (keys[:2], False), (keys, True)):
        ball = {"kind": "sphere", "center": [0, 0, -2], "radius": 0.1, "path": path, "repeat": repeat}
        told.append(check_scene(load_scene({"cloth": grid(), "obstacle": [ball]}))[1])
    assert told == [
        ["obstacle[0] jumps as its path is repeated: the last key is not where the first is"],
        [],
        [],
    ]


@pytest.mark.parametrize(
    ("turns", "told"), [(0.0, 0), (1.0, 0), (-1.0, 0), (3.0, 0), (6.283 / (2 * np.pi), 0), (0.5, 1), (1.1, 1)]
)
@pytest.mark.parametrize("axis", [(0, 0, 1), (0.6, 0, 0.8)])
def test_check_tells_of_a_repeated_path_that_turns_by_other_than_whole_turns(turns, told, axis):
    ways = [(0.3 + 2 * np.pi * turns * t) * np.array(axis) for t in (0.0, 1.0)]
    keys = [{"time": t, "rotation": way.tolist()} for t, way in enumerate(ways)]
    ball = {"kind": "sphere", "center": [0, 0, -2], "radius": 0.1, "path": keys, "repeat": True}
    jumps = "obstacle[0] jumps as its path is repeated: the last key is not turned as the first is"
    assert check_scene(load_scene({"cloth": grid(), "obstacle": [ball]}))[1] == told * [jumps]


# Meshes


def shells():
    """A closed mesh of each of these shapes, around the origin and half a metre high in all."""
    return {
        "box": trimesh.creation.box((0.6, 0.4, 0.5)),
        "torus": trimesh.creation.torus(0.4, 0.25, major_sections=10, minor_sections=8),
        "ball": trimesh.creation.icosphere(1, 0.25),
        "needle": trimesh.creation.cone(0.05, 0.5, sections=5).apply_translation([0, 0, -0.25]),
    }


def of_mesh(shape, **more):
    body = shells()[shape]
    return {"name": "it", "vertices": body.vertices.tolist(), "triangles": body.faces.tolist(), **more}


@pytest.mark.parametrize("name", shells())
@pytest.mark.parametrize("gap", [0.003, 0.05])
def test_the_distance_of_cloth_and_a_mesh_is_what_ipctk_measures(name, gap):
    """Cloth lies askew above the mesh, and is lowered by what is left: the way down is never shorter."""
    part = of_mesh(name, position=[0.1, 0.05, 0.0], rotation=[0.3, -0.2, 0.5])
    place = {"rotation": [0.1, 0.2, 0.0], "position": [0, 0, 0.8]}
    left = 0.0
    for _ in range(4):
        place["position"][2] -= left
        mesh = build_mesh(load_scene({"cloth": {**SHEET, **place}, "obstacle": [part]}))
        left = ipctk_distance(mesh, part) - gap
    gap += left
    assert warnings(part, thickness=gap - EXACT, **place) == []
    said = f'cloth[0] starts {gap:.2g} m from obstacle[0] (mesh "it"), nearer than'
    assert [w.startswith(said) for w in warnings(part, thickness=gap + EXACT, **place)] == [True]


EXACT = 1e-12  # fcl and ipctk agree on triangles to rounding


SHEET = {"kind": "grid", "size": [SIZE, SIZE], "resolution": [6, 6]}


def ipctk_distance(mesh, part):
    """Least distance of the cloth from the mesh [m], of all pairs of features."""
    shell = mesh.shells[0]
    body = shell.vertices @ rotation_matrix(part["rotation"]).T + part["position"]
    distances = [
        ipctk.point_triangle_distance(p, *corners)
        for points, other in ((body, mesh.vertices[mesh.triangles]), (mesh.vertices, body[shell.triangles]))
        for corners in other
        for p in points
    ]
    sides = body[ipctk.edges(shell.triangles)]
    distances += [
        ipctk.edge_edge_distance(*edge, *side) for edge in mesh.vertices[mesh.edges] for side in sides
    ]
    return min(distances) ** 0.5


@pytest.mark.parametrize("name", shells())
def test_cloth_that_meets_a_mesh_or_is_wholly_inside_it_is_named(name):
    inside = ['cloth[0] starts inside obstacle[0] (mesh "it")']
    assert warnings(of_mesh(name, position=[0.3, 0.2, HEIGHT])) == inside
    small = {"size": [1e-3, 1e-3], "position": [0.4 if name == "torus" else 0.0, 0, 0]}
    assert warnings(of_mesh(name), **small) == inside


def test_cloth_in_the_hole_of_a_torus_is_outside():
    assert warnings(of_mesh("torus"), size=[0.01, 0.01], position=[0, 0, 0]) == []


OVERLAPS = {
    "plane": ({"kind": "plane"}, 0.0),
    "box": ({"kind": "box", "center": [9, 0, -0.1], "size": [3, 3, 0.2]}, 0.0),
    "sphere": ({"kind": "sphere", "center": [9, 0, -0.4], "radius": 0.4}, 0.0),
    "capsule": ({"kind": "capsule", "start": [8.5, 0, -0.1], "end": [9.5, 0, -0.1], "radius": 0.1}, 0.0),
    "mesh": (of_mesh("box", position=[9.1, 0.05, -0.25]), 0.0),
}


@pytest.mark.parametrize("other", OVERLAPS)
@pytest.mark.parametrize(("by", "overlap"), [(0.01, True), (0.0, False), (-0.01, False)])
def test_a_mesh_overlaps_what_it_reaches_into_and_not_what_it_stands_on(other, by, overlap):
    part, top = OVERLAPS[other]
    upper = of_mesh("box", name="", position=[9.0, 0.0, top + 0.25 - by])
    kind = part.get("kind", "mesh")
    name = f'obstacle[1] ({kind} "it")' if "name" in part else f"obstacle[1] ({kind})"
    assert warnings(upper, part) == [f"obstacle[0] (mesh) and {name} overlap"] * overlap


def test_an_obstacle_inside_a_closed_mesh_overlaps_it():
    ball = {"kind": "sphere", "center": [9, 0, 0], "radius": 0.1}
    assert warnings(of_mesh("box", position=[9, 0, 0]), ball) == [
        'obstacle[0] (mesh "it") and obstacle[1] (sphere) overlap'
    ]


# Cloth across itself


def crossings(*cloth, **settings):
    made = sim.load_scene({"cloth": list(cloth), "settings": settings})
    return [w for w in check_scene(made)[1] if "crosses itself" in w]


def test_cloth_that_starts_across_itself_is_told_with_its_triangles():
    across = grid((0.4, 0.4), (9, 9), rotation=[0, 1.2, 0.3], position=[0.01, 0.02, 0.03])
    (warning,) = crossings(grid((0.4, 0.4), (10, 10)), across, contact="penalty")
    mesh = build_mesh(sim.load_scene({"cloth": [grid((0.4, 0.4), (10, 10)), across]}))
    i, j = map(int, re.search(r"triangles: (\d+) and (\d+)", warning).groups())
    exact = sim.intersections(mesh.vertices, mesh.triangles[[i, j]])
    assert len(exact)


def test_layers_apart_cross_nothing():
    assert not crossings(grid((0.4, 0.4), (10, 10)), grid((0.4, 0.4), (10, 10), position=[0, 0, 1e-3]))
