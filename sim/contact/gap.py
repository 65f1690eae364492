"""Gap springs: the contacts that the implicit solve feels.

A contact is an element like a spring, q(x) = Σ w_i n·x_i − offset with gradient w_i n, so that tension and
energy are those of `sim.elements`. Its drag across the normal is that of friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.compiled import dot, inner, kernel, row, scale
from sim.contact.contacts import NO_CONTACTS, Contacts, along, set_gaps, weighted
from sim.contact.friction import EXCESS, LACKING, expected_drag, first_drag, slip_of
from sim.contact.response import Response, lacks, targets
from sim.elements import NONE, Elements, make_elements, set_matrix_factors, set_tension
from sim.settings import Settings
from sim.solve.coupling import Coupling, build_coupling, uncoupled
from sim.solve.system import Matrix

FIRMER, STIFFEST = 10.0, 1e4
"""Times that a gap spring becomes stiffer at a time, and in all, so that impulses need not keep its gap."""


class GapSprings(NamedTuple):
    """Contacts and their springs.

    Attributes:
        contacts: That the solve feels; those with obstacles come last.
        pairs: How many of them are between vertices of the cloth.
        elements: Their gaps as coordinates.
        drag: (c,) d, the friction force per slip [N s/m].
        aside: (2, c) stiffness and drag of those that the solve does not feel yet, or no more.
        target: (c,) gap that each is to end with [m].
        stiffest: (c,) stiffness up to which it may be made stiffer for that [N/m].
    """

    contacts: Contacts
    pairs: int
    elements: Elements
    drag: np.ndarray
    aside: np.ndarray
    target: np.ndarray
    stiffest: np.ndarray

    def measure(self, positions: np.ndarray) -> None:
        """Evaluate the gaps at `positions` (n, 3) [m]."""
        set_gaps(self.contacts, positions, self.elements.q)

    def linearise(
        self, positions: np.ndarray, velocities: np.ndarray, h: float, matrix: Matrix, forces: np.ndarray
    ) -> Coupling:
        """Add the gap springs at `positions` and `velocities` to `matrix` and `forces`.

        Returns:
            What couples the vertices that touch each other.
        """
        if not len(self.drag):
            return uncoupled(len(positions))
        self.measure(positions)
        set_tension(self.elements, velocities)
        set_matrix_factors(self.elements, h, NONE)
        self.elements.tensor[:] = 0.0
        add_push(self.contacts, self.elements, matrix.diagonal, forces)
        add_drag(self.contacts, self.elements, self.drag, velocities, h, matrix.diagonal, forces)
        pairs = self.contacts.node[: self.pairs], self.contacts.weight[: self.pairs]
        return build_coupling(len(positions), *pairs, self.elements.tensor[: self.pairs])

    def begin_like(self, before: GapSprings) -> None:
        """Begin with what a solve `before` of the same step felt, and with its drag once that had settled."""
        if len(before.drag) and len(self.drag):
            twin, known = self.contacts.twins(before.contacts)
            self.take_up(known & before.acts[twin])
            for drag, whose in ((self.drag, self.acts), (self.aside[1], ~self.acts)):
                drag[known & whose] = (before.drag + before.aside[1])[twin[known & whose]]

    def settle(self, start, positions, velocities, model, friction, h, forces) -> bool:
        """Estimate the friction anew after a solve from the velocities `start` that ended at `velocities`.

        Returns whether contacts are held by more than their cones allow, or by much less, with the model's
        matrix and `forces` changed to the new drag, so that the solve should go on.
        """
        if not len(self.drag):
            return False
        drag, pushes = np.zeros_like(self.drag), self.pushes(positions, velocities, h)
        pieces = model.mesh.pieces, model.piece_masses
        found = velocities, pushes, friction, h, drag
        excess, lacking = expected_drag(self.contacts, self.drag, *pieces, *found)
        if excess <= EXCESS and lacking <= LACKING:
            return False
        add_drag(self.contacts, self.elements, drag - self.drag, start, h, model.matrix.diagonal, forces)
        self.drag[:] = drag
        return True

    def drag_along(self, velocities: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Coefficients of 1, t and t² in Σ d (slip)² at velocities + t step, as those of damping."""
        if not len(self.drag):
            return np.zeros(3)
        n = self.contacts.normal
        slip, change = (
            vectors - along(n, vectors)[:, None] * n
            for vectors in (self.contacts.passing(velocities), weighted(self.contacts, step))
        )
        squares = np.stack([along(slip, slip), 2.0 * along(slip, change), along(change, change)])
        return squares @ self.drag

    def slip(self, velocities: np.ndarray) -> np.ndarray:
        """(c,) speed across each contact [m/s]."""
        passing, n = self.contacts.passing(velocities), self.contacts.normal
        return np.linalg.norm(passing - along(n, passing)[:, None] * n, axis=1)

    def energy(self, positions: np.ndarray) -> float:
        """Energy [J] stored at `positions` in the gap springs that push, felt or not; none of them pulls."""
        self.measure(positions)
        overlap = np.minimum(self.elements.q - self.elements.rest, 0.0)
        return 0.5 * float((self.elements.stiffness + self.aside[0]) @ overlap**2)

    def forces(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(n, 3) forces [N] of the gap springs that push at `positions`, without friction."""
        return self.shares(positions, velocities, pull=False)[0]

    def shares(
        self, positions: np.ndarray, velocities: np.ndarray, pull: bool = True
    ) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
        """Forces (n, 3) [N] of all gap springs and of all drags, and the powers of their other sides' motion.

        A solve lets those that it feels also `pull`, until it lets go of them.
        """
        normal, friction = np.zeros_like(positions), np.zeros_like(positions)
        if not len(self.drag):
            return normal, friction, (0.0, 0.0)
        self._tension(positions, velocities)
        about = self.contacts, self.elements, self.drag, velocities, pull, normal, friction
        return normal, friction, spread(*about)

    def engage(self, positions: np.ndarray, slack: float, moved: float, last: bool) -> bool:
        """Let go of contacts that pull, and take up those that lack more than `slack` [m] of their target.

        What pushes and is off its target by more than that, and by more than the last iteration `moved` [m],
        becomes stiffer. Returns whether something lacks, is off, or pulls over more than that, so that the
        solve should go on; where that was its `last` iteration, all stays as it was felt.
        """
        self.measure(positions)
        over, acts = self.elements.q - self.elements.rest, self.acts
        pull, lack = acts & (over > 0.0), ~acts & (over < -slack)
        off = np.abs(self.target - self.elements.q) > max(slack, moved)
        off &= acts & ~pull & (self.elements.stiffness < self.stiffest)
        if not last:
            self.let_go(pull)
            self.take_up(lack)
            self._tighten(off)
        return bool(off.any() or lack.any() or (over[pull] > slack).any())

    def _tighten(self, which: np.ndarray) -> None:
        """Make those (c,) bool stiffer; each goes on from the force that it has.

        That is an augmented Lagrangian (Hestenes 1969; Powell 1969). What cloth that is stiffer than a gap
        spring leaves of an overlap would else be for impulses to take back, which ask no spring.
        """
        e = self.elements
        force = (e.stiffness * (e.rest - e.q))[which]
        e.stiffness[which] *= FIRMER
        e.rest[which] = self.target[which] + force / e.stiffness[which]

    def let_go(self, which: np.ndarray) -> None:
        """Have the solve not feel those (c,) bool, until it takes them up."""
        for strength, aside in zip(self._strengths, self.aside, strict=True):
            aside[which] += strength[which]
            strength[which] = 0.0

    def take_up(self, which: np.ndarray) -> None:
        """Have the solve feel those (c,) bool, and so again those that it had let go of."""
        for strength, aside in zip(self._strengths, self.aside, strict=True):
            strength[which] += aside[which]
            aside[which] = 0.0

    @property
    def acts(self) -> np.ndarray:
        """(c,) whether the solve feels each."""
        return self.elements.stiffness != 0.0

    @property
    def _strengths(self) -> tuple[np.ndarray, np.ndarray]:
        return self.elements.stiffness, self.drag

    def pushes(self, positions: np.ndarray, velocities: np.ndarray, h: float) -> np.ndarray:
        """(c,) normal impulse of each gap spring over a step that ends so [N s]."""
        return h * np.maximum(-self._tension(positions, velocities), 0.0)

    def _tension(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        self.measure(positions)
        set_tension(self.elements, velocities)
        return self.elements.tension


NO_GAP_SPRINGS = GapSprings(
    contacts=NO_CONTACTS,
    pairs=0,
    elements=make_elements(np.zeros((0, 4)), 0),
    drag=np.zeros(0),
    aside=np.zeros((2, 0)),
    target=np.zeros(0),
    stiffest=np.zeros(0),
)
"""What a step without contacts feels."""


def gap_springs(
    response: Response,
    contacts: Contacts,
    pairs: int,
    inverse_masses: np.ndarray,
    predicted: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    force: np.ndarray,
    slip: np.ndarray,
    settings: Settings,
) -> GapSprings:
    """The gap springs of contacts that pressed in the step before, or that would unhindered end too close.

    A linear solve cannot tell beforehand which of the latter will press, and feels them all. Where there are
    more Newton iterations, all contacts have springs: the first iteration feels what pressed before, or comes
    too close by the speed that it has, and the next take up what lacks. With all of them from the start,
    cloth that hangs off the edge of an obstacle would be pulled to it first, each step anew.

    Args:
        response: Which response.
        contacts: What detection found, those between vertices first.
        pairs: How many of them are between vertices.
        inverse_masses: (n,) [1/kg].
        predicted: (n, 3) where vertices would go without springs and contacts [m].
        positions: (n, 3) at the start of the step [m].
        velocities: (n, 3) there [m/s].
        force: (c,) with which each contact pressed in the step before [N].
        slip: (c,) slip expected after that step, zero for a new contact [m/s].
        settings: dt, friction and newton are read.
    """
    if not len(contacts.key):
        return NO_GAP_SPRINGS
    h, mass = settings.dt, contacts.masses(inverse_masses)
    lack = lacks(response, contacts, predicted, h)
    engages = response.solved and settings.newton > 1
    kept = np.flatnonzero(((lack > 0.0) | (force > 0.0) | engages) & (mass < np.inf))
    contacts, mass, lack, force, slip = (
        contacts.only(kept),
        mass[kept],
        lack[kept],
        force[kept],
        slip[kept],
    )
    passing = contacts.passing(velocities)
    closing = along(contacts.normal, passing)
    target = targets(response, contacts, h)
    elements = _across(response, contacts, target, mass, force, closing, positions, h)
    apart = (force == 0.0) & (contacts.start + h * closing >= elements.rest)
    sliding = np.linalg.norm(passing - closing[:, None] * contacts.normal, axis=1)
    bound = settings.friction * np.maximum(force, mass * np.maximum(lack, 0.0) / h**2)
    drag = first_drag(bound, np.maximum(sliding, slip), mass, h)
    among = int(np.count_nonzero(kept < pairs))
    stiffest = elements.stiffness * (STIFFEST if response.impulses else 1.0)
    springs = GapSprings(contacts, among, elements, drag, np.zeros((2, len(drag))), target, stiffest)
    if engages:
        springs.let_go(apart)
    return springs


def _across(
    response: Response,
    contacts: Contacts,
    target: np.ndarray,
    mass: np.ndarray,
    force: np.ndarray,
    closing: np.ndarray,
    positions: np.ndarray,
    h: float,
) -> Elements:
    """Springs along the normals of c contacts of `mass` (c,) toward their `target` gaps (c,) [m].

    They are damped where they are `closing` (c,) [m/s].
    """
    elements = make_elements(contacts.node, 0)
    elements.gradient[:] = contacts.weight[:, :, None] * contacts.normal[:, None]
    elements.stiffness[:] = response.stiffness * mass / h**2
    elements.rest[:] = target
    if response.carries:
        elements.rest[:] += force / elements.stiffness
    critical = 2.0 * np.sqrt(mass * elements.stiffness)
    damping = np.where(closing < 0.0, response.damping * critical, 0.0)
    if response.solved:  # over a step, that is a spring from the gap at its start: one law says what pushes
        elements.stiffness[:] += damping / h
        begin = contacts.gaps(positions) + h * along(contacts.normal, contacts.speed)
        elements.rest[:] += damping / h / elements.stiffness * (begin - elements.rest)
    else:
        elements.damping[:] = damping
        elements.drift[:] = along(contacts.normal, contacts.speed)
    return elements


@kernel
def spread(contacts, elements, drag, velocities, pull, normal, friction):
    """Add what each contact's vertices get of its forces along the normal and across, (n, 3) [N].

    Returns the powers [W] that the motion of the contacts' other sides puts in by both.
    """
    pushed = rubbed = 0.0
    for c in range(len(drag)):
        push = -elements.tension[c]
        if push < 0.0 and not pull:
            push = 0.0
        shove, speed = scale(push, row(contacts.normal, c)), row(contacts.speed, c)
        rub = scale(-drag[c], slip_of(contacts, velocities, c))
        for a in range(4):
            i, w = contacts.node[c, a], contacts.weight[c, a]
            for r in range(3):
                normal[i, r] += w * shove[r]
                friction[i, r] += w * rub[r]
        pushed += dot(shove, speed)
        rubbed += dot(rub, speed)
    return pushed, rubbed


@kernel
def add_push(contacts, elements, diagonal, forces):
    """Add the springs along the normals to the forces, the diagonal and their own tensors."""
    for c in range(len(elements.q)):
        n, along = contacts.normal[c], elements.along[c]
        _add_tensor(elements.tensor[c], along, n, 0.0)
        for a in range(4):
            i, w = contacts.node[c, a], contacts.weight[c, a]
            if w != 0.0:
                for r in range(3):
                    forces[i, r] -= elements.tension[c] * w * n[r]
                    for s in range(3):
                        diagonal[i, r, s] += w * w * along * n[r] * n[s]


@kernel
def add_drag(contacts, elements, drag, velocities, h, diagonal, forces):
    """Add the force −d (I − nnᵀ)(passing velocity), d from `drag` (c,), and its part h d (I − nnᵀ)."""
    for c in range(len(drag)):
        n, slip, across = contacts.normal[c], slip_of(contacts, velocities, c), h * drag[c]
        _add_tensor(elements.tensor[c], -across, n, across)
        for a in range(4):
            i, w = contacts.node[c, a], contacts.weight[c, a]
            if w != 0.0:
                for r in range(3):
                    forces[i, r] -= drag[c] * w * slip[r]
                    diagonal[i, r, r] += w * w * across
                    for s in range(3):
                        diagonal[i, r, s] -= w * w * across * n[r] * n[s]


@inner
def _add_tensor(tensor, along, n, alike):
    """Add along nnᵀ + alike I to a symmetric tensor of six numbers."""
    tensor[0] += along * n[0] * n[0] + alike
    tensor[1] += along * n[0] * n[1]
    tensor[2] += along * n[0] * n[2]
    tensor[3] += along * n[1] * n[1] + alike
    tensor[4] += along * n[1] * n[2]
    tensor[5] += along * n[2] * n[2] + alike
