"""Past the time up to which positions can be compared: observables of seeded runs, with their spread."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim.studies.cost.report import Band, Run
from sim.studies.cost.trace import Trace

SEED = 1e-6
"""By which vertices are moved at first, as part of the cloth's size."""

LATER = 2.0
"""How much more expensive steps may be past the horizon, where cloth is folded."""


def worth_an_ensemble(runs: Sequence[Run], seconds: float, most: float) -> dict[str, Run]:
    """The chosen run, and the most accurate one of those that take at most so long, by name.

    Args:
        runs: The chosen one first.
        seconds: Simulated time of each run [s].
        most: Wall time of each run [s].
    """
    chosen = runs[0]
    fit = [run for run in runs if LATER * run.ms * seconds <= 1e3 * most]
    best = min(fit, key=lambda run: (run.error, run.ms), default=chosen)
    return {"chosen": chosen} if best is chosen else {"chosen": chosen, "accurate": best}


def bands(name: str, traces: Sequence[Trace], look: int) -> Iterator[Band]:
    """Bands of every observable over runs that differ in their seed alone, and go on past a `look`.

    The deviation is that of what the runs were drawn from, so it takes two of them.
    """
    whole = [trace for trace in traces if not trace.stopped and len(trace) > look + 1]
    looks = min(map(len, whole), default=0)
    for observable in whole[0].observables if len(whole) > 1 else ():
        values = np.stack([trace.observables[observable][:looks] for trace in whole])
        yield Band(
            settings=name,
            observable=observable,
            members=len(whole),
            times=whole[0].times[:looks].tolist(),
            mean=values.mean(axis=0).tolist(),
            deviation=values.std(axis=0, ddof=1).tolist(),
        )
