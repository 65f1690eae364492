"""The effects that a scene may call for: which ones run, why the others do not, and what each costs.

An effect is left out by the settings that mean just that: there is no second switch. It is `off` where they
are so; `on` where it is looked at even in steps in which it cannot act; and else `auto`, which skips it where
a bound shows that it cannot act in the step, so that the cloth is the same as with `on`.

Every obstacle of a scene is an effect of its own, beside `obstacles`, which is about all of them.

This module imports no numba: scenes are checked without.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec

from sim.refusal import nearest, shown
from sim.settings import FIELDS, READ_OUTS, Settings

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
        obstacle: The one that it is about, where these are switches of single obstacles; else empty.
    """

    changes: str
    off: Mapping[str, Any]
    usual: Mapping[str, Any]
    on: Mapping[str, Any] = field(default_factory=dict)
    obstacle: str = ""

    def value(self, name: str, settings: Settings) -> Any:
        """What `settings` have for a setting of this effect."""
        value = getattr(settings, name)
        return single_obstacles(value).get(self.obstacle, "auto") if self.obstacle else value

    def has(self, values: Mapping[str, Any], settings: Settings) -> bool:
        """Whether `settings` have all these values, of which there are some."""
        return bool(values) and all(self.value(name, settings) == value for name, value in values.items())

    def changed(self, values: Mapping[str, Any], settings: Settings) -> dict[str, Any]:
        """The changes of `settings` that give them these values."""
        if not self.obstacle:
            return dict(values)
        return {
            name: _switches(single_obstacles(getattr(settings, name)) | {self.obstacle: value})
            for name, value in values.items()
        }


def _read_out(setting: str, tells: str) -> Effect:
    """What is measured of cloth."""
    about = f"{tells}; changes nothing of the cloth"
    return Effect(about, {setting: "off"}, {setting: "auto"}, {setting: "on"})


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
        "keeps a piece of cloth out of itself",
        {"self_collision": "off"},
        {"self_collision": "auto"},
        {"self_collision": "on"},
    ),
    "cloth_collision": Effect(
        "keeps pieces of cloth out of each other",
        {"cloth_collision": "off"},
        {"cloth_collision": "auto"},
        {"cloth_collision": "on"},
    ),
    "edge_edge": Effect(
        "keeps edges out of edges", {"edge_edge": "off"}, {"edge_edge": "auto"}, {"edge_edge": "on"}
    ),
    "continuous_detection": Effect(
        "finds what meets between two instants", {"detection": "static"}, {"detection": "continuous"}
    ),
    "friction": Effect("slows what slides", {"friction": 0.0}, {"friction": 0.3}),
    "ledger": _read_out("ledger", "tells where energy went"),
    "local_error": _read_out("local_error", "tells what a frame is off by"),
    "crossings": _read_out("crossings", "counts edges that go through triangles"),
}
"""Every effect but single obstacles, by the name that scenes, reports and pages have for it.

Read-outs are the last, each of the name of its setting, one of READ_OUTS."""

OBSTACLE = "obstacle "
"""What the name of a single obstacle's effect begins with; what it is called follows."""

TOLD_BESIDES = {
    "contact": "answers what meets, by the collision method",
    "integrator": "makes the step from forces",
    "sleep": "leaves out cloth that is at rest",
}
"""What a step also says a word of, though it is none of the effects: what it does."""

COLLISIONS = ("self_collision", "cloth_collision")
"""Effects whose pairs are of cloth and cloth."""

NONE_THERE, NO_TRIANGLES = "skipped: there are none", "skipped: no triangles"
SPREAD_OUT = "skipped: cloth is spread out, no part of it is behind another"
ONE_PIECE, ALONE = "skipped: there is one piece", "skipped: there is nothing to meet"
SLACK, UNDAMPED = "skipped: their stiffness is zero", "skipped: no springs act"
UNREAD = "skipped: nobody looks"
NEVER = (NONE_THERE, NO_TRIANGLES, ONE_PIECE, ALONE, SLACK, UNDAMPED, UNREAD)
"""What is said of an effect that no step has anything for; for how many steps says nothing then."""

CHOICES = ("auto", "on", "off")

