"""From cloth to stencils, on meshes of every sort."""

import numpy as np
import pytest

from sim.mesh import RIBBON_WIDTH, build_mesh, vertex_masses
from sim.scene import SceneError, load_scene
from tests.worlds import chain, grid, irregular, scene


def mesh_of(*cloth):
    return build_mesh(load_scene({"cloth": list(cloth)}))


def normals(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("kind", ["grid", "equilateral"])
@pytest.mark.parametrize("resolution", [(2, 2), (5, 4), (7, 8)])
def test_a_rectangle_is_a_disc_wound_alike_that_covers_its_area(kind, resolution):
    mesh = mesh_of({"kind": kind, "size": [2.0, 1.0], "resolution": list(resolution)})
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.triangles) == 1  # Euler characteristic of a disc
    assert (normals(mesh)[:, 2] > 0).all()
    assert normals(mesh)[:, 2].sum() / 2 == pytest.approx(2.0, rel=1e-12)
    boundary = 2 * len(mesh.edges) - 3 * len(mesh.triangles)
    assert len(mesh.hinges) == len(mesh.edges) - boundary


def test_equilateral_triangles_are_equilateral_inside():
    a = 0.1
    mesh = mesh_of({"kind": "equilateral", "size": [1.0, 10 * a * 3**0.5 / 2], "resolution": [11, 11]})
    x = mesh.vertices[mesh.triangles]
    lengths = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)
    inner = np.abs(x[:, :, 0]).max(axis=1) < 0.5 - 1e-9  # the half triangles that make the sides straight
    np.testing.assert_allclose(lengths[inner], a, rtol=1e-12)


def test_every_hinge_is_an_inner_edge_with_its_two_triangles_in_order():
    mesh = mesh_of(irregular())
    triangles = {tuple(np.roll(t, k)) for t in mesh.triangles.tolist() for k in range(3)}
    for x1, x2, x3, x4 in mesh.hinges.tolist():
        assert (x1, x2, x3) in triangles
        assert (x2, x1, x4) in triangles


def test_edges_are_each_listed_once_and_cover_triangles_and_explicit_edges():
    patch = {
        "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]],
        "triangles": [[0, 1, 2]],
        "edges": [[1, 0], [3, 1]],
    }
    mesh = mesh_of(patch)
    assert sorted(map(tuple, mesh.edges.tolist())) == [(0, 1), (0, 2), (1, 2), (1, 3)]


def test_names_pin_the_sides_and_corners_they_say():
    nx, ny = 4, 3
    for pins, expected in {
        ("left",): [0, 4, 8],
        ("right",): [3, 7, 11],
        ("bottom",): [0, 1, 2, 3],
        ("top",): [8, 9, 10, 11],
        ("corner00", "corner10", "corner01", "corner11"): [0, 3, 8, 11],
        (5, 2, 5): [2, 5],
    }.items():
        mesh = mesh_of(grid(resolution=(nx, ny), pins=list(pins)))
        assert mesh.pinned.tolist() == expected


def test_several_pieces_are_numbered_one_after_another():
    mesh = mesh_of(grid(resolution=(3, 3)), chain([[0, 0, 0], [0, 0, 1]], [1, 2], pins=[0]))
    assert mesh.pieces.tolist() == [0] * 9 + [1, 1]
    assert mesh.pinned.tolist() == [9]
    assert [9, 10] in mesh.edges.tolist()


def test_area_mass_is_density_times_area_with_the_centre_where_the_area_is():
    mesh = mesh_of(irregular())
    masses = vertex_masses(mesh, "area", 0.2)
    a, b, c = (mesh.rest_vertices[mesh.triangles[:, k]] for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert masses.sum() == pytest.approx(0.2 * areas.sum(), rel=1e-12)
    np.testing.assert_allclose(masses @ mesh.rest_vertices, 0.2 * areas @ ((a + b + c) / 3), atol=1e-12)


def test_constant_mass_has_the_same_total():
    mesh = mesh_of(irregular())
    masses = vertex_masses(mesh, "constant", 0.2)
    assert masses.sum() == pytest.approx(vertex_masses(mesh, "area", 0.2).sum(), rel=1e-12)
    assert np.ptp(masses) == 0.0


def test_no_vertex_is_without_mass():
    lonely = {
        "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [3, 0, 0]],
        "triangles": [[0, 1, 2]],
        "edges": [[1, 4]],
    }
    masses = vertex_masses(mesh_of(lonely), "area", 0.2)
    assert (masses > 0).all()
    assert masses[4] == pytest.approx(0.2 * RIBBON_WIDTH * 2.0 / 2, rel=1e-12)


def test_given_masses_and_piece_densities_rule():
    mesh = mesh_of(grid(resolution=(3, 3), density=0.5), chain([[0, 0, 0], [0, 0, 1]], [1, 2]))
    masses = vertex_masses(mesh, "area", 0.2)
    assert masses[:9].sum() == pytest.approx(0.5, rel=1e-12)
    assert masses[9:].tolist() == [1.0, 2.0]


def test_edges_of_three_triangles_do_not_bend_and_are_reported():
    book = {
        "vertices": [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0], [0.5, 0, 1]],
        "triangles": [[0, 1, 2], [1, 0, 3], [0, 1, 4]],
    }
    mesh = mesh_of(book)
    assert len(mesh.hinges) == 0
    assert any("three or more" in w for w in mesh.warnings)


@pytest.mark.parametrize(
    ("cloth", "words"),
    [
        ({"vertices": [[0, 0]]}, "cloth[0].vertices[0]: expected 3 finite numbers, got [0, 0]"),
        (
            {"vertices": [[0, 0, float("inf")]]},
            "cloth[0].vertices[0]: expected 3 finite numbers, got [0, 0, inf]",
        ),
        (
            {"vertices": [[0, 0, 0]] * 3, "triangles": [[0, 1, 3]]},
            "cloth[0].triangles[0]: expected vertex indices from 0 to 2",
        ),
        (
            {"vertices": [[0, 0, 0]] * 3, "triangles": [[0, 1, 1]]},
            "cloth[0].triangles[0]: expected distinct vertices",
        ),
        ({"vertices": [[0, 0, 0]] * 3, "edges": [[0, -1]]}, "cloth[0].edges[0]: expected vertex indices"),
        (
            {"vertices": [[0, 0, 0]], "masses": [0.0]},
            "cloth[0].masses[0]: expected ≥ 1e-18 and ≤ 1e+18 kg, got 0",
        ),
        ({"vertices": [[0, 0, 0]], "masses": [1.0, 2.0]}, "cloth[0].masses: expected 1 masses, got 2"),
        ({"vertices": []}, "cloth[0].vertices"),
        ({"vertices": [[0, 0, 0], [0, 0]]}, "cloth[0].vertices[1]: expected 3 finite numbers, got [0, 0]"),
        ({"vertices": [[0, 0, 2e4]]}, "within ±1e4 m"),
        (grid(pins=[64]), "cloth[0].pins[0]: expected a vertex index from 0 to 63, got 64"),
        (grid(pins=["middle"]), "cloth[0].pins[0]: expected one of corner00"),
        (chain([[0, 0, 0]], [1], pins=["left"]), "cloth[0].pins[0]"),
    ],
)
def test_bad_arrays_are_refused_with_row_and_reason(cloth, words):
    with pytest.raises(SceneError) as error:
        build_mesh(load_scene(scene(cloth)))
    assert words in str(error.value)
    assert "\n" not in str(error.value)
