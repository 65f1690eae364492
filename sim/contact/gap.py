"""The contact coordinate: q is the gap between a vertex and the plane that an obstacle shows it.

A contact is an element like a spring, q(x) = n·x − offset with gradient n, so that force, damping, matrix
and energy are those of `sim.elements`. Its memory holds the plane: n, then the offset, both at the end of
the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import kernel
from sim.contact.detect import Contacts
from sim.contact.friction import CREEP, EXCESS, add_drag, expected_drag
from sim.contact.response import Response, lacks, targets
from sim.elements import NONE, Elements, make_elements, set_matrix_factors, set_tension
from sim.settings import Settings
from sim.solve.system import Matrix, add_single_node


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = n·x − offset [m] and its gradient n."""
    for e in range(len(nodes)):
        i = nodes[e, 0]
        q[e] = -memory[e, 3]
        for r in range(3):
            q[e] += memory[e, r] * positions[i, r]
            gradient[e, 0, r] = memory[e, r]
        for m in range(4):
            new_memory[e, m] = memory[e, m]


class GapSprings(NamedTuple):
    """The contacts that the implicit solve feels.

    Attributes:
        elements: Gap coordinates, one node each.
        obstacle: (c,) the obstacle of each.
        speed: (c, 3) velocity of the obstacle's surface [m/s].
        drag: (c,) d, the friction force per slip [N s/m].
    """

    elements: Elements
    obstacle: np.ndarray
    speed: np.ndarray
    drag: np.ndarray

    @property
    def vertex(self) -> np.ndarray:
        """(c,) the vertex of each."""
        return self.elements.nodes[:, 0]

    def measure(self, positions: np.ndarray) -> None:
        """Evaluate the gaps at `positions` (n, 3) [m]."""
        e = self.elements
        coordinate(positions, e.nodes, e.memory, e.q, e.gradient, e.new_memory)

    def linearise(
        self, positions: np.ndarray, velocities: np.ndarray, h: float, matrix: Matrix, forces: np.ndarray
    ):
        """Add the gap springs at `positions` and `velocities` to `matrix` and `forces`."""
        if not len(self.drag):
            return
        self.measure(positions)
        set_tension(self.elements, velocities)
        set_matrix_factors(self.elements, h, NONE)
        add_single_node(self.elements, matrix, forces)
        add_drag(self, self.drag, velocities, h, matrix, forces)

    def settle(self, start, positions, velocities, model, friction, h, forces) -> bool:
        """Estimate the friction anew after a solve from the velocities `start` that ended at `velocities`.

        Returns whether some vertex is held by more than its cone allows, with the model's matrix and
        `forces` changed to the new drag, so that the solve should go on.
        """
        if not len(self.drag):
            return False
        drag, pushes = np.zeros_like(self.drag), self.pushes(positions, velocities, h)
        if (
            expected_drag(self, model.mesh.pieces, model.piece_masses, velocities, pushes, friction, h, drag)
            <= EXCESS
        ):
            return False
        add_drag(self, drag - self.drag, start, h, model.matrix, forces)
        self.drag[:] = drag
        return True

    def slip(self, velocities: np.ndarray) -> np.ndarray:
        """(c,) speed across each contact [m/s]."""
        passing = velocities[self.vertex] - self.speed
        normal = self.elements.gradient[:, 0]
        return np.linalg.norm(passing - _along(normal, passing)[:, None] * normal, axis=1)

    def energy(self, positions: np.ndarray) -> float:
        """Energy [J] stored at `positions` in the gap springs that push; none of them can pull."""
        self.measure(positions)
        overlap = np.minimum(self.elements.q - self.elements.rest, 0.0)
        return 0.5 * float(self.elements.stiffness @ overlap**2)

    def forces(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(n, 3) forces [N] of the gap springs that push at `positions`, without friction."""
        forces = np.zeros_like(positions)
        if len(self.drag):
            self.measure(positions)
            set_tension(self.elements, velocities)
            push = np.maximum(-self.elements.tension, 0.0)[:, None] * self.elements.gradient[:, 0]
            np.add.at(forces, self.vertex, push)
        return forces

    def release(self, positions: np.ndarray, slack: float) -> None:
        """Let go, for the rest of the step, of vertices farther than `slack` [m] off their target."""
        self.measure(positions)
        held = self.elements.q <= self.elements.rest + slack
        for strength in (self.elements.stiffness, self.elements.damping, self.drag):
            strength *= held

    def pushes(self, positions: np.ndarray, velocities: np.ndarray, h: float) -> np.ndarray:
        """(c,) normal impulse of each gap spring over a step that ends so [N s]."""
        self.measure(positions)
        set_tension(self.elements, velocities)
        return h * np.maximum(-self.elements.tension, 0.0)


NO_GAP_SPRINGS = GapSprings(
    make_elements(np.zeros((0, 1)), 4), np.zeros(0, dtype=np.int32), np.zeros((0, 3)), np.zeros(0)
)
"""What a step without contacts feels."""


def gap_springs(
    response: Response | None,
    contacts: Contacts,
    masses: np.ndarray,
    predicted: np.ndarray,
    velocities: np.ndarray,
    pressed: np.ndarray,
    slip: np.ndarray,
    settings: Settings,
) -> GapSprings:
    """The gap springs of contacts that pressed in the step before, or that would unhindered end too close.

    Args:
        response: Which response; none has no springs.
        contacts: What detection found.
        masses: (n,) [kg].
        predicted: (n, 3) where vertices would go without springs and contacts [m].
        velocities: (n, 3) at the start of the step [m/s].
        pressed: (c,) normal impulse of each contact in the step before [N s].
        slip: (c,) slip expected after that step, zero for a new contact [m/s].
        settings: dt, thickness and friction are read.
    """
    if response is None or not len(contacts.vertex):
        return NO_GAP_SPRINGS
    h = settings.dt
    target = targets(response, contacts, settings.thickness, h)
    lack = lacks(response, contacts, predicted, settings.thickness, h)
    kept = np.flatnonzero((lack > 0.0) | (pressed > 0.0))
    normal, speed, mass = contacts.normal[kept], contacts.speed[kept], masses[contacts.vertex[kept]]
    elements = make_elements(contacts.vertex[kept, None], 4)
    elements.memory[:] = contacts.planes()[kept]
    elements.stiffness[:] = response.stiffness * mass / h**2
    elements.rest[:] = target[kept]
    elements.drift[:] = _along(normal, speed)
    passing = velocities[contacts.vertex[kept]] - speed
    closing = _along(normal, passing)
    critical = 2.0 * np.sqrt(mass * elements.stiffness)
    elements.damping[:] = np.where(closing < 0.0, response.damping * critical, 0.0)
    sliding = np.linalg.norm(passing - closing[:, None] * normal, axis=1)
    force = np.maximum(pressed[kept] / h, mass * np.maximum(lack[kept], 0.0) / h**2)
    drag = settings.friction * force / np.maximum(np.maximum(sliding, slip[kept]), CREEP)
    return GapSprings(elements, contacts.obstacle[kept], speed, drag)


def _along(normals: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", normals, vectors)
