"""What an accuracy costs: the cheapest settings of a solver whose sheet is where its converged sheet is.

Every solver is compared with itself. Its ladder of ever more accurate settings is climbed until the sheet
moves no more, or time is out; the last rung is the reference, and what the last rung changed says how far to
trust it. That change counts as error, too: of a first-order method it is what is left.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from sim.bench.peers import Knobs, Run, words

HORIZON = 6
"""Frames after which sheets are compared; 0.1 s. At 0.25 s wrinkles decide, and halving the step still moves
Muslin's vertices by millimetres."""

TARGETS = (1e-2, 1e-3)
"""Errors to be met [m]: what an eye sees of a sheet of 1 m, and what contact at 5 mm can bear."""

SETTLED = 0.1
"""Part of the smallest target that a rung may change for the ladder to end."""

LADDER_SHARE = 0.7
"""Part of the time for the ladder; the rest is for other settings."""


@dataclass(frozen=True)
class Trial:
    """A run to the horizon: its settings, milliseconds per frame, and positions (n, 3) [m] at the end."""

    knobs: Knobs
    ms: float
    positions: np.ndarray

    def from_(self, other: Trial) -> float:
        """The largest distance of a vertex from where the other run has it [m]; infinite after a blow-up."""
        distance = float(np.linalg.norm(self.positions - other.positions, axis=1).max())
        return distance if math.isfinite(distance) else math.inf


def climb(
    start: Callable[[Knobs], Run],
    frames: Sequence[Knobs],
    ladder: Iterable[Knobs],
    others: Iterable[Knobs],
    seconds: float,
    strain: Callable[[np.ndarray], float],
    clock: Callable[[], float] = time.perf_counter,
) -> Iterator[dict[str, Any]]:
    """Run the settings of a solver, and say after each what is known by then, as `assess` does.

    Args:
        start: Makes a run.
        frames: The settings that it recommends first; they are always run.
        ladder: Ever more accurate ones.
        others: Ones that may be cheaper, tried last.
        seconds: After which nothing goes on [s]; what is not done by then is left out.
        strain: The largest strain of an edge, of positions.
        clock: Tells the time [s].
    """
    start(frames[0]).frame()  # compiles what there is to compile
    begin = clock()
    limit = begin + seconds
    tried = [trial for knobs in frames if (trial := attempt(start, knobs, clock, limit))]
    if len(tried) < len(frames):
        return
    rungs: list[Trial] = []
    done = {words(trial.knobs): trial for trial in tried}
    for knobs in ladder:
        until = begin + LADDER_SHARE * seconds if rungs else limit
        trial = done.get(words(knobs)) or attempt(start, knobs, clock, until)
        if trial is None:
            break
        rungs.append(trial)
        yield assess(tried, rungs, strain)
        if len(rungs) > 1 and rungs[-1].from_(rungs[-2]) <= SETTLED * min(TARGETS):
            break
    for knobs in others:
        trial = attempt(start, knobs, clock, limit) if rungs else None
        if trial is None:
            continue
        tried.append(trial)
        yield assess(tried, rungs, strain)


def attempt(
    start: Callable[[Knobs], Run], knobs: Knobs, clock: Callable[[], float], limit: float = math.inf
) -> Trial | None:
    """Run some settings to the horizon; None where the clock has passed `limit` [s] before that."""
    if clock() > limit:
        return None
    run, ms = start(knobs), []
    for _ in range(HORIZON):
        if clock() > limit:
            return None
        before = clock()
        run.frame()
        ms.append(1e3 * (clock() - before))
    return Trial(knobs, median(ms), run.positions())


def assess(
    tried: Sequence[Trial], rungs: Sequence[Trial], strain: Callable[[np.ndarray], float]
) -> dict[str, Any]:
    """What can be said of trials, the last of `rungs` being the reference.

    Returns:
        "settled" [m], the change of the last rung; "reference", its settings in words; "own", the first
        trial; "strain" and "own_strain"; "met", for each target the cheapest trial that meets it, or None;
        "best", the trial with the smallest error. A trial is its settings in words, "ms", and "error" [m].
    """
    last = rungs[-1]
    settled = last.from_(rungs[-2]) if len(rungs) > 1 else math.inf
    judged = [(trial, trial.from_(last) + settled) for trial in (*tried, *rungs)]
    by_cost = sorted(judged, key=lambda pair: pair[0].ms)
    met = [next((pair for pair in by_cost if pair[1] <= target), None) for target in TARGETS]
    return {
        "settled": _finite(settled),
        "reference": words(last.knobs),
        "own": _said(*judged[0]),
        "strain": _finite(strain(last.positions)),
        "own_strain": _finite(strain(tried[0].positions)),
        "met": [_said(*pair) if pair else None for pair in met],
        "best": _said(*min(judged, key=lambda pair: pair[1])),
    }


def _said(trial: Trial, error: float) -> dict[str, Any]:
    return {"settings": words(trial.knobs), "ms": trial.ms, "error": _finite(error)}


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
