"""Timed runs against the reference: what each costs, how wrong it is, and which are on the front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from sim.integrators import INTEGRATORS
from sim.settings import differing
from sim.studies.cost.front import front
from sim.studies.cost.plan import SOLVED, Planned
from sim.studies.cost.reference import Reference
from sim.studies.cost.report import Curve, Failure, Run, Truth
from sim.studies.cost.subject import Subject, differences
from sim.studies.cost.timing import Timed
from sim.studies.cost.trace import Trace


def judged(
    subject: Subject,
    planned: Sequence[Planned],
    timed: Sequence[Timed],
    reference: Reference,
    look: int,
) -> tuple[list[Run], list[Failure]]:
    """Runs with their errors up to a look, and runs that failed."""
    runs, failed = [], []
    for p, t in zip(planned, timed, strict=True):
        about = {
            "settings": p.settings,
            "changed": differing(subject.chosen, p.settings),
            "curves": p.curves,
        }
        if t.trace.stopped:
            failed.append(Failure(**about, reason=t.trace.stopped))
        else:
            runs.append(Run(**about, **_figures(subject, t, reference, look)))
    errors, floor = [r.error for r in runs], float(reference.floor[look])
    on = front([r.ms for r in runs], errors, floor)
    by_work = front([r.matvecs or math.inf for r in runs], errors, floor)
    fronts = zip(runs, on, by_work, strict=True)
    return [replace(r, front=a, front_by_work=b) for r, a, b in fronts], failed


def _figures(subject: Subject, t: Timed, reference: Reference, look: int) -> dict[str, Any]:
    trace, truth = t.trace, reference.trace
    until = slice(look + 1)
    apart = subject.apart(trace, truth, look)
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
        "error_observables": differences(trace, truth, look),
        "penetrations": int(trace.contact["penetrations"][until].max()),
        "deepest": float(trace.contact["deepest"][until].max()),
        "front": False,
        "front_by_work": False,
    }


def _turnover(trace: Trace, look: int) -> float:
    """The energy [J] that errors are told as part of: the most that any kind held or changed by."""
    until = slice(look + 1)
    largest = max(float(np.ptp(part[until])) for part in trace.parts.values())
    return max(largest, float(trace.parts["kinetic"][until].max()), np.finfo(float).tiny)


def truth(reference: Reference, look: int, refined: int) -> Truth:
    """The reference as it is reported."""
    return Truth(
        integrator="sdirk2",
        dt=reference.dt,
        floor=float(reference.floor[look]),
        checks={name: float(apart[: look + 1].max()) for name, apart in reference.checks.items()},
        times=reference.trace.times[: len(reference.floor)].tolist(),
        floor_by_time=reference.floor.tolist(),
        refined=refined,
    )


def curves(runs: Sequence[Run]) -> list[Curve]:
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
