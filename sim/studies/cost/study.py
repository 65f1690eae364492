"""What accuracy costs in time on one scene: a work–precision study, as Hairer and Wanner (1996) draw them.

In this order: how long runs may be compared at all; a reference that earns the name; every run of the plan,
timed alone and several times; which knob the error of the chosen settings comes from; and, past the time up
to which runs can be compared, seeded ensembles of observables.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import asdict, replace

from sim.bench.hardware import hardware, versions
from sim.scene import Scene, load_scene
from sim.settings import change
from sim.studies import Progress
from sim.studies.cost import plan as planning
from sim.studies.cost.ensemble import SEED, bands, worth_an_ensemble
from sim.studies.cost.horizon import HAIR, growth, growth_settings
from sim.studies.cost.judged import curves, judged, truth
from sim.studies.cost.plan import USUAL, Effort, Planned
from sim.studies.cost.reference import (
    FINER,
    ROUNDING,
    Reference,
    ReferenceError,
    comparable,
    judge,
    reference_settings,
    refuse,
)
from sim.studies.cost.report import Band, CostReport, Growth, Run, Source
from sim.studies.cost.sources import meshes, refinements, sources
from sim.studies.cost.subject import Subject
from sim.studies.cost.timing import Timed, measure, repeat
from sim.studies.cost.trace import Case, Trace
from sim.studies.cost.verdict import notes, verdict
from sim.studies.cost.workers import RunAll, workers
from sim.studies.seconds import check_seconds
from sim.warmup import warm_up

TARGET = 1e-2
"""Relative error that the recommendation is for."""

SECONDS = 1.0
"""Time that is simulated, where cloth can be compared for so long [s]."""

FEWEST = 2
"""Looks that a comparison needs at least."""

GROWTH_SHARE, REFERENCE_SHARE, SWEEP_SHARE, ENSEMBLE_SHARE = 0.06, 0.15, 0.55, 0.04
"""Parts of the time of a study for each run that drifts apart, each reference, all timed runs, and each
seeded run; what is reached by then is what is compared."""

HARDER = 2.0
"""Times that a step of a timed run takes longer than one of the reference, short and easy as these are."""


def cost(
    scene: Scene | str | Path | dict[str, Any],
    overrides: dict[str, Any] | None = None,
    seconds: float = SECONDS,
    effort: Effort = USUAL,
    target: float = TARGET,
    progress: Progress | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    finer: int = FINER,
) -> CostReport:
    """Measure what accuracy costs on a scene.

    Args:
        scene: As for Simulation.
        overrides: Settings that differ from the scene's; together they are the chosen ones.
        seconds: Up to which runs are compared, if they can be compared for so long [s].
        effort: How much to measure.
        target: Relative error that the recommendation is for.
        progress: Is told how far it is.
        jobs: Local processes for runs that are not timed; as many as there are cores if left out.
        cluster: Address of a Dask scheduler for them instead.
        finer: Times that the reference's step is finer than the finest one swept.

    Raises:
        SceneError, ValueError: for what makes no sense.
        ReferenceError: where there is no reference to tell errors against.
    """
    scene = load_scene(scene)
    chosen = change(scene.settings, **(overrides or {}))
    check_seconds(seconds)
    every = planning.steps(chosen, effort)[0]
    if not seconds >= FEWEST * every:
        raise ValueError(f"--seconds: expected at least {FEWEST} steps of {every:.3g} s, got {seconds:g}")
    if not 0.0 < target < 1.0:
        raise ValueError(f"--target: expected a relative error > 0 and < 1, got {target:g}")
    computer = hardware()
    told = progress or (lambda done, what: None)
    told(0.0, "getting kernels ready (the first run compiles them)")
    warm_up(replace(scene, settings=change(chosen, newton=max(chosen.newton, 3))))
    with workers(jobs, cluster) as run_all:
        subject = Subject.of(scene, chosen, every)
        study = _Study(subject, int(seconds / every + 1e-9), effort, told, run_all, finer)
        return replace(study.report(target), hardware=computer, versions=versions())


class _Study:
    """The stages of a study and what they share."""

    def __init__(
        self,
        subject: Subject,
        most: int,
        effort: Effort,
        progress: Progress,
        run_all: RunAll,
        finer: int,
    ) -> None:
        self.subject, self.most, self.effort, self.finer = subject, most, effort, finer
        self.run_all, self._progress, self._done = run_all, progress, 0.0
        self.known, self.begin, self.more = most, time.perf_counter(), planning.more_time(effort)

    def report(self, target: float) -> CostReport:
        """All stages."""
        subject = self.subject
        grown, base = self._growth()
        contact = bool(base.contact["contacts"].max() > 0)
        planned = planning.plan(subject.scene, subject.chosen, self.effort, contact)
        reference, timed, look, refined = self._compared(
            planned, max(1, round(grown.horizon / subject.every))
        )
        self._repeat(planned, timed, look)
        runs, failed = judged(subject, planned, timed, reference, look)
        if not runs or runs[0].settings != subject.chosen:
            raise ReferenceError(f"the chosen settings fail {timed[0].trace.stopped}")
        on_meshes = meshes(subject, timed[0], look, lambda what: self._say(0.83, what))
        found = self._sources(timed[0].trace, look, contact)
        seeded = self._bands(runs, look)
        self._say(1.0, "done")
        return CostReport(
            scene=subject.scene.name,
            seconds=self.most * subject.every,
            vertices=len(subject.masses),
            chosen=subject.chosen,
            horizon=look * subject.every,
            floor=float(reference.floor[look]),
            why_horizon=self._why(look, grown),
            growth=grown,
            reference=truth(reference, look, refined),
            runs=runs,
            failed=failed,
            curves=curves(runs),
            sources=found,
            meshes=on_meshes,
            bands=seeded,
            verdict=verdict(runs[0], runs, found, target, self._where(look)),
            notes=notes(runs, contact, self.effort.repeats, found),
            hardware={},
            versions={},
        )

    def _say(self, done: float, what: str) -> None:
        """Tell how far it is, in parts of the time that stages usually take.

        A reference that is refined does not take back what was said.
        """
        self._done = max(self._done, done)
        self._progress(self._done, what)

    def _made(self, cases: Sequence[Case], start: float, end: float, what: str) -> list[Trace]:
        """Traces of runs that are not timed, with progress from `start` to `end`."""
        self._say(start, what)
        traces = []
        for trace in self.run_all(cases):
            traces.append(trace)
            self._say(start + (end - start) * len(traces) / len(cases), what)
        return traces

    def _limit(self, share: float) -> float:
        """A share of the time of the study [s]."""
        return share * 60.0 * self.effort.minutes

    def _growth(self) -> tuple[Growth, Trace]:
        """How fast runs drift apart, and the run that they drift from."""
        subject, limit = self.subject, self._limit(GROWTH_SHARE)
        settings = growth_settings(subject.chosen.dt, subject.length)
        hairs = [(HAIR * subject.length, 1 + member) for member in range(self.effort.members)]
        cases = [subject.case(settings, self.most, limit=limit)]
        cases += [subject.case(settings, self.most, hair, limit=limit) for hair in hairs]
        base, *moved = self._made(cases, 0.02, 0.1, "how fast runs drift apart")
        if len(base) <= FEWEST:
            why = base.stopped or f"for lack of time; {self.more}"
            raise ReferenceError(
                f"a run with SDIRK2, which would tell how long runs can be compared, fails {why}"
            )
        return growth(base, moved, subject.masses, subject.length), base

    def _why(self, look: int, grown: Growth) -> str:
        """Why errors are told up to the horizon and no longer."""
        if grown.reached and look >= round(grown.horizon / self.subject.every):
            return "runs that differ by a hair differ visibly after that"
        if look >= self.most:
            return "it was not asked for more"
        if look < self.known:
            return "after that the reference is not known to a tenth of the smallest error"
        return f"a longer reference would take too long for this effort; {self.more}"

    def _where(self, look: int) -> str:
        """What errors are told of, in words."""
        if look >= self.most:
            return "on this scene"
        return f"in the first {look * self.subject.every:.2g} s of this scene"

    def _compared(self, planned: Sequence[Planned], last: int) -> tuple[Reference, list[Timed], int, int]:
        """A reference, runs that can be told against it, up to which look, and how often it was refined."""
        subject, timed, refined, fewest, asked = self.subject, None, 0, min(FEWEST, last), last
        while True:
            dt = planning.steps(subject.chosen, self.effort)[-1] / self.finer / 2**refined
            limit = self._limit(REFERENCE_SHARE)
            cases = [subject.case(s, last, limit=limit) for s in reference_settings(subject.chosen, dt)]
            traces = self._made(cases, 0.1, 0.3, "the reference")
            reference = judge(traces, dt, subject.masses, subject.length)
            begun = int(np.argmax(reference.floor > ROUNDING))  # before, cloth falls, and all are exact
            afforded = max(self._affordable(traces[0], planned), begun + FEWEST)
            last = min(last, *(len(trace) - 1 for trace in traces), afforded)
            if last < fewest:
                raise ReferenceError(
                    f"a reference with steps of {1e3 * dt:.3g} ms comes no farther than "
                    f"{last * subject.every:.3g} s in the time that there is; {self.more}"
                )
            timed = timed or self._timed(planned, last)
            fine = [t.trace for t in timed if not t.trace.stopped]
            if not fine:
                raise ReferenceError(f"every run fails; with the chosen settings {timed[0].trace.stopped}")
            errors = [reference.errors(trace, subject.masses, subject.length) for trace in fine]
            look, self.known = comparable(reference.floor, errors, last), last
            if look is not None and look >= fewest:
                return reference, timed, look, refined
            if refined == self.effort.refinements:
                raise refuse(reference, errors, last, fewest, cut=last < asked, more=self.more)
            refined += 1

    def _affordable(self, reference: Trace, planned: Sequence[Planned]) -> int:
        """Looks that every timed run can go on for twice: once to warm up, and once for the time."""
        if math.isinf(self.effort.minutes):
            return self.most
        per_step = reference.seconds / reference.work["steps"].sum()
        steps = 2 * sum(self.subject.every / p.settings.dt for p in planned)
        return max(FEWEST, int(self._limit(SWEEP_SHARE) / (HARDER * per_step * steps)))

    def _timed(self, planned: Sequence[Planned], last: int) -> list[Timed]:
        cases = [self.subject.case(asdict(p.settings), last) for p in planned]
        return measure(cases, lambda i: self._say(0.3 + 0.2 * i / len(cases), _what(planned[i])))

    def _repeat(self, planned: Sequence[Planned], timed: Sequence[Timed], look: int) -> None:
        cases = [self.subject.case(asdict(p.settings), look) for p in planned]
        until = self.begin + self._limit(1.0)

        def go_on(done: float) -> bool:
            self._say(0.5 + 0.32 * done, f"timing {len(cases)} runs, several times each")
            return time.perf_counter() < until

        repeat(cases, timed, self.effort.repeats, go_on)

    def _sources(self, chosen: Trace, look: int, contact: bool) -> list[Source]:
        turned = refinements(self.subject, look, contact)
        traces = self._made([r.case for r in turned], 0.85, 0.88, "where the error comes from")
        return sources(self.subject, chosen, turned, traces, look)

    def _bands(self, runs: Sequence[Run], look: int) -> list[Band]:
        """Observables of seeded runs, where there is time past the horizon."""
        members, limit = self.effort.ensemble, self._limit(ENSEMBLE_SHARE)
        if look >= self.most or not members:
            return []
        subject, found = self.subject, []
        chosen = worth_an_ensemble(runs, self.most * subject.every, limit)
        nudges = [(SEED * subject.length, 1 + member) for member in range(members)]
        cases = [
            subject.case(asdict(run.settings), self.most, nudge, limit=limit)
            for run in chosen.values()
            for nudge in nudges
        ]
        traces = self._made(cases, 0.88, 1.0, "seeded runs beyond the horizon")
        for k, name in enumerate(chosen):
            found += bands(name, traces[k * members : (k + 1) * members], look)
        return found


def _what(planned: Planned) -> str:
    return f"{planned.curves[0]}, h = {1e3 * planned.settings.dt:.3g} ms"
