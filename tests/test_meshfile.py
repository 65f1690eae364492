"""Mesh files: what each format gives back, what is mended, and what is refused."""

import struct
import tracemalloc

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sim.mesh import build_mesh
from sim.meshclaims import MAX_BYTES, SUFFIXES, declared_counts, vertex_count
from sim.meshfile import read_mesh
from sim.scene import SceneError, load_scene

FLOAT32 = 1e-7  # .ply and .stl hold single precision, and .obj eight digits
SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face %d\nproperty list uchar int vertex_indices\nend_header\n"
)

FACET = b"""solid
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
"""


@pytest.fixture(scope="module")
def sheet():
    return build_mesh(load_scene({"cloth": {"kind": "grid", "size": [1.0, 0.7], "resolution": [12, 9]}}))


def write(folder, name, data):
    (folder / name).write_bytes(data)
    return name, str(folder)


def refusal(folder, name, data):
    with pytest.raises(ValueError, match=r"^[^\n]+$") as refused:
        read_mesh(*write(folder, name, data))
    return str(refused.value)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("m.obj", {"file_type": "obj"}),
        ("m.OBJ", {"file_type": "obj"}),
        ("m.ply", {"file_type": "ply"}),
        ("m.ply", {"file_type": "ply", "encoding": "ascii"}),
        ("m.off", {"file_type": "off"}),
    ],
)
def test_vertices_and_triangles_come_back_in_the_order_of_the_file(tmp_path, sheet, name, options):
    exported = trimesh.Trimesh(sheet.vertices, sheet.triangles, process=False).export(**options)
    data = exported if isinstance(exported, bytes) else exported.encode()
    vertices, triangles, warnings = read_mesh(*write(tmp_path, name, data))
    assert np.abs(vertices - sheet.vertices).max() < FLOAT32
    assert np.array_equal(triangles, sheet.triangles)
    assert (vertices.dtype, triangles.dtype) == (np.float64, np.int32)
    assert warnings == []
    assert declared_counts(data, f".{name[-3:].lower()}") == (len(vertices), len(triangles))


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_an_stl_is_welded_into_the_same_triangles(tmp_path, sheet, kind):
    exported = trimesh.Trimesh(sheet.vertices, sheet.triangles, process=False).export(file_type=kind)
    data = exported if isinstance(exported, bytes) else exported.encode()
    vertices, triangles, _ = read_mesh(*write(tmp_path, "m.stl", data))
    assert len(vertices) == len(sheet.vertices)
    assert np.abs(vertices[triangles] - sheet.vertices[sheet.triangles]).max() < FLOAT32
    assert declared_counts(data, ".stl") == (None, len(triangles))


def test_the_obj_reader_agrees_with_trimesh_on_what_a_modelling_program_wrote(tmp_path):
    data = (
        b"""# hi\nmtllib secret.mtl\no cloth\n%s\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0.5 0.5\nvn 0 0 1
g front\nusemtl red\ns off\nf 1/1/1 2/2/1 3/3/1\ng hem\nf 1/4/1 3/3/1 4/4/1\n"""
        % SQUARE
    )
    vertices, triangles, _ = read_mesh(*write(tmp_path, "m.obj", data))
    theirs = trimesh.load_mesh(
        trimesh.util.wrap_as_stream(data),
        file_type="obj",
        process=False,
        maintain_order=True,
        skip_materials=True,
    )
    assert np.array_equal(vertices, theirs.vertices)
    assert np.array_equal(triangles, theirs.faces)


