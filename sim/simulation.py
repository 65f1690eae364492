"""A running simulation: it owns the state, advances it one step at a time, and reports each step.

A step is a transaction. It ends in a finite state and a report, or raises StepError and leaves the state as
it was. The same scene, settings and seed give the same bits, on any number of threads.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim.contact.detect import NO_CONTACTS, Contacts, deepest, detect
from sim.contact.friction import rub
from sim.contact.gap import GapSprings, gap_springs
from sim.contact.obstacles import Obstacles, Poses
from sim.contact.response import RESPONSES, lacks, push_out, targets
from sim.mesh import build_mesh
from sim.model import Model
from sim.scene import Scene, load_scene
from sim.settings import Settings, change
from sim.solve.implicit import Solution, SolveError, backward_euler
from sim.threads import processor_threads

MOST_SOLVES = 3
"""Solves of one step at most: one more where a solve led vertices into contacts that it did not feel."""

FASTEST = 1e6
"""A step that ends with a vertex faster than this [m/s] is refused: it has blown up."""


class StepError(RuntimeError):
    """A step that could not be done; the state is as it was before.

    Attributes:
        phase: Where it failed: "detect", "solve" or "respond".
        setting: The setting most likely to blame.
    """

    def __init__(self, reason: str, phase: str, setting: str) -> None:
        super().__init__(f"{phase}: {reason}; the likeliest setting to blame is {setting}")
        self.phase = phase
        self.setting = setting


@dataclass
class StepReport:
    """What one step did.

    Attributes:
        ms: Milliseconds by phase, and "total".
        iterations: Of the linear solver.
        newton: Newton iterations.
        residual: Estimated mass-weighted position error that the last linear solve left [m].
        converged: Whether the solver reached the tolerance.
        contacts: Contacts that detection found.
        penetrations: Vertices inside an obstacle at the end of the step.
        deepest: How far the deepest of them is inside [m].
        substeps: Parts that the step was done in.
        effects: Each effect and whether it ran, or why not.
        energy_injected: By changes of settings since the step before [J].
    """

    ms: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    newton: int = 0
    residual: float = 0.0
    converged: bool = True
    contacts: int = 0
    penetrations: int = 0
    deepest: float = 0.0
    substeps: int = 1
    effects: dict[str, str] = field(default_factory=dict)
    energy_injected: float = 0.0

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time that the block takes to `ms[name]` and to the total."""
        begin = time.perf_counter()
        yield
        took = 1e3 * (time.perf_counter() - begin)
        self.ms[name] = self.ms.get(name, 0.0) + took
        self.ms["total"] = self.ms.get("total", 0.0) + took


@dataclass(frozen=True)
class Snapshot:
    """Everything that decides how a simulation goes on, to the bit."""

    settings: Settings
    time: float
    positions: np.ndarray
    velocities: np.ndarray
    pressed: np.ndarray
    slip: np.ndarray
    memory: dict[str, np.ndarray]
    injected: float


