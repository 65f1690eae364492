"""Who judges contact from outside: ipctk on every step, where it is installed, and Muslin's exact test.

ipctk (the IPC Toolkit) is independent, and alone sees what passes wholly through something else within a
step. Without it only crossings at the end of a step are seen, by `sim.intersections`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from sim.contact.intersections import intersections
from sim.scene import Box
from sim.simulation import Simulation

try:
    import ipctk
except ImportError:
    ipctk = None

VERTEX_TRIANGLE, EDGE_EDGE = "vertex-triangle", "edge-edge"

HALVINGS = 60
"""Parts of a way this small are told apart by nothing that float64 can tell."""

FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)
"""A box's triangles, by corners that count up z fastest and x slowest."""


class Judge:
    """Whether the cloth of a world crosses itself.

    Attributes:
        name: Who judges, in words.
    """

    def __init__(self, world: Simulation) -> None:
        self.edges, self.triangles = world.edges.copy(), world.triangles.copy()
        self.name, self._mesh = "sim.intersections, at the ends of steps only", None
        if ipctk is not None:
            self.name = f"ipctk {ipctk.__version__} and sim.intersections"
            self._mesh = ipctk.CollisionMesh(
                np.asfortranarray(world.mesh.vertices),
                np.asfortranarray(self.edges),
                np.asfortranarray(self.triangles),
            )

    def crossings(self, x: np.ndarray) -> int:
        """Crossings of edges and triangles at x (n, 3); at least 1 where ipctk alone sees one."""
        found = len(intersections(x, self.triangles))
        seen = (
            self._mesh is not None
            and ipctk is not None
            and ipctk.has_intersections(self._mesh, np.asfortranarray(x))
        )
        return max(found, int(seen))

    def clean(self, x: np.ndarray) -> bool:
        """Whether nothing crosses at x (n, 3)."""
        return not self.crossings(x)

    def meetings(self, x: np.ndarray, y: np.ndarray) -> list[tuple[str, list[int]]]:
        """Pairs that touch on the way from x to y, (n, 3) both: what they are, and their vertices."""
        return list(self.each_meeting(x, y))

    def each_meeting(self, x: np.ndarray, y: np.ndarray) -> Iterator[tuple[str, list[int]]]:
        """The same one by one, for those who ask whether there is any.

        `is_step_collision_free` flags what comes near, too, and tight inclusion what it did not finish; what
        both flag is told apart by separating planes, if there are any.
        """
        x, y = np.asfortranarray(x), np.asfortranarray(y)
        if self._mesh is None or ipctk is None or ipctk.is_step_collision_free(self._mesh, x, y):
            return
        near = ipctk.Candidates()
        near.build(self._mesh, x, y, 0.0)
        for pair in near.fv_candidates:
            i = [pair.vertex_id, *self.triangles[pair.face_id]]
            if point_meets_triangle(x[i], y[i]):
                yield VERTEX_TRIANGLE, i
        for pair in near.ee_candidates:
            i = [*self.edges[pair.edge0_id], *self.edges[pair.edge1_id]]
            if edges_meet(x[i], y[i]):
                yield EDGE_EDGE, i


MOST = {"min_distance": 0.0, "max_iterations": 20_000}
"""What tight inclusion is asked for: contact, and an answer."""


def point_meets_triangle(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether a point and a triangle, rows 0 and 1 to 3 of x (4, 3), touch on the way to y (4, 3)."""
    if ipctk is not None and not ipctk.tight_inclusion.point_triangle_ccd(*x, *y, **MOST)[0]:
        return False
    return not surely_apart(x, y, (0,))


def edges_meet(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether two edges, rows 0, 1 and 2, 3 of x (4, 3), touch on the way to y (4, 3)."""
    if ipctk is not None and not ipctk.tight_inclusion.edge_edge_ccd(*x, *y, **MOST)[0]:
        return False
    return not surely_apart(x, y, (0, 1))


def passages(
    before: np.ndarray, after: np.ndarray, triangles: np.ndarray, a: np.ndarray, b: np.ndarray
) -> int:
    """Triangles that a point on its way from a to b, (3,) both, goes through while their vertices move."""
    ways = np.stack([before, after])[:, triangles]  # (2, m, 3, 3)
    low, high = ways.min(axis=(0, 2)), ways.max(axis=(0, 2))
    near = np.flatnonzero(((low <= np.maximum(a, b)) & (high >= np.minimum(a, b))).all(axis=1))
    starts = (np.vstack([a, before[triangles[k]]]) for k in near)
    ends = (np.vstack([b, after[triangles[k]]]) for k in near)
    return sum(point_meets_triangle(x, y) for x, y in zip(starts, ends, strict=True))


def cut_by_boxes(world: Simulation) -> int:
    """Edges of cloth that cross a side of a box, and edges of boxes that cross cloth."""
    corners = 0.5 * np.array(list(product((-1.0, 1.0), repeat=3)))
    x, triangles, count = [world.positions], [world.triangles], len(world.positions)
    for obstacle, (position, rotation) in zip(world.scene.obstacle, world.obstacle_poses(), strict=True):
        if isinstance(obstacle, Box):
            triangles.append(FACES + sum(map(len, x)))
            x.append((corners * obstacle.size) @ rotation.T + position)
    every = np.concatenate(triangles)
    found = intersections(np.concatenate(x), every)
    edges = np.unique(np.sort(every[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    cloth_edge = edges[found[:, 0], 0] < count
    cloth_face = found[:, 1] < len(world.triangles)
    return int(np.count_nonzero(cloth_edge != cloth_face))


def surely_apart(x: np.ndarray, y: np.ndarray, one: Sequence[int]) -> bool:
    """Whether a plane parts the vertices `one` of a pair from the others all the way from x to y, (4, 3).

    The plane may be another in each part of the way, but does not turn within it: so its ends tell all.
    """
    other = [k for k in range(4) if k not in one]
    parts = [(0.0, 1.0, 0)]
    while parts:
        low, high, depth = parts.pop()
        ends = x + low * (y - x), x + high * (y - x)
        for n in _axes(0.5 * (ends[0] + ends[1]), one, other):
            gaps = [np.subtract.outer((z - z[0])[list(one)] @ n, (z - z[0])[other] @ n).ravel() for z in ends]
            if np.min(gaps) > 1e-15 or np.max(gaps) < -1e-15:
                break
        else:
            if depth == HALVINGS:
                return False
            middle = 0.5 * (low + high)
            parts += [(low, middle, depth + 1), (middle, high, depth + 1)]
    return True


def _axes(x: np.ndarray, one: Sequence[int], other: Sequence[int]) -> Iterator[np.ndarray]:
    """Unit vectors square to two edges, or to one and through a vertex, of the tetrahedron x."""
    a, b = x[list(one)], x[other]
    ways = [q - p for p, q in product(a, b)]
    sides = [q - p for half in (a, b) for k, p in enumerate(half) for q in half[k + 1 :]]
    if len(one) == 1:
        yield from _unit(np.cross(b[1] - b[0], b[2] - b[0]))
    else:
        yield from _unit(np.cross(a[1] - a[0], b[1] - b[0]))
    for side, way in product(sides, ways):
        yield from _unit(way - (way @ side) / max(side @ side, 1e-300) * side)
    for way in ways:
        yield from _unit(way)


def _unit(n: np.ndarray) -> list[np.ndarray]:
    size = np.linalg.norm(n)
    return [n / size] if size > 0.0 else []
