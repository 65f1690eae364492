"""Scenes: what is simulated, as a typed, bounded definition read from TOML or from a dict of the same shape.

Everything is checked here, once: a scene that loads can be simulated. Errors are one line that names the
file, the key, what was expected and what was found. Lengths are in metres, angles in radians, times in
seconds; a rotation is a rotation vector (axis times angle).
"""

from __future__ import annotations

import math
import os
import re
import sys
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from sim.effects import check_obstacles, chosen, effects_with, obstacle_labels
from sim.refusal import in_words, nearest, shown
from sim.settings import FIELDS, Settings, convert

SCENES = Path(__file__).resolve().parent.parent / "static_scenes"
"""The folder of the scenes that come with Muslin."""

MAX_VERTICES = 200_000
"""Larger cloth, or larger meshes of obstacles, are refused before anything is allocated for them."""

MAX_NUMBERS = 6 * MAX_VERTICES
"""In an array that a dict holds: three for each triangle of the most vertices."""

MAX_PARTS = 1000
"""Pieces of cloth, and obstacles, beyond which a scene is refused."""

MAX_BYTES = 1_000_000
"""Scene files larger than this are refused before they are read; meshes go into files of their own."""

DEEPEST = 32
"""Parts of a dotted key that are read; tomllib's time and memory grow with the square of their number."""

DOTTED = re.compile(rb"""(?:\.[ \t]*+(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+){%d}""" % DEEPEST)
"""What follows the first part of a key that has more."""

TOO_DEEP = "expected tables and arrays within few others, got too many within each other"
"""What is said where Python itself gives up."""

LONGEST_LINE = 600
"""Characters of an error message, however long the value that it shows."""

Vector = tuple[float, float, float]
Turn = Annotated[float, Meta(ge=-1e4, le=1e4)]
Rotation = tuple[Turn, Turn, Turn]
Coordinate = Annotated[float, Meta(ge=-1e4, le=1e4)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Length = Annotated[float, Meta(ge=1e-4, le=1e3)]
Scale = Annotated[float, Meta(ge=1e-6, le=1e6)]
Count = Annotated[int, Meta(ge=2, le=2000)]
Density = Annotated[float, Meta(ge=1e-4, le=1e3)]


class SceneError(ValueError):
    """A scene that cannot be used; the message is one line: file, key, expected, found.

    Attributes:
        setting: The one that decides about it; empty where none does.
    """

    def __init__(self, message: str, setting: str = "") -> None:
        self.setting = setting
        line = " ".join(message.splitlines())  # keys and names may hold line ends, and what moves a cursor
        line = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in line)
        super().__init__(line if len(line) <= LONGEST_LINE else line[: LONGEST_LINE - 1] + "…")


