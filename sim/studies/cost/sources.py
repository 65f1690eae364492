"""Where the error of the chosen settings comes from: one knob at a time is turned towards accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.integrators import INTEGRATORS
from sim.settings import FIELDS
from sim.studies.cost.nested import nested
from sim.studies.cost.plan import has_contact
from sim.studies.cost.reference import converged_tolerance
from sim.studies.cost.report import MeshLevel, Source
from sim.studies.cost.subject import Subject, differences
from sim.studies.cost.timing import Timed, measure
from sim.studies.cost.trace import Case, Trace

STEP_PART = 4
"""Part of the time step that its error is told by."""


@dataclass(frozen=True)
class Refinement:
    """One knob turned towards accuracy.

    Attributes:
        source: Of the error that this shows.
        what: Which values it goes from and to, in words.
        case: The run.
        same_mesh: Whether positions can be compared; else observables alone.
    """

    source: str
    what: str
    case: Case
    same_mesh: bool = True


def refinements(subject: Subject, look: int, contact: bool) -> list[Refinement]:
    """What the error of the chosen settings may come from.

    Args:
        subject: The scene and the chosen settings.
        look: Up to which runs go.
        contact: Whether the cloth was seen to touch anything.
    """
    chosen, found = subject.chosen, []

    def turn(source: str, what: str, **changes: Any) -> None:
        found.append(Refinement(source, what, subject.case(changes, look)))

    dt, solved = chosen.dt / STEP_PART, converged_tolerance(chosen.dt)
    scaled = FIELDS["tolerance"].clamp(chosen.tolerance / STEP_PART**2)  # else a short step is badly solved
    turn("time step", f"{_ms(chosen.dt)} to {_ms(dt)}", dt=dt, tolerance=scaled)
    if INTEGRATORS[chosen.integrator].implicit:
        most = max(8, 4 * chosen.newton)
        turn("Newton iterations", f"{chosen.newton} to {most}", newton=most)
        if solved < chosen.tolerance:
            turn("linear solve", f"{chosen.tolerance:.2g} m to {solved:.2g} m", tolerance=solved)
    if contact and has_contact(subject.scene, chosen):
        thin = FIELDS["thickness"].clamp(0.5 * chosen.thickness)
        words = f"{1e3 * chosen.thickness:.2g} mm to {1e3 * thin:.2g} mm"
        turn("contact thickness", words, thickness=thin)
    if (finer := on_mesh(subject, look, 1)) is not None:
        found.append(Refinement("mesh", "edges half as long", finer, same_mesh=False))
    return found


def _ms(dt: float) -> str:
    return f"{1e3 * dt:.3g} ms"


def sources(
    subject: Subject, chosen: Trace, turned: Sequence[Refinement], traces: Sequence[Trace], look: int
) -> list[Source]:
    """What each knob changes of the `chosen` run; `traces` are those of what was `turned`."""
    return [_source(subject, chosen, r, t, look) for r, t in zip(turned, traces, strict=True)]


def _source(subject: Subject, chosen: Trace, turned: Refinement, trace: Trace, look: int) -> Source:
    about = {"source": turned.source, "what": turned.what}
    if trace.stopped:
        return Source(**about, change=None, observables={}, reason=trace.stopped)
    change = float(subject.apart(trace, chosen, look).max()) if turned.same_mesh else None
    return Source(**about, change=change, observables=differences(trace, chosen, look))


def on_mesh(subject: Subject, look: int, level: int) -> Case | None:
    """The chosen run on a nested mesh; None where the cloth has no such mesh."""
    other = nested(subject.scene, subject.chosen, level)
    if other is None:
        return None
    scene, stiffness = other
    return replace(subject.case(stiffness, look), scene=scene)


def meshes(subject: Subject, chosen: Timed, look: int, told: Callable[[str], None]) -> list[MeshLevel]:
    """The chosen run on the mesh half as fine, its own, and the one twice as fine; none where it has one."""
    found = [chosen]
    for level, words in ((-1, "half"), (1, "twice")):
        if (case := on_mesh(subject, look, level)) is not None:
            told(f"a mesh {words} as fine")
            (again,) = measure([case], lambda done: None)
            found += [] if again.trace.stopped else [again]
    found.sort(key=lambda timed: timed.trace.positions.shape[1])
    finest = found[-1].trace
    return [_mesh_level(timed, finest, look) for timed in found] if len(found) > 1 else []


def _mesh_level(timed: Timed, finest: Trace, look: int) -> MeshLevel:
    trace = timed.trace
    return MeshLevel(
        vertices=trace.positions.shape[1],
        ms=float(np.median(timed.repeats(look))),
        observables={name: float(values[look]) for name, values in trace.observables.items()},
        error_observables=None if trace is finest else differences(trace, finest, look),
    )
