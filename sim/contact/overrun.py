"""Which vertices obstacles have run over: pinned ones, and those that had no way out.

What belongs to such a vertex is in the obstacle, or goes through it, and is let go of: a mesh would else hold
it on the wrong side when it leaves. All else of the cloth is kept apart from the obstacle as ever, which so
stays in the hole of the elements around such vertices, and goes out there again. A vertex is forgotten once
none of its elements crosses the obstacle and, where that is closed, it is not inside.

The same holds of cloth that is found across an obstacle which nothing has kept it apart from: at a start that
is kept as it is, or as contact, detection or an obstacle is switched on. Cloth that is all inside a mesh may
belong there, as in a box. What is not let go of by shapes that have an inside leaves them, if it can.
"""

from __future__ import annotations

import numpy as np

from sim.contact.contacts import NOT_OVER
from sim.contact.faces import overlapping
from sim.contact.intersections import crossing
from sim.contact.obstacles import MESH, Obstacles, Poses
from sim.mesh import Mesh, elements, sides_of


def joined(over: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(k, 2) vertices and obstacles of both, each once, ascending."""
    return np.unique(np.concatenate([over, more]), axis=0) if len(more) else over


def found_over(o: int, mesh: Mesh, obstacles: Obstacles, poses: Poses, positions: np.ndarray) -> np.ndarray:
    """(k, 2) vertices of cloth at `positions` (n, 3) [m] that is found across obstacle o, and o.

    With them those inside of a mesh that edges join to such.
    """
    about = obstacles, poses, positions
    if obstacles.shapes.kind[o] == MESH:
        over = _crossing(o, elements(mesh), *about)
        joined_to = np.flatnonzero(np.isin(mesh.parts, mesh.parts[over])) if len(over) else over
        over = np.union1d(over, _inside(o, joined_to, *about))
    else:
        over = _overlapping(o, elements(mesh), *about)
    return np.stack([over, np.full(len(over), o)], axis=1).astype(np.int64)


def still_over(
    over: np.ndarray, mesh: Mesh, obstacles: Obstacles, poses: Poses, positions: np.ndarray
) -> np.ndarray:
    """Those of the vertices and obstacles `over` (k, 2) where cloth at `positions` (n, 3) [m] is not free."""
    left, around = [NOT_OVER], elements(mesh)
    for o in np.unique(over[:, 1]):
        mine = over[over[:, 1] == o]
        theirs = around[np.isin(around, mine[:, 0]).any(axis=1)]
        about = obstacles, poses, positions
        if obstacles.shapes.kind[o] == MESH:
            through = np.union1d(_crossing(o, theirs, *about), _inside(o, mine[:, 0], *about))
        else:
            through = _overlapping(o, theirs, *about)
        left.append(mine[np.isin(mine[:, 0], through)])
    return np.concatenate(left)


def _overlapping(
    o: int, faces: np.ndarray, obstacles: Obstacles, poses: Poses, positions: np.ndarray
) -> np.ndarray:
    """(k,) vertices of edges and triangles of `faces` (f, 3) that overlap obstacle o, which is no mesh."""
    overlaps = np.empty(len(faces), dtype=bool)
    overlapping(obstacles.shapes, o, poses, faces, positions, overlaps)
    return np.unique(faces[overlaps])


def _crossing(
    o: int, faces: np.ndarray, obstacles: Obstacles, poses: Poses, positions: np.ndarray
) -> np.ndarray:
    """(k,) vertices of edges and triangles of `faces` (f, 3) that cross the mesh obstacle o."""
    n, solid = len(positions), obstacles.solid
    theirs = solid.triangles[solid.part[solid.triangles[:, 0]] == o] + n
    every = np.concatenate([faces, theirs]).astype(np.int64)
    edges = sides_of(every, n + len(solid.vertices))
    found = crossing(np.concatenate([positions, obstacles.corners(poses)]), edges, every)
    sides, corners = edges[found[:, 0]], every[found[:, 1]]
    of_side, of_face = sides[:, 0] < n, corners[:, 0] < n
    return np.unique(np.concatenate([sides[of_side & ~of_face].ravel(), corners[~of_side & of_face].ravel()]))


def _inside(
    o: int, which: np.ndarray, obstacles: Obstacles, poses: Poses, positions: np.ndarray
) -> np.ndarray:
    """(k,) those of the vertices `which` that are inside the mesh obstacle o, if that is closed."""
    shell = obstacles.shells[o]
    if shell is None or shell.open_edges or not len(which):
        return which[:0]
    places = (positions[which] - poses.position[o]) @ poses.rotation[o]
    low, high = shell.vertices.min(axis=0), shell.vertices.max(axis=0)
    inside = ((places >= low) & (places <= high)).all(axis=1)
    inside[inside] = [shell.encloses(place) for place in places[inside]]
    return which[inside]
