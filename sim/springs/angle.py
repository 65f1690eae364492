"""Angle springs: q is the dihedral angle θ of a hinge.

After Bridson, Marino and Fedkiw (2003) and Grinspun et al. (2003).

With e = x2 − x1, triangle A = (x1, x2, x3) and B = (x2, x1, x4), the normals N1 = e × (x3 − x1) and N2 =
(x4 − x1) × e give θ = atan2(ê·(N2 × N1), N1·N2): zero when flat, positive when the tips x3 and x4 move to
the side that N1 points to. The gradient needs no trigonometry, and sums to no net force and no net torque.
"""

import math

from sim.compiled import Vec3, add, cross, dot, kernel, norm, put_corner, row, scale, sub

THINNEST = 1e-3
"""A triangle lower than this part of the hinge's edge has no reliable normal: the hinge then does not act."""


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = θ [rad], unwrapped beyond ±π by the angle of the last step, and ∂θ/∂x1 … ∂θ/∂x4."""
    for e in range(len(nodes)):
        x1 = row(positions, nodes[e, 0])
        edge = sub(row(positions, nodes[e, 1]), x1)
        to3 = sub(row(positions, nodes[e, 2]), x1)
        to4 = sub(row(positions, nodes[e, 3]), x1)
        n1 = cross(edge, to3)
        n2 = cross(to4, edge)
        length = norm(edge)
        square1 = dot(n1, n1)
        square2 = dot(n2, n2)
        if min(square1, square2) <= (THINNEST * length * length) ** 2:
            q[e] = memory[e, 0]
            new_memory[e, 0] = memory[e, 0]
            for a in range(4):
                put_corner(gradient, e, a, Vec3(0.0, 0.0, 0.0))
            continue
        theta = math.atan2(dot(edge, cross(n2, n1)) / length, dot(n1, n2))
        turn = theta - memory[e, 0]
        q[e] = memory[e, 0] + turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
        new_memory[e, 0] = q[e]
        g3 = scale(length / square1, n1)
        g4 = scale(length / square2, n2)
        t3 = dot(to3, edge) / (length * length)
        t4 = dot(to4, edge) / (length * length)
        put_corner(gradient, e, 0, add(scale(t3 - 1.0, g3), scale(t4 - 1.0, g4)))
        put_corner(gradient, e, 1, add(scale(-t3, g3), scale(-t4, g4)))
        put_corner(gradient, e, 2, g3)
        put_corner(gradient, e, 3, g4)