class _Part(msgspec.Struct, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """Base of the tables of a scene file."""


class _Cloth(_Part, kw_only=True):
    name: str = ""
    position: Point = (0.0, 0.0, 0.0)
    """Where the centre of a grid, or the origin of a mesh, is put."""
    rotation: Rotation = (0.0, 0.0, 0.0)
    """Rotation vector, applied about that point; unrotated grids lie in the x–y plane."""
    pins: list[int | str] = []
    """Vertices that stay where they start: indices, or a grid's "corner00" … "corner11", "left" … "top"."""
    density: Density | None = None
    """Mass per area [kg/m²] of this piece, where it differs from the setting."""


class Grid(_Cloth, kw_only=True, tag="grid"):
    """A rectangle of right triangles with alternating diagonals; x varies fastest in the numbering."""

    size: tuple[Length, Length] = (1.0, 1.0)
    resolution: tuple[Count, Count] = (32, 32)


class Equilateral(_Cloth, kw_only=True, tag="equilateral"):
    """A rectangle of (nearly) equilateral triangles with straight sides: odd rows have one vertex more.

    The triangles are exactly equilateral where size[1] / (resolution[1] − 1) is √3/2 of
    size[0] / (resolution[0] − 1).
    """

    size: tuple[Length, Length] = (1.0, 1.0)
    resolution: tuple[Count, Count] = (32, 37)


class MeshFile(_Cloth, kw_only=True, tag="mesh"):
    """A triangle mesh from a file (.obj, .ply, .stl, .off) beside the scene file."""

    file: str
    scale: Scale = 1.0


class Arrays(_Cloth, kw_only=True, tag="arrays"):
    """Explicit arrays, for scenes made in code."""

    vertices: Any
    triangles: Any = None
    edges: Any = None
    masses: Any = None
    rest_vertices: Any = None


class Key(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Where an obstacle is at a time."""

    time: Annotated[float, Meta(ge=0.0, le=1e6)]
    position: Point | None = None
    """Of the obstacle's reference point; where left out, the place that the obstacle is defined at."""
    rotation: Rotation = (0.0, 0.0, 0.0)
    """Rotation vector about the reference point; several turns are allowed."""


class _Obstacle(_Part, kw_only=True):
    name: str = ""
    path: list[Key] = []
    """Keys in order of time; before the first and after the last the obstacle stands still."""
    repeat: bool = False
    """Start again at the first key after the last one."""
    motion: Literal["smooth", "linear"] = "smooth"
    """Between keys: ease in and out, or constant velocity."""


class Sphere(_Obstacle, kw_only=True, tag="sphere"):
    """A solid ball; its reference point is its centre."""

    center: Point
    radius: Length

    @property
    def reference(self) -> Vector:
        """The point that a path moves and about which it turns."""
        return self.center


class Plane(_Obstacle, kw_only=True, tag="plane"):
    """A half-space: solid on the side that the normal points away from."""

    point: Point = (0.0, 0.0, 0.0)
    normal: Point = (0.0, 0.0, 1.0)

    @property
    def reference(self) -> Vector:
        """The point that a path moves and about which it turns."""
        return self.point


class Box(_Obstacle, kw_only=True, tag="box"):
    """A solid box, unrotated unless a path turns it; its reference point is its centre."""

    center: Point
    size: tuple[Length, Length, Length]

    @property
    def reference(self) -> Vector:
        """The point that a path moves and about which it turns."""
        return self.center


class Capsule(_Obstacle, kw_only=True, tag="capsule"):
    """All points within `radius` of a segment; its reference point is the segment's middle."""

    start: Point
    end: Point
    radius: Length

    @property
    def reference(self) -> Vector:
        """The point that a path moves and about which it turns."""
        (a, b, c), (d, e, f) = self.start, self.end
        return (a + d) / 2, (b + e) / 2, (c + f) / 2


class _Shell(_Obstacle, kw_only=True):
    """A surface of triangles, closed or open; its reference point is the mesh's origin."""

    position: Point = (0.0, 0.0, 0.0)
    """Where the origin of the mesh is put."""
    rotation: Rotation = (0.0, 0.0, 0.0)
    """Rotation vector, applied about that point, before what a path adds."""

    @property
    def reference(self) -> Vector:
        """The point that a path moves and about which it turns."""
        return self.position


class ShellFile(_Shell, kw_only=True, tag="mesh"):
    """A triangle mesh from a file, read as that of a cloth is."""

    file: str
    scale: Scale = 1.0


class ShellArrays(_Shell, kw_only=True, tag="arrays"):
    """A triangle mesh as arrays, for scenes made in code."""

    vertices: Any
    triangles: Any


Cloth = Grid | Equilateral | MeshFile | Arrays
Obstacle = Sphere | Plane | Box | Capsule | ShellFile | ShellArrays


class Lesson(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """What a person should see in a scene."""

    title: str
    look_for: str = ""
    tries: list[str] = field(default_factory=list, name="try")


class Camera(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Where a viewer stands at first, for one cloth at its place."""

    position: Point
    look_at: Point = (0.0, 0.0, 0.0)


class Compare(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """What the variants differ in when the scene is opened."""

    by: str = "contact"
    values: list[Any] = field(default_factory=lambda: ["penalty", "impulse"])
    fails: list[Any] = []
    """Those of the values that fail on purpose; the page says so of them."""


class Scene(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A whole scene. `source` names it in errors; `folder` is where its mesh files are looked for.

    Where there is a `plane`, no vertex leaves the one parallel to it that it starts in.
    """

    format: Literal[1] = 1
    name: str = ""
    plane: Literal["xy", "xz", "yz"] | None = None
    cloth: list[Cloth]
    obstacle: list[Obstacle] = []
    settings: Settings = Settings()
    lesson: Lesson | None = None
    camera: Camera | None = None
    compare: Compare = field(default_factory=Compare)
    effects: dict[str, str] = {}
    """Effects that the author forces "on" or "off"; `settings` are as they ask for."""
    source: str = "scene"
    folder: str = ""

    @property
    def obstacle_labels(self) -> list[str]:
        """What each obstacle is called where effects are: its name, or its number."""
        return obstacle_labels([part.name for part in self.obstacle])


def scene_files() -> list[Path]:
    """The scene files that come with Muslin, by name."""
    return sorted(SCENES.glob("*.toml"))


def find_scene(name: str | Path) -> Path:
    """The file that `name` means: a path, or the name of a scene that comes with Muslin."""
    path = Path(name)
    shipped = SCENES / f"{path.name.removesuffix('.toml')}.toml"
    if not path.exists() and len(path.parts) == 1 and shipped.exists():
        return shipped
    return path


def load_scene(source: Scene | str | Path | dict[str, Any]) -> Scene:
    """Read and check a scene, with its meshes.

    Args:
        source: Path of a TOML file, the name of a scene that comes with Muslin, or a dict of the same shape.

    Raises:
        SceneError: one line with the file, the key, what was expected and what was found.
    """
    scene = read_scene(source)
    if scene is not source:
        from sim.mesh import build_mesh  # which needs this module

        build_mesh(scene)
    return scene


def read_scene(source: Scene | str | Path | dict[str, Any]) -> Scene:
    """The same without its meshes, which may be missing, or wrong: for who builds them, or needs none."""
    if isinstance(source, Scene):
        return source
    if isinstance(source, dict):
        try:
            return _checked({"folder": str(Path.cwd()), **_plain(source)}, "scene", "scene")
        except RecursionError:
            raise SceneError(f"scene: {TOO_DEEP}") from None
    if not isinstance(source, str | os.PathLike):
        raise SceneError(f"scene: expected a file, the name of a scene or a dict, got {shown(source)}")
    path, table = _toml(source)
    for key in {"folder", "source"} & table.keys():
        raise SceneError(f"{source}: {key}: no such key; mesh files are looked for beside the scene file")
    return _checked({**table, "folder": str(path.resolve().parent)}, str(source), path.stem)


def _plain(value: Any) -> Any:
    """`value` with NumPy scalars and arrays as numbers and lists."""
    if (size := getattr(value, "size", 0)) > MAX_NUMBERS:
        raise SceneError(f"scene: expected arrays of at most {MAX_NUMBERS:,} numbers, got {size:,}")
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _toml(where: str | Path) -> tuple[Path, dict[str, Any]]:
    try:
        path = find_scene(where)
        if path.exists() and not path.is_file():  # a folder, or a pipe that would be waited for
            raise OSError("expected a regular file")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise SceneError(f"{where}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > MAX_BYTES:
        raise SceneError(f"{where}: expected at most {MAX_BYTES // 10**6} MB, got more")
    return path, _tables(data, where)


def _tables(data: bytes, where: str | Path) -> dict[str, Any]:
    if deep := DOTTED.search(data):
        line = data.count(b"\n", 0, deep.start()) + 1
        raise SceneError(f"{where}: line {line}: expected keys of at most {DEEPEST} parts, got more")
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
    except ValueError:  # what the conversion of numbers raises
        reason = f"expected whole numbers of at most {sys.get_int_max_str_digits():,} digits, got more"
    except RecursionError:
        reason = TOO_DEEP
    raise SceneError(f"{where}: not TOML: {reason}")


def _checked(table: dict[str, Any], where: str, name: str) -> Scene:
    table = {**table, "name": table.get("name", name)}
    table["cloth"] = _cloth_list(table.get("cloth", []), where)
    if isinstance(table.get("obstacle"), list):
        table["obstacle"] = [_kind_of_arrays(obstacle) for obstacle in table["obstacle"]]
    labels = obstacle_labels(_names(table.get("obstacle")))
    table["settings"] = _settings(table.get("settings", {}), table.get("effects", {}), labels, where)
    try:
        scene = msgspec.convert(table, Scene)
    except msgspec.ValidationError as error:
        raise SceneError(f"{where}: {in_words(str(error), table, Scene)}") from None
    for key, reason in _problems(scene):
        raise SceneError(f"{where}: {key}: {reason}")
    return msgspec.structs.replace(scene, source=where)


def _cloth_list(cloth: Any, where: str) -> list[Any]:
    cloth = cloth if isinstance(cloth, list) else [cloth]
    if not cloth:
        raise SceneError(f"{where}: cloth: expected at least one piece, got none")
    return [_kind_of_arrays(piece) for piece in cloth]


def _kind_of_arrays(part: Any) -> Any:
    return {"kind": "arrays", **part} if isinstance(part, dict) and "vertices" in part else part


def _names(obstacles: Any) -> list[str]:
    """The names of the obstacles in a table that nobody has checked yet."""
    tables = (
        [part if isinstance(part, dict) else {} for part in obstacles] if isinstance(obstacles, list) else []
    )
    return [name if isinstance(name := table.get("name"), str) else "" for table in tables]


def _settings(table: Any, effects: Any, labels: list[str], where: str) -> Settings:
    """The settings of a scene whose obstacles have these labels, with its effects as it forces them."""
    if not isinstance(table, dict):
        raise SceneError(f"{where}: settings: expected a table of settings, got {shown(table)}")
    try:
        settings = Settings(**{name: convert(name, value) for name, value in table.items()})
        check_obstacles(settings, labels)
    except ValueError as error:
        raise SceneError(f"{where}: settings.{error}") from None
    if not isinstance(effects, dict):
        raise SceneError(f"{where}: effects: expected a table of effects, got {shown(effects)}")
    try:
        return chosen(settings, effects, effects_with(labels))
    except ValueError as error:
        raise SceneError(f"{where}: effects.{error}") from None


def _problems(scene: Scene):
    """What types and bounds cannot say, as (key, reason)."""
    for i, cloth in enumerate(scene.cloth):
        for k, pin in enumerate(cloth.pins):
            if isinstance(pin, int) and pin < 0:
                yield (
                    f"cloth[{i}].pins[{k}]",
                    f"expected a vertex index ≥ 0 or the name of a side, got {shown(pin)}",
                )
        if isinstance(cloth, Grid | Equilateral) and math.prod(cloth.resolution) > MAX_VERTICES:
            yield (
                f"cloth[{i}].resolution",
                f"expected at most {MAX_VERTICES} vertices, got {math.prod(cloth.resolution)}",
            )
    for key, parts in (("cloth", scene.cloth), ("obstacle", scene.obstacle)):
        if len(parts) > MAX_PARTS:
            yield key, f"expected at most {MAX_PARTS} of them, got {len(parts)}"
    for i, obstacle in enumerate(scene.obstacle):
        times = [key.time for key in obstacle.path]
        if any(later <= sooner for sooner, later in pairwise(times)):
            yield f"obstacle[{i}].path", f"expected times that increase, got {times}"
        if obstacle.repeat and len(times) < 2:
            yield f"obstacle[{i}].repeat", "expected a path of at least two keys to repeat"
        if isinstance(obstacle, Plane) and math.hypot(*obstacle.normal) < 1e-9:
            yield f"obstacle[{i}].normal", f"expected a direction, got {list(obstacle.normal)}"
    if scene.compare.by not in FIELDS:
        yield "compare.by", f"{shown(scene.compare.by)} is no setting; {nearest(scene.compare.by, FIELDS)}"
    if not 1 <= len(scene.compare.values) <= 4:
        yield "compare.values", f"expected 1 to 4 values, got {len(scene.compare.values)}"
    for i, value in enumerate(scene.compare.values):
        try:
            convert(scene.compare.by, value)
        except ValueError as error:
            yield f"compare.values[{i}]", str(error)
    for i, value in enumerate(scene.compare.fails):
        if value not in scene.compare.values:
            yield f"compare.fails[{i}]", f"expected one of compare.values, got {shown(value)}"
