"""Obstacles that are meshes: what is read, what is mended, what is refused, and what is inside."""

import numpy as np
import pytest
import trimesh

import sim
from sim.check import check_scene
from sim.mesh import build_mesh
from sim.scene import MAX_VERTICES, SceneError
from sim.shells import Shell
from tests.worlds import grid, scene

TETRAHEDRON = {
    "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
}
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def built(*obstacles, folder="."):
    return build_mesh(sim.load_scene({**scene(grid(), *obstacles), "folder": str(folder)}))


def refusal(*obstacles, folder="."):
    with pytest.raises(SceneError, match=r"^[^\n]+$") as refused:
        built(*obstacles, folder=folder)
    return str(refused.value)


@pytest.mark.parametrize("form", ["obj", "ply", "stl", "off"])
def test_a_shell_is_the_mesh_of_its_file_times_the_scale(tmp_path, form):
    body = trimesh.creation.torus(1.0, 0.25, major_sections=12, minor_sections=8)
    body.export(tmp_path / f"body.{form}")
    shell = built({"kind": "mesh", "file": f"body.{form}", "scale": 0.1}, folder=tmp_path).shells[0]
    expected = 0.1 * np.asarray(body.triangles)
    assert shell.triangles.dtype == np.int32
    np.testing.assert_allclose(shell.vertices[shell.triangles], expected, atol=1e-7)  # single precision


def test_arrays_and_a_file_give_the_same_shell(tmp_path):
    (tmp_path / "body.obj").write_bytes(OBJ)
    mesh = built(TETRAHEDRON, {"kind": "plane"}, {"kind": "mesh", "file": "body.obj"}, folder=tmp_path)
    assert mesh.shells[1] is None
    np.testing.assert_array_equal(mesh.shells[0].vertices, mesh.shells[2].vertices)
    np.testing.assert_array_equal(mesh.shells[0].triangles, mesh.shells[2].triangles)
    assert mesh.warnings == ()


def test_repairs_of_a_shell_are_said_and_an_open_one_has_no_inside():
    faces = [*TETRAHEDRON["triangles"][:3], [0, 0, 1], [1, 2, 3]]
    loose = {"vertices": [*TETRAHEDRON["vertices"], [5, 5, 5]], "triangles": faces[:3] + faces[4:]}
    _, lines = check_scene(sim.load_scene(scene(grid(position=[0, 0, 3]), loose)))
    assert lines == [
        "obstacle[0]: left out 1 repeated triangle: 3",
        "obstacle[0]: left out 1 vertex that no triangle uses: 4",
        "obstacle[0]: 3 open edges; the mesh has no inside",
    ]


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({**TETRAHEDRON, "triangles": [[0, 1, 4]]}, "triangles[0]: expected vertex indices from 0 to 3, got"),
        ({**TETRAHEDRON, "triangles": [[0, 1, 1]]}, "triangles[0]: expected distinct vertices, got"),
        ({**TETRAHEDRON, "triangles": []}, "triangles: expected triangles, got none with an area"),
        ({"vertices": [[0, 0, 0]] * 3, "triangles": [[0, 1, 2]]}, "triangles: expected triangles, got none"),
        ({"vertices": [], "triangles": []}, "vertices: expected at least one vertex, got none"),
        ({**TETRAHEDRON, "vertices": [[0, 0]]}, "vertices[0]: expected 3 finite numbers, got [0, 0]"),
        ({**TETRAHEDRON, "vertices": "much"}, "vertices: expected rows of 3 finite numbers, got 'much'"),
        (
            {**TETRAHEDRON, "vertices": [[0, 0, np.nan]]},
            "vertices[0]: expected 3 finite numbers, got [0, 0, nan]",
        ),
        (
            {**TETRAHEDRON, "vertices": [[0, 0, 2e4]]},
            "vertices[0]: expected coordinates within ±1e4 m, got 2",
        ),
        ({"kind": "mesh", "file": "nowhere.obj"}, "file: nowhere.obj: no such file"),
        (
            {"kind": "mesh", "file": "body.glb"},
            "file: expected one of .obj, .ply, .stl, .off, got 'body.glb'",
        ),
        ({"kind": "mesh", "file": "../body.obj"}, "file: expected a file inside the scene's folder, got"),
        ({"kind": "mesh", "file": "bad.obj"}, "file: bad.obj: line 1: expected three numbers, got 'v 0 0'"),
        ({"kind": "mesh", "file": "body.obj", "scale": 1e-6}, "file: body.obj: expected a size of at least"),
        (
            {"kind": "mesh", "file": "body.obj", "scale": 1e5},
            "file: body.obj: vertex 2: expected coordinates",
        ),
    ],
)
def test_a_mesh_that_is_no_obstacle_is_refused_in_one_line(tmp_path, part, words):
    (tmp_path / "body.obj").write_bytes(OBJ)
    (tmp_path / "bad.obj").write_bytes(b"v 0 0\n")
    assert refusal(part, folder=tmp_path).startswith(f"scene: obstacle[0].{words}")


def test_too_many_vertices_in_all_meshes_together_are_refused():
    n = MAX_VERTICES // 2
    strip = np.zeros((n + 2, 3))
    strip[:, 0] = np.arange(n + 2) // 2 * 1e-2
    strip[1::2, 1] = 1e-2
    part = {"vertices": strip, "triangles": np.arange(n)[:, None] + [0, 1, 2]}
    assert refusal(part, part) == (
        f"scene: obstacle: expected meshes of at most 200,000 vertices, got {2 * n + 4:,}"
    )


def test_a_closed_shell_encloses_what_rays_say_it_does():
    """Against the parity of crossings, on a torus, whose hole is outside."""
    body = trimesh.creation.torus(1.0, 0.4, major_sections=20, minor_sections=12)
    shell = Shell(np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32))
    assert shell.open_edges == 0
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 3)) * [1, 1, 0.3]
    ray = np.array([0.3, 0.5, 0.8])  # through no edge, almost surely
    corners = shell.vertices[shell.triangles]
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    inside = []
    for p in points:  # Möller and Trumbore 1997
        h, r = np.cross(ray, v), p - a
        d = np.einsum("ij,ij->i", u, h)
        s, q = np.einsum("ij,ij->i", r, h) / d, np.cross(r, u)
        t, far = q @ ray / d, np.einsum("ij,ij->i", v, q) / d
        inside.append(np.count_nonzero((s > 0) & (t > 0) & (s + t < 1) & (far > 0)) % 2 == 1)
    assert 50 < sum(inside) < 350
    assert [shell.encloses(p) for p in points] == inside
