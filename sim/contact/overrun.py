"""Which vertices obstacles have run over: pinned ones, and those that had no way out.

What belongs to such a vertex is in the obstacle, or goes through it, and is let go of: a mesh would else hold
it on the wrong side when it leaves. All else of the cloth is kept apart from the obstacle as ever, which so
stays in the hole of the elements around such vertices, and goes out there again. A vertex is forgotten once
none of its elements crosses the obstacle and, where that is closed, it is not inside.
"""

from __future__ import annotations

import numpy as np

from sim.contact.contacts import NOT_OVER
from sim.contact.faces import overlapping
from sim.contact.intersections import intersections
from sim.contact.obstacles import MESH, Obstacles, Poses
from sim.mesh import Mesh, distinct_edges, elements


def joined(over: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(k, 2) vertices and obstacles of both, each once, ascending."""
    return np.unique(np.concatenate([over, more]), axis=0) if len(more) else over


def still_over(
    over: np.ndarray, mesh: Mesh, obstacles: Obstacles, poses: Poses, positions: np.ndarray
) -> np.ndarray:
    """Those of the vertices and obstacles `over` (k, 2) where cloth at `positions` (n, 3) [m] is not free."""
    left = [NOT_OVER]
    for o in np.unique(over[:, 1]):
        mine = over[over[:, 1] == o]
        around = elements(mesh)
        around = around[np.isin(around, mine[:, 0]).any(axis=1)]
        through = _through_mesh if obstacles.shapes.kind[o] == MESH else _through_shape
        left.append(mine[np.isin(mine[:, 0], through(o, around, mine[:, 0], obstacles, poses, positions))])
    return np.concatenate(left)


def _through_shape(
    o: int, around: np.ndarray, _: np.ndarray, obstacles: Obstacles, poses: Poses, x: np.ndarray
) -> np.ndarray:
    """Vertices of the elements `around` (f, 3) that overlap obstacle o."""
    overlaps = np.empty(len(around), dtype=bool)
    overlapping(obstacles.shapes, o, poses, around, x, overlaps)
    return around[overlaps]


def _through_mesh(
    o: int, around: np.ndarray, which: np.ndarray, obstacles: Obstacles, poses: Poses, x: np.ndarray
) -> np.ndarray:
    """Vertices of the elements `around` (f, 3) that cross obstacle o, and those of `which` inside it."""
    n, solid, shell = len(x), obstacles.solid, obstacles.shells[o]
    theirs = solid.triangles[solid.part[solid.triangles[:, 0]] == o] + n
    every = np.concatenate([around, theirs]).astype(np.int64)
    found = intersections(np.concatenate([x, obstacles.corners(poses)]), every)
    edges = distinct_edges(every, np.zeros((0, 2), dtype=np.int64), n + len(solid.vertices))
    sides, faces = edges[found[:, 0]], every[found[:, 1]]
    of_side, of_face = sides[:, 0] < n, faces[:, 0] < n
    crossing = [sides[of_side & ~of_face].ravel(), faces[~of_side & of_face].ravel()]
    if shell is not None and not shell.open_edges:
        places = (x[which] - poses.position[o]) @ poses.rotation[o]
        crossing.append(which[[shell.encloses(place) for place in places]])
    return np.concatenate(crossing)
