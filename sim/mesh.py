"""From the cloth of a scene to arrays: vertices, triangles and the stencils that springs live on.

Any triangle mesh will do: boundaries, irregular valence, several pieces, vertices without triangles, and
chains that have edges only. NumPy alone, so that a scene can be checked and shown before a kernel exists.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from sim import given
from sim.refusal import counted, shown
from sim.repair import connected, repair_triangles
from sim.rotation import rotation_matrix
from sim.scene import MAX_VERTICES, Arrays, Equilateral, Grid, MeshFile, Scene, SceneError
from sim.shells import Shell, read_shells

RIBBON_WIDTH = 0.01
"""Edges outside any triangle weigh like a ribbon of this width [m]."""


@dataclass(frozen=True)
class Mesh:
    """All cloth of a scene as one set of arrays, and its obstacles that are meshes.

    Index arrays are int32, the rest float64.

    Attributes:
        vertices: (n, 3) start positions [m].
        rest_vertices: (n, 3) positions [m] in which edges have their rest length.
        triangles: (m, 3), wound alike within each connected part.
        edges: (e, 2), each once: the sides of the triangles, then edges given explicitly.
        hinges: (h, 4) x1, x2 of an inner edge, then the opposite vertices x3 of triangle (x1, x2, x3) and
            x4 of triangle (x2, x1, x4).
        pieces: (n,) which cloth of the scene a vertex belongs to.
        pinned: (k,) vertices that stay where they start, sorted.
        axis: the coordinate that no vertex moves along, None where all may.
        density: (pieces,) mass per area [kg/m²], nan where the setting rules.
        given_masses: (n,) masses [kg] given explicitly, nan elsewhere.
        shells: the triangles of each obstacle of the scene, None for those that are no meshes.
        warnings: what was repaired or left out, one line each.
    """

    vertices: np.ndarray
    rest_vertices: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    hinges: np.ndarray
    pieces: np.ndarray
    pinned: np.ndarray
    axis: int | None
    density: np.ndarray
    given_masses: np.ndarray
    shells: tuple[Shell | None, ...]
    warnings: tuple[str, ...]

    @property
    def several(self) -> bool:
        """Whether there are several pieces of cloth."""
        return bool(self.pieces.any())

    @cached_property
    def parts(self) -> np.ndarray:
        """(n,) the part of the cloth that each vertex is of: all that edges, and so springs, join."""
        part = connected(len(self.vertices), *self.edges.astype(np.int64).T)
        return np.unique(part, return_inverse=True)[1]

    @property
    def altitudes(self) -> np.ndarray:
        """(3 m, 3) int32: apex, then the ends of the opposite edge; the three of each triangle in a row."""
        return self.triangles[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]].reshape(-1, 3)


def build_mesh(scene: Scene) -> Mesh:
    """The meshes of `scene`; raises SceneError for arrays or files that are none."""
    pieces: list[_Piece] = []
    total = 0
    for i, cloth in enumerate(scene.cloth):
        pieces.append(_piece(cloth, f"{scene.source}: cloth[{i}]", scene.folder))
        total += len(pieces[-1].vertices)
        if total > MAX_VERTICES:  # at once: many pieces of an allowed size would fill the memory
            raise SceneError(f"{scene.source}: cloth: expected at most {MAX_VERTICES} vertices, got {total}")
    first = np.cumsum([0] + [len(p.vertices) for p in pieces])
    triangles = np.concatenate([p.triangles + f for p, f in zip(pieces, first, strict=False)])
    extra = np.concatenate([p.edges + f for p, f in zip(pieces, first, strict=False)])
    shells, shell_warnings = read_shells(scene)
    densities = [cloth.density for cloth in scene.cloth]
    return Mesh(
        vertices=np.concatenate([p.vertices for p in pieces]),
        rest_vertices=np.concatenate([p.rest for p in pieces]),
        triangles=triangles.astype(np.int32),
        edges=distinct_edges(triangles, extra, total),
        hinges=np.concatenate([p.hinges + f for p, f in zip(pieces, first, strict=False)]).astype(np.int32),
        pieces=np.repeat(np.arange(len(pieces), dtype=np.int32), np.diff(first)),
        pinned=np.unique(np.concatenate([p.pins + f for p, f in zip(pieces, first, strict=False)])).astype(
            np.int32
        ),
        axis=None if scene.plane is None else "xyz".index(({*"xyz"} - {*scene.plane}).pop()),
        density=np.array([np.nan if d is None else d for d in densities]),
        given_masses=np.concatenate([p.masses for p in pieces]),
        shells=shells,
        warnings=tuple(w for p in pieces for w in p.warnings) + shell_warnings,
    )


def bare_edges(mesh: Mesh) -> np.ndarray:
    """(k, 2) int32 edges that are sides of no triangle."""
    return mesh.edges[triangles_at(mesh.edges, mesh.triangles, len(mesh.vertices)) == 0]


def triangles_at(edges: np.ndarray, triangles: np.ndarray, n: int) -> np.ndarray:
    """(e,) how many of the triangles of n vertices each edge is a side of."""
    sides = edge_numbers(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), n)
    of, count = np.unique(sides, return_counts=True)
    wanted = edge_numbers(edges, n)
    at = np.minimum(np.searchsorted(of, wanted), len(of) - 1)
    return np.where(of[at] == wanted, count[at], 0) if len(of) else np.zeros(len(edges), dtype=np.int64)


def elements(mesh: Mesh) -> np.ndarray:
    """(f, 3) int32 all of the cloth that can touch, as `elements_of` has it."""
    return elements_of(mesh.triangles, mesh.edges, len(mesh.vertices))


def elements_of(triangles: np.ndarray, edges: np.ndarray, n: int) -> np.ndarray:
    """(f, 3) int32 triangles, edges that no triangle has, and those of n vertices that no edge has.

    An edge repeats its second vertex, a vertex itself.
    """
    alone = np.ones(n, dtype=bool)
    alone[edges] = False
    bare, single = edges[triangles_at(edges, triangles, n) == 0], np.flatnonzero(alone)[:, None]
    return np.concatenate([triangles, bare[:, [0, 1, 1]], single[:, [0, 0, 0]]]).astype(np.int32)


def vertex_masses(mesh: Mesh, mass: str, density: float) -> np.ndarray:
    """(n,) masses [kg], all positive.

    Args:
        mesh: The cloth.
        mass: "area", a third of each triangle to its corners, or "constant", the same to every vertex of a
            piece.
        density: Mass per area [kg/m²] where a piece has none of its own.

    Edges outside any triangle weigh like a ribbon; a vertex with no triangle and no edge gets its piece's
    mean.
    """
    density_of_piece = np.where(np.isnan(mesh.density), density, mesh.density)
    share = np.zeros(len(mesh.vertices))
    corners = mesh.rest_vertices[mesh.triangles]
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    np.add.at(share, mesh.triangles, areas[:, None] / 3.0)
    bare = ~np.isin(mesh.edges, mesh.triangles).all(axis=1)
    ends = mesh.rest_vertices[mesh.edges[bare]]
    np.add.at(
        share, mesh.edges[bare], RIBBON_WIDTH * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None] / 2.0
    )
    masses = share * density_of_piece[mesh.pieces]
    for piece in range(len(density_of_piece)):
        own = mesh.pieces == piece
        weighty = own & (masses > 0.0)
        mean = masses[weighty].mean() if weighty.any() else 1e-3
        masses[own & ~weighty] = mean
        if mass == "constant":
            masses[own] = masses[own].sum() / own.sum()
    return np.where(np.isnan(mesh.given_masses), masses, mesh.given_masses)


@dataclass
class _Piece:
    """One cloth of the scene, numbered from zero."""

    vertices: np.ndarray
    triangles: np.ndarray
    hinges: np.ndarray
    edges: np.ndarray
    pins: np.ndarray
    masses: np.ndarray
    rest: np.ndarray
    warnings: list[str]


def _piece(cloth: Grid | Equilateral | MeshFile | Arrays, where: str, folder: str) -> _Piece:
    names: dict[str, np.ndarray] = {}
    warnings: list[str] = []
    edges, masses, rest = np.zeros((0, 2), int), None, None
    if isinstance(cloth, Grid):
        points, triangles, names = _grid(cloth)
    elif isinstance(cloth, Equilateral):
        points, triangles, names = _equilateral(cloth)
    elif isinstance(cloth, MeshFile):
        points, triangles, warnings = _read(cloth, where, folder)
    else:
        points, triangles, edges, masses, rest = _arrays(cloth, where)
        triangles, warnings = repair_triangles(points if rest is None else rest, triangles)
    n = len(points)
    hinges, unbent = build_hinges(triangles, n)
    placed = points @ rotation_matrix(cloth.rotation).T + np.asarray(cloth.position)
    return _Piece(
        vertices=placed,
        triangles=triangles.astype(np.int64),
        hinges=hinges,
        edges=edges,
        pins=_pins(cloth.pins, names, n, where),
        masses=np.full(n, np.nan) if masses is None else masses,
        rest=points if rest is None else rest,
        warnings=[f"{where}: {w}" for w in (*warnings, *unbent)],
    )


def _grid(cloth: Grid) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    nx, ny = cloth.resolution
    x, y = np.meshgrid(_span(cloth.size[0], nx), _span(cloth.size[1], ny))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(nx * ny)], axis=1)
    index = np.arange(nx * ny).reshape(ny, nx)
    a, b, c, d = (
        corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:])
    )
    i, j = np.meshgrid(np.arange(nx - 1), np.arange(ny - 1))
    even = ((i + j) % 2 == 0).ravel()[:, None]
    lower = np.where(even, np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
    upper = np.where(even, np.stack([a, d, c], axis=1), np.stack([b, d, c], axis=1))
    triangles = np.stack([lower, upper], axis=1).reshape(-1, 3)
    return points, triangles, _named(list(index))


def _equilateral(cloth: Equilateral) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    nx, ny = cloth.resolution
    xs = _span(cloth.size[0], nx)
    between = np.concatenate([xs[:1], 0.5 * (xs[1:] + xs[:-1]), xs[-1:]])
    rows, points, triangles = [], [], []
    for j, y in enumerate(_span(cloth.size[1], ny)):
        x = between if j % 2 else xs
        rows.append(np.arange(len(x)) + sum(map(len, points)))
        points.append(np.stack([x, np.full(len(x), y), np.zeros(len(x))], axis=1))
    for j, (low, high) in enumerate(pairwise(rows)):
        few, many = (high, low) if j % 2 else (low, high)
        flat_few = np.stack([few[:-1], few[1:], many[1:-1]], axis=1)
        flat_many = np.stack([many[1:], many[:-1], few], axis=1)
        both = np.concatenate([flat_few, flat_many])
        triangles.append(both[:, ::-1] if j % 2 else both)
    return np.concatenate(points), np.concatenate(triangles), _named(rows)


def _span(length: float, count: int) -> np.ndarray:
    return np.linspace(-0.5 * length, 0.5 * length, count)


def _named(rows: list[np.ndarray]) -> dict[str, np.ndarray]:
    """The names of the sides and corners of a rectangle given by its rows of vertices."""
    left, right = np.array([r[0] for r in rows]), np.array([r[-1] for r in rows])
    corners = {"corner00": left[:1], "corner10": right[:1], "corner01": left[-1:], "corner11": right[-1:]}
    return {**corners, "left": left, "right": right, "bottom": rows[0], "top": rows[-1]}


def _read(cloth: MeshFile, where: str, folder: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    from sim.meshfile import read_mesh

    try:
        points, triangles, warnings = read_mesh(cloth.file, folder, cloth.scale)
    except ValueError as error:
        raise SceneError(f"{where}.file: {error}") from None
    return points, triangles, warnings


def _arrays(cloth: Arrays, where: str):
    points = given.points(cloth.vertices, f"{where}.vertices")
    n = len(points)
    triangles = given.indices(cloth.triangles, 3, n, f"{where}.triangles")
    edges = given.indices(cloth.edges, 2, n, f"{where}.edges")
    masses = None if cloth.masses is None else given.masses(cloth.masses, n, f"{where}.masses")
    rest = None
    if cloth.rest_vertices is not None:
        rest = given.points(cloth.rest_vertices, f"{where}.rest_vertices")
        if len(rest) != n:
            raise SceneError(f"{where}.rest_vertices: expected {n} rows, got {len(rest)}")
    if len(triangles) or len(edges):
        named = (points, "vertices") if rest is None else (rest, "rest_vertices")
        given.check_size(named[0], f"{where}.{named[1]}")
    return points, triangles, edges, masses, rest


def _pins(pins: list[int | str], names: dict[str, np.ndarray], n: int, where: str) -> np.ndarray:
    found = [np.zeros(0, dtype=np.int64)]
    for k, pin in enumerate(pins):
        if isinstance(pin, str):
            if pin not in names:
                named = f"one of {', '.join(names)}" if names else "a vertex index for this kind of cloth"
                raise SceneError(f"{where}.pins[{k}]: expected {named}, got {shown(pin)}")
            found.append(names[pin])
        elif not 0 <= pin < n:
            raise SceneError(
                f"{where}.pins[{k}]: expected a vertex index from 0 to {n - 1}, got {shown(pin)}"
            )
        else:
            found.append(np.array([pin]))
    return np.concatenate(found)


def distinct_edges(triangles: np.ndarray, extra: np.ndarray, n: int) -> np.ndarray:
    """(e, 2) int32 every edge of the triangles (m, 3) once, and the `extra` (k, 2), of n vertices."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]], extra])
    _, first = np.unique(edge_numbers(sides, n), return_index=True)
    return np.sort(sides[first]).astype(np.int32)


