"""The same run under several values of one setting: cost, error, energy, penetrations, stretch, area.

Errors of numerical settings and of contact methods are told against one reference, which has the scene's own
settings; where the setting makes it another cloth, each variant has its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import asdict

from sim.bench.hardware import hardware, versions
from sim.crossings import Crossings
from sim.ledger import Ledger
from sim.scene import Scene, load_scene
from sim.settings import FIELDS, Settings, change
from sim.simulation import Simulation
from sim.studies import Progress
from sim.studies.cost.horizon import HAIR, growth, growth_settings
from sim.studies.cost.measures import size
from sim.studies.cost.reference import FINER, Reference, ReferenceError, comparable, judge, reference_settings
from sim.studies.cost.report import Balance, CompareReport, Growth, Variant
from sim.studies.cost.timing import Timed, measure, repeat
from sim.studies.cost.trace import Case
from sim.studies.cost.verdict import value_in_words
from sim.studies.cost.workers import RunAll, workers
from sim.studies.seconds import check_seconds
from sim.warmup import warm_up

REPEATS, MEMBERS = 3, 2
"""Timed runs of each variant, and runs that tell how fast runs drift apart."""

FINEST = 1_000_000
"""Time steps are taken for multiples of this part of a second."""

ANOTHER_CLOTH = ("friction", "jitter", "seed")
"""Settings outside the groups "Cloth" and "Wind" whose value makes it another run, not another way to compute
one."""


def compare(
    scene: Scene | str | Path | dict[str, Any],
    by: str,
    values: Sequence[Any],
    overrides: dict[str, Any] | None = None,
    seconds: float = 1.0,
    repeats: int = REPEATS,
    progress: Progress | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
) -> CompareReport:
    """Run a scene under several values of a setting.

    Args:
        scene: As for Simulation.
        by: Name of the setting.
        values: Its values, two or more.
        overrides: Other settings that differ from the scene's.
        seconds: That are simulated [s].
        repeats: Of every timed run.
        progress: Is told how far it is.
        jobs: As for `cost`.
        cluster: As for `cost`.

    Raises:
        SceneError, ValueError: for what makes no sense.
    """
    scene = load_scene(scene)
    chosen = change(scene.settings, **(overrides or {}))
    variants = [change(chosen, **{by: value}) for value in values]
    if len(set(variants)) < max(2, len(variants)):
        got = ", ".join(value_in_words(by, value) for value in values)
        raise ValueError(f"--by: expected two or more different values of {by}, got {got}")
    if repeats < 1:
        raise ValueError(f"--repeats: expected 1 or more, got {repeats}")
    check_seconds(seconds)
    every = common_multiple([s.dt for s in variants])
    looks = int(seconds / every + 1e-9)
    if looks < 1:
        raise ValueError(
            f"--seconds: expected at least {every:.3g} s, which all time steps divide, got {seconds:g}"
        )
    told = progress or (lambda done, what: None)
    computer = hardware()
    with workers(jobs, cluster) as run_all:
        study = _Comparison(scene, chosen, variants, every, looks, told, run_all)
        return study.report(by, repeats, computer)


def common_multiple(steps: Sequence[float]) -> float:
    """The shortest time [s] that is a whole number of each of these steps, to a millionth of a second.

    Raises:
        ValueError: where there is none of less than a thousand of the longest.
    """
    parts = [Fraction(step).limit_denominator(FINEST) for step in steps]
    multiple = Fraction(math.lcm(*(p.numerator for p in parts)), math.gcd(*(p.denominator for p in parts)))
    if multiple > 1000 * max(parts):
        raise ValueError("dt: expected time steps with a common multiple, such as 1/60, 1/120 and 1/240")
    return float(multiple)


def makes_another_cloth(name: str) -> bool:
    """Whether a setting says what is simulated, rather than how."""
    return FIELDS[name].group in ("Cloth", "Wind") or name in ANOTHER_CLOTH


class _Comparison:
    """The stages of a comparison and what they share."""

    def __init__(
        self,
        scene: Scene,
        chosen: Settings,
        variants: Sequence[Settings],
        every: float,
        looks: int,
        progress: Progress,
        run_all: RunAll,
    ) -> None:
        self.scene, self.chosen, self.variants = scene, chosen, variants
        self.every, self.looks, self.progress, self.run_all = every, looks, progress, run_all
        progress(0.0, "getting kernels ready (the first run compiles them)")
        for settings in variants:
            warm_up(scene_with(scene, settings))
        self.world = Simulation(scene, **asdict(chosen))
        self.length = size(self.world)
        self.masses = [Simulation(scene, **asdict(s)).masses.copy() for s in variants]

    def report(self, by: str, repeats: int, computer: dict[str, Any]) -> CompareReport:
        """All stages."""
        timed = self._timed(repeats)
        balances = self._balances()
        grown = self._growth()
        own = makes_another_cloth(by)
        references, words = self._references(own, max(1, round(grown.horizon / self.every)))
        errors, look = self._errors(timed, references)
        if references and look is None:
            words = "none: it is not known to a tenth of the smallest error at any time"
        self.progress(1.0, "done")
        found = [
            self._variant(value_in_words(by, getattr(s, by)), s, t, balance, look, error, reference)
            for s, t, balance, error, reference in zip(
                self.variants, timed, balances, errors, references or [None] * len(timed), strict=True
            )
        ]
        return CompareReport(
            scene=self.scene.name,
            seconds=self.looks * self.every,
            vertices=len(self.masses[0]),
            by=by,
            reference=words,
            horizon=None if look is None else look * self.every,
            growth=grown,
            variants=found,
            notes=_notes(by, own, look, self.looks, self.every) + _alike(found),
            hardware=computer,
            versions=versions(),
        )

    def _case(
        self, settings: dict[str, Any], looks: int, *nudges: tuple[float, int], booked: bool = False
    ) -> Case:
        return Case(self.scene, settings, self.every, looks, nudges, booked=booked)

    def _timed(self, repeats: int) -> list[Timed]:
        cases = [self._case(asdict(s), self.looks) for s in self.variants]
        timed = measure(cases, lambda done: self.progress(0.05 + 0.15 * done / len(cases), f"run {done + 1}"))

        def go_on(done: float) -> bool:
            self.progress(0.2 + 0.4 * done, "timing, several times each")
            return True

        repeat(cases, timed, repeats, go_on)
        return timed

    def _balances(self) -> list[Balance]:
        """Of each variant. Books take time, so they are kept in runs of their own: the same to the bit."""
        self.progress(0.6, "where energy goes")
        cases = [self._case(asdict(s), self.looks, booked=True) for s in self.variants]
        return [_balance(trace.ledger) for trace in self.run_all(cases)]

    def _growth(self) -> Growth:
        self.progress(0.63, "how fast runs drift apart")
        finest = min(s.dt for s in self.variants)
        settings = {**asdict(self.chosen), **growth_settings(finest, self.length)}
        hair = HAIR * self.length
        cases = [self._case(settings, self.looks)]
        cases += [self._case(settings, self.looks, (hair, 1 + m)) for m in range(MEMBERS)]
        base, *moved = self.run_all(cases)
        return growth(base, moved, self.masses[0], self.length)

    def _references(self, own: bool, looks: int) -> tuple[list[Reference], str]:
        """A reference for each variant, and what they are in words; none where there is none."""
        self.progress(0.7, "the reference")
        finest = min(s.dt for s in self.variants)
        dt = self.every / math.ceil(FINER * self.every / finest - 1e-9)
        cloths = self.variants if own else [self.chosen]
        looks = min(looks, self.looks)
        cases = [self._case(s, looks) for cloth in cloths for s in reference_settings(cloth, dt)]
        traces = list(self.run_all(cases))
        try:
            found = [
                judge(traces[3 * i : 3 * i + 3], dt, self.masses[i], self.length) for i in range(len(cloths))
            ]
        except ReferenceError as error:
            return [], f"none: {error}"
        whose = "its own settings" if own else "the scene's settings"
        words = f"SDIRK2, h = {1e3 * dt:.3g} ms, {whose}, checked by BDF2 and by twice the step"
        return (found if own else found * len(self.variants)), words

    def _errors(
        self, timed: Sequence[Timed], references: Sequence[Reference]
    ) -> tuple[list[np.ndarray | None], int | None]:
        """The errors of each variant up to each look, and the last look at which all of them can be told."""
        if not references:
            return [None] * len(timed), None
        errors = [
            reference.errors(t.trace, masses, self.length)
            for t, reference, masses in zip(timed, references, self.masses, strict=True)
        ]
        whole = [e for e, t in zip(errors, timed, strict=True) if not t.trace.stopped]
        floor = np.max([r.floor for r in references], axis=0)
        look = comparable(floor, whole, self.looks) if whole else None
        return [None if t.trace.stopped else e for e, t in zip(errors, timed, strict=True)], look

    def _variant(
        self,
        name: str,
        settings: Settings,
        t: Timed,
        balance: Balance,
        look: int | None,
        error: np.ndarray | None,
        reference: Reference | None,
    ) -> Variant:
        trace, last = t.trace, len(t.trace) - 1
        total = trace.energy
        rise = float((total - np.minimum.accumulate(total)).max())
        known = error is not None and look is not None
        crossings = Crossings(self.world.mesh, self.world.contact.obstacles)
        return Variant(
            name=name,
            settings=settings,
            ms=float(np.median(t.repeats(last))) if last else None,
            ms_repeats=t.repeats(last) if last else [],
            phases=t.phase_medians(last) if last else {},
            matvecs=trace.per_second(trace.work["matvecs"], last) if last else 0.0,
            queries=trace.per_second(trace.work["queries"], last) if last else 0.0,
            error=float(error[look]) if known else None,  # pyright: ignore[reportOptionalSubscript, reportArgumentType]
            floor=float(reference.floor[look]) if known and reference is not None else None,
            energy={kind: float(part[-1]) for kind, part in trace.parts.items()},
            energy_start=float(total[0]),
            energy_change=float(total[-1] - total[0]),
            energy_rise=rise,
            balance=balance,
            penetrations=int(trace.contact["penetrations"].max()),
            deepest=float(trace.contact["deepest"].max()),
            crossings=max(map(crossings.count, trace.times, trace.positions)),
            stretch=float(trace.strain.max()),
            observables={kind: float(values[-1]) for kind, values in trace.observables.items()},
            stopped=trace.stopped,
        )


def _balance(ledger: Ledger | None) -> Balance:
    assert ledger is not None, "its run is booked"
    parts = {name: getattr(ledger, name) for name in Balance.__struct_fields__}
    return Balance(**parts)


def scene_with(scene: Scene, settings: Settings) -> Scene:
    """The scene with other settings."""
    from msgspec.structs import replace

    return replace(scene, settings=settings)


def _alike(variants: Sequence[Variant]) -> list[str]:
    """A note where errors do not tell the variants apart."""
    errors = [v.error for v in variants if v.error is not None]
    floor = max((v.floor for v in variants if v.floor is not None), default=0.0)
    if len(errors) < 2 or max(errors) - min(errors) > floor:
        return []
    return [
        "Up to then all variants err alike, to within the floor: what tells them apart comes later, and "
        "shows in penetrations, crossings, energies and observables alone."
    ]


def _notes(by: str, own: bool, look: int | None, looks: int, every: float) -> list[str]:
    notes = [
        "Times are medians of runs made alone, in turn; the first of each, which warms up, does not count."
    ]
    if look is not None:
        after = (
            "; after that the reference is not known well enough, or runs that differ by a hair drift apart"
        )
        notes.append(
            f"Errors are the largest mass-weighted distance from the reference up to {look * every:.3g} s, "
            f"as part of the cloth's diagonal{after * (look < looks)}."
        )
    if own:
        notes.append(
            f"{by} makes another cloth of each variant: each has a reference of its own, with its own {by}."
        )
    return notes
