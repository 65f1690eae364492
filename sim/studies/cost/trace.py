"""One run of a scene, looked at now and then: where the cloth was, and what its steps cost."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.ledger import Ledger
from sim.report import StepError, StepReport
from sim.scene import Scene
from sim.simulation import Simulation
from sim.studies.cost.measures import Measures

WORK = ("matvecs", "queries", "newton", "steps", "unconverged", "stood_in")
"""Countable work of a step: matrix–vector products of the linear solver, pairs of features that contact
looked at, Newton iterations; and steps, those whose solver did not converge, and those that another
integrator took."""

CONTACT = ("contacts", "penetrations", "deepest")
"""What is largest in a step: contacts, vertices inside an obstacle, and how deep the deepest is [m]."""


@dataclass(frozen=True)
class Case:
    """A run to make; small, and the same in any process.

    Attributes:
        scene: What runs.
        settings: That differ from the scene's.
        every: Time from look to look [s]; a whole number of steps.
        looks: How many there are, after the one at the start.
        nudges: By how much each vertex is moved first: standard deviations [m], and seeds.
        limit: Processor time after which no more looks are taken [s]; a busy computer does not change it.
        booked: Whether an energy ledger is kept, which takes time: steps of such a run are not timed.
    """

    scene: Scene
    settings: dict[str, Any]
    every: float
    looks: int
    nudges: tuple[tuple[float, int], ...] = ()
    limit: float = math.inf
    booked: bool = False


@dataclass
class Trace:
    """What was seen of a run, one entry for each look; the first is the start.

    Attributes:
        times: (k,) [s].
        positions: (k, n, 3) [m].
        energy: (k,) kinetic and potential [J], with `parts` by kind.
        strain: (k,) largest strain of an edge.
        observables: By name, (k,).
        ms: (k,) wall milliseconds of all steps since the look before, `phases` by phase.
        work: By name out of WORK, (k,) summed since the look before.
        contact: By name out of CONTACT, (k,) largest since the look before.
        seconds: Processor time of all of it [s].
        stopped: Why it ended early; empty where it did not.
        ledger: Of its energy, up to the last look; None without books.
    """

    times: np.ndarray
    positions: np.ndarray
    energy: np.ndarray
    parts: dict[str, np.ndarray]
    strain: np.ndarray
    observables: dict[str, np.ndarray]
    ms: np.ndarray
    phases: dict[str, np.ndarray]
    work: dict[str, np.ndarray]
    contact: dict[str, np.ndarray]
    seconds: float
    stopped: str = ""
    ledger: Ledger | None = None

    def __len__(self) -> int:
        return len(self.times)

    def per_second(self, amounts: np.ndarray, looks: int) -> float:
        """What was summed up to a look, per simulated second."""
        return float(amounts[: looks + 1].sum() / self.times[looks])


@dataclass
class _Interval:
    """What happened since the last look."""

    ms: float = 0.0
    phases: dict[str, float] = field(default_factory=dict)
    work: dict[str, float] = field(default_factory=lambda: dict.fromkeys(WORK, 0.0))
    contact: dict[str, float] = field(default_factory=lambda: dict.fromkeys(CONTACT, 0.0))

    def add(self, world: Simulation, report: StepReport, ms: float) -> None:
        self.ms += ms
        for name, took in report.ms.items():
            if name != "total":
                self.phases[name] = self.phases.get(name, 0.0) + took
        obstacles = len(world.scene.obstacle) * len(world.positions) * (world.settings.contact != "none")
        work = {
            "matvecs": report.iterations,
            "queries": report.candidates + obstacles,
            "newton": report.newton,
            "steps": 1,
            "unconverged": not report.converged,
            "stood_in": report.integrator != world.settings.integrator,
        }
        for name, amount in work.items():
            self.work[name] += amount
        for name in CONTACT:
            self.contact[name] = max(self.contact[name], getattr(report, name))


def run(case: Case) -> Trace:
    """Make a run. A step that fails ends it, or the end of its time; what was seen by then is kept."""
    world = Simulation(case.scene, **case.settings)
    for deviation, seed in case.nudges:
        noise = np.random.default_rng(seed).standard_normal(world.positions.shape)
        world.place(world.positions + deviation * world.model.confined(noise))
    _warm(world)
    world.keep_ledger(case.booked)
    measures, steps = Measures(world), round(case.every / world.settings.dt)
    looks, intervals = [measures.look()], [_Interval()]
    positions, stopped, ledger = [world.positions.copy()], "", world.ledger
    begun = time.process_time()
    while len(looks) <= case.looks and (time.process_time() < begun + case.limit or len(looks) == 1):
        interval = _Interval()
        try:
            for _ in range(steps):
                begin = time.perf_counter()
                report = world.step()
                interval.add(world, report, 1e3 * (time.perf_counter() - begin))
        except StepError as error:
            stopped = f"at {world.time:.3g} s: {error}"
            break
        looks.append(measures.look())
        intervals.append(interval)
        positions.append(world.positions.copy())
        ledger = world.ledger
    return _trace(case, positions, looks, intervals, time.process_time() - begun, stopped, ledger)


def _warm(world: Simulation) -> None:
    """Take a step, and take it back: what a simulation builds once is no part of what its steps cost."""
    start = world.snapshot()
    with contextlib.suppress(StepError):  # the run itself will say so
        world.step()
    world.restore(start)


def _trace(
    case: Case,
    positions: list,
    looks: list,
    intervals: list[_Interval],
    seconds: float,
    stopped: str,
    ledger: Ledger | None,
) -> Trace:
    def columns(rows: list[dict[str, float]]) -> dict[str, np.ndarray]:
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: np.array([row.get(name, 0.0) for row in rows]) for name in names}

    return Trace(
        times=case.every * np.arange(len(looks)),
        positions=np.stack(positions),
        energy=np.array([sum(look.energy.values()) for look in looks]),
        parts=columns([look.energy for look in looks]),
        strain=np.array([look.strain for look in looks]),
        observables=columns([look.observables for look in looks]),
        ms=np.array([interval.ms for interval in intervals]),
        phases=columns([interval.phases for interval in intervals]),
        work=columns([interval.work for interval in intervals]),
        contact=columns([interval.contact for interval in intervals]),
        seconds=seconds,
        stopped=stopped,
        ledger=ledger,
    )
