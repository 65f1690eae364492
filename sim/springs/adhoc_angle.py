"""Angle springs as one would make them up: wrong on purpose, to show what goes wrong.

The course notes warn of them. The torque of a folded hinge, K (θ − θ0), is turned into a force along each
triangle's normal at its tip, and something is or is not given back to the shared edge. None of the rules is
the gradient of an energy: they push the cloth as a whole, or turn it, out of nothing. K is that of an angle
spring, and |e|, the length of the shared edge, the lever where a rule has none.
"""

from sim.compiled import add, inner, kernel, norm, put_corner, scale
from sim.springs.angle import dihedral, hinge_at


@inner
def _place(e, g3, g4, back, gradient):
    """Write what stands for the gradient: g3 and g4 on the tips, their sum taken `back` by the edge."""
    reaction = scale(-back, add(g3, g4))
    put_corner(gradient, e, 0, reaction)
    put_corner(gradient, e, 1, reaction)
    put_corner(gradient, e, 2, g3)
    put_corner(gradient, e, 3, g4)


@inner
def _fill(rule, positions, nodes, memory, q, gradient, new_memory):
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        q[e] = memory[e, 0]
        gradient[e] = 0.0
        if not hinge.thin:
            q[e] = dihedral(hinge, memory[e, 0])
            arm3 = norm(hinge.n1) / hinge.length if rule == 2 else hinge.length
            arm4 = norm(hinge.n2) / hinge.length if rule == 2 else hinge.length
            g3 = scale(1.0 / (arm3 * norm(hinge.n1)), hinge.n1)
            g4 = scale(1.0 / (arm4 * norm(hinge.n2)), hinge.n2)
            _place(e, g3, g4, 0.0 if rule == 0 else 0.5, gradient)
        new_memory[e, 0] = q[e]


@kernel
def tips(positions, nodes, memory, q, gradient, new_memory):
    """Forces on the tips alone: net force and net torque."""
    _fill(0, positions, nodes, memory, q, gradient, new_memory)


@kernel
def half(positions, nodes, memory, q, gradient, new_memory):
    """Half of the tips' forces given back at each end of the edge: no net force, but a net torque."""
    _fill(1, positions, nodes, memory, q, gradient, new_memory)


@kernel
def lever(positions, nodes, memory, q, gradient, new_memory):
    """The right forces on the tips, but half given back at each end: still a net torque."""
    _fill(2, positions, nodes, memory, q, gradient, new_memory)


coordinate = tips