SPRINGS = {"stretch": "stretch", "altitude": "altitudes", "bending": "bending"}
"""The effect of springs, by the setting that scales them."""


def single_obstacles(switches: str) -> dict[str, str]:
    """The obstacles that `each_obstacle` names, and how each one is switched."""
    return dict(part.strip().split("=") for part in switches.split(",") if part)


def _switches(choices: Mapping[str, str]) -> str:
    return ", ".join(f"{name}={choice}" for name, choice in choices.items() if choice != "auto")


def obstacle_labels(names: Sequence[str]) -> list[str]:
    """What obstacles with these `names` are called: their numbers where names are none, or no good."""
    good = [bool(re.fullmatch(r"[^=,\s]([^=,]*[^=,\s])?", name)) and not name.isdigit() for name in names]
    return [
        name if fine and names.count(name) == 1 else str(k)
        for k, (name, fine) in enumerate(zip(names, good, strict=True))
    ]


def effects_with(labels: Iterable[str]) -> dict[str, Effect]:
    """Every effect of a scene whose obstacles have these `labels`."""
    return EFFECTS | {OBSTACLE + label: _single(label) for label in labels}


def _single(label: str) -> Effect:
    choices = ({"each_obstacle": choice} for choice in ("off", "auto", "on"))
    return Effect(f"keeps cloth out of the obstacle {label}", *choices, obstacle=label)


def find_effect(name: str) -> Effect:
    """The effect of that name; a single obstacle's may be one of any scene.

    Raises:
        ValueError: names the effect and those there are.
    """
    if name.startswith(OBSTACLE):
        return _single(name.removeprefix(OBSTACLE))
    if name not in EFFECTS:
        raise ValueError(_no_effect(name, EFFECTS))
    return EFFECTS[name]


def title(name: str) -> str:
    """An effect's name as people read it: that of the switch that is its own, where there is one."""
    own = name in EFFECTS and EFFECTS[name].off == {name: "off"}
    return FIELDS[name].label if own else name.replace("_", " ")


def does(name: str) -> str:
    """What an effect does to cloth, or what else a step says a word of; ValueError as `find_effect`."""
    return TOLD_BESIDES[name] if name in TOLD_BESIDES else find_effect(name).changes


def _no_effect(name: str, known: Iterable[str]) -> str:
    return f"{name}: no such effect; {nearest(name, known)}"


def check_obstacles(settings: Settings, labels: Sequence[str]) -> None:
    """Raise ValueError where single obstacles are switched that a scene with these `labels` has not."""
    for name in single_obstacles(settings.each_obstacle):
        if name not in labels:
            there = f"one of {', '.join(labels)}" if labels else "none, as there are no obstacles"
            raise ValueError(f"each_obstacle: expected {there}, got {name!r}")


def state(name: str, settings: Settings) -> State:
    """Whether `settings` have an effect "off", "on" or "auto"."""
    effect = find_effect(name)
    if effect.has(effect.off, settings):
        return "off"
    return "on" if effect.has(effect.on, settings) else "auto"


def same_cloth(one: Settings, other: Settings) -> bool:
    """Whether two settings differ at most in what is looked at and by how many threads, not in what acts."""
    return _as_auto(one) == _as_auto(other)


def _as_auto(settings: Settings) -> Settings:
    """`settings` with auto for all that is on, in one thread: the same cloth to the bit."""
    on = [effect for effect in EFFECTS.values() if effect.has(effect.on, settings)]
    auto = {name: value for effect in on for name, value in effect.usual.items()}
    off = {name: how for name, how in single_obstacles(settings.each_obstacle).items() if how == "off"}
    return msgspec.structs.replace(settings, **auto, each_obstacle=_switches(off), threads=1)


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
    effect = find_effect(name)
    if choice not in CHOICES:
        raise ValueError(f'{name}: expected one of "auto", "on", "off", got {shown(choice)}')
    if choice == "off":
        return effect.changed(effect.off, settings)
    if choice == "on" and effect.on:
        return effect.changed(effect.on, settings)
    now = state(name, settings)
    if now == "off":
        source = settings if wanted is None else wanted
        if state(name, source) != "auto":
            return effect.changed(effect.usual, settings)
        return effect.changed({name: effect.value(name, source) for name in effect.off}, settings)
    return effect.changed(effect.usual, settings) if now == "on" and choice == "auto" else {}


