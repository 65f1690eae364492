"""Settings that meet a budget: a time per frame, or a local error.

What integrators, time steps, Newton iterations and tolerances cost and err by is measured on the spot, from
the present state (`sim.probe`). Of those that nothing beats in both, the front, a time picks the most
accurate that is fast enough, an error the fastest that is accurate enough; and what that gives up is said.
Contact decides what may be
chosen: settings that let more vertices into obstacles than the present ones are left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sim.integrators import INTEGRATORS
from sim.probe import FRAME, LocalError, Probe
from sim.report import StepError
from sim.settings import Settings, change
from sim.simulation import Snapshot
from sim.studies.cost.front import front
from sim.studies.cost.verdict import in_words, percent

TRIED = ("backward_euler", "sdirk2")
"""Integrators: the cheapest, and the most accurate at a given step."""

STEPS = (1, 2, 4)
"""Time steps of a frame."""

NEWTON = (1, 2, 4)
"""Newton iterations."""

TOLERANCES = (1e-3, 1e-4, 1e-6)
"""Position errors that a solve may leave [m]."""

REPEATS = 2
"""Times that each is measured; the shorter one counts, as other work only ever makes it longer."""


@dataclass(frozen=True)
class Tried:
    """Settings that differ from the present ones by `changes`, and what was measured of them."""

    changes: dict[str, Any]
    found: LocalError


@dataclass(frozen=True)
class Choice:
    """The answer to a budget.

    Attributes:
        changes: Settings to change; empty where nothing meets it, or nothing needs to change.
        met: Whether something does.
        sentence: What was chosen and what it gives up, or what comes nearest.
        present: What was measured of the present settings.
        chosen: And of those that meet the budget or come nearest.
        tried: All that was measured.
    """

    changes: dict[str, Any]
    met: bool
    sentence: str
    present: LocalError
    chosen: LocalError
    tried: list[Tried] = field(default_factory=list)


def candidates(settings: Settings, fixed: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Changes to try, the present settings first; none of them touches what is `fixed`."""
    frame = max(FRAME, settings.dt)
    found: list[dict[str, Any]] = [{}]
    for name, steps, newton, tolerance in itertools.product(TRIED, STEPS, NEWTON, TOLERANCES):
        if INTEGRATORS[name].order > 1 and newton == 1:
            continue  # a linearised step is of first order, whatever the integrator
        wanted = {"integrator": name, "dt": frame / steps, "newton": newton, "tolerance": tolerance}
        wanted = {k: v for k, v in wanted.items() if k not in fixed and v != getattr(settings, k)}
        if wanted not in found:
            found.append(wanted)
    return found


def choose_settings(
    probe: Probe,
    state: Snapshot,
    *,
    ms: float | None = None,
    error: float | None = None,
    fixed: tuple[str, ...] = (),
    told: Callable[[float], None] = lambda part: None,
) -> Choice:
    """Measure, and choose settings that meet a budget at a state.

    Args:
        probe: Measures them.
        state: Where from.
        ms: Milliseconds that a frame of 1/60 s may take, or
        error: the local error that it may have; one of the two.
        fixed: Names of settings that may not change.
        told: Told of the part that is done.

    Raises:
        ValueError: for none or both of the two, or one that is not positive.
        StepError: where the finer run, or the present settings, cannot do the frame.
    """
    if (ms is None) == (error is None) or not (ms or error or 0.0) > 0.0:
        raise ValueError("budget: expected a positive time per frame [ms], or a positive error")
    settings = state.ramp.target
    options = candidates(settings, fixed)
    truth = probe.truth(state, settings, max(FRAME, settings.dt))
    tried: list[Tried] = []
    for k, changes in enumerate(options):
        told(k / len(options))
        try:
            runs = [probe.error(state, changes, truth) for _ in range(REPEATS)]
        except StepError:
            if not changes:
                raise
            continue
        tried.append(Tried(changes, min(runs, key=lambda run: run.ms)))
    present = tried[0].found
    fit = [t for t in tried if t.found.inside <= present.inside]
    if ms is not None:  # errors that differ by no more than the floor are alike
        on = front([_frame(t) for t in fit], [t.found.error for t in fit], truth.floor)
        within = [t for t, best in zip(fit, on, strict=True) if best and _frame(t) <= ms]
        chosen = min(within, key=_error) if within else min(fit, key=_frame)
    else:
        within = [t for t in fit if _error(t) <= (error or 0.0)]
        chosen = min(within, key=_frame) if within else min(fit, key=_error)
    met = bool(within)
    words = _met(settings, chosen, present) if met else _missed(settings, chosen, ms, error)
    return Choice(chosen.changes if met else {}, met, words, present, chosen.found, tried)


def _frame(tried: Tried) -> float:
    """Milliseconds per 1/60 s."""
    return tried.found.ms * FRAME / tried.found.seconds


def _error(tried: Tried) -> float:
    return tried.found.error


def _costs(found: LocalError) -> str:
    ms, least = found.ms * FRAME / found.seconds, "" if found.sure else "about "
    return f"{ms:.3g} ms per frame, local error {least}{percent(found.error)}"


def _named(settings: Settings, changes: dict[str, Any]) -> str:
    """What the four are after the changes."""
    after = change(settings, **changes)
    return in_words({name: getattr(after, name) for name in ("integrator", "dt", "newton", "tolerance")})


def _met(settings: Settings, chosen: Tried, present: LocalError) -> str:
    if not chosen.changes:
        return f"The present settings meet it, and nothing tried does better: {_costs(present)}."
    found, gives = chosen.found, []
    if found.error > 1.05 * present.error:
        gives.append(f"accuracy: the error was {percent(present.error)}")
    if found.ms > 1.05 * present.ms:
        gives.append(f"time: a frame took {present.ms * FRAME / present.seconds:.3g} ms")
    lost = f"It gives up {' and '.join(gives)}." if gives else "It gives up nothing."
    return f"{_named(settings, chosen.changes)}: {_costs(found)}. {lost}"


def _missed(settings: Settings, chosen: Tried, ms: float | None, error: float | None) -> str:
    wanted = (
        f"takes at most {ms:.3g} ms per frame"
        if ms is not None
        else f"errs by at most {percent(error or 0.0)}"
    )
    nearest = f"{_named(settings, chosen.changes)}: {_costs(chosen.found)}"
    return f"Nothing tried {wanted}: nothing is changed. The nearest: {nearest}."
