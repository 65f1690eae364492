"""The mechanical model of a scene at given settings: masses, springs, and the matrix they fill."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.contact.contacts import Contacts, groups
from sim.contact.gap import NO_GAP_SPRINGS, GapSprings
from sim.damping import damping_ratios
from sim.effects import SPRINGS
from sim.elements import (
    LENGTH,
    LINE,
    NONE,
    NORMAL,
    elastic_energy,
    linearise,
    pooled,
    set_damping,
    set_tension,
)
from sim.mesh import Mesh, vertex_masses
from sim.settings import Settings
from sim.solve.cg import make_workspace
from sim.solve.coupling import uncoupled
from sim.solve.preconditioner import build_preconditioner
from sim.solve.system import add_curvature, add_forces, assemble, build_system, confine
from sim.springs.build import Springs, build_springs, kinds_in_force

if TYPE_CHECKING:
    from sim.wind import Wind

OUTSIDE = 1e-9
"""Weights of a contact that sum to more than this have their other side in an obstacle, not in cloth."""

BENDS = {"none": NONE, "length": LENGTH, "normal": NORMAL}


class Model:
    """Springs and masses on a mesh.

    Attributes:
        masses: (n,) [kg].
        inverse_masses: (n,) [1/kg], zero for fixed vertices.
        free: (n,) bool, false for vertices that are pinned or held.
        axis: The coordinate, 0 to 2, that the scene keeps as it is; None where all may move.
        free_mass: Sum of the masses of free vertices [kg].
        piece_masses: (pieces,) [kg].
        springs: one per kind in force; those without stiffness are there, and nothing is done about them.
        wind: The air, where it acts.
        costs: Milliseconds spent on each effect, added up.
        costs_below: The same of work that an effect shares with others.
        pool: What matrix and forces are made of, and which of it goes where, `gather`.
        matrix: A, filled by `linearise`.
        coupling: What contacts add to A between vertices.
        preconditioner: of A, refreshed for each solve.
        damping_ratios: γ over frequency, as `set_damping` reads it.
    """

    def __init__(self, mesh: Mesh, settings: Settings) -> None:
        self.mesh = mesh
        self.settings = settings
        n = len(mesh.vertices)
        self._unpinned = np.ones(n, dtype=bool)
        self._unpinned[mesh.pinned] = False
        self.free = self._unpinned
        self.axis = mesh.axis
        self._forces = np.zeros((n, 3))
        self.wind: Wind | None = None
        self.costs: dict[str, float] = {}
        self.costs_below: dict[str, float] = {}
        self._known: tuple[np.ndarray, dict[str, float]] | None = None
        self.damping_ratios = damping_ratios(settings)
        self._set_masses()
        self._set_weights()
        self._set_springs()
        self._set_wind()

    def apply(self, settings: Settings, positions: np.ndarray) -> None:
        """Take over new settings; a new spring kind starts from the present `positions` (n, 3)."""
        old, self.settings, self._known = self.settings, settings, None
        idle = [springs for springs in self.springs if not springs.acts]
        if (old.mass, old.density) != (settings.mass, settings.density):
            self._set_masses()
        self._set_weights()
        if kinds_in_force(old) != kinds_in_force(settings):
            known = {s.name: s for s in self.springs}
            self._set_springs(known)
            self.remember(positions, [s for s in self.springs if s.name not in known])
        for springs in self.springs:
            springs.apply(settings)
        woken = [springs for springs in idle if springs.acts]
        for springs in woken:  # what they remember is long past
            springs.recall(0.0)
        self.remember(positions, woken)
        self.measure(positions)
        self.choose()
        self.damping_ratios = damping_ratios(settings)
        self._set_wind()

    def hold(self, held: np.ndarray) -> None:
        """Have the vertices `held` (n,) bool stay where they are, as pinned ones do, and no others."""
        free = self._unpinned & ~held if held.any() else self._unpinned
        if (free == self.free).all():
            return
        self.free = free
        self._set_free_masses()
        self.preconditioner = build_preconditioner(self.mesh, self.free, self.matrix)

    def _set_free_masses(self) -> None:
        self.inverse_masses = np.where(self.free, 1.0 / self.masses, 0.0)
        self.free_mass = float(self.masses[self.free].sum())

    def _set_masses(self) -> None:
        self.masses = vertex_masses(self.mesh, self.settings.mass, self.settings.density)
        self._set_free_masses()
        self.piece_masses = np.bincount(self.mesh.pieces, self.masses)

    def _set_weights(self) -> None:
        self._weights = self.masses[:, None] * np.asarray(self.settings.gravity)

    def _set_springs(self, known: dict[str, Springs] | None = None) -> None:
        known = known or {}
        kinds = kinds_in_force(self.settings)
        self.springs = [
            known.get(name) or build_springs(name, kind, self.mesh) for name, kind in kinds.items()
        ]
        for springs in self.springs:
            springs.apply(self.settings)
        self.pool, elements = pooled([s.elements for s in self.springs])
        for springs, shared in zip(self.springs, elements, strict=True):
            springs.elements = shared
        tensors = [s.kind.bends != "none" for s in self.springs]
        stencils = [e.nodes for e in elements]
        self.matrix, self.gather = build_system(len(self.masses), stencils, tensors)
        self.preconditioner = build_preconditioner(self.mesh, self.free, self.matrix)
        self.coupling = uncoupled(len(self.masses))
        self.work = make_workspace(len(self.masses))

    def _set_wind(self) -> None:
        """Have the air that acts, and nothing of it where none does."""
        if not (self.settings.drag > 0.0 and len(self.mesh.triangles)):
            self.wind = None
        elif self.wind is None:
            from sim.wind import Wind  # which a step without wind does without

            self.wind = Wind(self.mesh)

    def linearise(
        self,
        positions: np.ndarray,
        velocities: np.ndarray,
        contacts: GapSprings,
        h: float,
        exact: bool = False,
        lag: np.ndarray | None = None,
    ) -> np.ndarray:
        """Fill the matrix M + h D + h² H at `positions` and return the forces (n, 3) [N] there.

        H is filtered, so that the matrix is positive definite, or it is the `exact` Hessian. Coefficients of
        the air's drag and lift are those of the velocities `lag` (n, 3), where given.
        """
        self.measure(positions)
        self._weigh(self._forces)
        curved = []
        for springs in self._acting():
            begin, bends = perf_counter(), BENDS[springs.kind.bends]
            curvature = springs.curvature(positions) if exact else None
            if curvature is not None:
                curved.append((springs.elements, curvature))
                bends = LINE if bends != NONE else NONE
            fused = perf_counter()
            linearise(springs.elements, velocities, self.inverse_masses, self.damping_ratios, h, bends)
            self._spent_with_damping(fused)
            self._spent(SPRINGS[springs.kind.stiffness], begin)
        begin = perf_counter()
        assemble(self.pool, self.gather, self.masses, self.matrix)
        for elements, curvature in curved:
            add_curvature(elements, curvature, h, self.matrix)
        add_forces(self.pool, self.gather, self._forces)
        self._spent_on_all(begin)
        if self.wind is not None:
            begin = perf_counter()
            self.wind.measure(positions, velocities if lag is None else lag)
            self.wind.linearise(velocities, h, self.matrix, self._forces)
            self._spent("wind", begin)
        if self.axis is not None:
            confine(self.matrix, self.masses, self.axis, self._forces)
        self.coupling = contacts.linearise(positions, velocities, h, self.matrix, self._forces)
        return self._forces

    def _weigh(self, forces: np.ndarray) -> None:
        """Have `forces` (n, 3) [N] be those of gravity alone."""
        if not any(self.settings.gravity):
            forces[:] = 0.0
            return
        begin = perf_counter()
        np.copyto(forces, self._weights)
        self._spent("gravity", begin)

    def _acting(self) -> list[Springs]:
        """The springs that have some stiffness."""
        return [springs for springs in self.springs if springs.acts]

    def confined(self, vectors: np.ndarray) -> np.ndarray:
        """The part of `vectors` (n, 3) that can be moved along: zero where pinned, and along `axis`."""
        moves = np.where(self.free[:, None], vectors, 0.0)
        if self.axis is not None:
            moves[:, self.axis] = 0.0
        return moves

    @property
    def conservative(self) -> bool:
        """Whether the springs' forces are the gradient of an energy."""
        return not any(springs.kind.wrong for springs in self.springs)

    def loose(self, contacts: Contacts) -> tuple[np.ndarray, np.ndarray]:
        """Which pieces nothing holds from outside, alone or together with those that they touch.

        Returns:
            (pieces,) the group of pieces joined by contacts that each one is in, and the groups' masses [kg],
            infinite where a vertex is pinned or touches an obstacle, or the air holds it.
        """
        pieces = self.mesh.pieces
        group = groups(len(self.piece_masses), contacts.joins(pieces))
        masses = np.bincount(group, self.piece_masses, len(group))
        masses[group[pieces[~self.free]]] = np.inf
        outside = contacts.only(np.abs(contacts.weight.sum(axis=1)) > OUTSIDE)
        own = outside.node[np.arange(len(outside.node)), (outside.weight != 0.0).argmax(axis=1)]
        masses[group[pieces[own]]] = np.inf
        if self.wind is not None:
            masses[:] = np.inf
        return group, masses

    def forces(self, positions: np.ndarray, velocities: np.ndarray, anew: bool = True) -> np.ndarray:
        """(n, 3) elastic, damping, gravity and wind forces [N]; b `anew`, or as last linearised."""
        forces = np.empty_like(positions)
        self.felt(positions, velocities, anew, forces)
        return forces

    def felt(
        self, positions: np.ndarray, velocities: np.ndarray, anew: bool, forces: np.ndarray
    ) -> tuple[dict[str, float], float]:
        """Fill `forces` (n, 3) [N] as `forces` has them; `energies` there are known then, too.

        Returns:
            What the damping of each kind takes [W], and what the air gives [W].
        """
        self.measure(positions)
        self._weigh(forces)
        stored, taken = dict.fromkeys((springs.name for springs in self.springs), 0.0), {}
        for springs in self._acting():
            if anew:
                begin = perf_counter()
                set_damping(springs.elements, self.inverse_masses, self.damping_ratios)
                self._spent_with_damping(begin)
            stored[springs.name], taken[springs.name] = set_tension(springs.elements, velocities)
        add_forces(self.pool, self.gather, forces)
        self._know(positions, stored)
        blown = 0.0
        if self.wind is not None:
            self.wind.measure(positions, velocities)
            blown = self.wind.push(velocities, forces)
        if self.axis is not None:
            forces[:, self.axis] = 0.0
        return taken, blown

    def accelerations(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """(n, 3) forces over masses [m/s²], zero for pinned vertices."""
        return self.inverse_masses[:, None] * self.forces(positions, velocities)

    def energies(self, positions: np.ndarray) -> dict[str, float]:
        """Potential energy [J] of gravity (zero at the origin) and of each spring kind."""
        if self._known is not None and np.array_equal(positions, self._known[0]):
            return dict(self._known[1])
        self.measure(positions)
        stored = {s.name: float(elastic_energy(s.elements)) if s.acts else 0.0 for s in self.springs}
        return dict(self._know(positions, stored))

    def _know(self, positions: np.ndarray, stored: dict[str, float]) -> dict[str, float]:
        """Keep what springs have `stored` [J] at `positions`: a ledger and who shows it ask for it again."""
        gravity = -float(self.masses @ (positions @ np.asarray(self.settings.gravity)))
        self._known = positions.copy(), {"gravity": gravity, **stored}
        return self._known[1]

    def potential(self, positions: np.ndarray, contacts: GapSprings) -> float:
        """Potential energy [J] of everything that the implicit step feels."""
        return sum(self.energies(positions).values()) + contacts.energy(positions)

    def gain(
        self, x: np.ndarray, v: np.ndarray, end_x: np.ndarray, end_v: np.ndarray, h: float
    ) -> tuple[float, float, float, float]:
        """How much a step of h [s] from (`x`, `v`) to (`end_x`, `end_v`) raised the energy [J].

        Returns that; the kinetic energies before and after it; and the work that wind may have done.
        """
        before, after = (0.5 * float(self.masses @ (u * u).sum(axis=1)) for u in (v, end_v))
        # The start first: a solve has measured springs there, and where they end they are measured anyway.
        stored, kept = (self.potential(y, NO_GAP_SPRINGS) for y in (x, end_x))
        blown = h * max(self.wind.power(end_v), 0.0) if self.wind is not None else 0.0
        return after - before + kept - stored, before, after, blown

    def measure(self, positions: np.ndarray) -> None:
        """Evaluate every spring's coordinate and gradient at `positions`."""
        for springs in self._acting():
            begin = perf_counter()
            springs.measure(positions)
            self._spent(SPRINGS[springs.kind.stiffness], begin)

    def _spent(self, effect: str, begin: float, part: float = 1.0) -> None:
        """Book the time since `begin`, or a part of it, for an effect."""
        self.costs[effect] = self.costs.get(effect, 0.0) + part * 1e3 * (perf_counter() - begin)

    def _spent_on_all(self, begin: float) -> None:
        """Book the time since `begin` for the springs that act, by how many blocks each kind adds to."""
        acting = self._acting()
        blocks = [s.elements.nodes.size * (s.elements.nodes.shape[1] + 1) for s in acting]
        for springs, own in zip(acting, blocks, strict=True):
            self._spent(SPRINGS[springs.kind.stiffness], begin, own / sum(blocks))

    def _spent_with_damping(self, begin: float) -> None:
        """Book the time since `begin` as more than damping takes: forces are made in the same pass."""
        if self.settings.gamma > 0.0:
            took = 1e3 * (perf_counter() - begin)
            self.costs_below["damping"] = self.costs_below.get("damping", 0.0) + took

    def remember(self, positions: np.ndarray, springs: list[Springs] | None = None) -> tuple[int, float]:
        """Accept `positions`: what the coordinates remember of them is kept, and kinds choose who acts next.

        Returns:
            How many elements began or ceased to act, and the energy [J] that this put in.
        """
        for s in self.springs if springs is None else springs:
            if s.acts:
                s.remember(positions)
        return self.choose()

    def forget(self, positions: np.ndarray) -> None:
        """Start anew at `positions` (n, 3), with nothing remembered but them."""
        for s in self.springs:
            s.recall(0.0)
        self._known = None
        self.remember(positions)

    def choose(self) -> tuple[int, float]:
        """Let each kind choose, from what was last measured, which of its elements act; as `remember`."""
        changes = [springs.choose(self.settings) for springs in self._acting()]
        if count := sum(count for count, _ in changes):
            self._known = None
        return count, sum(energy for _, energy in changes)

    def memory(self) -> dict[str, np.ndarray]:
        """A copy of what the coordinates remember, by kind."""
        return {s.name: s.elements.memory.copy() for s in self.springs}

    def restore_memory(self, memory: dict[str, Any], positions: np.ndarray) -> None:
        """Put back what `memory` returned at `positions` (n, 3)."""
        for s in self.springs:
            s.recall(memory[s.name])
        self._known = None
        self.measure(positions)
        self.choose()