@pytest.mark.parametrize(
    "faces",
    [
        b"f 1 2 3 4\n",
        b"f -4 -3 -2 -1\n",
        b"f 1//9 2//9 3//9 4//9 # four\n",
        b"f 1 2 \\\n 3 4\n",
        b"f 1 2 3 4\r\n",
    ],
)
def test_obj_faces_may_be_written_in_many_ways(tmp_path, faces):
    _, triangles, _ = read_mesh(*write(tmp_path, "m.obj", SQUARE + faces))
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_polygons_become_triangles_in_every_format_that_has_them(tmp_path):
    rows = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    for name, data in (("m.off", b"OFF\n4 1 0\n" + rows), ("m.ply", PLY % (4, 1) + rows)):
        vertices, triangles, warnings = read_mesh(*write(tmp_path, name, data))
        assert warnings == ["cut 1 polygon into triangles"]
        corners = vertices[triangles]
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum()
        assert len(triangles) == 2
        assert area == pytest.approx(1.0)


def test_a_binary_ply_may_mix_polygons_and_be_of_either_order(tmp_path):
    edges = b"element edge 1\nproperty list uchar short vertices\nend_header"
    header = PLY.replace(b"end_header", edges) % (4, 2)
    for order, name in (("<", b"binary_little_endian"), (">", b"binary_big_endian")):
        points = struct.pack(f"{order}12f", 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0)
        faces = struct.pack(f"{order}B4iB3iB2h", 4, 0, 1, 2, 3, 3, 0, 1, 3, 2, 0, 3)
        data = header.replace(b"ascii", name) + points + faces
        vertices, triangles, _ = read_mesh(*write(tmp_path, "m.ply", data))
        assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [3, 1, 0]]  # wound like its neighbours
        more = "m.ply: expected nothing after all that the header claims, got 3 bytes"
        assert refusal(tmp_path, "m.ply", data + b"\x01\x02\x03") == more


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_texts_of_any_system_are_read(tmp_path, suffix, mark, end):
    """A mark at the start once hid the first vertex of an .obj, so that all others were numbered wrongly."""
    rows = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    text = {
        ".obj": SQUARE[:24] + b"f 1 2 3\n",
        ".ply": PLY % (3, 1) + rows,
        ".stl": FACET,
        ".off": b"OFF\n3 1 0\n" + rows,
    }[suffix]
    name, folder = write(tmp_path, f"m{suffix}", mark + text.replace(b"\n", end))
    vertices, triangles, _ = read_mesh(name, folder)
    assert triangles.tolist() == [[0, 1, 2]]
    assert len(vertices) == 3
    assert vertices[0].tolist() == [0, 0, 0]
    assert vertex_count(name, folder) == (None if suffix == ".stl" else 3)


def test_a_few_bytes_never_take_much_memory_or_time(tmp_path):
    """An edge to vertex 999,999,999, of no use here, once took 19 GB and three minutes."""
    edge = b"element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header"
    rows = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n0 999999999\n"
    name, folder = write(tmp_path, "m.ply", PLY.replace(b"end_header", edge) % (3, 1) + rows)
    tracemalloc.start()
    read_mesh(name, folder)
    assert tracemalloc.get_traced_memory()[1] < 10**8  # room for the largest file is made at first
    tracemalloc.stop()


def test_scale_makes_metres_of_file_units(tmp_path):
    data = b"v 0 0 0\nv 1500 0 0\nv 0 1500 0\nf 1 2 3\n"
    file = write(tmp_path, "m.obj", data)
    assert read_mesh(*file)[2] == ["1,500 m across (looks like millimetres: scale = 0.001?)"]
    vertices, _, warnings = read_mesh(*file, scale=1e-3)
    assert vertices.max() == pytest.approx(1.5)
    assert warnings == []


