"""Which effects a scene needs: each one is left out, or brought in, from the same states, and judged.

The run is cut into windows. From the state at the start of each window the scene is stepped as it is, with
half the step, and once for every effect with that effect switched. How far the cloth then is from where it is
otherwise tells what the effect changes; what half the step changes is the numerical error of the run itself,
and what is smaller nobody can see. States are shared, so that differences do not grow into other folds.

An effect also matters where leaving it out lets cloth into an obstacle or through itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tomli_w

from sim.bench.hardware import hardware, versions
from sim.effects import NEVER, State, chosen, effects_with, state, switch
from sim.report import StepError, StepReport
from sim.scene import Scene, load_scene
from sim.settings import FIELDS, READ_OUTS, Settings, change
from sim.simulation import Simulation, Snapshot
from sim.studies import Progress
from sim.studies.cost.measures import distances, size
from sim.studies.cost.report import AuditedEffect, AuditReport
from sim.studies.seconds import check_seconds
from sim.warmup import warm_up

WINDOWS = 5
"""Parts that a run is cut into, unless it is shorter than so many steps."""

CLEAR = 3.0
"""A change of so many numerical errors matters; one of less than 1 is below it."""

ROUNDING = 1e-11
"""Relative distance that rounding alone may make: what changes no more than that changes nothing."""

SLOWER = 0.1
"""Part of a step by which one without an effect must be slower, and by more than noise, for that to count."""

SHORTEST, LONGEST = 1.0, 5.0
"""Time that is looked at unless somebody says how long [s]: the longest if obstacles move that long."""

OUTLIERS = 0.1
"""Part of all steps, at either end, that costs leave out: a computer has other things to do now and then."""

FINER = 2
"""Parts of a step that the numerical error is told by."""

MATTERS, BELOW, UNCERTAIN = "matters", "below the numerical error", "uncertain"


@dataclass
class _Way:
    """What was seen of a few steps.

    Attributes:
        places: (k, n, 3) where vertices were after each look [m].
        ms: Of each step.
        reports: Of each step.
        inside: Vertices inside obstacles at the end.
        crossed: Pairs that cross at the end.
        stopped: Whether a step could not be done.
    """

    places: np.ndarray
    ms: list[float] = field(default_factory=list)
    reports: list[StepReport] = field(default_factory=list)
    inside: int = 0
    crossed: int = 0
    stopped: bool = False


@dataclass
class _Seen:
    """Of one effect in every window: how far it took the cloth, in lengths and in numerical errors."""

    influence: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)
    ms: list[list[float]] = field(default_factory=list)
    worse: bool = False


def audit(
    scene: Scene | str | Path | dict[str, Any],
    overrides: dict[str, Any] | None = None,
    seconds: float | None = None,
    tolerance: float = 0.01,
    progress: Progress | None = None,
) -> AuditReport:
    """Judge every effect of a scene.

    Args:
        scene: As for Simulation.
        overrides: Settings that differ from the scene's.
        seconds: That are looked at [s]; if left out, one, or more if obstacles take longer to go their ways.
        tolerance: How far all that is recommended to be left out may take the cloth together, relative.
        progress: Is told how far it is.

    Raises:
        SceneError, ValueError: for what makes no sense, or cannot be run.
    """
    scene = load_scene(scene)
    settings = change(scene.settings, **(overrides or {}))
    if not tolerance > 0.0 or not math.isfinite(tolerance):
        raise ValueError(f"--tolerance: expected > 0, got {tolerance:g}")
    seconds = _until_obstacles_rest(scene) if seconds is None else seconds
    check_seconds(seconds)
    steps = round(seconds / settings.dt)
    if steps < 1:
        raise ValueError(f"--seconds: expected at least one step of {settings.dt:.3g} s, got {seconds:g}")
    told = progress or (lambda done, what: None)
    told(0.0, "getting kernels ready (the first run compiles them)")
    warm_up(scene)
    return _Audit(scene, settings, steps, tolerance, told).report(hardware())


def _until_obstacles_rest(scene: Scene) -> float:
    """Time [s] by which the scene has shown what its obstacles do, within bounds."""
    ends = [obstacle.path[-1].time for obstacle in scene.obstacle if obstacle.path]
    return min(max(SHORTEST, *ends), LONGEST) if ends else SHORTEST


class _Audit:
    """The stages of an audit and what they share."""

    def __init__(
        self, scene: Scene, settings: Settings, steps: int, tolerance: float, told: Progress
    ) -> None:
        self.scene, self.settings, self.steps, self.tolerance, self.told = (
            scene,
            settings,
            steps,
            tolerance,
            told,
        )
        self.base: list[_Way] = []
        self.again: list[_Way] = []
        self.error: list[float] = []
        every = effects_with(scene.obstacle_labels).items()
        self.effects = {name: effect for name, effect in every if name not in READ_OUTS}
        self.seen = {name: _Seen() for name in self.effects}
        self.world = Simulation(scene, **{name: getattr(settings, name) for name in FIELDS})
        self.masses, self.length = self.world.masses.copy(), size(self.world)
        self.now: dict[str, State] = {name: state(name, settings) for name in self.effects}
        self.changes = {
            name: switch(name, "auto" if now == "off" else "off", settings) for name, now in self.now.items()
        }

    def report(self, computer: dict[str, Any]) -> AuditReport:
        """Do all of it."""
        start = self.world.snapshot()
        for part, first, count in self._windows():
            self.told(0.8 * part, f"steps {first + 1} to {first + count}")
            self._window(count)
        self.told(0.8, "what can be left out together")
        left_out, apart, whole, ms = self._together(start)
        return AuditReport(
            scene=self.scene.name,
            seconds=self.steps * self.settings.dt,
            vertices=len(self.masses),
            settings=self.settings,
            tolerance=self.tolerance,
            numerical_error=max(self.error),
            cost_noise=self._noise(),
            windows=len(self.error),
            ms=whole,
            effects=[self._effect(name) for name in self.effects],
            recommended=dict.fromkeys(left_out, "off"),
            recommended_ms=ms,
            recommended_error=apart,
            toml=self._toml(left_out, whole, ms, apart),
            notes=list(NOTES),
            hardware=computer,
            versions=versions(),
        )

    def _windows(self) -> Iterator[tuple[float, int, int]]:
        """The part that is done before each window, its first step, and how many it has."""
        count = min(WINDOWS, self.steps)
        for k in range(count):
            first = k * self.steps // count
            yield k / count, first, (k + 1) * self.steps // count - first

    def _window(self, count: int) -> None:
        """Step one window in every way, and leave the world as it is at the end."""
        start = self.world.snapshot()
        as_is = self._steps(start, {}, count)
        if as_is.stopped:
            raise ValueError(f"{self.scene.name}: a step fails as it is; see `muslin run {self.scene.name}`")
        end = self.world.snapshot()
        finer = FIELDS["tolerance"].clamp(self.settings.tolerance / FINER**2)
        finer = {"dt": self.settings.dt / FINER, "tolerance": finer}
        error = self._apart(self._steps(start, finer, count * FINER, FINER), as_is)
        self.base.append(as_is)
        self.error.append(error)
        for name, changes in self.changes.items():
            way, found = self._steps(start, changes, count), self.seen[name]
            moved = self._apart(way, as_is)
            found.influence.append(moved)
            found.ratio.append(0.0 if moved <= ROUNDING else moved / max(error, ROUNDING))
            found.ms.append(way.ms)
            found.worse |= way.inside > as_is.inside or way.crossed > as_is.crossed
        self.again.append(self._steps(start, {}, count))
        self.world.restore(end)

    def _steps(self, start: Snapshot, changes: dict[str, Any], count: int, every: int = 1) -> _Way:
        """Take `count` steps from a state with other settings, and look `every` few."""
        world = self.world
        world.restore(start)
        if changes:
            world.switch(**changes)
        way, places = _Way(np.zeros(0)), []
        for k in range(count):
            try:
                report = world.step()
            except StepError:
                way.stopped = True
                break
            way.ms.append(report.ms["total"])
            way.reports.append(report)
            if (k + 1) % every == 0:
                places.append(world.positions.copy())
        way.places = np.array(places)
        way.inside = int(np.count_nonzero(world.contact.depths(world.time, world.positions)))
        way.crossed = world.crossings()
        return way

    def _apart(self, way: _Way, as_is: _Way) -> float:
        """The largest relative distance of two ways; infinite where one stopped."""
        if way.stopped:
            return math.inf
        return float(distances(way.places, as_is.places, self.masses, self.length).max())

    def _runs(self, name: str) -> float:
        """The part of the steps in which an effect ran."""
        words = [report.effects[name] for way in self.base for report in way.reports]
        return sum(word.startswith("ran") for word in words) / len(words)

    def _share(self, name: str) -> float:
        """What a step with the effect costs more than without, as part of the step as it is.

        Steps are compared with those of the same moment: what contact there is makes more of a difference.
        """
        rows = [
            (0.5 * (first + last), other)
            for way, again, others in zip(self.base, self.again, self.seen[name].ms, strict=True)
            for first, last, other in zip(way.ms, again.ms, others, strict=False)  # it may have stopped
        ]
        if not rows:
            return 0.0
        as_is, other = np.array(rows).T
        more = _trimmed(as_is - other).mean() / _trimmed(as_is).mean()
        return float(-more if self.now[name] == "off" else more)

    def _noise(self) -> float:
        """How far costs are off, as part of a step: by what two runs of the same steps differ in time.

        Or by what effects seem to cost that no step has anything for, if that is more.
        """
        first, last = (np.array([ms for way in ways for ms in way.ms]) for ways in (self.base, self.again))
        apart = _trimmed(first - last)
        spread = 2.0 * float(apart.std()) / math.sqrt(len(apart))
        reports = [report for way in self.base for report in way.reports]
        void = [name for name in self.effects if all(report.effects[name] in NEVER for report in reports)]
        own = max(abs(float(apart.mean())), spread) / float(_trimmed(first).mean())
        return max(own, *(abs(self._share(name)) for name in void), 0.0)

    def _effect(self, name: str) -> AuditedEffect:
        seen, reports = self.seen[name], [report for way in self.base for report in way.reports]
        clear = seen.worse or max(seen.ratio) > CLEAR
        return AuditedEffect(
            name=name,
            now=self.now[name],
            verdict=MATTERS if clear else BELOW if max(seen.ratio) < 1.0 else UNCERTAIN,
            cost_share=self._share(name),
            own_ms=median(report.costs.get(name, 0.0) for report in reports),
            influence=_finite(max(seen.influence)),
            errors=_finite(max(seen.ratio)),
            ran=self._runs(name),
            why=reports[-1].effects[name] + "; without it cloth gets into something" * seen.worse,
        )

    def _together(self, start: Snapshot) -> tuple[list[str], float, float, float]:
        """The effects to leave out, how far this takes the cloth, and a step's milliseconds with and without.

        Candidates ran, change less than the tolerance, keep cloth out of nothing, and make no step slower by
        their absence, as where cloth that is let through tangles. Those that change most are kept after all
        until the whole run stays within the tolerance without the others, and takes no longer than with all.
        """
        left = [
            name
            for name, seen in self.seen.items()
            if self.now[name] != "off" and self._runs(name) > 0.0 and not seen.worse
        ]
        left = [name for name in left if max(self.seen[name].influence) < self.tolerance]
        slower = max(SLOWER, self._noise())
        left = [name for name in left if self._share(name) > -slower]
        left.sort(key=lambda name: max(self.seen[name].influence))
        as_is = self._steps(start, {}, self.steps)
        whole = median(as_is.ms)
        while left:
            without = chosen(self.settings, dict.fromkeys(left, "off"), self.effects)
            changes = {key: getattr(without, key) for name in left for key in self.effects[name].off}
            way = self._steps(start, changes, self.steps)
            apart = self._apart(way, as_is)
            safe = way.inside <= as_is.inside and way.crossed <= as_is.crossed
            if apart <= self.tolerance and safe and median(way.ms) <= (1.0 + slower) * whole:
                return left, apart, whole, median(way.ms)
            left.pop()
        return [], 0.0, whole, whole

    def _toml(self, left: Sequence[str], whole: float, ms: float, apart: float) -> str:
        """The recommended block of a scene file, with its figures in a comment."""
        about = f"# audit over {self.steps * self.settings.dt:.3g} s, tolerance {100 * self.tolerance:g} %:"
        if not left:
            return f"{about}\n# every effect that runs is needed\n[effects]\n"
        figures = f"# {whole:.3g} to {ms:.3g} ms per step, moves the cloth by {100 * apart:.2g} %"
        return f"{about}\n{figures}\n" + tomli_w.dumps({"effects": dict.fromkeys(left, "off")})


def _trimmed(values: np.ndarray) -> np.ndarray:
    """Values without the OUTLIERS at either end."""
    few = int(OUTLIERS * len(values))
    return np.sort(values)[few : len(values) - few]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


NOTES = (
    "Influence is the largest mass-weighted distance of the cloth from where it is as things are, as part of "
    "its diagonal, after any step of a window; the numerical error is what half the step does to the same.",
    f"An effect matters where it changes more than {CLEAR:g} numerical errors in some window, or keeps cloth "
    "out of something; it is below the numerical error where it changes less than one in all of them.",
    "The cost of an effect is that of a step as things are less that of one without it at the same moment, "
    "so that what it adds to the solver's work counts, too. Its noise is what the same steps, made twice, "
    "differ by, or what effects seem to cost that there is nothing for (obstacles where there are none): a "
    "cost that is smaller, or negative by so much, says nothing.",
    "Recommended to be off is what ran and changes less than the tolerance, all of it together over the "
    "whole run; what never ran is left to auto, which goes on watching for it, for the scene may change.",
    "Read-outs (energy ledger, local error, crossings) are not judged: they change nothing of the cloth.",
)
