"""Springs between two vertices: q is their distance.

Along the sides of triangles these are edge springs (Provot 1995; Choi and Ko 2002 for the Hessian); between
the two vertices opposite a hinge they are cross-connect springs, which have no linear bending stiffness
about a flat rest shape, cannot tell a fold up from a fold down, and stiffen the cloth in its plane as well.
"""

import numba

from sim.compiled import kernel, norm, parallel_kernel, put, put_corner, row, scale, sub

SHORTEST = 1e-12
"""Vertices closer than this [m] have no direction; the one of the last step is kept."""


@parallel_kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = |x2 − x1| [m] and its gradient (−n, n); the memory is the direction n."""
    for e in numba.prange(len(nodes)):
        d = sub(row(positions, nodes[e, 1]), row(positions, nodes[e, 0]))
        length = norm(d)
        n = scale(1.0 / length, d) if length > SHORTEST else row(memory, e)
        q[e] = length
        put_corner(gradient, e, 0, scale(-1.0, n))
        put_corner(gradient, e, 1, n)
        put(new_memory, e, n)


@kernel
def curvature(positions, nodes, memory, out):
    """Fill ∇²q: ±(I − nnᵀ)/q, and zero for vertices that coincide."""
    for e in range(len(nodes)):
        d = sub(row(positions, nodes[e, 1]), row(positions, nodes[e, 0]))
        length = norm(d)
        for r in range(3):
            for s in range(3):
                value = 0.0
                if length > SHORTEST:
                    value = ((1.0 if r == s else 0.0) - d[r] * d[s] / length**2) / length
                out[e, r, s] = out[e, 3 + r, 3 + s] = value
                out[e, r, 3 + s] = out[e, 3 + r, s] = -value