def test_repairs_are_made_and_said(tmp_path):
    extra = b"v 7 7 7\nf 1 2 3\nf 1 4 3\nf 3 1 2\nf 1 2 2\n"
    vertices, triangles, warnings = read_mesh(*write(tmp_path, "m.obj", SQUARE + extra))
    assert triangles.tolist() == [[0, 1, 2], [2, 3, 0]]
    assert len(vertices) == 4
    assert warnings == [
        "left out 1 triangle without area: 3",
        "left out 1 repeated triangle: 2",
        "turned 1 triangle round so that neighbours agree",
        "left out 1 vertex that no triangle uses: 4; pins count the others",
    ]


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("m.obj", b"f 1 2 3\nf 2 3 9\n" + SQUARE, "line 2: expected vertices 1 to 4, got 'f 2 3 9'"),
        ("m.obj", SQUARE + b"f 1 2\n", "line 5: expected three or more vertex numbers, got 'f 1 2'"),
        ("m.obj", SQUARE + b"f 1 2 0\n", "line 5: expected three or more vertex numbers, got 'f 1 2 0'"),
        ("m.obj", SQUARE + b"f 1 2 -9\n", "line 5: expected three or more vertex numbers, got 'f 1 2 -9'"),
        ("m.obj", b"v 0 0\n", "line 1: expected three numbers, got 'v 0 0'"),
        ("m.obj", b"v 0 x 0\n", "line 1: expected three numbers, got 'v 0 x 0'"),
        ("m.obj", b"v 0 1_0 0\n", "line 1: expected three numbers, got 'v 0 1_0 0'"),
        ("m.obj", "v 0 \u0663 0\n".encode(), "line 1: expected three numbers, got 'v 0 \u0663 0'"),
        ("m.obj", SQUARE + b"f 1 2_0 3\n", "line 5: expected three or more vertex numbers, got 'f 1 2_0"),
        ("m.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n0_3 0 1 2\n", "line 6: expected how many corners, and"),
        (
            "m.ply",
            PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1_0 0\n",
            "line 12: expected vertex with x y z, got '0 1_0",
        ),
        ("m.ply", PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 0_2\n", "line 13: expected face with list"),
        ("m.stl", FACET.replace(b"1 0 0", b"1_0 0 0"), "line 5: expected vertex and three numbers, got"),
        *(
            (name, (text + "v 0 0 0\n").encode(coding), "expected plain text, got text in UTF-16: save it as")
            for name, text in (
                ("m.obj", "# a\n"),
                ("m.ply", "ply\n"),
                ("m.stl", "solid\n"),
                ("m.off", "OFF\n"),
            )
            for coding in ("utf-16", "utf-16-le", "utf-16-be")
        ),
        (
            "m.obj",
            b"v 0 nan 0\n" + SQUARE + b"f 1 2 3\n",
            "vertex 0: expected finite numbers, got [0.0, nan, 0.0]",
        ),
        ("m.obj", b"v 0 1e999 0\n" + SQUARE + b"f 1 2 3\n", "vertex 0: expected finite numbers, got"),
        ("m.obj", SQUARE, "expected triangles, got none"),
        ("m.obj", b"", "expected triangles, got none"),
        ("m.obj", SQUARE + b"f 1 1 2\n", "expected triangles, got none with an area"),
        (
            "m.obj",
            b"v 9e4 0 0\n" + SQUARE + b"f 1 2 4\n",
            "vertex 0: expected coordinates within ±10000 m, got 90000 (looks",
        ),
        *(
            (
                "m.obj",
                SQUARE + f"v 0 {far} 0\nf 1 2 3\nf 1 2 5\n".encode(),
                f"vertex 4: expected coordinates within ±10000 m, got {far} (looks",
            )
            for far in ("1e+160", "1e+308")  # of which no square, and no size, is finite
        ),
        (
            "m.obj",
            b"v 0 0 0\nv 1e-5 0 0\nv 0 1e-5 0\nf 1 2 3\n",
            "expected a size of at least 0.0001 m, got 1e-05",
        ),
        ("m.obj", b"v 0 0 0\n" * 200_001, "expected at most 200,000 vertices, got 200,001"),
        ("m.obj", b"f 1 1 1\n" * 400_001, "expected at most 400,000 faces, got 400,001"),
        ("m.obj", SQUARE + b"f" + b" 1 2 3" * 200_000, "expected at most 400,000 triangles, got more"),
        ("m.obj", b"#" * (MAX_BYTES + 1), "expected at most 10 MB, got more"),
        ("m.ply", PLY % (4_000_000_000, 1), "expected at most 200,000 vertices, got 4,000,000,000"),
        ("m.ply", PLY % (3, 4_000_000_000), "expected at most 400,000 faces, got 4,000,000,000"),
        ("m.ply", PLY % (100_000, 1), "its header claims 100,001 elements, more than its 159 bytes can hold"),
        ("m.ply", b"ply\n", "expected ply at its start, and a PLY header that ends with end_header"),
        ("m.ply", PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n", "it ends at face 0 of 1"),
        (
            "m.ply",
            PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0.5 1 2\n",
            "line 13: expected face with list vertex_indices, got '3 0.5 1 2'",
        ),
        (
            "m.ply",
            PLY.replace(b"int vert", b"uchar vert") % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 256 1 2\n",
            "triangle 0: expected vertices 0 to 2, got [256, 1, 2]",
        ),
        ("m.ply", PLY % (3, 1) + b"0 0 0\n1 0 0 x\n", "line 11: expected vertex with x y z, got '1 0 0 x'"),
        (
            "m.ply",
            PLY.replace(b"element f", b"element vertex 3\nelement f"),
            "line 3: expected a line of a PLY",
        ),
        (
            "m.ply",
            PLY.replace(b"ascii", b"binary"),
            "line 2: expected a line of a PLY header, got 'format bi",
        ),
        (
            "m.ply",
            PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 2 1 0\n",
            "line 14: expected nothing after all that the header claims, got '3 2 1 0'",
        ),
        (
            "m.ply",
            PLY.replace(b"float z", b"float z\nproperty float x") % (3, 1),
            "expected one property x of element vertex, got 2",
        ),
        ("m.off", b"OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "expected 3 vertices and 2 faces, but it"),
        ("m.stl", FACET + FACET[6:24], "line 9: expected endsolid at its end, got 'facet normal 0 0 1'"),
        ("m.stl", FACET.replace(b"vertex 1 0 0\n", b""), "line 7: expected three vertices in each facet"),
        ("m.stl", b"\0" * 80 + b"\2\0\0\0" + b"\0" * 50, "expected solid, or 184 bytes for the facets"),
        (
            "m.ply",
            PLY % (3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
            "triangle 0: expected vertices 0 to 2, got",
        ),
        (
            "m.ply",
            PLY % (3, 1) + b"0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n",
            "vertex 1: expected finite numbers, got",
        ),
        ("m.off", b"OFF\n4000000000 1 0\n", "expected at most 200,000 vertices, got 4,000,000,000"),
        ("m.off", b"OFF\n3 99999 0\n", "its header claims 100,002 elements, more than its 14 bytes can hold"),
        (
            "m.off",
            b"OFF\n3 " + b"9" * 5000 + b" 0\n",
            "expected OFF and the numbers of vertices and faces at its",
        ),
        (
            "m.off",
            b"OFF\n" + b"9" * 5000 + b" 1 0\n",
            "expected OFF and the numbers of vertices and faces at",
        ),
        (
            "m.ply",
            PLY.replace(b"%d", b"9" * 900, 1) % 1,
            "line 3: expected a line of a PLY header, got 'element vertex 999",
        ),
        (
            "m.ply",
            PLY.replace(b"ascii", b"binary_little_endian").replace(b"list uchar", b"list int") % (3, 1)
            + b"\0" * 36
            + (-3).to_bytes(4, "little", signed=True),
            "face 0: vertex_indices: expected a list of none or more, got -3",
        ),
        ("m.off", b"hello", "expected OFF and the numbers of vertices and faces at its start"),
        (
            "m.off",
            b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n",
            "triangle 0: expected vertices 0 to 2, got [0, 1, 7]",
        ),
        ("m.stl", b"\0" * 80 + b"\xff\xff\xff\xff", "expected solid, or 214,748,364,834 bytes"),
        (
            "m.stl",
            b"\0" * 80 + (190_000).to_bytes(4, "little") + b"\0" * 50 * 190_000,
            "expected triangles, got none",
        ),
        ("m.stl", b"solid\nendsolid\n", "expected triangles, got none"),
    ],
)
def test_a_file_that_is_no_cloth_is_refused_in_one_line(tmp_path, name, data, words):
    assert refusal(tmp_path, name, data).startswith(f"{name}: {words}")


def test_a_ply_list_that_claims_billions_is_refused(tmp_path):
    header = PLY.replace(b"ascii", b"binary_little_endian").replace(b"list uchar", b"list uint") % (3, 1)
    assert refusal(tmp_path, "m.ply", header + b"\0" * 36 + b"\xff" * 16).startswith(
        "m.ply: it ends at face 0 of 1"
    )


@pytest.mark.parametrize("file", ["../m.obj", "/etc/passwd", "a/../../m.obj", "link.obj", "linked/m.obj"])
def test_no_file_outside_the_scenes_folder_is_read(tmp_path, file):
    inside = tmp_path / "scenes"
    inside.mkdir()
    (tmp_path / "m.obj").write_bytes(SQUARE + b"f 1 2 3\n")
    (inside / "link.obj").symlink_to(tmp_path / "m.obj")
    (inside / "linked").symlink_to(tmp_path)
    with pytest.raises(ValueError, match="expected a file inside the scene's folder, got"):
        read_mesh(file, str(inside))


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("m.glb", "expected one of .obj, .ply, .stl, .off, got 'm.glb'"),
        ("m.zip", "expected one of"),
        ("m", "expected one of"),
        ("nowhere.obj", "nowhere.obj: no such file"),
        ("folder.obj", "folder.obj: no such file"),
        ("a\0b.obj", "expected the name of a file, got"),
        ("x" * 300 + ".obj", "x"),
    ],
)
def test_names_that_are_no_mesh_file_are_refused(tmp_path, file, words):
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ValueError, match=r"^[^\n]+$") as refused:
        read_mesh(file, str(tmp_path))
    assert str(refused.value).startswith(words)


