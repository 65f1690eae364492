"""Cloth that starts across itself or across mesh obstacles: found, refused, or untangled.

Impulses keep apart what starts apart, so a tangle at the start would stay for ever. To undo one, vertices
move against the gradient of the length of the contour along which surfaces cross, as in Volino and
Magnenat-Thalmann (2006, Resolving surface collisions through intersection contour minimization): a loop that
pokes through shrinks to a point and is gone. The gradient is taken as it is for the polyline of the mesh, and
smoothed by a Laplacian, so that cloth moves in patches and keeps its shape.

That undoes what pokes through. It does not undo sheets that cut each other from border to border, whose
contour is as short as it can be, nor layers that lie exactly in one plane, nor what has passed through
completely, which leaves no contour. The first two are told, and nothing is moved then.

Needs neither numba nor scipy before it looks for crossings, so that `muslin check` has the same words.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sim.effects import feels_cloth
from sim.mesh import Mesh, elements, sides_of
from sim.refusal import LISTED, counted, listed
from sim.scene import SceneError
from sim.settings import Settings

MOST_ROUNDS = 300
"""Moves that are tried."""

STRIDE = 0.4
"""Part of a typical edge that a vertex moves at most at a time: the contour must be found where it goes."""

BEYOND = 1.5
"""Times the way to where the gradient says that the contour is gone, so that layers end up apart."""

PATCH = 12.0
"""Typical edges over which a move fades out along the cloth."""

GRAZING = 0.1
"""Sine of the least angle at which an edge counts as crossing a triangle; below, the contour runs away."""


class Surfaces(NamedTuple):
    """Cloth, and behind it mesh obstacles, as triangles of one set of vertices.

    Attributes:
        triangles: (m, 3) int64 vertex numbers.
        edges: (e, 2) int64 their sides, each once.
        free: (n,) bool, which vertices may move.
        cloth: How many vertices, the first ones, are cloth.
        piece: (n,) the piece of cloth that each vertex is of, negative for those of obstacles.
        within: Whether it counts where a piece crosses itself.
        between: Whether it counts where pieces cross each other.
        axis: The coordinate that no vertex moves along, None where all may.
    """

    triangles: np.ndarray
    edges: np.ndarray
    free: np.ndarray
    cloth: int
    piece: np.ndarray
    within: bool
    between: bool
    axis: int | None = None

    def counts(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Whether what is at vertices i and at vertices j may not cross; obstacles may cross each other."""
        one, other = self.piece[i], self.piece[j]
        of_cloth = np.where(one == other, self.within, self.between)
        return np.where(np.minimum(one, other) >= 0, of_cloth, np.maximum(one, other) >= 0)

    @property
    def cloth_triangles(self) -> int:
        """How many triangles, the first ones, are cloth."""
        return int(np.count_nonzero(self.triangles[:, 0] < self.cloth))


class Untangled(NamedTuple):
    """What came of it.

    Attributes:
        positions: (n, 3) [m]; those that were given where crossings are left.
        pairs: (p, 2) pairs of triangles that crossed at first.
        left: (q, 2) pairs that cross after all that was tried; none where all is well.
        moved: The longest way of a vertex [m].
    """

    positions: np.ndarray
    pairs: np.ndarray
    left: np.ndarray
    moved: float


def surfaces_of(mesh: Mesh, settings: Settings, obstacles: np.ndarray) -> Surfaces | None:
    """What may not cross what: cloth, then felt `obstacles` (m, 3), numbered from 0; None if all may."""
    felt = feels_cloth(settings, mesh.several) or len(obstacles)
    if settings.contact == "none" or not felt or not len(mesh.triangles):
        return None
    feels = settings.self_collision != "off", settings.cloth_collision != "off"
    return _surfaces(mesh, mesh.triangles, obstacles, *feels)


def all_surfaces(mesh: Mesh, obstacles: np.ndarray) -> Surfaces:
    """The same of all that can cross, felt or not; edges without triangles are triangles without area."""
    return _surfaces(mesh, elements(mesh), obstacles, True, True)


def _surfaces(mesh: Mesh, cloth: np.ndarray, obstacles: np.ndarray, within: bool, between: bool) -> Surfaces:
    n = len(mesh.vertices)
    piece = np.concatenate([mesh.pieces, np.full(int(obstacles.max(initial=-1)) + 1, -1)])
    free = piece >= 0
    free[mesh.pinned] = False
    triangles = np.ascontiguousarray(np.concatenate([cloth, obstacles + n]), dtype=np.int64)
    return Surfaces(triangles, sides_of(triangles, len(piece)), free, n, piece, within, between, mesh.axis)


def refuses(settings: Settings) -> bool:
    """Whether a start that crosses itself is refused."""
    return settings.tangled == "refuse" and settings.contact == "impulse"


