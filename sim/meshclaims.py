"""Which file a scene means by a mesh, and what it claims to hold, before anything is parsed or allocated.

No NumPy here: `muslin scenes` says how many vertices there are and must answer at once.
"""

from __future__ import annotations

import re
from pathlib import Path

from sim.scene import MAX_VERTICES

SUFFIXES = (".obj", ".ply", ".stl", ".off")
"""The kinds of file that are read."""

MAX_BYTES = 10_000_000
"""Larger files are refused before they are read."""

MAX_TRIANGLES = 2 * MAX_VERTICES
"""About as many as a mesh of the most vertices has; more are refused before anything is allocated."""


def vertex_count(file: str, folder: str) -> int | None:
    """How many vertices a file says it has, without reading the mesh; None where only reading it can tell."""
    path = mesh_path(file, folder)
    try:
        return declared_counts(mesh_bytes(path, file), path.suffix.lower())[0]
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def declared_counts(data: bytes, suffix: str) -> tuple[int | None, int]:
    """The (vertices, faces) that a file claims to have, None for those of an .stl, which repeats them.

    Raises:
        ValueError: the claim is larger than Muslin, or than the file itself, can hold.
    """
    vertices, faces, everything = _COUNTERS[suffix](data)
    if (vertices or 0) > MAX_VERTICES:
        raise ValueError(f"expected at most {MAX_VERTICES:,} vertices, got {vertices:,}")
    if faces > MAX_TRIANGLES:
        raise ValueError(f"expected at most {MAX_TRIANGLES:,} faces, got {faces:,}")
    if everything > len(data):  # each element takes at least a byte
        raise ValueError(
            f"its header claims {everything:,} elements, more than its {len(data):,} bytes can hold"
        )
    return vertices, faces


def mesh_path(file: str, folder: str) -> Path:
    """The resolved path of `file`, which must be a regular file that really lies inside `folder`."""
    root = Path(folder).resolve()
    try:
        path = (root / file).resolve()
    except (OSError, ValueError, RuntimeError):  # embedded zeros, endless links
        raise ValueError(f"expected the name of a file, got {file!r}") from None
    if not path.is_relative_to(root):
        raise ValueError(f"expected a file inside the scene's folder, got {file!r}")
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"expected one of {', '.join(SUFFIXES)}, got {file!r}")
    return path


def mesh_bytes(path: Path, file: str) -> bytes:
    """The content of a file, which a ValueError calls `file` where it is not there or too large."""
    try:
        if not path.is_file():
            raise ValueError(f"{file}: no such file")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read: {error.strerror}") from None
    if len(data) > MAX_BYTES:
        raise ValueError(f"{file}: expected at most {MAX_BYTES // 10**6} MB, got more")
    return data


# What a file claims: (vertices, faces, all elements that a header announces)


def _count_obj(data: bytes) -> tuple[int, int, int]:
    return len(re.findall(rb"^[ \t]*v[ \t]", data, re.M)), len(re.findall(rb"^[ \t]*f[ \t]", data, re.M)), 0


def count_ply(data: bytes) -> tuple[int, int, int]:
    """The vertices, faces and all elements that a .ply claims to have."""
    header = data[: max(data.find(b"end_header"), 0)]
    found = re.findall(rb"^element[ \t]+(\S+)[ \t]+([0-9]+)", header, re.M)
    counts = {name: int(number) for name, number in found}
    return counts.get(b"vertex", 0), counts.get(b"face", 0), sum(counts.values())


def _count_stl(data: bytes) -> tuple[None, int, int]:
    claimed = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if len(data) == 84 + 50 * claimed:
        return None, claimed, 0
    return None, len(re.findall(rb"^[ \t]*endfacet", data, re.M | re.I)), 0


def _count_off(data: bytes) -> tuple[int, int, int]:
    found = re.match(rb"\s*C?OFF\s+(?:#[^\n]*\n\s*)*+([0-9]+)[ \t]+([0-9]+)", data)
    if not found:
        raise ValueError("expected OFF and the numbers of vertices and faces at its start")
    vertices, faces = int(found[1]), int(found[2])
    return vertices, faces, vertices + faces


_COUNTERS = {".obj": _count_obj, ".ply": count_ply, ".stl": _count_stl, ".off": _count_off}
