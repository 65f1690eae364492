"""The battery: hard cases of which each measures figures and holds them against their marks.

A case is one decorated function in a file by theme. Its docstring says what it does; it yields figures:

    @case("N11", "springs of no length", seconds=1.0)
    def no_length(probe):
        trial = probe.start(scene(...))
        yield at_most("drift", drift, 1e-9, "m")

A case with several runs is run with as many seeds, one after the other; one that fails fails the case.
`sim.stress.executor` runs tasks, which are cases with a seed, in other processes.

This module imports no numba; the files with the cases are imported when they are asked for.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.stress.probe import Probe

THEMES = ("numerics", "contact", "sweep")
"""The files with the cases, in the order in which they are run."""

SHORT_SECONDS, SHORT_RUNS = 20.0, 2
"""Cases that take longer [s] are left out of the short battery; others run this often, or as they say."""

Run = Callable[["Probe"], "Iterator[Figure]"]


@dataclass(frozen=True)
class Figure:
    """What was measured, and what it must not exceed, or fall short of.

    Attributes:
        what: In words.
        value: Measured.
        mark: That it is held against; None for a figure that is only reported.
        unit: Of both.
        least: Whether the mark is the least that will do, and not the most.
    """

    what: str
    value: float
    mark: float | None
    unit: str = ""
    least: bool = False

    @property
    def passed(self) -> bool:
        """Whether it is within its mark; what is no number is not."""
        if self.mark is None:
            return True
        return math.isfinite(self.value) and (
            self.value >= self.mark if self.least else self.value <= self.mark
        )

    @property
    def share(self) -> float:
        """How much of what the mark leaves is used: 1 at the mark, more beyond."""
        if self.mark is None:
            return -math.inf
        if self.passed and (self.value == self.mark or self.mark == 0.0):
            return 1.0 if self.least else 0.0
        value, mark = (self.mark, self.value) if self.least else (self.value, self.mark)
        share = value / mark if mark else math.inf
        return share if self.passed else max(share, 1.0 + 1e-9) if math.isfinite(share) else math.inf


def at_most(what: str, value: Any, mark: float, unit: str = "") -> Figure:
    """A figure that may not exceed its mark."""
    return Figure(what, float(value), mark, unit)


def at_least(what: str, value: Any, mark: float, unit: str = "") -> Figure:
    """A figure that must reach its mark."""
    return Figure(what, float(value), mark, unit, least=True)


def reported(what: str, value: Any, unit: str = "") -> Figure:
    """A figure without a mark."""
    return Figure(what, float(value), None, unit)


@dataclass(frozen=True)
class Case:
    """A hard case.

    Attributes:
        name: To choose it by, unique.
        title: A few words.
        run: Yields its figures.
        seconds: About what one run takes on one core [s].
        runs: Seeds that it is run with in the full battery.
        short: And in the short one.
        theme: The file that it is in.
    """

    name: str
    title: str
    run: Run
    seconds: float
    runs: int
    short: int
    theme: str

    @property
    def about(self) -> str:
        """What it does: the first paragraph of the docstring."""
        return " ".join((self.run.__doc__ or "").partition("\n\n")[0].split())


@dataclass(frozen=True)
class Task:
    """One run of a case."""

    name: str
    seed: int


CASES: dict[str, Case] = {}
"""Every case by name, once its file has been imported."""


def case(
    name: str, title: str, *, seconds: float, runs: int = 1, short: int = SHORT_RUNS
) -> Callable[[Run], Run]:
    """Register the function below as a case; `Case` says what the arguments are."""

    def register(run: Run) -> Run:
        if name in CASES:
            raise ValueError(f"{name}: there is a case of this name")
        theme = run.__module__.rpartition(".")[2]
        CASES[name] = Case(name, title, run, seconds, runs, min(short, runs), theme)
        return run

    return register


def cases() -> dict[str, Case]:
    """Every case by name, by theme and then as they stand in their files."""
    for theme in THEMES:
        importlib.import_module(f"sim.stress.{theme}")
    return {name: case for theme in THEMES for name, case in CASES.items() if case.theme == theme}


def choose(names: Sequence[str] = (), full: bool = False) -> list[Case]:
    """The cases that `names` mean, or without names those of the short or of the full battery.

    A name means the case of this name, those that begin with it and a hyphen (C2 means C2-wire,
    too), or those of a theme.

    Raises:
        ValueError: for a name that means none.
    """
    known = cases()
    if not names:
        return [case for case in known.values() if full or case.seconds <= SHORT_SECONDS]
    chosen: dict[str, Case] = {}
    for name in names:
        found = [c for c in known.values() if f"{c.name}-".startswith(f"{name}-") or c.theme == name]
        if not found:
            raise ValueError(f"--case: expected one of {', '.join((*THEMES, *known))}, got {name!r}")
        chosen.update((case.name, case) for case in found)
    return list(chosen.values())


def plan(chosen: Sequence[Case], full: bool = False, seed: int = 0, runs: int | None = None) -> list[Task]:
    """The tasks of `chosen` cases.

    Args:
        chosen: What to run.
        full: As many runs as a case has, rather than a few.
        seed: Of the first run of each case; those of the others follow.
        runs: Of each case, if it is not for the case to say.
    """
    many = {case.name: runs or (case.runs if full else case.short) for case in chosen}
    return [Task(case.name, seed + k) for case in chosen for k in range(many[case.name])]
