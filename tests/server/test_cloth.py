"""What cloth consists of in the 3-D view: sheets, and strands where there are no triangles."""

from types import SimpleNamespace

import numpy as np
import pytest
from fake_world import SCENE

from server.cloth import Sheets, Strands, bare_edges, bare_vertices, draw_cloth
from server.palette import INK, VARIANTS
from sim import load_scene
from sim.mesh import build_mesh

CHAIN = {"vertices": [[0.1 * i, 0.0, 1.0] for i in range(10)], "edges": [[i, i + 1] for i in range(9)]}

KITE = {
    "vertices": [[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 0.5], [0, 0, 0], [2, 2, 2]],
    "triangles": [[0, 1, 2]],
    "edges": [[1, 0], [4, 3], [0, 3]],
}
"""A triangle with a string of two edges at its first corner, an edge given twice, and a loose vertex."""


class FakeScene:
    """Remembers what was added to it, by the last part of its name."""

    def __init__(self):
        self.nodes = {}

    def __getattr__(self, method):
        def add(name, *args, **props):
            self.nodes[name.rpartition("/")[2]] = node = SimpleNamespace(method=method, args=args, **props)
            return node

        return add


def mesh_of(cloth, **options):
    return build_mesh(load_scene({**SCENE, "cloth": {**cloth, **options}}))


def draw(mesh, scale=1.0):
    scene = FakeScene()
    return scene.nodes, draw_cloth(scene, "/variant0", mesh, VARIANTS[0], scale)


def test_sides_of_triangles_are_no_bare_edges():
    mesh = mesh_of(KITE)
    assert sorted(map(tuple, np.sort(bare_edges(mesh)))) == [(0, 3), (3, 4)]
    assert bare_vertices(mesh).tolist() == [0, 3, 4, 5]


def test_nothing_is_added_for_cloth_of_triangles_alone():
    nodes, parts = draw(mesh_of(SCENE["cloth"]))
    assert set(nodes) == {"cloth", "reverse", "lines"}
    assert [type(part) for part in parts] == [Sheets]


def test_pieces_are_told_apart_and_each_moves_with_its_own_vertices():
    mesh = build_mesh(load_scene("stack"))
    nodes, parts = draw(mesh)
    assert {"cloth", "cloth1", "cloth2"} <= set(nodes)
    tones = [sum(nodes[name].color) for name in ("cloth", "cloth1", "cloth2")]
    assert nodes["cloth"].color == VARIANTS[0]
    assert tones[0] > tones[1] + 30 > tones[2] + 60
    moved = mesh.vertices + np.arange(len(mesh.vertices))[:, None]
    for part in parts:
        part.move(moved)
    corners = [nodes[name].vertices[nodes[name].faces] for name in ("cloth", "cloth1", "cloth2")]
    assert np.array_equal(np.concatenate(corners), moved[mesh.triangles])


def test_chain_is_lines_and_balls_and_no_empty_mesh():
    nodes, parts = draw(mesh_of(CHAIN))
    assert set(nodes) == {"strands", "balls"}
    assert nodes["strands"].args[0].shape == (9, 2, 3)
    assert nodes["strands"].args[1] == VARIANTS[0]
    assert len(nodes["balls"].batched_positions) == 10
    assert [type(part) for part in parts] == [Strands]


def test_lone_vertices_are_balls():
    nodes, _ = draw(mesh_of({"vertices": [[0, 0, 0], [1, 0, 0]]}))
    assert set(nodes) == {"balls"}
    assert len(nodes["balls"].batched_positions) == 2


def test_kite_has_a_sheet_and_strands():
    nodes, _ = draw(mesh_of(KITE, pins=[1, 4]))
    assert set(nodes) == {"cloth", "reverse", "lines", "pins", "strands", "balls"}
    assert nodes["pins"].args[0].tolist() == [[1, 0, 1]], "a ball shows a pin by itself"


def test_pinned_balls_are_dark():
    nodes, _ = draw(mesh_of(CHAIN, pins=[0]))
    colors = nodes["balls"].batched_colors
    assert tuple(colors[0]) == INK
    assert {tuple(color) for color in colors[1:]} == {VARIANTS[0]}


def test_strands_and_sheets_move_with_a_frame():
    mesh = mesh_of(KITE)
    nodes, parts = draw(mesh)
    moved = (mesh.vertices + np.array([1.0, 2.0, 3.0])).astype(np.float32)
    for part in parts:
        part.move(moved)
    assert nodes["strands"].points == pytest.approx(moved[bare_edges(mesh)])
    assert nodes["balls"].batched_positions == pytest.approx(moved[[0, 3, 4, 5]])
    assert nodes["cloth"].vertices is nodes["reverse"].vertices
    assert np.shares_memory(nodes["cloth"].vertices, moved)
    assert np.array_equal(nodes["cloth"].vertices, moved)


def radius(nodes):
    return np.linalg.norm(nodes["balls"].args[0], axis=1).max()


def test_sizes_follow_the_scene_and_balls_of_a_chain_stay_apart():
    spring = mesh_of({"vertices": [[0, 0, 0], [1, 0, 0]], "edges": [[0, 1]]})
    small, large = (draw(spring, scale)[0] for scale in (1.0, 4.0))
    assert radius(large) == pytest.approx(4 * radius(small))
    assert large["strands"].thickness == pytest.approx(4 * small["strands"].thickness)
    chain, _ = draw(mesh_of(CHAIN), 4.0)
    assert 2 * radius(chain) < 0.1
    assert 2 * radius(chain) >= chain["strands"].thickness, "or the balls could not be seen"


def test_edge_of_no_length_can_be_drawn():
    nodes, _ = draw(mesh_of({"vertices": [[0, 0, 0], [0, 0, 0]], "edges": [[0, 1]]}))
    assert 0 < radius(nodes) < 1
