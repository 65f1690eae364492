"""Repair of triangles that nothing can be simulated on, each kind reported in one line with numbers from 0.

Pure NumPy on plain arrays, and quick for meshes of 50,000 triangles. What is left out or turned round is
always said; what a solver can live with (edges of three triangles, holes, several pieces) is left alone.
"""

from __future__ import annotations

import numpy as np

from sim.refusal import counted, listed

NO_AREA = 1e-12
"""Triangles smaller than this share of the squared size of the mesh have no direction to speak of."""

PINS = "; pins count the others"
"""What a missing vertex means to cloth."""


def repair_triangles(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Leave out useless triangles and wind neighbours alike.

    Args:
        vertices: (n, 3) positions [m], all finite.
        triangles: (m, 3) vertex indices, all in range.

    Returns:
        (k, 3) triangles in their old order, k ≤ m, and a line for each kind of repair that was needed.
    """
    empty = _without_area(vertices, triangles)
    repeated = _repeated(len(vertices), triangles, ~empty)
    warnings = _left_out(empty, "triangle without area", "triangles without area")
    warnings += _left_out(repeated, "repeated triangle")
    useless = empty | repeated
    triangles, turned = wound_alike(triangles[~useless] if useless.any() else triangles)
    return triangles, warnings + turned


def used_vertices(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Vertices that a triangle uses, in their old order, with the triangles renumbered to fit."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    if used.all():
        return vertices, triangles, []
    number = np.cumsum(used) - 1
    what = "vertex that no triangle uses", "vertices that no triangle uses"
    (warning,) = _left_out(~used, *what)
    return vertices[used], number[triangles], [warning + PINS]


def wound_alike(triangles: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Turn triangles round until neighbours agree, in each connected part the way most of it is wound.

    Neighbours are two triangles that share an edge with no third one. In the double cover of the mesh, where
    every triangle lies once as it is and once turned round and is joined to the copies that agree with it, a
    part that can be wound alike falls into two mirrored halves; a one-sided part (a Möbius strip) does not.
    """
    first, second, agree = _neighbours(triangles)
    if agree.all():
        return triangles, []
    m = len(triangles)
    crossed = np.where(agree, 0, m)
    cover = connected(
        2 * m, np.concatenate([first, first + m]), np.concatenate([second + crossed, second + m - crossed])
    )
    as_is, turned = cover[:m], cover[m:]
    one_sided = as_is == turned
    votes = np.bincount(as_is, minlength=2 * m)
    # Ties keep the half of the part's first triangle, which has the smaller label.
    outvoted = (votes[as_is] < votes[turned]) | ((votes[as_is] == votes[turned]) & (turned < as_is))
    flip = outvoted & ~one_sided
    warnings = []
    if flip.any():
        warnings.append(f"turned {counted(int(flip.sum()), 'triangle')} round so that neighbours agree")
    if one_sided.any():
        parts = len(np.unique(as_is[one_sided]))
        warnings.append(f"{counted(parts, 'one-sided part')} cannot be wound alike; its seam does not bend")
    return np.where(flip[:, None], triangles[:, ::-1], triangles), warnings


def _without_area(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) bool: triangles whose area is none beside the size of the mesh."""
    if len(triangles) == 0:
        return np.zeros(0, dtype=bool)
    corners = vertices[triangles]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    size = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
    return ~(area > NO_AREA * size**2)


def _repeated(n: int, triangles: np.ndarray, among: np.ndarray) -> np.ndarray:
    """(m,) bool: triangles with the same three of n vertices as one before, both `among` those that count."""
    number = np.flatnonzero(among)
    low, middle, high = np.sort(triangles[number].astype(np.int64), axis=1).T
    _, pair = np.unique(low * n + middle, return_inverse=True)
    _, first = np.unique(pair * n + high, return_index=True)
    repeated = among.copy()
    repeated[number[first]] = False
    return repeated


def _left_out(which: np.ndarray, one: str, many: str = "") -> list[str]:
    """In words, which things were left out, (m,) bool."""
    numbers = np.flatnonzero(which)
    return [f"left out {counted(len(numbers), one, many)}: {listed(numbers)}"] if len(numbers) else []


def _neighbours(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles that share an edge with no third, and whether they run along it opposite ways."""
    start = triangles.astype(np.int64).ravel()
    end = triangles[:, [1, 2, 0]].astype(np.int64).ravel()
    key = np.minimum(start, end) * (int(triangles.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, at, count = np.unique(key[order], return_index=True, return_counts=True)
    a, b = order[at[count == 2]], order[at[count == 2] + 1]
    return a // 3, b // 3, start[a] != start[b]


def connected(n: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """For each of n nodes, the smallest node that the pairs (a, b) connect it to.

    Hooks trees of labels together and halves their depth in turn (Shiloach and Vishkin 1982): a few dozen
    passes over the arrays where walking a long strip would take as many passes as it has triangles.
    """
    label = np.arange(n)
    while True:
        low = np.minimum(label[a], label[b])
        if np.array_equal(low, label[a]) and np.array_equal(low, label[b]):
            return label
        np.minimum.at(label, label[a], low)
        np.minimum.at(label, label[b], low)
        while not np.array_equal(label, shorter := label[label]):
            label = shorter
