"""What accuracy costs in time on one scene: a work–precision study, as Hairer and Wanner (1996) draw them.

In this order: how long runs may be compared at all; a reference that earns the name; every run of the plan,
timed alone and several times; which knob the error of the chosen settings comes from; and, past the time up
to which runs can be compared, seeded ensembles of observables.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import asdict, replace

from sim.bench.hardware import hardware, versions
from sim.integrators import INTEGRATORS
from sim.scene import Scene, load_scene
from sim.settings import Settings, change
from sim.simulation import Simulation
from sim.studies import Progress
from sim.studies.cost import plan as planning
from sim.studies.cost.front import front
from sim.studies.cost.horizon import HAIR, growth, growth_settings
from sim.studies.cost.measures import distances, size
from sim.studies.cost.nested import nested
from sim.studies.cost.plan import SOLVED, USUAL, Effort, Planned
from sim.studies.cost.reference import (
    FINER,
    Reference,
    ReferenceError,
    comparable,
    judge,
    reference_settings,
    refuse,
)
from sim.studies.cost.report import Band, CostReport, Curve, Failure, Growth, MeshLevel, Run, Source, Truth
from sim.studies.cost.timing import Timed, measure, repeat
from sim.studies.cost.trace import Case, Trace
from sim.studies.cost.verdict import ENERGY, verdict
from sim.studies.cost.workers import RunAll, workers
from sim.warmup import warm_up

TARGET = 1e-2
"""Relative error that the recommendation is for."""

SECONDS = 1.0
"""Time that is simulated, where cloth can be compared for so long [s]."""

FEWEST = 2
"""Looks that a comparison needs at least."""

SEED = 1e-6
"""By which ensembles' vertices are moved at first, as part of the cloth's size."""

GROWTH_SHARE, REFERENCE_SHARE, SWEEP_SHARE, ENSEMBLE_SHARE = 0.06, 0.15, 0.55, 0.04
"""Parts of the time of a study for each run that drifts apart, each reference, all timed runs, and each
seeded run; what is reached by then is what is compared."""

HARDER = 2.0
"""Times that a step of a timed run takes longer than one of the reference, short and easy as these are."""

LATER = 2.0
"""How much more expensive steps may be past the horizon, where cloth is folded."""


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
    every = planning.steps(chosen, effort)[0]
    if not seconds >= FEWEST * every:
        raise ValueError(f"--seconds: expected at least {FEWEST} steps of {every:.3g} s, got {seconds:g}")
    if not 0.0 < target < 1.0:
        raise ValueError(f"--target: expected a relative error > 0 and < 1, got {target:g}")
    computer = hardware()
    with workers(jobs, cluster) as run_all:
        study = _Study(
            scene, chosen, seconds, effort, target, progress or (lambda done, what: None), run_all, finer
        )
        return replace(study.report(), hardware=computer, versions=versions())


class _Study:
    """The stages of a study and what they share."""

    def __init__(
        self,
        scene: Scene,
        chosen: Settings,
        seconds: float,
        effort: Effort,
        target: float,
        progress: Progress,
        run_all: RunAll,
        finer: int,
    ) -> None:
        self.scene, self.chosen, self.effort, self.target = scene, chosen, effort, target
        self.progress, self.run_all, self.finer = progress, run_all, finer
        self.every = planning.steps(chosen, effort)[0]
        self.most = self.known = int(seconds / self.every + 1e-9)
        progress(0.0, "getting kernels ready (the first run compiles them)")
        warm_up(replace(scene, settings=change(chosen, newton=max(chosen.newton, 3))))
        self.begin = time.perf_counter()
        world = Simulation(scene, **asdict(chosen))
        self.masses, self.length = world.masses.copy(), size(world)

    def report(self) -> CostReport:
        """All stages."""
        grown, base = self._growth()
        contact = bool(base.contact["contacts"].max() > 0)
        planned = planning.plan(self.scene, self.chosen, self.effort, contact)
        last = max(1, round(grown.horizon / self.every))
        reference, timed, look, refined = self._compared(planned, last)
        self._repeat(planned, timed, look)
        runs, failed = self._runs(planned, timed, reference, look)
        if not runs or runs[0].settings != self.chosen:
            raise ReferenceError(f"the chosen settings fail {timed[0].trace.stopped}")
        meshes, finer = self._meshes(timed[0], look)
        sources = self._sources(timed[0].trace, look, contact, finer)
        bands = self._bands(runs, look)
        self.progress(1.0, "done")
        horizon = look * self.every
        return CostReport(
            scene=self.scene.name,
            seconds=self.most * self.every,
            vertices=len(self.masses),
            chosen=self.chosen,
            horizon=horizon,
            floor=float(reference.floor[look]),
            why_horizon=self._why(horizon, grown),
            growth=grown,
            reference=_truth(reference, look, refined),
            runs=runs,
            failed=failed,
            curves=_curves(runs),
            sources=sources,
            meshes=meshes,
            bands=bands,
            verdict=verdict(runs[0], runs, sources, self.target),
            notes=_notes(runs, contact, self.effort.repeats),
            hardware={},
            versions={},
        )

    # How long runs can be compared

    def _case(
        self, settings: dict[str, Any], looks: int, *nudges: tuple[float, int], share: float = math.inf
    ) -> Case:
        """A run of so many looks, for a share of the time of the study at most."""
        limit = share * 60.0 * self.effort.minutes
        return Case(self.scene, {**asdict(self.chosen), **settings}, self.every, looks, nudges, limit)

    def _growth(self) -> tuple[Growth, Trace]:
        """How fast runs drift apart, and the run that they drift from."""
        settings = growth_settings(self.chosen.dt, self.length)
        hair = HAIR * self.length
        cases = [self._case(settings, self.most, share=GROWTH_SHARE)]
        cases += [
            self._case(settings, self.most, (hair, 1 + m), share=GROWTH_SHARE)
            for m in range(self.effort.members)
        ]
        traces = self._made(cases, 0.02, 0.15, "how fast runs drift apart")
        if min(map(len, traces)) <= FEWEST:
            raise ReferenceError(f"a run with SDIRK2 fails {max(t.stopped for t in traces)}")
        return growth(traces[0], traces[1:], self.masses, self.length), traces[0]

    def _made(self, cases: Sequence[Case], start: float, end: float, what: str) -> list[Trace]:
        """Traces of runs that are not timed, with progress from `start` to `end`."""
        self.progress(start, what)
        traces = []
        for trace in self.run_all(cases):
            traces.append(trace)
            self.progress(start + (end - start) * len(traces) / len(cases), what)
        return traces

    def _reference_step(self) -> float:
        return planning.steps(self.chosen, self.effort)[-1] / self.finer

    def _why(self, horizon: float, grown: Growth) -> str:
        """Why errors are told up to the horizon and no longer."""
        if grown.reached and horizon >= grown.horizon - 0.5 * self.every:
            return "runs that differ by a hair differ visibly after that"
        if horizon >= (self.most - 0.5) * self.every:
            return "it was not asked for more"
        if round(horizon / self.every) < self.known:
            return "after that the reference is not known to a tenth of the smallest error"
        return "a longer reference would take too long for this effort; ask for --full"

    # Reference and timed runs

    def _compared(self, planned: Sequence[Planned], last: int) -> tuple[Reference, list[Timed], int, int]:
        """A reference, runs that can be told against it, up to which look, and how often it was refined."""
        dt, timed = self._reference_step(), None
        for refined in range(self.effort.refinements + 1):
            settings = reference_settings(self.chosen, dt / 2**refined)
            cases = [self._case(s, last, share=REFERENCE_SHARE) for s in settings]
            traces = self._made(cases, 0.15, 0.5, "the reference")
            last = min(last, *(len(trace) - 1 for trace in traces), self._affordable(traces[0], planned))
            reference = judge(traces, dt / 2**refined, self.masses, self.length)
            self.known = last
            timed = timed or self._timed(planned, last)
            fine = [t.trace for t in timed if not t.trace.stopped]
            if not fine:
                raise ReferenceError(f"every run fails; with the chosen settings {timed[0].trace.stopped}")
            errors = [reference.errors(trace, self.masses, self.length) for trace in fine]
            look = comparable(reference.floor, errors, last)
            if look is not None and look >= min(FEWEST, last):
                return reference, timed, look, refined
            if refined == self.effort.refinements:
                raise refuse(reference, errors, last)
        raise AssertionError("unreachable")

    def _affordable(self, reference: Trace, planned: Sequence[Planned]) -> int:
        """Looks that every timed run can go on for twice: once to warm up, and once for the time."""
        if math.isinf(self.effort.minutes):
            return self.most
        per_step = reference.seconds / reference.work["steps"].sum()
        steps = 2 * sum(self.every / p.settings.dt for p in planned)
        return max(FEWEST, int(SWEEP_SHARE * 60.0 * self.effort.minutes / (HARDER * per_step * steps)))

    def _timed(self, planned: Sequence[Planned], last: int) -> list[Timed]:
        cases = [self._case(asdict(p.settings), last) for p in planned]
        return measure(
            cases, lambda done: self.progress(0.5 + 0.15 * done / len(cases), _what(planned[done]))
        )

    def _repeat(self, planned: Sequence[Planned], timed: Sequence[Timed], look: int) -> None:
        cases = [self._case(asdict(p.settings), look) for p in planned]
        until = self.begin + 60.0 * self.effort.minutes

        def go_on(done: float) -> bool:
            self.progress(0.65 + 0.2 * done, f"timing {len(cases)} runs, several times each")
            return time.perf_counter() < until

        repeat(cases, timed, self.effort.repeats, go_on)

    def _runs(
        self, planned: Sequence[Planned], timed: Sequence[Timed], reference: Reference, look: int
    ) -> tuple[list[Run], list[Failure]]:
        runs, failed = [], []
        for p, t in zip(planned, timed, strict=True):
            about = {
                "settings": p.settings,
                "changed": planning.differing(self.chosen, p.settings),
                "curves": p.curves,
            }
            if t.trace.stopped:
                failed.append(Failure(**about, reason=t.trace.stopped))
            else:
                runs.append(Run(**about, **self._figures(t, reference, look)))
        errors, floor = [r.error for r in runs], float(reference.floor[look])
        on = front([r.ms for r in runs], errors, floor)
        by_work = front([r.matvecs or math.inf for r in runs], errors, floor)
        fronts = zip(runs, on, by_work, strict=True)
        return [replace(r, front=a, front_by_work=b) for r, a, b in fronts], failed

    def _figures(self, t: Timed, reference: Reference, look: int) -> dict[str, Any]:
        trace, truth = t.trace, reference.trace
        until = slice(look + 1)
        apart = distances(trace.positions[until], truth.positions[until], self.masses, self.length)
        steps = trace.work["steps"][until].sum()
        repeats = t.repeats(look)
        return {
            "ms": float(np.median(repeats)),
            "ms_repeats": repeats,
            "phases": t.phase_medians(look),
            "matvecs": trace.per_second(trace.work["matvecs"], look),
            "queries": trace.per_second(trace.work["queries"], look),
            "newton_per_step": float(trace.work["newton"][until].sum() / steps),
            "unconverged": float(trace.work["unconverged"][until].sum() / steps),
            "stood_in": float(trace.work["stood_in"][until].sum() / steps),
            "error": float(apart.max()),
            "error_at_end": float(apart[-1]),
            "error_energy": float(
                np.abs(trace.energy[until] - truth.energy[until]).max() / _turnover(truth, look)
            ),
            "error_strain": float(np.abs(trace.strain[until] - truth.strain[until]).max()),
            "error_observables": _differences(trace, truth, look),
            "penetrations": int(trace.contact["penetrations"][until].max()),
            "deepest": float(trace.contact["deepest"][until].max()),
            "front": False,
            "front_by_work": False,
        }

    # Where the error comes from

    def _meshes(self, timed: Timed, look: int) -> tuple[list[MeshLevel], dict[str, Any] | None]:
        """The chosen settings on nested meshes; and what the finest one needs to be the same cloth."""
        found = [(0, timed)]
        stiffness = None
        for level in (-1, 1):
            if (other := nested(self.scene, self.chosen, level)) is None:
                continue
            self.progress(0.85 + 0.02 * (level > 0), f"a mesh {'half' if level < 0 else 'twice'} as fine")
            self._finer = other[0] if level > 0 else None
            case = Case(other[0], {**asdict(self.chosen), **other[1]}, self.every, look)
            again = measure([case], lambda done: None)[0]
            if not again.trace.stopped:
                found.append((level, again))
                stiffness = other[1] if level > 0 else None
        if len(found) == 1:
            return [], None
        found.sort(key=lambda pair: pair[0])
        finest = found[-1][1].trace
        return [_mesh_level(t, finest, look) for _, t in found], stiffness

    def _sources(self, chosen: Trace, look: int, contact: bool, mesh: dict[str, Any] | None) -> list[Source]:
        """What each knob changes of the chosen run when it is turned towards accuracy."""
        turned = planning.refinements(self.scene, self.chosen, contact, mesh)
        cases = [
            replace_scene(self._case(r.changes, look), self._finer)
            if r.level
            else self._case(r.changes, look)
            for r in turned
        ]
        traces = self._made(cases, 0.89, 0.93, "where the error comes from")
        found = []
        for r, trace in zip(turned, traces, strict=True):
            if trace.stopped:
                found.append(
                    Source(source=r.source, what=r.what, change=None, observables={}, reason=trace.stopped)
                )
                continue
            apart = None
            if not r.level:
                until = slice(look + 1)
                moved = distances(trace.positions[until], chosen.positions[until], self.masses, self.length)
                apart = float(moved.max())
            moved = _differences(trace, chosen, look)
            found.append(Source(source=r.source, what=r.what, change=apart, observables=moved))
        return found

    # Beyond the horizon

    def _bands(self, runs: Sequence[Run], look: int) -> list[Band]:
        """Observables of seeded runs, past the time up to which positions can be compared."""
        if look >= self.most or not self.effort.ensemble:
            return []
        chosen, members = runs[0], self.effort.ensemble
        most = 6e4 * self.effort.minutes * ENSEMBLE_SHARE
        fit = [run for run in runs if LATER * run.ms * self.most * self.every <= most]
        best = min(fit, key=lambda run: (run.error, run.ms), default=chosen)
        names = {"chosen": chosen, "accurate": best} if best is not chosen else {"chosen": chosen}
        nudge = SEED * self.length
        cases = [
            self._case(asdict(run.settings), self.most, (nudge, 1 + m), share=ENSEMBLE_SHARE)
            for run in names.values()
            for m in range(members)
        ]
        traces = iter(self._made(cases, 0.93, 1.0, "seeded runs beyond the horizon"))
        return list(chain(*(_bands_of(name, [next(traces) for _ in range(members)]) for name in names)))


def replace_scene(case: Case, scene: Scene | None) -> Case:
    """The same run of another scene."""
    from dataclasses import replace as replaced

    return case if scene is None else replaced(case, scene=scene)


def _what(planned: Planned) -> str:
    return f"{planned.curves[0]}, h = {1e3 * planned.settings.dt:.3g} ms"


def _turnover(trace: Trace, look: int) -> float:
    """The energy [J] that errors are told as part of: the most that any kind held or changed by."""
    until = slice(look + 1)
    largest = max(float(np.ptp(part[until])) for part in trace.parts.values())
    return max(largest, float(trace.parts["kinetic"][until].max()), np.finfo(float).tiny)


def _differences(trace: Trace, truth: Trace, look: int) -> dict[str, float]:
    """By how much observables differ at a look, in their own units."""
    return {
        name: float(values[look] - truth.observables[name][look])
        for name, values in trace.observables.items()
    }


def _mesh_level(timed: Timed, finest: Trace, look: int) -> MeshLevel:
    trace = timed.trace
    return MeshLevel(
        vertices=trace.positions.shape[1],
        ms=float(np.median(timed.repeats(look))),
        observables={name: float(values[look]) for name, values in trace.observables.items()},
        error_observables=None if trace is finest else _differences(trace, finest, look),
    )


def _truth(reference: Reference, look: int, refined: int) -> Truth:
    return Truth(
        integrator="sdirk2",
        dt=reference.dt,
        floor=float(reference.floor[look]),
        checks={name: float(apart[: look + 1].max()) for name, apart in reference.checks.items()},
        times=reference.trace.times[: len(reference.floor)].tolist(),
        floor_by_time=reference.floor.tolist(),
        refined=refined,
    )


def _curves(runs: Sequence[Run]) -> list[Curve]:
    """Every curve, with the order that its errors show over the time step."""
    found = []
    for name in dict.fromkeys(curve for run in runs for curve in run.curves):
        points = sorted((run.settings.dt, run.error) for run in runs if name in run.curves)
        steps, errors = np.array(points).T
        order = float(np.polyfit(np.log(steps), np.log(errors), 1)[0]) if len(set(steps)) > 2 else None
        method = name.removesuffix(f", {SOLVED}")
        expected = INTEGRATORS[method].order if method in INTEGRATORS and method != name else None
        found.append(Curve(name=name, order=order, expected=expected))
    return found


def _bands_of(name: str, traces: Sequence[Trace]) -> Iterator[Band]:
    whole = [trace for trace in traces if not trace.stopped]
    looks = min(map(len, whole), default=0)
    for observable in whole[0].observables if whole else ():
        values = np.stack([trace.observables[observable][:looks] for trace in whole])
        yield Band(
            settings=name,
            observable=observable,
            members=len(whole),
            times=whole[0].times[:looks].tolist(),
            mean=values.mean(axis=0).tolist(),
            deviation=values.std(axis=0).tolist(),
        )


def _notes(runs: Sequence[Run], contact: bool, repeats: int) -> list[str]:
    notes = [
        "All runs start from the same state and simulate the same cloth; errors are mass-weighted distances "
        "from the reference as part of the cloth's diagonal, the largest up to the horizon.",
        f"On curves named “{SOLVED}” equations are solved so well that all error is the time step's; on "
        "curves named after an integrator alone, Newton iterations are as chosen, and the tolerance goes "
        "with the step squared.",
        "The reference is known to a tenth of the smallest error plotted, or the study would have "
        "been refused.",
        "Not recommended are settings that let cloth deeper into an obstacle than the chosen ones do, or "
        f"whose energy is more wrong than theirs and than {ENERGY:.0f} times the target.",
    ]
    stood_in = max((run.stood_in for run in runs), default=0.0)
    if contact:
        notes.append(
            "Cloth touches something here: a step that feels a contact is one of backward Euler whatever the "
            f"integrator (up to {stood_in:.0%} of the steps), so no method is of more than first order from "
            "there on."
        )
    if (fewest := min(len(run.ms_repeats) for run in runs)) < repeats:
        notes.append(
            f"Time was up before all repeats: some runs were timed less often, down to {fewest} of {repeats}."
        )
    return notes
