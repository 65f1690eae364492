"""Which effects a step had, and why the others did not act."""

from __future__ import annotations

import math

from sim.model import Model
from sim.report import StepReport
from sim.settings import Settings


def effects(
    settings: Settings, model: Model, report: StepReport, obstacles: bool, limit: float | None
) -> dict[str, str]:
    """Each effect by name: that it ran, or in a few words why not.

    Args:
        settings: In force.
        model: Its springs.
        report: Of the step, with the number of contacts.
        obstacles: Whether the scene has any.
        limit: Longest stable step of an explicit integrator [s], None for an implicit one, nan where there is
            none because the springs are wrong.
    """
    found = {"gravity": "ran" if any(settings.gravity) else "off: zero"}
    for springs in model.springs:
        size = getattr(settings, springs.kind.stiffness)
        words = "ran" if size > 0.0 else f"off: {springs.kind.stiffness} is zero"
        if springs.kind.wrong:
            words = f"ran, wrong on purpose: {springs.kind.wrong}"
        if springs.kind.switch and report.energy_jumps:
            words += f"; {report.energy_jumps} taken up or left, which put in {report.energy_jump:.2g} J"
        if springs.left_out:
            words += f"; {springs.left_out} left out, too thin"
        found[f"{springs.name} springs"] = words
    if settings.altitudes == "none":
        found["altitude springs"] = "off: altitudes is none"
    if settings.bend == "none":
        found["bending"] = "off: bend is none"
    found["damping"] = "ran" if settings.gamma > 0.0 else "off: gamma is zero"
    if not obstacles:
        found["contact"] = "off: no obstacle"
    elif settings.contact == "none":
        found["contact"] = "off: contact is none"
    else:
        found["contact"] = (
            f"ran: {report.contacts} contacts" if report.contacts else "ran: nothing within reach"
        )
    found["integrator"] = _integrator(settings, report, limit)
    return found


def _integrator(settings: Settings, report: StepReport, limit: float | None) -> str:
    name = settings.integrator
    if limit is None:
        return f"{report.integrator}, not {name}: contact" if report.integrator != name else name
    if math.isnan(limit):
        return f"{name}: no step is stable with springs that make energy out of nothing"
    words = f"{name}: stable up to {1e3 * limit:.3g} ms"
    return f"unstable: {words}, dt is {1e3 * settings.dt:.3g} ms" if settings.dt > limit else words