def clear_start(
    x: np.ndarray, solid: np.ndarray, surfaces: Surfaces | None, settings: Settings, source: str
) -> tuple[np.ndarray, str]:
    """Where cloth starts that is to be at `x` (n, 3) [m], and a line where that is elsewhere.

    Args:
        x: The cloth's vertices.
        solid: (k, 3) those of the mesh obstacles that are felt [m].
        surfaces: Of `surfaces_of`.
        settings: Say what is to be done about a tangle.
        source: The scene, for messages.

    Raises:
        SceneError: the cloth crosses itself or a mesh obstacle, and that is refused or could not be undone.
    """
    undo = settings.tangled == "untangle"
    if surfaces is None or not (undo or refuses(settings)):
        return x, ""
    points = np.concatenate([x, solid])
    if not undo:
        pairs = _pairs(crossings(points, surfaces), surfaces)
        if len(pairs):
            raise SceneError(f"{source}: {refusal(pairs, surfaces.cloth_triangles)}", "tangled")
        return x, ""
    found = untangle(points, surfaces)
    if len(found.left):
        tried = f"could not be untangled: of {len(found.pairs):,} pairs, there are left"
        left = in_words(found.left, surfaces.cloth_triangles)
        raise SceneError(f"{source}: {CROSSES} and {tried} {left}; {APART}, or {KEEP}", "tangled")
    if not len(found.pairs):
        return x, ""
    undone = in_words(found.pairs, surfaces.cloth_triangles)
    return found.positions[: len(x)], f"untangled the start, by up to {found.moved:.2g} m: {undone}"


CROSSES = "cloth crosses itself or a mesh obstacle at the start"
APART = "place it apart"
KEEP = 'set tangled = "keep" to run it as it is'


def refusal(pairs: np.ndarray, cloth: int) -> str:
    """What is said of a start that is refused for `pairs` (p, 2) of triangles, the first `cloth` of cloth."""
    ways = f'{APART}, set tangled = "untangle" to have small crossings undone, or {KEEP}'
    return f"{CROSSES}, which impulses do not undo: {in_words(pairs, cloth)}; {ways}"


def in_words(pairs: np.ndarray, cloth: int) -> str:
    """How many pairs (p, 2) of triangles there are, and the first; those past `cloth` are of obstacles."""
    some = pairs[: LISTED + 1]
    named = [f"{i} and {j}" if j < cloth else f"{i} and {j - cloth} of the obstacle" for i, j in some]
    return f"{counted(len(pairs), 'pair')} of triangles: {listed(named)}"


def untangle(x: np.ndarray, surfaces: Surfaces) -> Untangled:
    """Move free vertices of `x` (n, 3) [m] until no triangles cross, or give up."""
    found, start = crossings(x, surfaces), x
    first = _pairs(found, surfaces)
    if not len(found):
        return Untangled(start, first, first, 0.0)
    smooth, x = _smoother(surfaces), x.copy()
    ends = x[surfaces.edges]
    typical = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
    for _ in range(MOST_ROUNDS):
        length, gradient = contour(x, surfaces.triangles, surfaces.edges, found)
        if surfaces.axis is not None:
            gradient[:, surfaces.axis] = 0.0
        way = smooth(gradient)
        slope, fastest = float((gradient * way).sum()), float(np.linalg.norm(way, axis=1).max())
        if slope <= 0.0:  # as short as it can be
            break
        x -= min(BEYOND * length / slope, STRIDE * typical / fastest) * way
        found = crossings(x, surfaces)
        if not len(found):
            return Untangled(x, first, first[:0], float(np.linalg.norm(x - start, axis=1).max()))
    return Untangled(start, first, _pairs(found, surfaces), 0.0)


def contour(
    x: np.ndarray, triangles: np.ndarray, edges: np.ndarray, crossings: np.ndarray
) -> tuple[float, np.ndarray]:
    """The length [m] of the contour along which triangles cross, and its gradient (n, 3).

    Args:
        x: (n, 3) positions [m].
        triangles: (m, 3) vertex numbers.
        edges: (e, 2) their sides.
        crossings: (p, 2) [edge, triangle], as `sim.intersections` gives them.

    A segment is where two triangles cross. Each end of it is where a side of one meets the other, at X, or a
    corner that both share. A side of direction E that moves by δ beside a triangle of normal n moves X by
    δ − E (n · δ) / (n · E) beside it.
    """
    i, j = edges[crossings[:, 0]].T
    corners = triangles[crossings[:, 1]]
    a, b, c = x[corners].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.maximum(area, np.finfo(float).tiny)
    along = x[j] - x[i]
    steep = np.einsum("ij,ij->i", along, normal)
    least = GRAZING * np.linalg.norm(along, axis=1)
    steep = np.where(np.abs(steep) < least, np.copysign(least, steep), steep)
    steep = np.where(steep == 0.0, 1.0, steep)  # of an edge without length
    t = (np.einsum("ij,ij->i", a - x[i], normal) / steep).clip(0.0, 1.0)
    point = x[i] + t[:, None] * along
    weight = _barycentric(point, a, b, c)

    one, other, shared = _segments(triangles, edges, crossings)
    far = np.where((shared >= 0)[:, None], x[shared], point[other])
    chord = point[one] - far
    size = np.linalg.norm(chord, axis=1)
    unit = chord / np.maximum(size, np.finfo(float).tiny)[:, None]
    pull = np.zeros_like(point)  # gradient by each crossing point
    np.add.at(pull, one, unit)
    np.add.at(pull, other[shared < 0], -unit[shared < 0])

    gradient = np.zeros_like(x)
    np.add.at(gradient, shared[shared >= 0], -unit[shared >= 0])
    slide = (np.einsum("ij,ij->i", pull, along) / steep)[:, None] * normal
    np.add.at(gradient, i, (1.0 - t)[:, None] * (pull - slide))
    np.add.at(gradient, j, t[:, None] * (pull - slide))
    np.add.at(gradient, corners, weight[:, :, None] * slide[:, None])
    return float(size.sum()), gradient