def chosen(settings: Settings, choices: Mapping[str, str], known: Mapping[str, Effect] = EFFECTS) -> Settings:
    """`settings` with effects as `choices` force them; auto leaves them as they are.

    Args:
        settings: In force.
        choices: "auto", "on" or "off" by effect.
        known: The effects that there are.

    Raises:
        ValueError: as `switch`; also for an effect forced on that has nothing to act with.
    """
    for name, choice in choices.items():
        if name not in known:
            raise ValueError(_no_effect(name, known))
        changes, effect = switch(name, choice, settings), known[name]
        if choice == "on" and not effect.on and state(name, settings) == "off":
            ((setting, value),) = effect.off.items()
            held = list(value) if isinstance(value, tuple) else value
            raise ValueError(f'{name}: expected "auto" or "off" while settings.{setting} is {held}, got "on"')
        if choice != "auto":
            settings = msgspec.structs.replace(settings, **changes)
    return settings


class Cost(NamedTuple):
    """What an effect takes of a step.

    Attributes:
        ms: Milliseconds; None where there is no figure.
        most: Whether it takes less than that.
        why: Where the figure is from, or why there is none.
    """

    ms: float | None
    most: bool
    why: str


def cost(name: str, words: str, report: StepReport) -> Cost:
    """What a step says that an effect, or what else it says `words` of, took of its time."""
    if words.startswith("off"):
        return Cost(0.0, False, "nothing of it is computed")
    if name in report.costs:
        how = "shared out evenly among those that are looked at" * name.startswith(OBSTACLE)
        return Cost(report.costs[name], False, how or "without what it adds to the work of the solver")
    if name in report.costs_below:
        return Cost(report.costs_below[name], True, "it is computed along with the forces of springs")
    if words.startswith("skipped"):
        return Cost(0.0, False, "nothing of it was computed in this step")
    if name == "contact":
        return Cost(report.ms.get("respond", 0.0), False, "what contacts are given after the solve")
    if name == "integrator":
        forces = sum(report.costs.get(effect, 0.0) for effect in (*SPRINGS.values(), "wind", "gravity"))
        left = max(report.ms.get("solve", 0.0) - forces, 0.0)
        return Cost(left, False, "the solver, without springs, wind and gravity")
    if name in TOLD_BESIDES:
        return Cost(0.0, False, "nothing of it was computed in this step")
    return Cost(None, False, "in the figure of contact, which has it of one piece")


@dataclass(frozen=True)
class _Chosen:
    """What `settings` make of the effects of a scene.

    Attributes:
        settings: In force.
        effects: By name.
        off: What is said of those that are off.
    """

    settings: Settings
    effects: Mapping[str, Effect]
    off: Mapping[str, str]

    @staticmethod
    def by(settings: Settings, obstacles: Sequence[str]) -> _Chosen:
        """For a scene whose obstacles are called so."""
        effects = effects_with(obstacles)
        off = {name: why_off(effect) for name, effect in effects.items() if effect.has(effect.off, settings)}
        return _Chosen(settings, effects, off)