class Simulation:
    """Cloth and obstacles of a scene, advanced by implicit steps.

    Args:
        scene: A loaded scene, a path, the name of a scene that comes with Muslin, or a dict.
        overrides: Settings that differ from the scene's.

    Raises:
        SceneError: For a scene that cannot be used.
        ValueError: For an override out of bounds: names field, value and bounds.
    """

    def __init__(self, scene: Scene | str | Path | dict[str, Any], **overrides: Any) -> None:
        self.scene = load_scene(scene)
        self._settings = change(self.scene.settings, **overrides)
        self.mesh = build_mesh(self.scene)
        self.obstacles = Obstacles(self.scene)
        self.model = Model(self.mesh, self._settings)
        self._positions = self._start()
        self._velocities = np.zeros_like(self._positions)
        self._pressed = np.zeros((len(self._positions), len(self.scene.obstacle)))
        self._slip = np.zeros_like(self._pressed)
        self._time = 0.0
        self._injected = 0.0
        self.model.remember(self._positions)

    def _start(self) -> np.ndarray:
        noise = np.random.default_rng(self._settings.seed).standard_normal(self.mesh.vertices.shape)
        return self.mesh.vertices + self._settings.jitter * noise * self.model.free[:, None]

    @property
    def settings(self) -> Settings:
        """The settings in force. Immutable; `update` replaces them."""
        return self._settings

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

    def momentum(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear momentum (3,) [kg m/s] and angular momentum about the origin (3,) [kg m²/s]."""
        linear = self.model.masses[:, None] * self._velocities
        return linear.sum(axis=0), np.cross(self._positions, linear).sum(axis=0)

    def forces(self) -> np.ndarray:
        """(n, 3) elastic, damping and gravity forces [N] at the present state, contact left out."""
        return self.model.forces(self._positions, self._velocities)

    def obstacle_poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3,) [m] and rotation (3, 3) of each obstacle now, in the scene's order.

        The rotation takes the obstacle's own frame to the world: a plane's normal and a capsule's axis are z.
        """
        poses = self.obstacles.poses(self._time)
        return list(zip(poses.position, poses.rotation, strict=True))

    def update(self, **changes: Any) -> None:
        """Change settings while running; positions and velocities stay, and so does everything on an error.

        Raises:
            ValueError: names field, value and bounds.
        """
        settings = change(self._settings, **changes)
        before = sum(self.energy().values())
        self.model.apply(settings, self._positions)
        self._settings = settings
        self._injected += sum(self.energy().values()) - before

    def snapshot(self) -> Snapshot:
        """The present state, for `restore`."""
        return Snapshot(
            settings=self._settings,
            time=self._time,
            positions=self._positions.copy(),
            velocities=self._velocities.copy(),
            pressed=self._pressed.copy(),
            slip=self._slip.copy(),
            memory=self.model.memory(),
            injected=self._injected,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this scene; from there the same bits follow."""
        self.model.apply(snapshot.settings, snapshot.positions)
        self._settings, self._time, self._injected = snapshot.settings, snapshot.time, snapshot.injected
        self._positions, self._velocities = snapshot.positions.copy(), snapshot.velocities.copy()
        self._pressed, self._slip = snapshot.pressed.copy(), snapshot.slip.copy()
        self.model.restore_memory(snapshot.memory)

    def step(self) -> StepReport:
        """Advance by one time step of settings.dt.

        Raises:
            StepError: where the step cannot be done; the state is as it was.
        """
        report = StepReport(energy_injected=self._injected)
        with processor_threads(self._settings.threads):
            solution, poses, touch = self._advance(report)
        with report.phase("report"):
            if self.scene.obstacle:
                depths = np.zeros(len(self._positions))
                deepest(self.obstacles.shapes, poses, solution.positions, depths)
                report.penetrations, report.deepest = int(np.count_nonzero(depths)), float(depths.max())
            report.effects = self._effects(report)
        self._positions, self._velocities = solution.positions, solution.velocities
        self._pressed, self._slip = touch
        self._time += self._settings.dt
        self._injected = 0.0
        return report

    def _advance(self, report: StepReport) -> tuple[Solution, Poses, tuple[np.ndarray, np.ndarray]]:
        """Where the state goes in one step, with the obstacles' poses and what `_respond` returns."""
        h = self._settings.dt
        before, after = self.obstacles.poses(self._time), self.obstacles.poses(self._time + h)
        springs, solution, contacts = self._solve_with_contact(before, after, report)
        with report.phase("respond"):
            touch = self._respond(springs, contacts, solution)
        calm = np.isfinite(solution.positions) & (np.abs(solution.velocities) < FASTEST)
        if not calm.all():
            raise StepError("positions or velocities are beyond all bounds", "respond", self._suspect())
        report.contacts = len(contacts.vertex)
        report.newton, report.converged = solution.newton, solution.converged
        report.residual = solution.residual
        with report.phase("report"):
            self.model.remember(solution.positions)
        return solution, after, touch

    def _solve_with_contact(
        self, before: Poses, after: Poses, report: StepReport
    ) -> tuple[GapSprings, Solution, Contacts]:
        """Solve with contacts on the way that vertices would take by themselves, then on their real way."""
        h, free = self._settings.dt, self.model.free[:, None]
        end = self._positions + h * (self._velocities + h * np.asarray(self._settings.gravity) * free)
        solves = 0
        while True:
            with report.phase("detect"):
                springs = self._gap_springs(self._detect(before, after, end), end)
            with report.phase("solve"):
                solution = self._solve(springs)
            with report.phase("detect"):
                contacts = self._detect(before, after, solution.positions)
                late = self._late(contacts, springs, solution.positions)
            solves, report.iterations = solves + 1, report.iterations + solution.iterations
            if not len(late) or solves == MOST_SOLVES:
                return springs, solution, contacts
            end[late] = solution.positions[late]

    def _detect(self, before: Poses, after: Poses, end: np.ndarray) -> Contacts:
        s = self._settings
        if s.contact not in RESPONSES or not self.scene.obstacle:
            return NO_CONTACTS
        way = self._positions, end, self.model.free, s.dt
        return detect(self.obstacles, before, after, *way, s.thickness, s.detection == "continuous")

    def _gap_springs(self, contacts: Contacts, predicted: np.ndarray) -> GapSprings:
        s, pairs = self._settings, (contacts.vertex, contacts.obstacle)
        state = predicted, self._velocities, self._pressed[pairs], self._slip[pairs]
        return gap_springs(RESPONSES.get(s.contact), contacts, self.model.masses, *state, s)

    def _late(self, contacts: Contacts, springs: GapSprings, end: np.ndarray) -> np.ndarray:
        """Vertices that an impulse would have to push, as the solve did not feel a contact that it led to."""
        response = RESPONSES.get(self._settings.contact)
        if response is None or not response.impulses:
            return np.zeros(0, dtype=np.int64)
        felt = np.zeros(self._pressed.shape, dtype=bool)
        felt[springs.vertex, springs.obstacle] = True
        s = self._settings
        near = lacks(response, contacts, end, s.thickness, s.dt) > s.tolerance
        return contacts.vertex[near & ~felt[contacts.vertex, contacts.obstacle]]

    def _solve(self, springs: GapSprings) -> Solution:
        s = self._settings
        try:
            return backward_euler(
                self.model, springs, s, self._positions, self._velocities, s.dt, self._positions
            )
        except SolveError as error:
            raise StepError(str(error), "solve", self._suspect()) from None

    def _respond(
        self, springs: GapSprings, contacts: Contacts, solution: Solution
    ) -> tuple[np.ndarray, np.ndarray]:
        """Impulses and friction after the solve; returns normal impulses [N s] and slip [m/s], (n, o)."""
        s, h = self._settings, self._settings.dt
        pressed, slip, drag = (np.zeros_like(self._pressed) for _ in range(3))
        response = RESPONSES.get(s.contact)
        if response is None or not self.scene.obstacle:
            return pressed, slip
        x, v = solution.positions, solution.velocities
        solved = springs.vertex, springs.obstacle
        pressed[solved], drag[solved], slip[solved] = springs.pushes(x, v, h), springs.drag, springs.slip(v)
        pairs = contacts.vertex, contacts.obstacle
        impulses, wanted = pressed[pairs], targets(response, contacts, s.thickness, h)
        push = contacts, wanted, self.model.masses, h, x, v, impulses
        if response.impulses:
            push_out(*push)
        rub(contacts, s.friction, self.model.masses, h, x, v, impulses, drag[pairs])
        if response.impulses:
            push_out(*push)
        pressed[pairs] = impulses
        return pressed, slip

    def _suspect(self) -> str:
        """The setting most likely to make a step fail: the first that is far from where it does well."""
        s = self._settings
        far = {
            "gravity": float(np.abs(s.gravity).max()) > 100.0,
            "dt": s.dt > 1 / 30,
            "stretch": s.stretch > 1e5,
            "bending": s.bending > 1.0,
            "gamma": s.gamma > 10.0,
        }
        return next((name for name, is_far in far.items() if is_far), "dt")

    def _effects(self, report: StepReport) -> dict[str, str]:
        s = self._settings
        effects = {"gravity": "ran" if any(s.gravity) else "off: zero"}
        for springs in self.model.springs:
            size = getattr(s, springs.kind.stiffness)
            effects[f"{springs.name} springs"] = (
                "ran" if size > 0.0 else f"off: {springs.kind.stiffness} is zero"
            )
        if s.bend == "none":
            effects["bending"] = "off: bend is none"
        effects["damping"] = "ran" if s.gamma > 0.0 else "off: gamma is zero"
        if not self.scene.obstacle:
            effects["contact"] = "off: no obstacle"
        elif s.contact == "none":
            effects["contact"] = "off: contact is none"
        else:
            effects["contact"] = (
                f"ran: {report.contacts} contacts" if report.contacts else "ran: nothing within reach"
            )
        return effects


def _read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view