def test_a_scene_names_the_cloth_whose_file_is_wrong(tmp_path):
    cloth = {"kind": "mesh", "file": "nowhere.obj"}
    with pytest.raises(SceneError, match=r"^scene: cloth\[0\].file: nowhere.obj: no such file$"):
        load_scene({"cloth": cloth, "folder": str(tmp_path)})


def test_the_count_that_a_file_claims_is_the_count_that_it_has():
    scene = load_scene("meshcloth")
    claimed = vertex_count(scene.cloth[0].file, scene.folder)
    assert claimed == len(build_mesh(scene).vertices)


STARTS = {".obj": SQUARE + b"f 1 2 3\n", ".ply": PLY % (3, 1), ".stl": b"solid x\n", ".off": b"OFF\n3 1 0\n"}


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(data=st.binary(max_size=300), start=st.booleans())
@settings(max_examples=150, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_bytes_give_a_mesh_or_a_value_error(tmp_path, suffix, data, start):
    name, folder = write(tmp_path, f"m{suffix}", STARTS[suffix] * start + data)
    try:
        vertices, triangles, _ = read_mesh(name, folder)
    except ValueError:
        return
    assert np.isfinite(vertices).all()
    assert triangles.max() < len(vertices)


@given(at=st.integers(0, 400), byte=st.integers(0, 255), cut=st.integers(1, 400))
@settings(max_examples=200, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_spoilt_binary_ply_gives_a_mesh_or_a_value_error(tmp_path, sheet, at, byte, cut):
    good = trimesh.Trimesh(sheet.vertices, sheet.triangles, process=False).export(file_type="ply")
    data = good[:at] + bytes([byte]) + good[at + 1 : len(good) - cut % 3]
    name, folder = write(tmp_path, "m.ply", data)
    try:
        read_mesh(name, folder)
    except ValueError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
