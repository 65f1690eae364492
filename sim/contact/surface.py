"""The surface that can touch itself: features, who owns them, which are neighbours, and a tree over them.

The elements of a surface are its triangles, then the edges that no triangle has, then the vertices that no
edge has. Each vertex and each edge belongs to one element, so that a pair of elements stands for a few pairs
of features and no pair of features is met twice. Elements that share a vertex are neighbours; theirs are the
pairs that every broad phase would find again, so they are worked out here, once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.mesh import build_hinges, elements_of

LEAF = 4
"""Elements of a leaf of the tree."""

HUB = 24
"""Elements at a vertex beyond which they are no neighbours: all pairs of them would be too many."""


FLAT = 1e-7
"""Height over an edge's length by which two triangles may be off one plane: what single precision rounds."""


class Tree(NamedTuple):
    """A binary tree over f elements in preorder: node i's first child is i + 1, its second skip[i + 1].

    Attributes:
        begin: (t,) first element below each node.
        end: (t,) the one after the last.
        skip: (t,) the node after the last below each node.
        leaf: (l,) the nodes without children.
    """

    begin: np.ndarray
    end: np.ndarray
    skip: np.ndarray
    leaf: np.ndarray


class Surface(NamedTuple):
    """f elements and e edges on the vertices of cloth and of mesh obstacles.

    Attributes:
        faces: (f, 3) int32 vertices of each element, in the tree's order; an edge repeats its second, and a
            vertex itself.
        solid: (f,) bool, whether it is a triangle.
        edges: (e, 2) int32.
        own_vertex: (f, 3) bool, which of its corners an element owns.
        own_edge: (f, 3) int32 the edges that it owns, −1 elsewhere.
        crowded: (n,) bool, vertices with more than HUB elements.
        near_vertices: (p, 2) int32 a vertex and an element, of neighbours.
        near_edges: (q, 2) int32 two edges, of neighbours.
    """

    faces: np.ndarray
    solid: np.ndarray
    edges: np.ndarray
    own_vertex: np.ndarray
    own_edge: np.ndarray
    crowded: np.ndarray
    near_vertices: np.ndarray
    near_edges: np.ndarray

    def without(self, vertices: np.ndarray, edges: np.ndarray) -> Surface:
        """The same, with none of these `vertices` (n,) and `edges` (e,), both bool, looking for partners."""
        return self._replace(
            own_vertex=self.own_vertex & ~vertices[self.faces],
            near_vertices=self.near_vertices[~vertices[self.near_vertices[:, 0]]],
            own_edge=np.where((self.own_edge >= 0) & edges[self.own_edge], np.int32(-1), self.own_edge),
            near_edges=self.near_edges[~edges[self.near_edges].any(axis=1)],
        )


