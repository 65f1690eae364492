"""Readers of mesh files: the bytes of an .obj, .ply, .stl or .off to vertices and triangles.

Our own, as a file may be anybody's: each reads once from front to end, makes nothing larger than the file,
takes no number for another, and says which line or row is wrong. A file that ends too soon is refused.
Materials, colours, normals and texture coordinates are left; polygons become fans of triangles,
and are counted.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from sim.meshclaims import MAX_TRIANGLES, Element, Property, binary_stl_faces, ply_header
from sim.scene import MAX_VERTICES

Arrays = tuple[np.ndarray, np.ndarray]

Read = tuple[Any, Any, int]
"""Vertices, triangles, and how many faces with more corners were cut into such."""

SHOWN = 60
"""Characters of a line that a message shows."""

LONGEST = 2_000_000
"""Bytes of a line that is read, and words of lines that one goes on in."""

CORNERS = "three or more vertex numbers"


def parse(data: bytes, suffix: str) -> tuple[np.ndarray, np.ndarray, int]:
    """What a file has.

    Returns:
        (n, 3) float64 vertices in units of the file, (m, 3) int64 triangles, whose numbers may be any, and of
        how many faces with more corners some of these are.

    Raises:
        ValueError: one line that says what is wrong, and where.
    """
    vertices, triangles, polygons = _READERS[suffix](data)
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return points, np.array(triangles, dtype=np.int64).reshape(-1, 3), polygons


class _Lines:
    """The words of each line that has any.

    Args:
        data: The text.
        first: The number of its first line.
        comment: What begins a comment, if anything does.

    Attributes:
        number: Of the line that was read last, from 1.
    """

    def __init__(self, data: bytes, first: int = 1, comment: bytes = b"") -> None:
        self.number, self._first, self._comment = first - 1, first, comment
        self._lines = data.splitlines()  # of Unix, Windows and old Macs

    def __iter__(self) -> Iterator[list[str]]:
        held: list[str] = []
        for number, line in enumerate(self._lines, self._first):
            text = line.partition(self._comment)[0].rstrip() if self._comment else line
            if not text and not held:
                continue
            self.number = number
            if max(len(text), len(held)) > LONGEST:
                raise ValueError(f"line {number}: expected at most {LONGEST // 10**6} MB, got more")
            more = bool(self._comment) and text.endswith(b"\\")  # goes on in the next line
            held += text.removesuffix(b"\\" * more).decode("utf-8", "replace").split()
            if held and not more:
                yield held
                held = []

    def wrong(self, expected: str, words: list[str]) -> ValueError:
        """What to raise for the last line."""
        return ValueError(f"line {self.number}: expected {expected}, got {' '.join(words)[:SHOWN]!r}")


def _plain(word: str) -> str:
    """The word; ValueError where Python would take it for a number and no other program does: 1_0, or ٣."""
    if "_" in word or not word.isascii():
        raise ValueError
    return word


def _point(words: list[str]) -> tuple[float, float, float]:
    x, y, z = (float(_plain(word)) for word in words)
    return x, y, z


class _Faces:
    """Faces as they are read.

    Attributes:
        triangles: Of all of them.
        polygons: How many had more than three corners.
    """

    def __init__(self) -> None:
        self.triangles: list[tuple[int, int, int]] = []
        self.polygons = 0

    def add(self, corners: Sequence[int]) -> None:
        """Take in one as a fan of triangles; ValueError for fewer than three corners."""
        if len(corners) < 3:
            raise ValueError
        self.triangles += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
        self.polygons += len(corners) > 3

    def check_number(self) -> None:
        """Refuse more triangles than anybody has use for."""
        if len(self.triangles) > MAX_TRIANGLES:
            raise ValueError(f"expected at most {MAX_TRIANGLES:,} triangles, got more")


def _index(word: str) -> int:
    """A vertex number that int64 holds; whether there is such a vertex is looked at later."""
    index = int(_plain(word))
    if abs(index) > np.iinfo(np.int32).max:
        raise ValueError
    return index


def _read_obj(data: bytes) -> Read:
    vertices: list[tuple[float, float, float]] = []
    faces = _Faces()
    lines = _Lines(data, comment=b"#")
    ahead: list[tuple[int, int, list[str]]] = []  # faces of vertices that are still to come
    for words in lines:
        try:
            if words[0] == "v":
                vertices.append(_point(words[1:4]))
            elif words[0] == "f":
                corners = [_obj_index(word, len(vertices)) for word in words[1:]]
                faces.add(corners)
                if max(corners) >= len(vertices):
                    ahead.append((max(corners), lines.number, words))
        except ValueError:
            raise lines.wrong("three numbers" if words[0] == "v" else CORNERS, words) from None
        faces.check_number()
    for corner, lines.number, words in ahead:
        if corner >= len(vertices) > 0:
            raise lines.wrong(f"vertices 1 to {len(vertices)}", words)
    return vertices, faces.triangles, faces.polygons


def _obj_index(word: str, count: int) -> int:
    """The vertex that `7`, `7/1/2`, `7//2` or `-1` (the latest) means, from 0."""
    index = int(_plain(word.partition("/")[0]))
    if index == 0 or index < -count or index > MAX_VERTICES:
        raise ValueError
    return index - 1 if index > 0 else count + index


def _read_off(data: bytes) -> Read:
    vertices: list[tuple[float, float, float]] = []
    faces = _Faces()
    lines = _Lines(data, comment=b"#")
    rows = iter(lines)
    counts = next(rows)[1:] or next(rows)  # beside OFF or below; what they claim has been looked at
    left = int(counts[1])
    for words in rows:
        if len(vertices) < int(counts[0]):
            try:
                vertices.append(_point(words[:3]))
            except ValueError:
                raise lines.wrong("three numbers", words) from None
        elif left:
            left -= 1
            try:
                faces.add(_listed(words, 0)[0])
            except ValueError:
                raise lines.wrong(f"how many corners, and {CORNERS}", words) from None
            faces.check_number()
        else:
            break
    if len(vertices) < int(counts[0]) or left:
        raise ValueError(f"expected {counts[0]} vertices and {counts[1]} faces, but it ends before")
    return vertices, faces.triangles, faces.polygons


def _listed(words: list[str], at: int) -> tuple[list[int], int]:
    """The whole numbers after the one at `at` that says how many there are, and where the next word is."""
    count = int(_plain(words[at]))
    end = at + 1 + count
    if count < 0 or end > len(words):
        raise ValueError
    return [_index(word) for word in words[at + 1 : end]], end


def _read_stl(data: bytes) -> Read:
    """Three vertices for each triangle, as the file has them."""
    if (faces := binary_stl_faces(data)) is not None:
        row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners: Any = np.frombuffer(data, row, faces, 84)["corners"]
        return corners, np.arange(3 * faces), 0
    if not data.lstrip().lower().startswith(b"solid"):
        claimed = int.from_bytes(data[80:84], "little")
        raise ValueError(
            f"expected solid, or {84 + 50 * claimed:,} bytes for the facets that it claims to have"
        )
    corners, whole, lines, words, last = [], 0, _Lines(data), [], ""
    for words in lines:
        last = words[0].lower()
        if last == "vertex":
            try:
                corners.append(_point(words[1:]))
            except ValueError:
                raise lines.wrong("vertex and three numbers", words) from None
        elif last == "endfacet":
            if len(corners) - whole != 3:
                raise lines.wrong("three vertices in each facet", words)
            whole += 3
    if last not in {"endsolid", "endfacet"}:
        raise lines.wrong("endsolid at its end", words)
    return corners, np.arange(whole), 0


def _read_ply(data: bytes) -> Read:
    encoding, elements, body = ply_header(data)
    named = {element.name: element for element in elements}
    for name in ("vertex", "face"):
        if name not in named:
            raise ValueError(f"expected an element {name}, got {', '.join(named) or 'none'}")
    axes, corners = [_place(named["vertex"], axis) for axis in "xyz"], _corners(named["face"])
    vertices: list[list[float]] = []
    faces = _Faces()
    for element, k, row in (_ascii_rows if encoding == "ascii" else _binary_rows)(
        data, body, elements, encoding
    ):
        if element == "vertex":
            vertices.append([row[axis] for axis in axes])
        elif element == "face":
            try:
                faces.add(row[corners])
            except ValueError:
                raise ValueError(f"face {k}: expected {CORNERS}, got {list(row[corners])}") from None
            faces.check_number()
    return vertices, faces.triangles, faces.polygons


def _place(element: Element, name: str) -> int:
    """Which property of an element it is, of those that are no lists."""
    places = [p for p, known in enumerate(element.properties) if known.name == name and not known.length]
    if len(places) != 1:
        found = len(places) or "none"
        raise ValueError(f"expected one property {name} of element {element.name}, got {found}")
    return places[0]


def _corners(face: Element) -> int:
    """Which property of a face lists its vertices: the one named so, or the only list."""
    lists = [place for place, known in enumerate(face.properties) if known.length]
    named = [p for p in lists if face.properties[p].name in {"vertex_indices", "vertex_index"}]
    if len(chosen := named or lists) != 1 or face.properties[chosen[0]].fractional:
        raise ValueError("expected one property list … vertex_indices of whole numbers of element face")
    return chosen[0]


Rows = Iterator[tuple[str, int, list]]
"""The element, the number and the properties of each row in turn."""


def _ascii_rows(data: bytes, body: int, elements: Sequence[Element], encoding: str) -> Rows:
    lines = _Lines(data[body:], len(data[:body].splitlines()) + 1)
    rows = iter(lines)
    for element in elements:
        for k in range(element.rows):
            words = next(rows, None)
            if words is None:
                raise ValueError(f"it ends at {element.name} {k:,} of {element.claimed:,}")
            try:
                row = _ascii_row(element, words)
            except (ValueError, IndexError):
                what = " ".join(f"{'list ' * bool(known.length)}{known.name}" for known in element.properties)
                raise lines.wrong(f"{element.name} with {what}", words) from None
            yield element.name, k, row
    if (words := next(rows, None)) is not None:
        raise lines.wrong("nothing after all that the header claims", words)


def _ascii_row(element: Element, words: list[str]) -> list:
    row, at = [], 0
    for known in element.properties:
        if known.length:
            if known.fractional:
                length = int(_plain(words[at]))
                values = [float(_plain(word)) for word in words[at + 1 : at + 1 + length]]
                at += 1 + length
            else:
                values, at = _listed(words, at)
            row.append(values)
        else:
            row.append(float(_plain(words[at])))
            at += 1
    if at != len(words):
        raise ValueError
    return row


def _binary_rows(data: bytes, at: int, elements: Sequence[Element], encoding: str) -> Rows:
    order = "<" if encoding == "binary_little_endian" else ">"
    for element in elements:
        readers = [_reader(known, order) for known in element.properties]
        for k in range(element.rows):
            row = []
            try:
                for read in readers:
                    value, at = read(data, at)
                    row.append(value)
            except struct.error:
                raise ValueError(f"it ends at {element.name} {k:,} of {element.claimed:,}") from None
            except ValueError as error:
                raise ValueError(f"{element.name} {k}: {error}") from None
            yield element.name, k, row
    if rest := len(data[at:].strip()):
        raise ValueError(f"expected nothing after all that the header claims, got {rest:,} bytes")


def _reader(known: Property, order: str) -> Callable[[bytes, int], tuple[Any, int]]:
    one = struct.Struct(order + known.type)
    if not known.length:
        return lambda data, at: (one.unpack_from(data, at)[0], at + one.size)
    length = struct.Struct(order + known.length)

    def read(data: bytes, at: int) -> tuple[Any, int]:
        (count,), at = length.unpack_from(data, at), at + length.size
        if count < 0:
            raise ValueError(f"{known.name}: expected a list of none or more, got {count}")
        end = at + count * one.size
        if end > len(data):
            raise struct.error
        return struct.unpack_from(f"{order}{count}{known.type}", data, at), end

    return read


_READERS: dict[str, Callable[[bytes], Read]] = {
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".stl": _read_stl,
    ".off": _read_off,
}
