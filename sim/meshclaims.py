"""Which file a scene means by a mesh, and what it claims to hold, before anything is parsed or allocated.

No NumPy here: `muslin scenes` says how many vertices there are and must answer at once.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from sim.scene import MAX_VERTICES

SUFFIXES = (".obj", ".ply", ".stl", ".off")
"""The kinds of file that are read."""

MAX_BYTES = 10_000_000
"""Larger files are refused before they are read."""

MAX_TRIANGLES = 2 * MAX_VERTICES
"""About as many as a mesh of the most vertices has; more are refused before anything is allocated."""

MAX_ROWS = 2 * (MAX_VERTICES + MAX_TRIANGLES)
"""Vertices, faces and whatever else a file has: edges, say."""

DIGITS = 20
"""Of a number that a header claims; what has more is none."""

HEADER_LINES, HEADER_LINE = 1000, 1000
"""Lines of a .ply before its rows, and bytes of one, beyond which it is none."""

LINE_END = re.compile(rb"\r\n|\n|\r")
"""Of Unix, Windows and old Macs."""

MARK = b"\xef\xbb\xbf"
"""What some programs begin a text with; of its first word it is no part."""

UTF16 = re.compile(rb"\xff\xfe|\xfe\xff|(?:[\t\n\r -~]\0){4}|(?:\0[\t\n\r -~]){4}")
"""How text in UTF-16 begins, with its mark or without."""


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
    if UTF16.match(data) and not binary_stl_faces(data):
        raise ValueError("expected plain text, got text in UTF-16: save it as UTF-8")
    vertices, faces, everything = _COUNTERS[suffix](data)
    if (vertices or 0) > MAX_VERTICES:
        raise ValueError(f"expected at most {MAX_VERTICES:,} vertices, got {vertices:,}")
    if faces > MAX_TRIANGLES:
        raise ValueError(f"expected at most {MAX_TRIANGLES:,} faces, got {faces:,}")
    if everything > MAX_ROWS:
        raise ValueError(f"expected at most {MAX_ROWS:,} elements, got {everything:,}")
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
    return data if binary_stl_faces(data) else data.removeprefix(MARK)


# What a file claims: (vertices, faces, all elements that a header announces)


def _count_obj(data: bytes) -> tuple[int, int, int]:
    vertices, faces = (len(re.findall(rb"(?:^|\r)[ \t]*%b[ \t]" % word, data, re.M)) for word in (b"v", b"f"))
    return vertices, faces, 0


PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
}
"""Names of numbers in a .ply, and what module struct calls them."""

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")


class Property(NamedTuple):
    """A number of each row of an element, or a list of as many as a `length` before them says.

    Attributes:
        name: In the file.
        type: Of the numbers, as module struct has it.
        length: Type of the length, empty for a number that is no list.
    """

    name: str
    type: str
    length: str = ""

    @property
    def fractional(self) -> bool:
        """Whether its numbers need not be whole."""
        return self.type in "fd"


class Element(NamedTuple):
    """What a .ply has a number of rows of."""

    name: str
    claimed: int
    properties: list[Property]

    @property
    def rows(self) -> int:
        """How many take up room."""
        return self.claimed if self.properties else 0


def ply_header(data: bytes) -> tuple[str, list[Element], int]:
    """How the rows of a .ply are written, what they are, and the byte where they begin.

    Raises:
        ValueError: with the line that is wrong.
    """
    encoding, elements, at = "", [], 0
    for number in range(1, HEADER_LINES):
        begin, at = at, _line_end(data, at)
        words = data[begin : min(at, begin + HEADER_LINE)].decode("ascii", "replace").split()
        try:
            match words:
                case ["ply"] if number == 1:
                    pass
                case _ if number == 1 or at == begin:
                    break
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, _] if name in ENCODINGS:
                    encoding = name
                case ["element", name, count] if name not in {e.name for e in elements}:
                    elements.append(Element(name, _claimed(count), []))
                case ["property", "list", length, kind, name] if PLY_TYPES[length] not in "fd":
                    elements[-1].properties.append(Property(name, PLY_TYPES[kind], PLY_TYPES[length]))
                case ["property", kind, name]:
                    elements[-1].properties.append(Property(name, PLY_TYPES[kind]))
                case ["end_header"] if encoding:
                    return encoding, elements, at
                case _:
                    raise KeyError
        except (LookupError, ValueError):
            shown = " ".join(words)[:60]
            raise ValueError(f"line {number}: expected a line of a PLY header, got {shown!r}") from None
    raise ValueError("expected ply at its start, and a PLY header that ends with end_header")


def _claimed(count: str) -> int:
    if not count.isdecimal() or len(count) > DIGITS:
        raise ValueError
    return int(count)


def _line_end(data: bytes, at: int) -> int:
    """The byte after the line that begins at a byte, however it ends."""
    found = LINE_END.search(data, at)
    return found.end() if found else len(data)


def _count_ply(data: bytes) -> tuple[int, int, int]:
    counts = {element.name: element.claimed for element in ply_header(data)[1]}
    return counts.get("vertex", 0), counts.get("face", 0), sum(counts.values())


def binary_stl_faces(data: bytes) -> int | None:
    """How many faces a binary .stl has; None for a file that is none."""
    claimed = int.from_bytes(data[80:84], "little")
    return claimed if len(data) == 84 + 50 * claimed else None


def _count_stl(data: bytes) -> tuple[None, int, int]:
    claimed = binary_stl_faces(data)
    if claimed is None:
        claimed = len(re.findall(rb"^[ \t]*endfacet", data, re.M | re.I))
    return None, claimed, 0


def _count_off(data: bytes) -> tuple[int, int, int]:
    number = rb"([0-9]{1,%d})" % DIGITS
    found = re.match(rb"\s*C?OFF\s+(?:#[^\n]*\n\s*)*+%b[ \t]+%b(?![0-9])" % (number, number), data)
    if not found:
        raise ValueError("expected OFF and the numbers of vertices and faces at its start")
    vertices, faces = int(found[1]), int(found[2])
    return vertices, faces, vertices + faces


_COUNTERS = {".obj": _count_obj, ".ply": _count_ply, ".stl": _count_stl, ".off": _count_off}
