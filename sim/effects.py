"""Which effects a step had, and why the others did not act."""

from __future__ import annotations

import math

from sim.model import Model
from sim.report import StepReport
from sim.settings import Settings

UNSURE = {
    "static": "looked for once per step",
    "penalty": "springs give way",
    "postprocess": "put right once",
}
"""Why detection or collision method may let through what moves by more than the thickness in a step."""


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
    found["contact"] = _contact(settings, report, obstacles)
    found["self-collision"] = _self_collision(settings, model, report)
    found["integrator"] = _integrator(settings, report, limit)
    return found


def _tunnelling(settings: Settings, report: StepReport, thickness: float) -> str:
    """That the step may have let something through, and why; empty where it was slow, or cannot."""
    why = UNSURE.get("static" if settings.detection == "static" else settings.contact)
    if why is None or report.moved <= thickness:
        return ""
    return f"; may tunnel: moved {1e3 * report.moved:.3g} mm, thickness {1e3 * thickness:.2g} mm, {why}"


def _contact(settings: Settings, report: StepReport, obstacles: bool) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not obstacles and settings.self_collision == "off":
        return "off: no obstacle, and self-collision is off"
    words = f"ran: {report.contacts} contacts" if report.contacts else "ran: nothing within reach"
    if report.substeps > 1:
        words += f"; in {report.substeps} parts, as in one it would have tangled or put energy in"
    if report.pinched:
        words += f"; pinched: obstacles leave {report.pinched} vertices less room than the thickness"
    if report.held_back:
        words += f"; {report.held_back} vertices held back from what they would have met"
    return words + _tunnelling(settings, report, settings.thickness)


def _self_collision(settings: Settings, model: Model, report: StepReport) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if settings.self_collision == "off":
        return "off: self_collision is off"
    if not len(model.mesh.edges):
        return "off: no edges"
    words = f"ran: {report.candidates} pairs looked at, {report.near} near"
    if report.hits:
        words += f", {report.hits} kept from meeting"
    if report.thickness < settings.thickness:
        words += f"; {1e3 * report.thickness:.2g} mm thick, 0.4 of an edge"
    return words + _tunnelling(settings, report, report.thickness or settings.thickness)


def _integrator(settings: Settings, report: StepReport, limit: float | None) -> str:
    name = settings.integrator
    if limit is None:
        return f"{report.integrator}, not {name}: contact" if report.integrator != name else name
    if math.isnan(limit):
        return f"{name}: no step is stable with springs that make energy out of nothing"
    words = f"{name}: stable up to {1e3 * limit:.3g} ms"
    return f"unstable: {words}, dt is {1e3 * settings.dt:.3g} ms" if settings.dt > limit else words
