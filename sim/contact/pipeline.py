"""The way of a step through contact: detect, feel contacts in the solve, detect again, respond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.contact.detect import NO_CONTACTS, Contacts, deepest, detect
from sim.contact.friction import rub
from sim.contact.gap import GapSprings, gap_springs
from sim.contact.obstacles import Obstacles, Poses
from sim.contact.response import RESPONSES, Response, lacks, push_out, targets
from sim.integrators import INTEGRATORS
from sim.model import Model
from sim.report import StepReport
from sim.scene import Scene
from sim.settings import Settings
from sim.solve.implicit import Solution

MOST_SOLVES = 3
"""Solves of one step at most: one more where a solve led vertices into contacts that it did not feel."""

Solve = Callable[[GapSprings], Solution]


class Pipeline:
    """Contact between a scene's cloth and obstacles.

    Attributes:
        obstacles: Of the scene.
        pressed: (n, o) normal impulse of each vertex and obstacle in the last step [N s].
        slip: (n, o) speed at which they passed each other after it [m/s].
    """

    def __init__(self, scene: Scene, model: Model) -> None:
        self.obstacles = Obstacles(scene)
        self.any = bool(scene.obstacle)
        self._model = model
        self._shape = len(model.masses), len(scene.obstacle)
        self.forget()

    def forget(self) -> None:
        """Start with nothing touched."""
        self.pressed, self.slip = np.zeros(self._shape), np.zeros(self._shape)

    def through(
        self,
        settings: Settings,
        time: float,
        x: np.ndarray,
        v: np.ndarray,
        solve: Solve,
        report: StepReport,
    ) -> tuple[Solution, tuple[np.ndarray, np.ndarray]]:
        """Take one step from (`x`, `v`) at `time` with `solve`, which feels the contacts that it is given.

        Contacts are looked for on the way that vertices would take by themselves; then on the way that they
        took, and the step solved again where that led into some.

        Returns:
            The end of the step, and what `pressed` and `slip` are after it.
        """
        h, free = settings.dt, self._model.free[:, None]
        before, after = self.obstacles.poses(time), self.obstacles.poses(time + h)
        response = self._response(settings)
        end = x + h * (v + h * np.asarray(settings.gravity) * free)
        solves = 0
        while True:
            with report.phase("detect"):
                found = self._detect(response, settings, before, after, x, end)
                springs = self._gap_springs(response, settings, found, end, v)
            with report.phase("solve"):
                solution = solve(springs)
            with report.phase("detect"):
                contacts = self._detect(response, settings, before, after, x, solution.positions)
                late = self._late(response, settings, contacts, springs, solution.positions)
            solves, report.iterations = solves + 1, report.iterations + solution.iterations
            if not len(late) or solves == MOST_SOLVES:
                break
            end[late] = solution.positions[late]
        report.contacts = max(len(contacts.vertex), len(springs.vertex))  # felt, or found where it led to
        with report.phase("respond"):
            touch = self._respond(response, settings, springs, contacts, solution)
        return solution, touch

    def depths(self, time: float, positions: np.ndarray) -> np.ndarray:
        """(n,) how far each vertex is inside an obstacle at `time` [m], zero outside."""
        depths = np.zeros(len(positions))
        deepest(self.obstacles.shapes, self.obstacles.poses(time), positions, depths)
        return depths

    def _response(self, settings: Settings) -> Response | None:
        """How cloth answers; forces that are not solved for must be soft enough for an explicit step."""
        response = RESPONSES.get(settings.contact) if self.any else None
        if response is None or INTEGRATORS[settings.integrator].implicit:
            return response
        return replace(response, stiffness=1.0, damping=min(response.damping, 0.5), solved=False)

    def _detect(
        self,
        response: Response | None,
        s: Settings,
        before: Poses,
        after: Poses,
        x: np.ndarray,
        end: np.ndarray,
    ) -> Contacts:
        if response is None:
            return NO_CONTACTS
        way = x, end, self._model.free, s.dt
        return detect(self.obstacles, before, after, *way, s.thickness, s.detection == "continuous")

    def _gap_springs(
        self, response: Response | None, s: Settings, contacts: Contacts, end: np.ndarray, v: np.ndarray
    ) -> GapSprings:
        pairs = (contacts.vertex, contacts.obstacle)
        state = end, v, self.pressed[pairs], self.slip[pairs]
        springs = gap_springs(response, contacts, self._model.masses, *state, s)
        if response is not None and not response.solved:
            springs.drag[:] = 0.0  # only a solve can feel drag; all friction is given after the step
        return springs

    def _late(
        self,
        response: Response | None,
        s: Settings,
        contacts: Contacts,
        springs: GapSprings,
        end: np.ndarray,
    ) -> np.ndarray:
        """Vertices that an impulse would have to push, as the solve did not feel a contact that it led to."""
        if response is None or not (response.impulses and response.solved):
            return np.zeros(0, dtype=np.int64)
        felt = np.zeros(self.pressed.shape, dtype=bool)
        felt[springs.vertex, springs.obstacle] = True
        near = lacks(response, contacts, end, s.thickness, s.dt) > s.tolerance
        return contacts.vertex[near & ~felt[contacts.vertex, contacts.obstacle]]

    def _respond(
        self,
        response: Response | None,
        s: Settings,
        springs: GapSprings,
        contacts: Contacts,
        solution: Solution,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Impulses and friction after the solve; returns normal impulses [N s] and slip [m/s], (n, o)."""
        h, masses = s.dt, self._model.masses
        pressed, slip, drag = (np.zeros_like(self.pressed) for _ in range(3))
        if response is None:
            return pressed, slip
        x, v = solution.positions, solution.velocities
        solved = springs.vertex, springs.obstacle
        if response.solved:
            pressed[solved] = springs.pushes(x, v, h)
        else:  # it pushed as it did at the start
            pressed[solved] = h * np.maximum(-springs.elements.tension, 0.0)
        drag[solved], slip[solved] = springs.drag, springs.slip(v)
        pairs = contacts.vertex, contacts.obstacle
        impulses, wanted = pressed[pairs], targets(response, contacts, s.thickness, h)
        push = contacts, wanted, masses, h, x, v, impulses
        if response.impulses:
            push_out(*push)
        rub(contacts, s.friction, masses, h, x, v, impulses, drag[pairs])
        if response.impulses:
            push_out(*push)
        pressed[pairs] = impulses
        return pressed, slip
