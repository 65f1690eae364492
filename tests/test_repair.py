"""Repair of triangles, against meshes that were spoilt in a known way."""

import numpy as np
import pytest

from sim.mesh import build_mesh
from sim.repair import repair_triangles, used_vertices, wound_alike
from sim.scene import load_scene


@pytest.fixture
def sheet():
    return build_mesh(load_scene({"cloth": {"kind": "grid", "resolution": [9, 7]}}))


def moebius(count):
    """A strip of triangles closed with half a turn."""
    quads = [(2 * j, 2 * j + 1, 2 * j + 2, 2 * j + 3) for j in range(count - 1)]
    quads.append((2 * count - 2, 2 * count - 1, 1, 0))
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (b, d, c))])
    along = np.arange(count) / count * 2 * np.pi
    vertices = np.zeros((2 * count, 3))
    for side, first in ((-0.3, 0), (0.3, 1)):
        radius = 1 + side * np.cos(along / 2)
        vertices[first::2] = np.stack(
            [radius * np.cos(along), radius * np.sin(along), side * np.sin(along / 2)], axis=1
        )
    return vertices, triangles


def test_a_good_mesh_is_left_alone(sheet):
    triangles, warnings = repair_triangles(sheet.vertices, sheet.triangles)
    assert triangles is sheet.triangles
    assert warnings == []


def test_triangles_without_area_are_left_out(sheet):
    line = sheet.triangles[0][[0, 1, 1]]  # a corner twice
    row = [[0, 1, 2]]  # three vertices in a row
    triangles, warnings = repair_triangles(sheet.vertices, np.concatenate([sheet.triangles, [line], row]))
    m = len(sheet.triangles)
    assert np.array_equal(triangles, sheet.triangles)
    assert warnings == [f"left out 2 triangles without area: {m}, {m + 1}"]


def test_no_more_than_a_few_are_listed_and_by_their_own_numbers(sheet):
    """Those that repeat another are counted as they came, before those without area were left out."""
    flat = [[0, 0, k] for k in range(1, 10)]
    triangles = np.concatenate([flat, sheet.triangles, sheet.triangles[:1]])
    _, warnings = repair_triangles(sheet.vertices, triangles)
    assert warnings == [
        "left out 9 triangles without area: 0, 1, 2, 3, 4, …",
        f"left out 1 repeated triangle: {9 + len(sheet.triangles)}",
    ]


def test_a_far_vertex_that_no_triangle_uses_makes_no_triangle_look_small(sheet):
    vertices = np.concatenate([1e-3 * sheet.vertices, [[1e4, 0.0, 0.0]]])
    assert repair_triangles(vertices, sheet.triangles)[1] == []


def test_triangles_that_repeat_another_are_left_out_however_they_are_written(sheet):
    again = np.concatenate([sheet.triangles, sheet.triangles[3:4, ::-1], sheet.triangles[5:6, [1, 2, 0]]])
    triangles, warnings = repair_triangles(sheet.vertices, again)
    m = len(sheet.triangles)
    assert np.array_equal(triangles, sheet.triangles)
    assert warnings == [f"left out 2 repeated triangles: {m}, {m + 1}"]


@pytest.mark.parametrize("share", [0.02, 0.4])
def test_winding_follows_the_majority_in_any_order_of_triangles(sheet, share):
    rng = np.random.default_rng(3)
    order = rng.permutation(len(sheet.triangles))
    spoilt = sheet.triangles[order].copy()
    flip = rng.random(len(spoilt)) < share
    spoilt[flip] = spoilt[flip, ::-1]
    triangles, warnings = repair_triangles(sheet.vertices, spoilt)
    corners = sheet.vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all()
    assert len(warnings) == 1
    assert warnings[0].startswith(f"turned {flip.sum()} triangle")


def test_each_connected_part_keeps_its_own_side(sheet):
    n = len(sheet.vertices)
    below = sheet.triangles[:, ::-1] + n
    both = np.concatenate([sheet.triangles, below])
    vertices = np.concatenate([sheet.vertices, sheet.vertices - [0.0, 0.0, 1.0]])
    assert np.array_equal(repair_triangles(vertices, both)[0], both)


def test_a_one_sided_strip_is_said_to_be_one():
    vertices, triangles = moebius(20)
    same, warnings = repair_triangles(vertices, triangles)
    assert np.array_equal(same, triangles)
    assert warnings == ["1 one-sided part cannot be wound alike; its seam does not bend"]


def test_three_triangles_on_one_edge_are_left_alone():
    triangles = np.array([[0, 1, 2], [0, 1, 4], [1, 0, 3]])
    assert wound_alike(triangles)[1] == []


def test_no_triangles_need_no_repair():
    triangles, warnings = repair_triangles(np.zeros((3, 3)), np.zeros((0, 3), dtype=int))
    assert len(triangles) == 0
    assert warnings == []


def test_unused_vertices_are_dropped_and_the_others_keep_their_order(sheet):
    vertices = np.insert(sheet.vertices, 5, [9.0, 9.0, 9.0], axis=0)
    triangles = np.where(sheet.triangles >= 5, sheet.triangles + 1, sheet.triangles)
    kept, renumbered, warnings = used_vertices(vertices, triangles)
    assert np.array_equal(kept, sheet.vertices)
    assert np.array_equal(renumbered, sheet.triangles)
    assert warnings == ["left out 1 vertex that no triangle uses: 5; pins count the others"]


def test_a_long_strip_in_mixed_winding_is_settled_in_few_passes(benchmark):
    """Label propagation one neighbour at a time would take a pass per triangle: minutes for this strip."""
    i = np.arange(50_000)
    vertices = np.stack([i // 2, i % 2, 0 * i], axis=1).astype(float)
    strip = np.stack([i[:-2], i[1:-1], i[2:]], axis=1)  # every second one is wound the other way
    triangles, warnings = benchmark(repair_triangles, vertices, strip)
    assert warnings == ["turned 24,999 triangles round so that neighbours agree"]
    assert len(triangles) == len(strip)
