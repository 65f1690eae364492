"""Triangle meshes from files: .obj read here, .ply, .stl and .off read by trimesh.

A file is data from somebody else's program, or from somebody else: it must lie in the scene's own folder, be
of a modest size, and name no other file. Vertices keep the order of the file, so that pins can name them.
The reader of .obj is our own because it can say which line is wrong, keeps vertices whole where texture
coordinates part them, and spares `muslin check` the second that importing trimesh takes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from sim.given import FARTHEST
from sim.meshclaims import MAX_TRIANGLES, count_ply, declared_counts, mesh_bytes, mesh_path
from sim.meshparse import HARMLESS, parse, parse_apart
from sim.repair import repair_triangles, used_vertices
from sim.scene import MAX_VERTICES

SMALLEST = 1e-4
"""Meshes smaller than this [m] are refused."""

HUGE = 100.0
"""Cloth larger than this [m] is possible, but most likely measured in millimetres."""

MILLIMETRES = "looks like millimetres: scale = 0.001?"

Arrays = tuple[np.ndarray, np.ndarray]


def read_mesh(file: str, folder: str, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read and repair a mesh.

    Args:
        file: Path of the file, relative to `folder` and inside it.
        folder: The scene's folder.
        scale: Metres per unit of the file.

    Returns:
        (n, 3) float64 vertices [m], (m, 3) int32 triangles wound alike, and a line for each repair.

    Raises:
        ValueError: one line that says what is wrong with the file.
    """
    path = mesh_path(file, folder)
    data = mesh_bytes(path, file)
    suffix = path.suffix.lower()
    try:
        declared_counts(data, suffix)
        vertices, triangles = _read_obj(data) if suffix == ".obj" else _read_with_trimesh(data, suffix)
        _check_indices(vertices, triangles)
        vertices = vertices * scale
        if suffix == ".stl":
            vertices, triangles = _welded(vertices, triangles)
        triangles, warnings = repair_triangles(vertices, triangles)
        if len(triangles) == 0:
            raise ValueError("expected triangles, got none with an area")
        vertices, triangles, left_out = used_vertices(vertices, triangles)
        return vertices, triangles.astype(np.int32), _size_warnings(vertices) + warnings + left_out
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


# Readers: bytes to (n, 3) float64 vertices in file units and (m, 3) triangles


def _read_obj(data: bytes) -> Arrays:
    """Vertices and faces of a Wavefront .obj; materials, groups, normals and texture coordinates are left."""
    vertices: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, words in _obj_lines(data):
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])
                vertices.append((x, y, z))
            elif words[0] == "f":
                triangles += _fan([_obj_index(word, len(vertices)) for word in words[1:]])
        except (ValueError, OverflowError):
            expected = "three numbers" if words[0] == "v" else "three or more vertex numbers"
            raise ValueError(f"line {number}: expected {expected}, got {' '.join(words)[:60]!r}") from None
        if len(triangles) > MAX_TRIANGLES:
            raise ValueError(f"expected at most {MAX_TRIANGLES:,} triangles, got more")
    return np.array(vertices, dtype=float).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _obj_lines(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """The words of each line that has any, comments left out and continued lines joined."""
    held: list[str] = []
    for number, line in enumerate(io.StringIO(data.decode("utf-8", errors="replace")), 1):
        line = line.partition("#")[0].rstrip("\r\n")
        held += line.removesuffix("\\").split()
        if not line.endswith("\\"):
            if held:
                yield number, held
            held = []


def _obj_index(word: str, count: int) -> int:
    """The vertex that `7`, `7/1/2`, `7//2` or `-1` (the latest) means, from 0."""
    index = int(word.partition("/")[0])
    if index == 0 or index < -count or index > MAX_VERTICES:
        raise ValueError
    return index - 1 if index > 0 else count + index


def _fan(corners: list[int]) -> list[tuple[int, int, int]]:
    if len(corners) < 3:
        raise ValueError
    first = corners[0]
    return [(first, b, c) for b, c in pairwise(corners[1:])]


def _read_with_trimesh(data: bytes, suffix: str) -> Arrays:
    if suffix == ".ply":
        data = _rows_of_ply(data)
    elif suffix == ".off":  # of a megabyte of comments trimesh makes a hundred
        data = re.sub(rb"^[ \t\r]*(?:#[^\n]*)?\n", b"", data, flags=re.M)
    try:
        vertices, triangles = (parse_apart if len(data) > HARMLESS else parse)(data, suffix[1:])
    except Exception as error:  # whatever a reader makes of broken bytes, it is the file that is wrong
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise ValueError(f"cannot be read as {suffix}: {reason}") from None
    if vertices.size == 0 or triangles.size == 0:
        raise ValueError("expected triangles, got none")
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int64)


def _rows_of_ply(data: bytes) -> bytes:
    """The same without what follows the rows that the header of an ascii .ply announces.

    Trimesh makes an array of each line of it, in a gigabyte for a file of nothing else.
    """
    header, end, rows = data.partition(b"end_header")
    if not end:
        raise ValueError("expected a PLY header that ends with end_header")
    if re.search(rb"^format[ \t]+ascii", header, re.M) is None:
        return data
    count = count_ply(data)[2] + 1  # and what is left of the header's last line
    return header + end + b"\n".join(rows.split(b"\n", count)[:count])


# Checks


def _check_indices(vertices: np.ndarray, triangles: np.ndarray) -> None:
    if len(triangles) == 0:
        raise ValueError("expected triangles, got none")
    wrong = ((triangles < 0) | (triangles >= len(vertices))).any(axis=1)
    if wrong.any():
        face = int(np.argmax(wrong))
        raise ValueError(
            f"triangle {face}: expected vertices 0 to {len(vertices) - 1}, got {triangles[face].tolist()}"
        )
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        vertex = int(np.argmin(finite))
        raise ValueError(f"vertex {vertex}: expected finite numbers, got {vertices[vertex].tolist()}")


def _welded(vertices: np.ndarray, triangles: np.ndarray) -> Arrays:
    """One vertex for all corners at exactly the same place, numbered as they first appear.

    An .stl repeats each vertex in every triangle, to the same bits.
    """
    places, first, which = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty(len(places), dtype=np.int64)
    number[order] = np.arange(len(places))
    return places[order], number[which.ravel()][triangles]


def _size_warnings(vertices: np.ndarray) -> list[str]:
    """Refuse sizes that cannot be meant; warn of one that is likely a matter of units."""
    farthest = float(np.abs(vertices).max())
    if farthest > FARTHEST:
        raise ValueError(f"expected coordinates within ±{FARTHEST:g} m, got {farthest:g} ({MILLIMETRES})")
    size = float(np.ptp(vertices, axis=0).max())
    if size < SMALLEST:
        raise ValueError(f"expected a size of at least {SMALLEST:g} m, got {size:g} (scale = 1000?)")
    return [f"{size:,.0f} m across ({MILLIMETRES})"] if size > HUGE else []
