"""Coarse levels of a mesh: lattices over its rest shape, and the weights that interpolate from their nodes.

Inside a cell of a lattice, interpolation is linear on the simplex of Freudenthal's triangulation that holds
the point: up to four nodes, found by sorting, whose weights reproduce every motion that is linear in the rest
shape. A flat shape in a plane of the lattice meets three.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.solve.graph import starts

NEGLIGIBLE = 1e-3
"""Coordinates this part of a cell above a lattice plane count as lying on it."""


class Weights(NamedTuple):
    """Interpolation from m nodes to n points, by point.

    Attributes:
        first: (n + 1,) where each point's nodes start.
        node: The nodes that a point depends on.
        weight: Their weights, which add up to one, or to zero for a point that depends on none.
    """

    first: np.ndarray
    node: np.ndarray
    weight: np.ndarray


def principal_axes(points: np.ndarray) -> np.ndarray:
    """`points` (k, 3) about their centre, turned so that the widest extent is x and the smallest z."""
    centred = points - points.mean(axis=0)
    return centred @ np.linalg.eigh(centred.T @ centred)[1][:, ::-1]


def interpolate(points: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Linear interpolation at `points` (k, 3) on a lattice.

    Returns:
        (point, node, weight) of every weight that is not zero, and the positions (m, 3) of the nodes.
    """
    scaled = (points - points.min(axis=0, initial=np.inf)) / spacing
    cell = np.floor(scaled + NEGLIGIBLE)
    inside = np.clip(scaled - cell, 0.0, 1.0)
    inside[inside < NEGLIGIBLE] = 0.0
    order = np.argsort(-inside, axis=1, kind="stable")
    steps = np.take_along_axis(inside, order, axis=1)
    weights = np.diff(steps, axis=1, prepend=1.0, append=0.0) * -1.0
    corner, point, corners, weight = cell, [], [], []
    for k in range(4):
        kept = np.flatnonzero(weights[:, k] > 0.0)
        point.append(kept)
        corners.append(corner[kept])
        weight.append(weights[kept, k])
        if k < 3:
            corner = corner + (np.arange(3) == order[:, k, None])
    nodes, node = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    return np.concatenate(point), node.ravel(), np.concatenate(weight), nodes * spacing


def by_point(point: np.ndarray, node: np.ndarray, weight: np.ndarray, n: int) -> Weights:
    """The same weights, ordered by point."""
    order = np.lexsort((node, point))
    return Weights(starts(point[order], n), node[order].astype(np.int64), weight[order])
