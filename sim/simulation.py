"""A running simulation: it owns the state, advances it one step at a time, and reports each step.

A step is a transaction. It ends in a finite state and a report, or raises StepError and leaves the state as
it was. The same scene, settings and seed give the same bits, on any number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.contact.broad import CandidateError
from sim.contact.contacts import Touch
from sim.contact.gap import GapSprings
from sim.contact.pipeline import Pipeline
from sim.crossings import Crossings
from sim.effects import Told, check_obstacles, chosen, effects_with, same_cloth, state
from sim.integrators import INTEGRATORS, State
from sim.ledger import Books, Ledger, Tally
from sim.mesh import build_mesh
from sim.model import Model
from sim.ramp import Ramp
from sim.report import StepError, StepReport
from sim.safe import suspect
from sim.scene import Scene, read_scene
from sim.settings import Settings, change, only_read_outs
from sim.sleep import Rest, driven
from sim.solve.implicit import Solution, SolveError
from sim.solve.stepping import take_step
from sim.tangles import clear_start, surfaces_of
from sim.threads import processor_threads

if TYPE_CHECKING:
    from sim.strain import Limit

FASTEST = 1e6
"""A step that ends with a vertex faster than this [m/s] is refused: it has blown up."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that decides how a simulation goes on, to the bit."""

    ramp: Ramp
    time: float
    positions: np.ndarray
    velocities: np.ndarray
    previous: State | None
    touched: Touch
    memory: dict[str, np.ndarray]
    injected: float
    books: Books | None = None
    still: np.ndarray | None = None


