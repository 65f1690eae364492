"""What a case has to work with: simulations whose every step is watched, and what came of a run."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.report import StepError, StepReport
from sim.scene import Obstacle, Scene
from sim.shells import Shell
from sim.simulation import Simulation, Snapshot
from sim.stress import Figure, Task, at_most, cases
from sim.stress.judge import Judge
from sim.stress.keep import pack

LONGEST, PATIENCE = 120.0, 60.0
"""A run is ended after the first [s] and so many times what it should take."""

AGAIN = 1.0
"""Seconds after which a run that goes on is told again to end."""


class Fault(Exception):
    """A step went wrong; the figure says what."""

    def __init__(self, figure: Figure) -> None:
        super().__init__(figure.what)
        self.figure = figure


class Trial:
    """A simulation that is watched: each step must end with numbers, and untangled if it is judged.

    Args:
        world: The simulation.
        judged: Whether cloth that touches itself or goes through itself on the way is a fault.

    Attributes:
        before: The state before the last step.
        reports: Of all steps.
    """

    def __init__(self, world: Simulation, judged: bool) -> None:
        self.world, self.judge = world, Judge(world) if judged else None
        self.reports: list[StepReport] = []
        self.before: Snapshot = world.snapshot()

    def step(self, steps: int = 1) -> StepReport:
        """Take so many steps; the report of the last.

        Raises:
            Fault: where a step ends in what is no number, in a tangle, or beyond one.
            StepError: where it could not be done.
        """
        for _ in range(steps):
            self.before = self.world.snapshot()
            self.reports.append(self.world.step())
            self._check()
        return self.reports[-1]

    def until(self, seconds: float) -> Iterator[StepReport]:
        """Step on to a time [s]."""
        while self.world.time < seconds - 1e-9:
            yield self.step()

    def _check(self) -> None:
        world, k = self.world, len(self.reports)
        wrong = ~(np.isfinite(world.positions) & np.isfinite(world.velocities)).all(axis=1)
        if wrong.any():
            raise Fault(at_most(f"vertices that are no numbers after step {k}", wrong.sum(), 0.0))
        if self.judge is None:
            return
        if crossings := self.judge.crossings(world.positions):
            raise Fault(at_most(f"crossings after step {k}", crossings, 0.0))
        if self.reports[-1].substeps == 1:  # else the way had corners
            way = self.before.positions, world.positions
            for what, _ in self.judge.each_meeting(*way):
                raise Fault(at_most(f"pairs that went through each other in step {k}, {what}", 1, 0.0))


class Probe:
    """One run of a case.

    Attributes:
        seed: Of the run.
        random: Seeded with it.
        trials: What was started, in order.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.random = np.random.default_rng(seed)
        self.trials: list[Trial] = []

    def start(self, scene: Scene | str | dict[str, Any], judged: bool = False, **settings: Any) -> Trial:
        """A simulation of `scene`, watched; the cloth of one that is judged must start untangled."""
        return self.watch(Simulation(scene, **{"seed": self.seed, **settings}), judged)

    def watch(self, world: Simulation, judged: bool = False) -> Trial:
        """The same for a simulation that there is."""
        trial = Trial(world, judged)
        self.trials.append(trial)
        if trial.judge and (crossings := trial.judge.crossings(trial.world.positions)):
            raise Fault(at_most("crossings at the start", crossings, 0.0))
        return trial


@dataclass(frozen=True)
class Picture:
    """What the last simulation of a run looked like at its end.

    Attributes:
        positions: (n, 3) [m].
        triangles: (m, 3).
        edges: (e, 2), of which some belong to no triangle.
        held: (n,) bool, vertices of pieces that are pinned as a whole, and stand for obstacles.
        obstacles: Of the scene, with the shell of each that is a mesh, its position (3,) and rotation (3, 3).
    """

    positions: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    held: np.ndarray
    obstacles: list[tuple[Obstacle, Shell | None, np.ndarray, np.ndarray]]


@dataclass
class Outcome:
    """What came of a task.

    Attributes:
        task: Which.
        figures: Measured, as far as it went.
        trouble: Why it went no farther, if it did not.
        seconds: That it took.
        steps: That were taken.
        auditor: Who judged intersections; "" where nobody had to.
        picture: Of the end.
        kept: Of a failure: files by the end of their names.
    """

    task: Task
    figures: list[Figure] = field(default_factory=list)
    trouble: str = ""
    seconds: float = 0.0
    steps: int = 0
    auditor: str = ""
    picture: Picture | None = None
    kept: dict[str, bytes] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether it came to its end with every figure within its mark."""
        return not self.trouble and bool(self.figures) and all(figure.passed for figure in self.figures)


def run_task(task: Task) -> Outcome:
    """Run one case with one seed; whatever goes wrong is in the outcome."""
    case, probe, outcome, begin = cases()[task.name], Probe(task.seed), Outcome(task), time.perf_counter()
    try:
        with _ended_after(LONGEST + PATIENCE * case.seconds):
            for figure in case.run(probe):
                outcome.figures.append(figure)
    except Fault as fault:
        outcome.figures.append(fault.figure)
    except StepError as error:
        outcome.trouble = f"a step could not be done: {error}"
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        outcome.trouble = f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"
    outcome.seconds = time.perf_counter() - begin
    outcome.steps = sum(len(trial.reports) for trial in probe.trials)
    outcome.auditor = next((trial.judge.name for trial in probe.trials if trial.judge), "")
    if probe.trials:
        outcome.picture = take_picture(probe.trials[-1].world)
        if not outcome.passed:
            outcome.kept = pack(probe.trials[-1].world, probe.trials[-1].before)
    return outcome


def take_picture(world: Simulation) -> Picture:
    """Of a simulation as it is now."""
    parts = zip(world.scene.obstacle, world.mesh.shells, world.obstacle_poses(), strict=True)
    placed = [(obstacle, shell, *pose) for obstacle, shell, pose in parts]
    free = np.bincount(world.pieces, weights=world.model.free) > 0.0
    held = ~free[world.pieces]
    return Picture(world.positions.copy(), world.triangles.copy(), world.edges.copy(), held, placed)


@contextlib.contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the block after so long, where the system and the thread allow.

    And again after each second more: what is raised in a callback of the garbage collector goes nowhere.
    """
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def late(*_: object) -> None:
        raise TimeoutError(f"not done after {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, late)
    timer = signal.setitimer(signal.ITIMER_REAL, seconds, AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, *timer)
