"""Which runs a study of cost makes: curves, each of one knob."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sim.effects import feels_cloth, feels_obstacles
from sim.integrators import INTEGRATORS
from sim.scene import Scene
from sim.settings import FIELDS, Settings, change
from sim.studies.cost.reference import converged


@dataclass(frozen=True)
class Effort:
    """How much a study does.

    Attributes:
        finer: Halvings of the time step below the chosen one.
        coarser: Doublings above it.
        integrators: That are swept; all if empty.
        repeats: Of every timed run.
        members: Runs that tell how fast runs drift apart.
        ensemble: Seeded runs of each band beyond the horizon.
        refinements: Halvings of the reference's step, where it is too coarse at first.
        minutes: That the study should take; the horizon is shortened for it. inf does not.
    """

    finer: int
    coarser: int
    integrators: tuple[str, ...]
    repeats: int
    members: int
    ensemble: int
    refinements: int
    minutes: float


SOME = ("backward_euler", "bdf2", "midpoint", "sdirk2")

QUICK = Effort(1, 1, ("backward_euler", "sdirk2"), 3, 2, 0, 2, 0.75)
USUAL = Effort(2, 1, SOME, 3, 3, 4, 2, 2.5)
FULL = Effort(3, 1, (), 5, 8, 12, 2, math.inf)


def more_time(effort: Effort) -> str:
    """What the user can do for a study that takes more time; nothing for one that takes all it needs."""
    if math.isinf(effort.minutes):
        return ""
    return "ask for --full, or leave out --quick" if effort == QUICK else "ask for --full"


NEWTONS = (1, 2, 4, 8)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)

STEP, NEWTON, TOLERANCE, RESPONSE = "time step alone", "Newton iterations", "tolerance", "contact"
"""Names of the curves on which nothing but this differs from the chosen settings."""

SOLVED = "solved"
"""Ends the name of an integrator's curve whose equations are as good as solved."""


@dataclass
class Planned:
    """A run to make, and the curves that it is a point of."""

    settings: Settings
    curves: list[str]


def steps(chosen: Settings, effort: Effort) -> list[float]:
    """The time steps [s] that are swept, the longest first."""
    return [chosen.dt / 2.0**k for k in range(-effort.coarser, effort.finer + 1)]


def has_contact(scene: Scene, settings: Settings) -> bool:
    """Whether cloth can touch anything."""
    there = feels_obstacles(settings, scene.obstacle_labels), feels_cloth(settings, len(scene.cloth) > 1)
    return settings.contact != "none" and any(there)


def plan(scene: Scene, chosen: Settings, effort: Effort, contact: bool) -> list[Planned]:
    """All runs, each once; the first has the chosen settings.

    Args:
        scene: What is simulated.
        chosen: The settings that the study is about.
        effort: How much to do.
        contact: Whether the cloth was seen to touch anything.
    """
    runs: dict[Settings, Planned] = {}

    def add(curve: str, **changes: Any) -> None:
        settings = change(chosen, **changes)
        curves = runs.setdefault(settings, Planned(settings, [])).curves
        if curve not in curves:
            curves.append(curve)

    add(STEP)
    for dt in steps(chosen, effort):
        add(STEP, dt=dt)
        for name in effort.integrators or [n for n, i in INTEGRATORS.items() if i.implicit]:
            scaled = _within("tolerance", chosen.tolerance * (dt / chosen.dt) ** 2)
            add(name, integrator=name, dt=dt, tolerance=scaled)
            add(f"{name}, {SOLVED}", integrator=name, **converged(dt))
    if INTEGRATORS[chosen.integrator].implicit:
        for newton in NEWTONS:
            add(NEWTON, newton=newton)
        for tolerance in TOLERANCES:
            add(TOLERANCE, tolerance=tolerance)
    if contact and has_contact(scene, chosen):
        for response in ("penalty", "impulse", "postprocess"):
            for detection in ("static", "continuous"):
                add(RESPONSE, contact=response, detection=detection)
    return list(runs.values())


def _within(name: str, value: float) -> float:
    return FIELDS[name].clamp(value)