def inside_flats(
    positions: np.ndarray, triangles: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) and (e,) bool, which vertices and `edges` (e, 2) lie inside flat parts of a rigid surface.

    What touches one of them touches the triangles around it, with a corner, or reaches beyond the flat part
    and touches its border. Felt for itself it would only be a bump that holds up what slides past.
    """
    hinges, _ = build_hinges(triangles, len(positions))
    a, b, c, d = positions[hinges.T]
    along, one, other = b - a, np.cross(b - a, c - a), np.cross(d - a, b - a)
    alike = np.einsum("ij,ij->i", one, other) > 0.0
    height = np.abs(np.einsum("ij,ij->i", one, d - a))
    flat = alike & (height <= FLAT * np.linalg.norm(one, axis=1) * np.linalg.norm(along, axis=1))
    within = np.isin(_keys(edges, len(positions)), _keys(hinges[flat, :2], len(positions)))
    bordering = np.bincount(edges[~within].ravel(), minlength=len(positions)) > 0
    return ~bordering, within


def build_surface(positions: np.ndarray, triangles: np.ndarray, edges: np.ndarray) -> tuple[Surface, Tree]:
    """The surface of `triangles` (m, 3) and `edges` (e, 2), and a tree for `positions` (n, 3) [m]."""
    faces = elements_of(triangles, edges, len(positions))
    order, tree = _tree(positions[faces].mean(axis=1))
    faces, solid = faces[order], order < len(triangles)
    n, f = len(positions), len(faces)
    own_vertex = np.zeros((f, 3), dtype=bool)
    vertices, first = np.unique(faces, return_index=True)
    own_vertex.ravel()[first] = True
    vertex_owner = np.full(n, -1)
    vertex_owner[vertices] = first // 3
    sides = _keys(_sides(faces), n).reshape(3, f).T.copy()
    sides[~solid, 1:] = -1
    sides[faces[:, 0] == faces[:, 1]] = -1
    keys = _keys(edges, n)
    by_key = np.argsort(keys, kind="stable")
    found, first = np.unique(sides, return_index=True)
    first = first[found >= 0]
    edge_of = by_key[np.searchsorted(keys[by_key], found[found >= 0])]
    own_edge = np.full((f, 3), -1, dtype=np.int32)
    own_edge.ravel()[first] = edge_of
    edge_owner = np.empty(len(edges), dtype=np.int64)
    edge_owner[edge_of] = first // 3
    count = np.bincount(np.concatenate([faces[solid].ravel(), faces[~solid, :2].ravel()]), minlength=n)
    crowded = count > HUB
    touching = _neighbours(faces, crowded)
    near = _near_vertices(faces, solid, own_vertex, touching), _near_edges(edges, own_edge, touching)
    return Surface(faces, solid, edges.astype(np.int32), own_vertex, own_edge, crowded, *near), tree


def _sides(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _keys(pairs: np.ndarray, n: int) -> np.ndarray:
    pairs = pairs.astype(np.int64)
    return pairs.min(axis=1) * n + pairs.max(axis=1)


def _neighbours(faces: np.ndarray, crowded: np.ndarray) -> np.ndarray:
    """(p, 2) pairs of elements, the lower first, that share a vertex which is not crowded."""
    corner = faces.ravel()
    element = np.repeat(np.arange(len(faces)), 3)
    fine = ~crowded[corner]
    order = np.lexsort((element[fine], corner[fine]))
    corner, element = corner[fine][order], element[fine][order]
    found = []
    for apart in range(1, 3 * HUB):
        same = corner[apart:] == corner[:-apart]
        if not same.any():
            break
        a, b = element[:-apart][same], element[apart:][same]
        found.append(np.stack([a[a < b], b[a < b]], axis=1))
    pairs = np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)
    return _distinct(pairs, len(faces))


def _distinct(pairs: np.ndarray, n: int) -> np.ndarray:
    keys = np.unique(pairs[:, 0] * n + pairs[:, 1])
    return np.stack(np.divmod(keys, n), axis=1) if len(keys) else np.zeros((0, 2), dtype=np.int64)


def _near_vertices(faces: np.ndarray, solid: np.ndarray, own: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Pairs of a vertex and a triangle, of neighbouring elements, that have no vertex in common."""
    both = np.concatenate([touching, touching[:, ::-1]])
    both = both[solid[both[:, 1]]]
    found = [
        np.stack([faces[both[:, 0], k], both[:, 1]], axis=1)[own[both[:, 0], k]].astype(np.int32)
        for k in range(3)
    ]
    pairs = np.concatenate(found)
    return np.ascontiguousarray(pairs[(faces[pairs[:, 1]] != pairs[:, :1]).all(axis=1)])


def _near_edges(edges: np.ndarray, own_edge: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Pairs of edges, of neighbouring elements, that have no vertex in common."""
    a, b = own_edge[touching[:, 0]], own_edge[touching[:, 1]]
    pairs = np.stack([np.repeat(a, 3, axis=1).ravel(), np.tile(b, 3).ravel()], axis=1)
    pairs = pairs[(pairs >= 0).all(axis=1)]
    one, other = edges[pairs[:, 0]], edges[pairs[:, 1]]
    apart = (one[:, :, None] != other[:, None, :]).all(axis=(1, 2))
    return np.ascontiguousarray(pairs[apart], dtype=np.int32)


def _tree(centers: np.ndarray) -> tuple[np.ndarray, Tree]:
    """The order of the elements, and a tree that halves each node's along its longest side."""
    order = np.arange(len(centers))
    ranges = []
    pending = [(0, len(centers))] if len(centers) else []
    while pending:
        low, high = pending.pop()
        ranges.append((low, high))
        if high - low > LEAF:
            part = order[low:high]
            axis = np.argmax(np.ptp(centers[part], axis=0))
            order[low:high] = part[np.argsort(centers[part, axis], kind="stable")]
            middle = low + LEAF * (-(-(high - low) // LEAF) // 2)
            pending += [(middle, high), (low, middle)]
    begin, end = np.array(ranges, dtype=np.int64).reshape(-1, 2).T
    leaves = -(-(end - begin) // LEAF)
    skip = np.arange(len(begin)) + 2 * leaves - 1
    return order, Tree(begin.copy(), end.copy(), skip, np.flatnonzero(leaves == 1))
