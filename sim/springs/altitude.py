"""Altitude springs: q is the height of a triangle's apex p over the line of the opposite edge a → b.

After the course notes, and the altitude springs of Selle, Lentine and Fedkiw (2008). With e = b − a, the
foot is a + t e, t = (p − a)·e/|e|², not clamped to the edge: the weights (1, −(1 − t), −t) along n are then
the exact gradient of the height, also of an obtuse triangle, and neither push nor turn it as a whole.

The height has a sign. A triangle that collapsed and went on is inside out, its height is negative, and the
spring pushes it back the way it came. Which way that is, the triangle's normal ê × n of the last step tells.
"""

import numba
import numpy as np

from sim.compiled import cross, dot, kernel, norm, parallel_kernel, put, put_corner, row, scale, sub

SHORTEST = 1e-12
"""A shorter edge [m] is a point, and a lower triangle has no direction but that of the last step."""


@parallel_kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q [m] and its gradient w n, w = (1, −(1 − t), −t); the memory is the normal ê × n."""
    for e in numba.prange(len(nodes)):
        a = row(positions, nodes[e, 1])
        edge = sub(row(positions, nodes[e, 2]), a)
        to = sub(row(positions, nodes[e, 0]), a)
        length = norm(edge)
        along = scale(1.0 / length, edge) if length > SHORTEST else scale(0.0, edge)
        t = dot(to, along) / length if length > SHORTEST else 0.0
        rise = sub(to, scale(t, edge))
        rise = sub(rise, scale(dot(rise, along), along))  # once more, so that an obtuse one loses no digits
        height = norm(rise)
        before = cross(row(memory, e), along)
        if height > SHORTEST:
            n = scale((-1.0 if dot(rise, before) < 0.0 else 1.0) / height, rise)
        else:
            size = norm(before)
            n = scale(1.0 / size, before) if size > SHORTEST else before
        q[e] = dot(rise, n)
        put_corner(gradient, e, 0, n)
        put_corner(gradient, e, 1, scale(t - 1.0, n))
        put_corner(gradient, e, 2, scale(-t, n))
        normal = cross(along, n)
        put(new_memory, e, normal if dot(normal, normal) > 0.5 else row(memory, e))


@kernel
def curvature(positions, nodes, memory, out):
    """Fill ∇²q: w wᵀ mmᵀ/q + (w sᵀ ê nᵀ + s wᵀ n êᵀ)/|e| − s sᵀ q nnᵀ/|e|², s = (0, 1, −1), m = ê × n."""
    for e in range(len(nodes)):
        a = row(positions, nodes[e, 1])
        edge = sub(row(positions, nodes[e, 2]), a)
        to = sub(row(positions, nodes[e, 0]), a)
        length = norm(edge)
        out[e] = 0.0
        if length <= SHORTEST:
            continue
        along = scale(1.0 / length, edge)
        t = dot(to, along) / length
        rise = sub(to, scale(t, edge))
        height = norm(rise)
        if height <= SHORTEST:
            continue
        sign = -1.0 if dot(rise, cross(row(memory, e), along)) < 0.0 else 1.0
        n = scale(sign / height, rise)
        height *= sign
        m = cross(along, n)
        for i in range(3):
            w_i = 1.0 if i == 0 else (t - 1.0 if i == 1 else -t)
            s_i = 0.0 if i == 0 else (1.0 if i == 1 else -1.0)
            for j in range(3):
                w_j = 1.0 if j == 0 else (t - 1.0 if j == 1 else -t)
                s_j = 0.0 if j == 0 else (1.0 if j == 1 else -1.0)
                for r in range(3):
                    for s in range(3):
                        out[e, 3 * i + r, 3 * j + s] = (
                            w_i * w_j * m[r] * m[s] / height
                            + (w_i * s_j * along[r] * n[s] + s_i * w_j * n[r] * along[s]) / length
                            - s_i * s_j * height * n[r] * n[s] / length**2
                        )


def active(q, settings):
    """(e,) which altitudes act: all, or of each triangle's three in a row the shortest, or none."""
    if settings.altitudes == "all":
        return np.ones(len(q), dtype=bool)
    if settings.altitudes == "none":
        return np.zeros(len(q), dtype=bool)
    heights = np.abs(q).reshape(-1, 3)
    return (np.arange(3) == heights.argmin(axis=1)[:, None]).ravel()
