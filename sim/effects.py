"""The effects that a scene may call for: which ones run, why the others do not, and what each costs.

An effect is left out by the settings that mean just that: there is no second switch. It is `off` where they
are so; `on` where it is looked at even in steps in which it cannot act; and else `auto`, which skips it where
a bound shows that it cannot act in the step, so that the cloth is the same as with `on`.

This module imports no numba: scenes are checked without.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from sim.settings import Settings

if TYPE_CHECKING:
    from sim.model import Model
    from sim.report import StepReport
    from sim.springs.build import Springs

State = Literal["auto", "on", "off"]
"""How a scene has an effect."""


@dataclass(frozen=True)
class Effect:
    """What there is to know of an effect.

    Attributes:
        changes: What it does to cloth, in words.
        off: Settings that leave it out.
        usual: Settings that bring it in where a scene has none.
        on: Settings that have it looked at in every step; none where there is nothing that auto could skip.
    """

    changes: str
    off: Mapping[str, Any]
    usual: Mapping[str, Any]
    on: Mapping[str, Any] = field(default_factory=dict)


EFFECTS: dict[str, Effect] = {
    "gravity": Effect("pulls all cloth down", {"gravity": (0.0, 0.0, 0.0)}, {"gravity": (0.0, 0.0, -9.81)}),
    "stretch": Effect("keeps edges as long as they are at rest", {"stretch": 0.0}, {"stretch": 50.0}),
    "altitudes": Effect("keeps triangles from collapsing", {"altitudes": "none"}, {"altitudes": "all"}),
    "bending": Effect("keeps hinges at their rest angle", {"bend": "none"}, {"bend": "angle"}),
    "damping": Effect("lets springs come to rest", {"gamma": 0.0}, {"gamma": 0.2}),
    "wind": Effect("air pushes and brakes triangles", {"drag": 0.0}, {"drag": 1.2}),
    "strain_limiting": Effect("lets no edge be too long", {"strain_limit": 0.0}, {"strain_limit": 0.1}),
    "obstacles": Effect(
        "keeps cloth out of obstacles", {"obstacles": "off"}, {"obstacles": "auto"}, {"obstacles": "on"}
    ),
    "self_collision": Effect(
        "keeps cloth out of cloth",
        {"self_collision": "off"},
        {"self_collision": "auto"},
        {"self_collision": "on"},
    ),
    "continuous_detection": Effect(
        "finds what meets between two instants", {"detection": "static"}, {"detection": "continuous"}
    ),
    "friction": Effect("slows what slides", {"friction": 0.0}, {"friction": 0.3}),
}
"""Every effect by the name that scenes, reports and pages have for it."""

CHOICES = ("auto", "on", "off")

SPRINGS = {"stretch": "stretch", "altitude": "altitudes", "bending": "bending"}
"""The effect of springs, by the setting that scales them."""


def state(name: str, settings: Settings) -> State:
    """Whether `settings` have an effect "off", "on" or "auto"."""
    effect = EFFECTS[name]
    if _hold(effect.off, settings):
        return "off"
    return "on" if effect.on and _hold(effect.on, settings) else "auto"


def _hold(values: Mapping[str, Any], settings: Settings) -> bool:
    return all(getattr(settings, name) == value for name, value in values.items())


def switch(name: str, choice: str, settings: Settings, wanted: Settings | None = None) -> dict[str, Any]:
    """The changes of settings that make an effect "off", "on" or "auto".

    Args:
        name: Of the effect.
        choice: One of CHOICES.
        settings: In force.
        wanted: Where values of an effect that is brought in come from, if it has them; else they are usual.

    Raises:
        ValueError: names the effect, what was expected and what was found.
    """
    if name not in EFFECTS:
        raise ValueError(f"{name}: no such effect; the effects are {', '.join(EFFECTS)}")
    if choice not in CHOICES:
        raise ValueError(f'{name}: expected one of "auto", "on", "off", got {choice!r}')
    effect = EFFECTS[name]
    if choice == "off":
        return dict(effect.off)
    if choice == "on" and effect.on:
        return dict(effect.on)
    now = state(name, settings)
    if now == "off":
        source = settings if wanted is None else wanted
        return dict(effect.usual) if state(name, source) != "auto" else _values(effect, source)
    return dict(effect.usual) if now == "on" and choice == "auto" else {}


def _values(effect: Effect, settings: Settings) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in effect.off}


def chosen(settings: Settings, choices: Mapping[str, str]) -> Settings:
    """`settings` with effects as `choices` force them; auto leaves them as they are.

    Raises:
        ValueError: as `switch`; also for an effect forced on that has nothing to act with.
    """
    for name, choice in choices.items():
        changes = switch(name, choice, settings)
        if choice == "on" and not EFFECTS[name].on and state(name, settings) == "off":
            ((setting, value),) = EFFECTS[name].off.items()
            shown = list(value) if isinstance(value, tuple) else value
            raise ValueError(
                f'{name}: expected "auto" or "off" while settings.{setting} is {shown}, got "on"'
            )
        if choice != "auto":
            settings = msgspec.structs.replace(settings, **changes)
    return settings


class Told:
    """Says of each step what its effects did, and remembers for how long they have been skipped.

    Attributes:
        skipped: Steps in a row in which an effect was skipped, by its name.
        usual: The least milliseconds that it took in a step that it was not.
    """

    def __init__(self) -> None:
        self.skipped: dict[str, int] = {}
        self.usual: dict[str, float] = {}

    def tell(
        self, settings: Settings, model: Model, report: StepReport, obstacles: bool, limit: float | None
    ) -> dict[str, str]:
        """Each effect by name: that it ran, or in a few words why not.

        Args:
            settings: In force.
            model: Its springs.
            report: Of the step, with the number of contacts.
            obstacles: Whether the scene has any.
            limit: Longest stable step of an explicit integrator [s], None for an implicit one, nan where
                there is none because the springs are wrong.
        """
        found = dict.fromkeys(EFFECTS, "ran")
        for springs in model.springs:
            found[SPRINGS[springs.kind.stiffness]] = _springs(springs, report)
        found["obstacles"] = _obstacles(settings, report, obstacles)
        found["self_collision"] = _self_collision(settings, model, report)
        found["continuous_detection"] = _continuous(settings, model, report, obstacles)
        found["wind"] = "ran" if model.wind is not None else "skipped: no triangles"
        found["strain_limiting"] = _strain(report)
        found["friction"] = "ran" if report.contacts else "skipped: no contacts"
        for name, effect in EFFECTS.items():
            if state(name, settings) == "off":
                found[name] = f"off: {_why_off(effect)}"
            found[name] += self._streak(name, found[name], report)
        found["contact"] = _contact(settings, report, obstacles)
        found["integrator"] = _integrator(settings, report, limit)
        return found

    def _streak(self, name: str, words: str, report: StepReport) -> str:
        """For how long an effect has been skipped, and what that saved."""
        took = report.costs.get(name, 0.0)
        if not words.startswith("skipped"):
            self.skipped[name] = 0
            if words.startswith("ran"):  # the least, as the first time may have compiled something
                self.usual[name] = min(took, self.usual.get(name, math.inf))
            return ""
        self.skipped[name] = self.skipped.get(name, 0) + 1
        many = f" for {self.skipped[name]} steps" if self.skipped[name] > 1 else ""
        saved = self.usual.get(name, 0.0) - took
        return f"{many}; saves {saved:.2g} ms per step" if saved > 0.01 else many


def _why_off(effect: Effect) -> str:
    ((name, value),) = effect.off.items()
    nothing = value == 0.0 or value == (0.0, 0.0, 0.0)
    return f"{name} is {'zero' if nothing else value}"


def _springs(springs: Springs, report: StepReport) -> str:
    words = "ran" if springs.value > 0.0 else "skipped: their stiffness is zero"
    if springs.kind.wrong:
        words = f"ran, wrong on purpose: {springs.kind.wrong}"
    if springs.kind.switch and report.energy_jumps:
        words += f"; {report.energy_jumps} taken up or left, which put in {report.energy_jump:.2g} J"
    if springs.left_out:
        words += f"; {springs.left_out} left out, too thin"
    return words


def _strain(report: StepReport) -> str:
    if report.limited:
        return f"ran: {report.limited} edges pulled, largest strain {report.strain:.3g}"
    return "ran: no edge was too long"


UNSURE = {
    "static": "looked for once per step",
    "penalty": "springs give way",
    "postprocess": "put right once",
}
"""Why detection or collision method may let through what moves by more than the thickness in a step."""


def _tunnelling(settings: Settings, report: StepReport, thickness: float) -> str:
    """That the step may have let something through, and why; empty where it was slow, or cannot."""
    why = UNSURE.get("static" if settings.detection == "static" else settings.contact)
    if why is None or report.moved <= thickness:
        return ""
    return f"; may tunnel: moved {1e3 * report.moved:.3g} mm, thickness {1e3 * thickness:.2g} mm, {why}"


def _contact(settings: Settings, report: StepReport, obstacles: bool) -> str:
    """What the collision method did."""
    if settings.contact == "none":
        return "off: contact is none"
    felt = obstacles and settings.obstacles != "off"
    if not felt and settings.self_collision == "off":
        return f"off: no obstacle{' is felt' * obstacles}, and self-collision is off"
    words = f"ran: {report.contacts} contacts" if report.contacts else "ran: nothing within reach"
    if report.substeps > 1:
        words += f"; in {report.substeps} parts, as in one it would have tangled or put energy in"
    if report.pinched:
        words += f"; pinched: obstacles leave {report.pinched} vertices less room than the thickness"
    if report.held_back:
        words += f"; {report.held_back} vertices held back from what they would have met"
    return words + _tunnelling(settings, report, settings.thickness)


def _obstacles(settings: Settings, report: StepReport, obstacles: bool) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not obstacles:
        return "skipped: there are none"
    return "ran" if report.near_obstacles else "skipped: none within reach"


def _self_collision(settings: Settings, model: Model, report: StepReport) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not len(model.mesh.edges):
        return "off: no edges"
    words = f"ran: {report.candidates} pairs looked at, {report.near} near"
    if not report.looks:
        words = "skipped: nothing within reach"
    if report.looks and not report.lists:
        words += "; the list of an earlier step holds"
    if report.hits:
        words += f", {report.hits} kept from meeting"
    if report.thickness < settings.thickness:
        words += f"; {1e3 * report.thickness:.2g} mm thick, 0.4 of an edge"
    return words + _tunnelling(settings, report, report.thickness or settings.thickness)


def _continuous(settings: Settings, model: Model, report: StepReport, obstacles: bool) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not ((obstacles and settings.obstacles != "off") or settings.self_collision != "off"):
        return "skipped: there is nothing to meet"
    if report.sweeps or report.near_obstacles:
        return "ran"
    return "skipped: all goes less far than half the way to what is nearest"


def _integrator(settings: Settings, report: StepReport, limit: float | None) -> str:
    name = settings.integrator
    if limit is None:
        return f"{report.integrator}, not {name}: contact" if report.integrator != name else name
    if math.isnan(limit):
        return f"{name}: no step is stable with springs that make energy out of nothing"
    words = f"{name}: stable up to {1e3 * limit:.3g} ms"
    return f"unstable: {words}, dt is {1e3 * settings.dt:.3g} ms" if settings.dt > limit else words
