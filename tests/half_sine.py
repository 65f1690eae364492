"""Half-sine springs: q = 2 sin(θ/2), bounded and monotone up to a half turn (Bridson et al. 2003)."""

import math

from sim.compiled import kernel, put_corner, scale
from sim.springs.angle import dihedral, dihedral_gradient, hinge_at


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = 2 sin(θ/2) and its gradient cos(θ/2) ∇θ; the memory is θ."""
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        theta = memory[e, 0] if hinge.thin else dihedral(hinge, memory[e, 0])
        new_memory[e, 0] = theta
        q[e] = 2.0 * math.sin(0.5 * theta)
        gradient[e] = 0.0
        if not hinge.thin:
            for a, g in enumerate(dihedral_gradient(hinge)):
                put_corner(gradient, e, a, scale(math.cos(0.5 * theta), g))
