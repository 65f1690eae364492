"""A bending kind that Muslin does not have, as someone else would add it: q = 2 sin(θ/2).

Bounded and monotone up to a half turn (Bridson, Marino and Fedkiw 2003); the gradient is cos(θ/2) ∇θ.
"""

import math

from sim.compiled import kernel, put_corner, scale
from sim.springs.angle import dihedral, dihedral_gradient, hinge_at


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = 2 sin(θ/2) and its gradient; the memory is θ."""
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        theta = memory[e, 0] if hinge.thin else dihedral(hinge, memory[e, 0])
        new_memory[e, 0] = theta
        q[e] = 2.0 * math.sin(0.5 * theta)
        gradient[e] = 0.0
        if not hinge.thin:
            g1, g2, g3, g4 = dihedral_gradient(hinge)
            put_corner(gradient, e, 0, scale(math.cos(0.5 * theta), g1))
            put_corner(gradient, e, 1, scale(math.cos(0.5 * theta), g2))
            put_corner(gradient, e, 2, scale(math.cos(0.5 * theta), g3))
            put_corner(gradient, e, 3, scale(math.cos(0.5 * theta), g4))