class Told:
    """Says of each step what its effects did, and remembers for how long they have been skipped.

    Attributes:
        skipped: Steps in a row in which an effect was skipped, by its name.
        usual: The least milliseconds that it took in a step that it was not.
    """

    def __init__(self) -> None:
        self.skipped: dict[str, int] = {}
        self.usual: dict[str, float] = {}
        self._chosen: _Chosen | None = None

    def _in_force(self, settings: Settings, obstacles: Sequence[str]) -> _Chosen:
        """What follows from the settings alone, which hardly ever change."""
        if self._chosen is None or self._chosen.settings is not settings:
            self._chosen = _Chosen.by(settings, obstacles)
        return self._chosen

    def tell(
        self,
        settings: Settings,
        model: Model,
        report: StepReport,
        obstacles: Sequence[str],
        limit: float | None,
    ) -> dict[str, str]:
        """Each effect by name: that it ran, or in a few words why not.

        Args:
            settings: In force.
            model: Its springs.
            report: Of the step, with the number of contacts.
            obstacles: What those of the scene are called.
            limit: Longest stable step of an explicit integrator [s], None for an implicit one, nan where
                there is none because the springs are wrong.
        """
        chosen, there = self._in_force(settings, obstacles), feels_obstacles(settings, obstacles)
        found = dict.fromkeys(chosen.effects, "ran")
        for springs in model.springs:
            found[SPRINGS[springs.kind.stiffness]] = _springs(springs, report)
        if not any(springs.acts for springs in model.springs):
            found["damping"] = UNDAMPED
        found["obstacles"] = _obstacles(settings, report, obstacles)
        for label in obstacles:
            found[OBSTACLE + label] = _obstacle(settings, report, label)
        for name in COLLISIONS:
            found[name] = _collision(name, settings, model, report)
        found["edge_edge"] = _edge_edge(settings, model, report, there)
        found["continuous_detection"] = _continuous(settings, model, report, there)
        found["wind"] = "ran" if model.wind is not None else NO_TRIANGLES
        found["strain_limiting"] = _strain(report)
        found["friction"] = "ran" if report.contacts else "skipped: no contacts"
        for name in READ_OUTS:
            found[name] = "ran" if name in report.costs else UNREAD
        found |= chosen.off
        for name in chosen.effects:
            found[name] += self._streak(name, found[name], report)
        found["contact"] = _contact(settings, model, report, obstacles, there)
        found["integrator"] = _integrator(settings, report, limit)
        found["sleep"] = _sleep(settings, model, report)
        return found

    def asleep(self, settings: Settings, obstacles: Sequence[str]) -> dict[str, str]:
        """The same of a step that is left out, as all cloth sleeps."""
        chosen = self._in_force(settings, obstacles)
        return {
            **dict.fromkeys(chosen.effects, "skipped: all cloth is at rest"),
            **chosen.off,
            "sleep": "asleep",
        }

    def _streak(self, name: str, words: str, report: StepReport) -> str:
        """For how long an effect has been skipped, and what that saved."""
        took = report.costs.get(name, 0.0)
        if not words.startswith("skipped"):
            self.skipped[name] = 0
            if words.startswith("ran"):  # the least, as the first time may have compiled something
                self.usual[name] = min(took, self.usual.get(name, math.inf))
            return ""
        self.skipped[name] = self.skipped.get(name, 0) + 1
        told = self.skipped[name] > 1 and words not in NEVER
        many = f" for {self.skipped[name]} steps" if told else ""
        saved = self.usual.get(name, 0.0) - took
        return f"{many}; saves {saved:.2g} ms per step" if saved > 0.01 else many


def why_off(effect: Effect) -> str:
    """What is said of an effect that is off."""
    ((name, value),) = effect.off.items()
    if effect.obstacle:
        return f"off: {name} has {effect.obstacle}={value}"
    nothing = value == 0.0 or value == (0.0, 0.0, 0.0)
    return f"off: {name} is {'zero' if nothing else value}"


def _springs(springs: Springs, report: StepReport) -> str:
    words = "ran" if springs.acts else SLACK if len(springs.stencil) else NONE_THERE
    if springs.kind.wrong and springs.acts:
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


def felt_obstacles(settings: Settings, obstacles: Sequence[str]) -> list[bool]:
    """Which of the obstacles that are called so cloth feels."""
    single = single_obstacles(settings.each_obstacle)
    return [settings.obstacles != "off" and single.get(label) != "off" for label in obstacles]


def feels_obstacles(settings: Settings, obstacles: Sequence[str]) -> bool:
    """Whether cloth feels one of the obstacles at least."""
    return any(felt_obstacles(settings, obstacles))


def feels_cloth(settings: Settings, several: bool) -> bool:
    """Whether cloth feels itself, or one of `several` pieces another."""
    return settings.self_collision != "off" or (settings.cloth_collision != "off" and several)


def _meets_cloth(settings: Settings, model: Model) -> bool:
    return len(model.mesh.edges) > 0 and feels_cloth(settings, model.mesh.several)