class Simulation:
    """Cloth and obstacles of a scene, advanced by implicit steps.

    Args:
        scene: A loaded scene, a path, the name of a scene that comes with Muslin, or a dict.
        effects: Those that are forced "on" or "off", by name, whatever scene and overrides have.
        overrides: Settings that differ from the scene's.

    Attributes:
        note: What was done to the start so that it crosses nothing; empty where nothing was.

    Raises:
        SceneError: For a scene that cannot be used.
        ValueError: For an override out of bounds: names field, value and bounds; and for a wrong effect.
    """

    def __init__(
        self,
        scene: Scene | str | Path | dict[str, Any],
        effects: Mapping[str, str] | None = None,
        **overrides: Any,
    ) -> None:
        self.scene = read_scene(scene)
        settings, known = change(self.scene.settings, **overrides), effects_with(self.scene.obstacle_labels)
        self._ramp = Ramp.done(self._checked(chosen(settings, effects or {}, known)))
        self.mesh = build_mesh(self.scene)
        self.model = Model(self.mesh, self.settings)
        self.contact = Pipeline(self.scene, self.model)
        self._positions, self.note = self._start()
        self._velocities = np.zeros_like(self._positions)
        self._previous: State | None = None
        self._time = 0.0
        self._injected = 0.0
        self._limit: float | None = None
        self._books: Books | None = None
        self._books_wanted: bool | None = None
        self._edges: Limit | None = None
        self._crossings = Crossings(self.mesh, self.contact.obstacles)
        self._told = Told()
        self._rest = Rest(self.mesh.parts, float(np.ptp(self.mesh.rest_vertices, axis=0).max()))
        self._last = StepReport()
        self.model.forget(self._positions)
        self._open_books()

    def _start(self) -> tuple[np.ndarray, str]:
        """Where cloth starts (n, 3) [m], and a line where it had to be untangled."""
        noise = np.random.default_rng(self.settings.seed).standard_normal(self.mesh.vertices.shape)
        x, obstacles = (
            self.mesh.vertices + self.settings.jitter * self.model.confined(noise),
            self.contact.obstacles,
        )
        solid = obstacles.felt(self.settings).solid
        surfaces = surfaces_of(self.mesh, self.settings, solid.triangles)
        corners = obstacles.corners(obstacles.poses(0.0), solid)
        return clear_start(x, corners, surfaces, self.settings, self.scene.source)

    @property
    def settings(self) -> Settings:
        """The settings that hold, or that are gone over to. Immutable; `update` replaces them."""
        return self._ramp.target

    @property
    def effects(self) -> dict[str, str]:
        """Whether each effect is "on", "off" or "auto"."""
        return {name: state(name, self.settings) for name in effects_with(self.scene.obstacle_labels)}

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._time

    @property
    def positions(self) -> np.ndarray:
        """(n, 3) [m], read-only; valid until the next step."""
        return _read_only(self._positions)

    @property
    def velocities(self) -> np.ndarray:
        """(n, 3) [m/s], read-only; valid until the next step."""
        return _read_only(self._velocities)

    @property
    def triangles(self) -> np.ndarray:
        """(m, 3) int32 vertex indices, read-only."""
        return _read_only(self.mesh.triangles)

    @property
    def edges(self) -> np.ndarray:
        """(e, 2) int32 vertex indices, read-only."""
        return _read_only(self.mesh.edges)

    @property
    def masses(self) -> np.ndarray:
        """(n,) [kg], read-only."""
        return _read_only(self.model.masses)

    @property
    def pinned(self) -> np.ndarray:
        """(k,) int32 indices of the vertices that stay where they start, read-only."""
        return _read_only(self.mesh.pinned)

    @property
    def pieces(self) -> np.ndarray:
        """(n,) int32 index of the scene's cloth that each vertex belongs to, read-only."""
        return _read_only(self.mesh.pieces)

    def energy(self) -> dict[str, float]:
        """Energy [J] by kind: kinetic, gravity (zero at the origin), and each spring kind in force."""
        kinetic = 0.5 * float(self.model.masses @ np.einsum("ij,ij->i", self._velocities, self._velocities))
        return {"kinetic": kinetic, **self.model.energies(self._positions)}

    @property
    def ledger(self) -> Ledger | None:
        """Where energy went since `keep_ledger`, or since cloth was placed elsewhere; None without books."""
        return None if self._books is None else self._books.ledger(self.energy(), self._injected)

    def keep_ledger(self, kept: bool = True) -> None:
        """Keep an energy ledger from now on, or none; the steps are the same to the bit.

        Where `settings.ledger` is off there is none; once it is not, one is opened.
        """
        self._books_wanted = kept
        self._open_books()

    @property
    def _keeps_books(self) -> bool:
        """Whether somebody asks for a ledger, or the settings do and nobody asks for none."""
        choice, wanted = self.settings.ledger, self._books_wanted
        return choice != "off" and (choice == "on" if wanted is None else wanted)

    def _open_books(self) -> None:
        """Begin a ledger, if one is to be kept."""
        self.contact.booked = self._keeps_books
        self._books = Books(sum(self.energy().values()) - self._injected) if self._keeps_books else None

    def momentum(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear momentum (3,) [kg m/s] and angular momentum about the origin (3,) [kg m²/s]."""
        # a tenth of what each one's cross product takes
        about = (self.model.masses * self._positions.T) @ self._velocities
        return self.model.masses @ self._velocities, (about - about.T)[[1, 2, 0], [2, 0, 1]]

    def forces(self) -> np.ndarray:
        """(n, 3) elastic, damping, gravity and wind forces [N] at the present state, contact left out."""
        if self.model.wind is not None:
            self.model.wind.blow(self.settings, self._time, self._positions)
        return self.model.forces(self._positions, self._velocities)

    def obstacle_poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3,) [m] and rotation (3, 3) of each obstacle now, in the scene's order.

        The rotation takes the obstacle's own frame to the world: a plane's normal and a capsule's axis are z.
        """
        poses = self.contact.obstacles.poses(self._time)
        return list(zip(poses.position, poses.rotation, strict=True))

    def crossings(self) -> int:
        """How many edges of cloth and mesh obstacles go through triangles of cloth or of the other now.

        What is not felt counts, too. Layers that have passed through each other completely leave none.
        """
        return self._crossings.count(self._time, self._positions)

    def stability_limit(self) -> float:
        """The longest step [s] for which symplectic Euler is stable about the present state."""
        from sim.solve.stability import longest_step  # SciPy, which a step does without

        return longest_step(self.model, self._positions)

    def update(self, **changes: Any) -> None:
        """Change settings while running; positions and velocities stay, and so does everything on an error.

        Stiffnesses and the rest angle of cloth that has moved go over to their new values within a tenth of
        a second. The energy that changes put in is booked in the report of the step that it acts in.

        Raises:
            ValueError: names field, value and bounds.
        """
        settings = self._checked(change(self.settings, **changes))
        self._change(self._ramp.toward(settings) if self._time > 0.0 else Ramp.done(settings), changes)

    def switch(self, **changes: Any) -> None:
        """Change settings at once, as `update` without its way of going over; for comparisons, not for eyes.

        Raises:
            ValueError: names field, value and bounds.
        """
        self._change(Ramp.done(self._checked(change(self.settings, **changes))), changes)

    def _change(self, ramp: Ramp, changes: Mapping[str, Any]) -> None:
        """Put the settings of `ramp` in force, which these changes make; cloth does not feel read-outs."""
        if only_read_outs(changes):
            self._ramp = self._ramp.toward(ramp.target)
        else:
            old = self._ramp
            self._go_over(ramp)
            self._limit = None
            if not (same_cloth(old.settings, ramp.settings) and same_cloth(old.target, ramp.target)):
                self._previous = None
        if self.contact.booked != self._keeps_books:
            self._open_books()

    def _checked(self, settings: Settings) -> Settings:
        """These settings, which switch no obstacles but those of the scene; else ValueError."""
        check_obstacles(settings, self.scene.obstacle_labels)
        return settings

    @property
    def asleep(self) -> bool:
        """Whether all cloth sleeps: steps are left out until something could move it."""
        return bool(self.sleeping.all())

    @property
    def sleeping(self) -> np.ndarray:
        """(n,) bool, which vertices are of parts of the cloth that sleep."""
        if self.settings.sleep == "off":
            return np.zeros(len(self._positions), dtype=bool)
        return self._rest.asleep[self._rest.part]

    def _go_over(self, ramp: Ramp) -> None:
        """Put the settings of `ramp` in force, and book the energy that this puts in."""
        self._rest.wake()
        self.model.hold(self.sleeping)
        before = sum(self.energy().values())
        self.model.apply(ramp.settings, self._positions)
        self._ramp = ramp
        self._injected += sum(self.energy().values()) - before

    def place(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Put the cloth elsewhere, at time zero and with no past; pinned vertices stay where they are put.

        Args:
            positions: (n, 3) [m].
            velocities: (n, 3) [m/s], zero where left out; those of pinned vertices count as zero.

        Raises:
            ValueError: for arrays of another shape, or with numbers that are not finite.
        """
        new = [self._given(positions, "positions")]
        still = np.zeros_like(self._positions)
        new.append(still if velocities is None else self._given(velocities, "velocities"))
        self._go_over(Ramp.done(self.settings))
        self._positions, self._velocities = new[0], self.model.confined(new[1])
        self._time = self._injected = 0.0
        self._previous = self._limit = None
        self.contact.forget()
        self.model.forget(self._positions)
        self._open_books()

    def _given(self, value: Any, name: str) -> np.ndarray:
        """A float64 copy of an array for all vertices (n, 3)."""
        try:
            array = np.array(value)
        except ValueError:  # rows of different lengths
            array = np.zeros(0)
        good = array.shape == self._positions.shape and array.dtype.kind in "iuf"
        if not good or not np.isfinite(array).all():
            raise ValueError(f"{name}: expected finite numbers of shape {self._positions.shape}")
        return array.astype(float)

    def stop(self) -> None:
        """Take all velocity off the cloth, and book it as a change of settings."""
        self._rest.wake()
        self._injected -= self.energy()["kinetic"]
        self._velocities = np.zeros_like(self._velocities)
        self._previous = None
        self.contact.touched = self.contact.touched.still()

    def snapshot(self) -> Snapshot:
        """The present state, for `restore`."""
        return Snapshot(
            ramp=self._ramp,
            time=self._time,
            positions=self._positions.copy(),
            velocities=self._velocities.copy(),
            previous=self._previous,
            touched=self.contact.touched,
            memory=self.model.memory(),
            injected=self._injected,
            books=self._books,
            still=self._rest.still,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this scene; from there the same bits follow.

        Raises:
            ValueError: for one of other cloth; the state is as it was.
        """
        if (found := snapshot.positions.shape) != self._positions.shape:
            raise ValueError(f"snapshot: expected one of {len(self._positions)} vertices, got {found[0]}")
        self.model.apply(snapshot.ramp.settings, snapshot.positions)
        self._ramp, self._time, self._injected = snapshot.ramp, snapshot.time, snapshot.injected
        self._positions, self._velocities = snapshot.positions.copy(), snapshot.velocities.copy()
        self._previous, self._limit = snapshot.previous, None
        self._rest.wake()
        if snapshot.still is not None:
            self._rest.still = snapshot.still
        self.contact.touched = snapshot.touched
        self.model.restore_memory(snapshot.memory, self._positions)
        self._open_books()
        if self._books is not None:
            self._books = snapshot.books or self._books

    def step(self) -> StepReport:
        """Advance by one time step of settings.dt.

        Raises:
            StepError: where the step cannot be done; the state is as it was.
        """
        begin, report = perf_counter(), StepReport()
        ramp, injected, still = self._ramp, self._injected, self._rest.still
        if self.sleeping.any():
            self._rest.rouse(self._driven(self._time))
        if self.asleep:
            return self._sleep(begin)
        self.model.hold(self.sleeping)
        self.model.costs, self.model.costs_below = report.costs, report.costs_below
        try:
            if not ramp.over:
                self._go_over(ramp.after(self.settings.dt))
            with processor_threads(self.settings.threads):
                solution, touch, smooth = self._advance(report)
                while self.sleeping.any() and self._rest.rouse(self._rest.touched(self.contact.joins)):
                    self.model.hold(self.sleeping)
                    report = StepReport(ms=report.ms, costs=report.costs, costs_below=report.costs_below)
                    solution, touch, smooth = self._advance(report)
        except StepError:
            if ramp is not self._ramp:
                self._go_over(ramp)
                self._injected = injected
            self._rest.still = still
            raise
        before = self._velocities, self._time
        report.energy_injected, self._injected = self._injected, 0.0
        report.moved = self._longest_way(solution.positions)
        if self.model.wind is not None:
            report.wind_work = self.settings.dt * self.model.wind.power(solution.velocities)
        self._accept(solution, touch, smooth, report)
        with report.phase("report"):
            if self.scene.obstacle and self.settings.obstacles != "off":
                depths = self.contact.depths(self._time, self._positions, self.settings)
                report.penetrations, report.deepest = int(np.count_nonzero(depths)), float(depths.max())
            if self.settings.sleep == "auto":
                with report.spent("sleep"):
                    self._settle(*before, report)
            report.effects = self._effects(report)
        report.close(begin)
        self._last = report
        return report

    def _driven(self, time: float) -> np.ndarray:
        """(parts,) bool, which parts of the cloth something may move in the step from `time` [s]."""
        return driven(self.settings, self.contact.obstacles, time, self._positions, self._rest.part)

    def _settle(self, before: np.ndarray, time: float, report: StepReport) -> None:
        """Count for how long cloth is still, from its velocities `before` a step; some may fall asleep."""
        if not self._ramp.over:
            self._rest.wake()
            return
        awake = ~self.sleeping
        self._rest.after(before, self._velocities, self.settings.dt, self._driven(time), self.contact.joins)
        report.sleeping = int(np.count_nonzero(self._rest.asleep))
        falls = self.sleeping & awake
        if not falls.any():
            return
        energy = self.energy()["kinetic"]
        self._velocities = np.where(falls[:, None], 0.0, self._velocities)
        report.discarded = energy - self.energy()["kinetic"]
        if self._previous is not None:
            x, v = self._previous
            self._previous = np.where(falls[:, None], self._positions, x), np.where(falls[:, None], 0.0, v)
        if self.asleep:
            self.contact.touched = self.contact.touched.still()
        if self._books is not None:
            self._books = self._books.asleep(report.discarded)

    def _sleep(self, begin: float) -> StepReport:
        """Let time pass, in a step that began at `begin` [s]."""
        report = replace(
            self._last, ms=dict.fromkeys(self._last.ms, 0.0), costs={}, costs_below={}, asleep=True
        )
        report.iterations = report.newton = report.energy_jumps = 0
        report.moved = report.discarded = report.wind_work = 0.0
        report.energy_injected = report.energy_jump = 0.0
        with report.phase("report"):
            self._time += self.settings.dt
            report.effects = self._told.asleep(self.settings, self.contact.obstacles.labels)
        report.close(begin)
        return report

    def _advance(self, report: StepReport) -> tuple[Solution, Touch, bool]:
        """Where the state goes in one step, how hard it touches what, and whether nothing broke its way.

        What the integrator does not know of, as impulses and strain limits, breaks it, and a look back across
        that would throw cloth off what it ran into.
        """
        name = self.settings.integrator
        looks_back, ended = INTEGRATORS[name].looks_back, np.zeros(0)

        def solve(
            springs: GapSprings, settings: Settings, x: np.ndarray, v: np.ndarray, guess: np.ndarray | None
        ) -> Solution:
            nonlocal ended
            way = settings, x, v, self._previous if settings is self.settings else None
            tally = Tally(self.model, springs, self._books.rows, report) if self._books is not None else None
            try:
                solution, report.integrator = take_step(self.model, springs, *way, tally, guess)
            except SolveError as error:
                raise StepError(str(error), "solve", suspect(self.settings)) from None
            if looks_back:
                ended = np.concatenate([solution.positions, solution.velocities])
            self._refuse_beyond_bounds(solution, "solve")  # before it is looked for what all of it meets
            if settings.strain_limit > 0.0:
                return self._limited(settings, solution, report)
            return solution

        state = self.settings, self._time, self._positions, self._velocities
        if (wind := self.model.wind) is not None:
            half = 0.5 * self.settings.dt  # the middle of a step stands for all of it to second order
            wind.blow(self.settings, self._time + half, self._positions + half * self._velocities)
        with np.errstate(over="ignore", invalid="ignore"):  # a step that blows up is refused below
            try:
                solution, touch = self.contact.through(*state, solve, report)
            except CandidateError as error:
                raise StepError(str(error), "detect", suspect(self.settings)) from None
        self._refuse_beyond_bounds(solution, "respond")
        report.newton, report.converged = solution.newton, solution.converged
        report.residual = solution.residual
        report.solver, report.stopped = solution.solver, solution.stopped
        smooth = looks_back and report.integrator == name and report.substeps == 1
        state = solution.positions, solution.velocities
        return solution, touch, smooth and np.array_equal(ended, np.concatenate(state))

    def _limited(self, s: Settings, end: Solution, report: StepReport) -> Solution:
        """The `end` of a step, where no edge is longer than it may be."""
        with report.phase("limit"), report.spent("strain_limiting"):
            from sim.strain import make_limit, shorten  # which a step without a limit does without

            if self._edges is None:
                self._edges = make_limit(self.mesh.edges, self.mesh.rest_vertices, self.mesh.axis)
            about = self._edges, s.strain_limit, self.model.inverse_masses
            before = end.velocities.copy()
            found = shorten(*about, s.dt, end.positions, end.velocities)
            report.strain, report.limited = found
            return replace(end, limited=self.masses[:, None] * (end.velocities - before))

    def _refuse_beyond_bounds(self, solution: Solution, phase: str) -> None:
        if wild := beyond_bounds(solution.positions, solution.velocities):
            raise StepError(wild, phase, suspect(self.settings))

    def _longest_way(self, end: np.ndarray) -> float:
        """How far [m] the step to `end` takes the vertex or the point of an obstacle that goes farthest.

        Planes count without their turn, which takes them far where there may be nothing.
        """
        ways = np.linalg.norm(end - self._positions, axis=1)
        obstacles = self.contact.obstacles
        felt = obstacles.felt(self.settings)
        if not felt.which.any():
            return float(ways.max())
        before, after = (obstacles.poses(t) for t in (self._time, self._time + self.settings.dt))
        # Of the difference of two rotations the largest singular value is there twice, and the third is zero.
        turn = np.linalg.norm(after.rotation - before.rotation, axis=(1, 2)) / math.sqrt(2.0)
        reach = np.linalg.norm(obstacles.shapes.half, axis=1)
        rigid = np.linalg.norm(after.position - before.position, axis=1) + turn * reach
        corners = (obstacles.corners(poses, felt.solid) for poses in (before, after))
        meshes = np.linalg.norm(np.subtract(*corners), axis=1)
        return float(np.concatenate([ways, rigid[felt.which], meshes]).max())

    def _accept(self, solution: Solution, touch: Touch, smooth: bool, report: StepReport) -> None:
        """Make the end of a step the present state; a `smooth` one may be looked back across."""
        self._previous = (self._positions, self._velocities) if smooth else None
        self._positions, self._velocities = solution.positions, solution.velocities
        self.contact.touched = touch
        self._time += self.settings.dt
        with report.phase("report"):
            report.energy_jumps, report.energy_jump = self.model.remember(self._positions)
            if self._books is not None:
                about = self.contact.parts, report.energy_injected, report.energy_jump, solution.rows
                with report.spent("ledger", alone=True):
                    self._books = self._books.after(*about)

    def _effects(self, report: StepReport) -> dict[str, str]:
        if INTEGRATORS[self.settings.integrator].implicit:
            self._limit = None
        elif self._limit is None:
            self._limit = self.stability_limit() if self.model.conservative else math.nan
        about = self.settings, self.model, report, self.contact.obstacles.labels, self._limit
        return self._told.tell(*about)


def beyond_bounds(positions: np.ndarray, velocities: np.ndarray) -> str:
    """Which quantity of which vertex no step may end with, and its value; empty where all is well."""
    for name, unit, array, limit in (
        ("position", "m", positions, np.inf),
        ("velocity", "m/s", velocities, FASTEST),
    ):
        if np.abs(array).max() < limit:
            continue
        size = np.abs(array).max(axis=1)
        wild = ~(size < limit)  # also where it is no number
        if wild.any():
            vertex = int(np.argmax(wild))
            bound = f", beyond {limit:g} {unit}" if np.isfinite(limit) else ", which is not finite"
            return f"{name} of vertex {vertex} is {size[vertex]:.3g} {unit}{bound}"
    return ""


def _read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view