def crossings(x: np.ndarray, surfaces: Surfaces) -> np.ndarray:
    """(p, 2) [edge, triangle] that cross, obstacles among themselves and what is not asked for left out."""
    from sim.contact.intersections import crossing  # Numba, which `muslin check` does without

    if not len(surfaces.triangles):
        return np.zeros((0, 2), dtype=np.int64)
    found = crossing(np.ascontiguousarray(x, dtype=float), surfaces.edges, surfaces.triangles)
    edges, corners = surfaces.edges[found[:, 0], 0], surfaces.triangles[found[:, 1], 0]
    return found[surfaces.counts(edges, corners)]


def _beside(triangles: np.ndarray, edges: np.ndarray, crossings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) crossings, and (k,) each triangle that the crossing edge is a side of."""
    n = int(triangles.max()) + 1
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    number = np.searchsorted(edges[:, 0].astype(np.int64) * n + edges[:, 1], sides[:, 0] * n + sides[:, 1])
    order = np.argsort(number, kind="stable")
    begin, end = (np.searchsorted(number[order], crossings[:, 0], side) for side in ("left", "right"))
    which = np.repeat(np.arange(len(crossings)), end - begin)
    place = np.arange(len(which)) - np.repeat(np.cumsum(end - begin) - (end - begin), end - begin)
    return which, order[begin[which] + place] // 3


def _pairs(crossings: np.ndarray, surfaces: Surfaces) -> np.ndarray:
    """(p, 2) the triangles that cross where edges and triangles do, each pair once."""
    which, triangle = _beside(surfaces.triangles, surfaces.edges, crossings)
    pairs = np.sort(np.stack([triangle, crossings[which, 1]], axis=1), axis=1)
    return np.unique(pairs, axis=0)


def _segments(
    triangles: np.ndarray, edges: np.ndarray, crossings: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The ends of the contour's segments: (s,) a crossing, (s,) another one or (s,) a vertex, −1 where none.

    Pairs of triangles of which one lies in the other's plane, or that only touch, have no segment.
    """
    which, triangle = _beside(triangles, edges, crossings)
    pairs = np.sort(np.stack([triangle, crossings[which, 1]], axis=1), axis=1)
    order = np.lexsort((which, pairs[:, 1], pairs[:, 0]))
    which, pairs = which[order], pairs[order]
    _, first, count = np.unique(pairs, axis=0, return_index=True, return_counts=True)
    two = first[count == 2]
    single = first[count == 1]
    corners = triangles[pairs[single]]
    same = corners[:, 0, :, None] == corners[:, 1, None, :]
    vertex = np.where(same.any(axis=(1, 2)), (corners[:, 0] * same.any(axis=2)).max(axis=1), -1)
    single, vertex = single[vertex >= 0], vertex[vertex >= 0]
    one = np.concatenate([which[two], which[single]])
    other = np.concatenate([which[two + 1], which[single]])
    return one, other, np.concatenate([np.full(len(two), -1), vertex])


def _barycentric(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(k, 3) weights of the corners at points in triangles, no less than zero; a third each without area."""
    u, v, w = b - a, c - a, p - a
    uu, uv, vv = (np.einsum("ij,ij->i", *pair) for pair in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("ij,ij->i", w, u), np.einsum("ij,ij->i", w, v)
    whole = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (vv * wu - uv * wv) / whole, (uu * wv - uv * wu) / whole
    weight = np.stack([1.0 - s - t, s, t], axis=1)
    weight[~np.isfinite(weight).all(axis=1)] = 1.0 / 3.0
    weight = weight.clip(0.0, 1.0)
    return weight / weight.sum(axis=1, keepdims=True)


def _smoother(surfaces: Surfaces) -> Callable[[np.ndarray], np.ndarray]:
    """What smooths (n, 3) along the cloth: (1 + r² L) u = g, L the graph's Laplacian, u = 0 at pins."""
    from scipy.sparse import coo_array, csr_array, diags_array
    from scipy.sparse.linalg import splu

    edges, free = surfaces.edges, surfaces.free
    n, rows = len(free), np.concatenate([edges[:, 0], edges[:, 1]])
    columns = np.concatenate([edges[:, 1], edges[:, 0]])
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n)).tocsr()
    matrix = csr_array(diags_array(1.0 + PATCH**2 * links.sum(axis=1)) - PATCH**2 * links)
    solve = splu(matrix[free][:, free].tocsc()).solve

    def smooth(gradient: np.ndarray) -> np.ndarray:
        found = np.zeros_like(gradient)
        found[free] = solve(gradient[free])
        return found

    return smooth