def _contact(
    settings: Settings, model: Model, report: StepReport, obstacles: Sequence[str], felt: bool
) -> str:
    """What the collision method did."""
    if settings.contact == "none":
        return "off: contact is none"
    if not felt and not _meets_cloth(settings, model):
        return f"off: no obstacle{' is felt' * bool(obstacles)}, and no cloth is felt"
    words = f"ran: {report.contacts} contacts" if report.contacts else "ran: nothing within reach"
    if report.substeps > 1:
        words += f"; in {report.substeps} parts, as in one it would have tangled or put energy in"
    if report.pinched:
        words += f"; pinched: obstacles leave {report.pinched} vertices less room than the thickness"
    if report.overrun:
        words += f"; overrun by {', '.join(report.overrun_by)}, through the cloth at {report.overrun}"
        words += " vertices that are pinned, had no way out, or began there"
    if report.held_back:
        words += f"; {report.held_back} vertices held back from what they would have met"
    if report.cut_short:
        words += ", as the step's budget of pairs and parts was spent"
    return words + _tunnelling(settings, report, settings.thickness)


def _obstacles(settings: Settings, report: StepReport, obstacles: Sequence[str]) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not obstacles:
        return NONE_THERE
    near = sum(_near(report, label) for label in obstacles)
    if not near:
        return "skipped: none within reach"
    return "ran" if near == len(obstacles) else f"ran: {near} of {len(obstacles)} within reach"


def _near(report: StepReport, label: str) -> bool:
    """Whether an obstacle could not be shown to be out of reach."""
    return label in report.near_obstacles or OBSTACLE + label in report.looked


def _obstacle(settings: Settings, report: StepReport, label: str) -> str:
    if settings.contact == "none" or settings.obstacles == "off":
        return "off: " + ("contact is none" if settings.contact == "none" else "obstacles is off")
    return "ran" if _near(report, label) else "skipped: out of reach"


def _collision(name: str, settings: Settings, model: Model, report: StepReport) -> str:
    """Of cloth with cloth: within pieces, or between them."""
    if settings.contact == "none":
        return "off: contact is none"
    if not len(model.mesh.edges):
        return "off: no edges"
    if name == "cloth_collision" and not model.mesh.several:
        return ONE_PIECE
    if name not in report.looked and state(name, settings) != "on":
        return SPREAD_OUT if report.outspread else "skipped: nothing within reach"
    words = _pairs(name, report)
    if not report.lists:
        words += "; the list of an earlier step holds"
    if report.thickness < settings.thickness:
        words += f"; {1e3 * report.thickness:.2g} mm thick, 0.4 of an edge"
    return words + _tunnelling(settings, report, report.thickness or settings.thickness)


def _edge_edge(settings: Settings, model: Model, report: StepReport, felt: bool) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not (_meets_cloth(settings, model) or felt):
        return ALONE
    if "edge_edge" not in report.looked and settings.edge_edge != "on":
        return SPREAD_OUT if report.outspread else "skipped: no edge within reach of another"
    return _pairs("edge_edge", report)


def _pairs(name: str, report: StepReport) -> str:
    return f"ran: {report.looked.get(name, 0)} pairs looked at, {report.felt.get(name, 0)} felt"


def _continuous(settings: Settings, model: Model, report: StepReport, felt: bool) -> str:
    if settings.contact == "none":
        return "off: contact is none"
    if not (felt or _meets_cloth(settings, model)):
        return ALONE
    if report.sweeps or report.near_obstacles:
        return f"ran: {report.hits} kept from meeting" if report.hits else "ran"
    return (
        SPREAD_OUT if report.outspread else "skipped: all goes less far than half the way to what is nearest"
    )


def _sleep(settings: Settings, model: Model, report: StepReport) -> str:
    if settings.sleep == "off":
        return "off: sleep is off"
    if not report.sleeping:
        return "awake"
    return f"{report.sleeping} of {model.mesh.parts.max() + 1} parts of the cloth sleep"


def _integrator(settings: Settings, report: StepReport, limit: float | None) -> str:
    name = settings.integrator
    if limit is None:
        return f"{report.integrator}, not {name}: contact" if report.integrator != name else name
    if math.isnan(limit):
        return f"{name}: no step is stable with springs that make energy out of nothing"
    words = f"{name}: stable up to {1e3 * limit:.3g} ms"
    return f"unstable: {words}, dt is {1e3 * settings.dt:.3g} ms" if settings.dt > limit else words