def edge_numbers(ends: np.ndarray, n: int) -> np.ndarray:
    """(e,) int64 one number for each edge by its `ends` (e, 2), of n vertices, whichever comes first."""
    return ends.min(axis=1).astype(np.int64) * n + ends.max(axis=1)


def sides_of(triangles: np.ndarray, n: int) -> np.ndarray:
    """(e, 2) int64 every side of the triangles (m, 3) once, by its lower and then its higher vertex of n."""
    return distinct_edges(triangles.astype(np.int64), np.zeros((0, 2), dtype=np.int64), n).astype(np.int64)


def build_hinges(triangles: np.ndarray, n: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Inner edges with their two opposite vertices; edges of three or more triangles are left out."""
    start = triangles.ravel()
    end = triangles[:, [1, 2, 0]].ravel()
    opposite = triangles[:, [2, 0, 1]].ravel()
    key = edge_numbers(np.stack([start, end], axis=1), n)
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pairs = first[count == 2]
    a, b = order[pairs], order[pairs + 1]
    against = (start[a] == end[b]) & (opposite[a] != opposite[b])
    odd = start[a[~against]], end[a[~against]]
    a, b = a[against], b[against]
    swap = start[a] > end[a]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    hinges = np.stack([start[a], end[a], opposite[a], opposite[b]], axis=1).astype(np.int32)
    crowded = order[first[count > 2]]
    warnings = _unbent(start[crowded], end[crowded], "three or more triangles")
    return hinges, (*warnings, *_unbent(*odd, "triangles wound against each other"))


def _unbent(starts: np.ndarray, ends: np.ndarray, of: str) -> list[str]:
    if not len(starts):
        return []
    which = f"between vertices {starts[0]} and {ends[0]}"
    which = which if len(starts) == 1 else f"the first {which}"
    return [f"{counted(len(starts), 'edge')} of {of}, {which}: no bending there"]
