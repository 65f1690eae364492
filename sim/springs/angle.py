"""Angle springs: q is the dihedral angle θ of a hinge.

After Bridson, Marino and Fedkiw (2003) and Grinspun et al. (2003); the Hessian has the content of Tamstorf
and Grinspun (2013).

With e = x2 − x1, triangle A = (x1, x2, x3) and B = (x2, x1, x4), the normals N1 = e × (x3 − x1) and N2 =
(x4 − x1) × e give θ = atan2(ê·(N2 × N1), N1·N2): zero when flat, positive when the tips x3 and x4 move to
the side that N1 points to. The gradient needs no trigonometry, and sums to no net force and no net torque.
"""

import math
from typing import NamedTuple

from sim.compiled import Vec3, add, cross, dot, inner, kernel, norm, put_corner, row, scale, sub

THINNEST = 1e-3
"""A triangle lower than this part of the hinge's edge has no reliable normal: the hinge then does not act."""


class Hinge(NamedTuple):
    """A hinge at some instant; the normals N1 and N2 are as long as twice their triangle's area."""

    edge: Vec3
    to3: Vec3
    to4: Vec3
    length: float
    n1: Vec3
    n2: Vec3
    thin: bool


@inner
def hinge_at(positions, nodes, e):
    """Edges and normals of hinge e, and whether one of its triangles is too thin to have an angle."""
    x1 = row(positions, nodes[e, 0])
    edge = sub(row(positions, nodes[e, 1]), x1)
    to3 = sub(row(positions, nodes[e, 2]), x1)
    to4 = sub(row(positions, nodes[e, 3]), x1)
    n1 = cross(edge, to3)
    n2 = cross(to4, edge)
    length = norm(edge)
    thin = min(norm(n1), norm(n2)) <= THINNEST * length * length
    return Hinge(edge, to3, to4, length, n1, n2, thin)


@inner
def dihedral(hinge, last):
    """θ [rad], within half a turn of `last`: so it goes on past ±π."""
    theta = math.atan2(dot(hinge.edge, cross(hinge.n2, hinge.n1)) / hinge.length, dot(hinge.n1, hinge.n2))
    return theta - 2.0 * math.pi * math.floor((theta - last + math.pi) / (2.0 * math.pi))


@inner
def dihedral_gradient(hinge):
    """∂θ/∂x1 … ∂θ/∂x4."""
    g3 = scale(hinge.length / dot(hinge.n1, hinge.n1), hinge.n1)
    g4 = scale(hinge.length / dot(hinge.n2, hinge.n2), hinge.n2)
    t3 = dot(hinge.to3, hinge.edge) / (hinge.length * hinge.length)
    t4 = dot(hinge.to4, hinge.edge) / (hinge.length * hinge.length)
    g1 = add(scale(t3 - 1.0, g3), scale(t4 - 1.0, g4))
    g2 = add(scale(-t3, g3), scale(-t4, g4))
    return g1, g2, g3, g4


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = θ [rad], unwrapped beyond ±π by the angle of the last step, and ∂θ/∂x1 … ∂θ/∂x4."""
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        if hinge.thin:
            q[e] = memory[e, 0]
            gradient[e] = 0.0
        else:
            q[e] = dihedral(hinge, memory[e, 0])
            g1, g2, g3, g4 = dihedral_gradient(hinge)
            put_corner(gradient, e, 0, g1)
            put_corner(gradient, e, 1, g2)
            put_corner(gradient, e, 2, g3)
            put_corner(gradient, e, 3, g4)
        new_memory[e, 0] = q[e]


@kernel
def curvature(positions, nodes, memory, out):
    """Fill ∇²θ.

    The gradient rows are n1/h1 on x3, n2/h2 on x4, and minus their shares 1 − t and t on x1 and x2, so that
    δ(n/h) = G δx and δt = τ δx of each triangle give every row.
    """
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        out[e] = 0.0
        if hinge.thin:
            continue
        along = scale(1.0 / hinge.length, hinge.edge)
        for side in range(2):
            to = hinge.to3 if side == 0 else hinge.to4
            area = hinge.n1 if side == 0 else hinge.n2
            height = norm(area) / hinge.length
            n = scale(1.0 / norm(area), area)
            t = dot(to, along) / hinge.length
            m = scale(1.0 / height, sub(to, scale(t, hinge.edge)))
            tip = 2 + side
            for j in range(4):
                lever = t - 1.0 if j == 0 else (-t if j == 1 else (1.0 if j == tip else 0.0))
                turn = -1.0 if j == 0 else (1.0 if j == 1 else 0.0)
                for s in range(3):
                    tau = (along[s] * lever + height / hinge.length * m[s] * turn) / hinge.length
                    for r in range(3):
                        g = -(m[r] * n[s] + n[r] * m[s]) * lever / height**2 - along[r] * n[s] * turn / (
                            height * hinge.length
                        )
                        out[e, 3 * tip + r, 3 * j + s] += g
                        out[e, r, 3 * j + s] += (t - 1.0) * g + n[r] / height * tau
                        out[e, 3 + r, 3 * j + s] += -t * g - n[r] / height * tau
