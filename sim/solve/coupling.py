"""The part of the matrix that contacts between vertices couple: Σ w_a w_b S over each contact's vertices.

Which vertices touch changes with every step, so this part has no blocks of its own. It is applied as it is
written: each contact takes the weighted sum of its vertices, turns it by its tensor S, and gives every vertex
its share back, gathered in a fixed order. What it adds on the diagonal is in the matrix's own diagonal.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from sim.compiled import CHUNKS, inner, parallel_kernel, share


class Coupling(NamedTuple):
    """Of c contacts and n vertices.

    Attributes:
        node: (c, 4) vertices of each contact.
        weight: (c, 4) w.
        tensor: (c, 6) S: xx, xy, xz, yy, yz, zz.
        moved: (c, 3) room for S Σ w x.
        first: (n + 1,) where each vertex's contacts start in `contact` and `corner`.
        contact: the contacts of a vertex, ascending.
        corner: its place among the four of each.
    """

    node: np.ndarray
    weight: np.ndarray
    tensor: np.ndarray
    moved: np.ndarray
    first: np.ndarray
    contact: np.ndarray
    corner: np.ndarray


def build_coupling(n: int, node: np.ndarray, weight: np.ndarray, tensor: np.ndarray) -> Coupling:
    """The coupling of n vertices by contacts; `tensor` is shared, not copied."""
    contact, corner = np.nonzero(weight)
    vertex = node[contact, corner]
    order = np.argsort(vertex, kind="stable")
    first = np.searchsorted(vertex[order], np.arange(n + 1))
    return Coupling(node, weight, tensor, np.zeros((len(node), 3)), first, contact[order], corner[order])


def uncoupled(n: int) -> Coupling:
    """No contact at all."""
    return build_coupling(n, np.zeros((0, 4), dtype=np.int32), np.zeros((0, 4)), np.zeros((0, 6)))


@parallel_kernel
def move(coupling, x):
    """Fill moved = S Σ w x."""
    for chunk in numba.prange(CHUNKS):
        _move(
            coupling.node,
            coupling.weight,
            coupling.tensor,
            coupling.moved,
            x,
            share(chunk, len(coupling.node)),
        )


@inner
def _move(node, weight, tensor, moved, x, part):
    for c in range(part[0], part[1]):
        u = v = w = 0.0
        for a in range(4):
            i, s = node[c, a], weight[c, a]
            u += s * x[i, 0]
            v += s * x[i, 1]
            w += s * x[i, 2]
        t = tensor[c]
        moved[c, 0] = t[0] * u + t[1] * v + t[2] * w
        moved[c, 1] = t[1] * u + t[3] * v + t[4] * w
        moved[c, 2] = t[2] * u + t[4] * v + t[5] * w


@inner
def coupled(coupling, i, u, v, w):
    """What row i of the coupling gives, beyond its diagonal, where x_i = (u, v, w), after `move`."""
    x = y = z = 0.0
    for k in range(coupling.first[i], coupling.first[i + 1]):
        c = coupling.contact[k]
        s, t = coupling.weight[c, coupling.corner[k]], coupling.tensor[c]
        x += s * (coupling.moved[c, 0] - s * (t[0] * u + t[1] * v + t[2] * w))
        y += s * (coupling.moved[c, 1] - s * (t[1] * u + t[3] * v + t[4] * w))
        z += s * (coupling.moved[c, 2] - s * (t[2] * u + t[4] * v + t[5] * w))
    return x, y, z
