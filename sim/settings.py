"""The settings of a simulation: one typed, bounded, documented definition.

Validation with a path in the error, TOML, the page's sliders and tooltips, the command line and the
parameter table in the docs are all read from here; nothing else lists the settings.
"""

import json
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from sim.integrators import INTEGRATORS
from sim.refusal import nearest, shown
from sim.springs import BENDING


def number(
    default_unit: str,
    group: str,
    description: str,
    *,
    ge: float | None = None,
    le: float | None = None,
    scale: str = "linear",
    slider: tuple[float, float] | None = None,
    label: str = "",
    formula: str = "",
    cost: str = "",
    ramps: bool = False,
) -> Meta:
    """The bounds and the words of a numeric setting.

    `slider` is the useful part of the allowed range; a setting that `ramps` goes over to a new value in
    several steps, as it would jerk the cloth otherwise.
    """
    extra = {"unit": default_unit, "group": group, "scale": scale, "slider": slider, "label": label}
    more = {"formula": formula, "cost": cost, "ramps": ramps}
    return Meta(ge=ge, le=le, description=description, extra={**extra, **more})


def choice(
    group: str,
    description: str,
    *,
    choices: Callable[[], dict[str, str]] | None = None,
    label: str = "",
    cost: str = "",
) -> Meta:
    """The words of an enumerated setting; `choices` gives an open set of values and what each one means."""
    extra = {"unit": "", "group": group, "choices": choices, "label": label, "formula": "", "cost": cost}
    return Meta(description=description, extra=extra)


def text(group: str, description: str, *, pattern: str, example: str, label: str, cost: str) -> Meta:
    """The words of a setting that is a text, of the form that `pattern` says and `example` shows."""
    extra = {"unit": "", "group": group, "example": example, "label": label, "formula": "", "cost": cost}
    return Meta(pattern=pattern, description=description, extra=extra)


PAIRS = {
    "auto": "looked at where bounds cannot show that nothing is near; the same cloth as with on",
    "on": "all pairs are found anew and looked at every time",
}
"""How pairs of cloth may be looked at."""

READ_OUT = "Read-outs"
"""The group of what is measured of cloth, which it changes nothing of."""

SWITCHES = r"^([^=,\s][^=,]*=(on|off)(, *[^=,\s][^=,]*=(on|off))*)?\Z"
"""Names of obstacles, and how each one is switched."""

Acceleration = Annotated[float, Meta(ge=-1e3, le=1e3)]
"""A component of gravity [m/s²]: up to a hundred times the earth's."""

Speed = Annotated[float, Meta(ge=-100.0, le=100.0)]
"""A component of the wind [m/s]: up to that of a hurricane."""


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that may change while a simulation runs. Immutable: a change makes a new value."""

    gamma: Annotated[
        float,
        number(
            "",
            "Cloth",
            "Damping ratio γ of every spring: below 1 it rings, at 1 it is critical, above 1 it creeps.",
            ge=0.0,
            le=1000.0,
            slider=(0.0, 2.0),
            label="damping ratio γ",
            formula="b = γ · 2 √(μ K), 1/μ = Σ |∇q|² / m",
            cost="free",
        ),
    ] = 0.2
    rest_angle: Annotated[
        float,
        number(
            "rad",
            "Cloth",
            "Fold angle θ₀ at which every hinge is at rest; the sign says to which side it curls.",
            ge=-math.pi,
            le=math.pi,
            slider=(-1.5, 1.5),
            label="rest angle θ₀",
            formula="q₀ = q(rest hinge folded to θ₀)",
            cost="free",
            ramps=True,
        ),
    ] = 0.0
    stretch: Annotated[
        float,
        number(
            "N",
            "Cloth",
            "Stretch stiffness k of the edge springs; the spring constant is k divided by the rest length.",
            ge=0.0,
            le=1e8,
            scale="log",
            slider=(1.0, 1e4),
            label="stretch stiffness",
            formula="E = ½ (k / l₀) (l − l₀)²",
            cost="stiffer cloth needs more solver iterations",
            ramps=True,
        ),
    ] = 50.0
    altitudes: Annotated[
        Literal["none", "shortest", "all"],
        choice(
            "Cloth",
            "Springs along the heights of each triangle, which keep it from collapsing.",
            choices=lambda: {
                "none": "edges alone hold the triangles",
                "shortest": "one per triangle, on its longest edge; chosen every step, and energy jumps",
                "all": "all three",
            },
            label="altitude springs",
            cost="all three cost about as much as the edge springs",
        ),
    ] = "none"
    altitude: Annotated[
        float,
        number(
            "N",
            "Cloth",
            "Stiffness k of the altitude springs; the spring constant is k divided by the height at rest.",
            ge=0.0,
            le=1e8,
            scale="log",
            slider=(1.0, 1e4),
            label="altitude stiffness",
            formula="E = ½ (k / h₀) (h − h₀)²",
            cost="stiffer cloth needs more solver iterations",
            ramps=True,
        ),
    ] = 50.0
    bend: Annotated[
        str,
        choice(
            "Cloth",
            "Which coordinate of a hinge resists bending.",
            choices=lambda: {"none": "no bending resistance"} | {k: v.summary for k, v in BENDING.items()},
            label="bending spring",
            cost="angle and modified springs couple all four vertices of a hinge, cross springs two",
        ),
    ] = "angle"
    adhoc_rule: Annotated[
        Literal["tips", "half", "lever"],
        choice(
            "Cloth",
            "How ad-hoc angle springs, which are wrong on purpose, turn an angle into forces.",
            choices=lambda: {
                "tips": "along the normals, on the tips alone: a net force and a net torque",
                "half": "and half of it back on each end of the shared edge: a net torque",
                "lever": "the right forces on the tips, but half back on each end: a net torque",
            },
            label="ad-hoc rule",
            cost="the same",
        ),
    ] = "tips"
    bending: Annotated[
        float,
        number(
            "N·m",
            "Cloth",
            "Bending stiffness c, one number for all kinds: they agree for small folds. Cross springs have "
            "no linear stiffness when flat, so they are matched at a fold of 60°.",
            ge=0.0,
            le=1e4,
            scale="log",
            slider=(1e-6, 1e-1),
            label="bend stiffness",
            formula="E = ½ c w (θ − θ₀)², w = |e| / (h₁ + h₂)",
            cost="free unless very stiff",
            ramps=True,
        ),
    ] = 1e-4
    strain_limit: Annotated[
        float,
        number(
            "",
            "Cloth",
            "Largest strain of an edge: impulses after the solve keep it there, before contact is answered. "
            "Zero lets springs alone decide.",
            ge=0.0,
            le=1.0,
            slider=(0.0, 0.2),
            label="strain limit",
            formula="|l / l₀ − 1| ≤ limit, where l > l₀",
            cost="nothing while no edge is at it, then up to as much as the solve",
        ),
    ] = 0.0
    mass: Annotated[
        Literal["area", "constant"],
        choice(
            "Cloth",
            "How mass is shared out: a third of each triangle to its corners, or the same to every vertex.",
            label="mass lumping",
            cost="the same",
        ),
    ] = "area"
    density: Annotated[
        float,
        number(
            "kg/m²",
            "Cloth",
            "Mass per area of cloth; a piece may carry its own.",
            ge=1e-4,
            le=1e3,
            scale="log",
            slider=(0.02, 2.0),
            label="density",
            formula="m = Σ ρ A / 3",
            cost="free",
        ),
    ] = 0.2
    gravity: Annotated[
        tuple[Acceleration, Acceleration, Acceleration],
        number("m/s²", "Cloth", "Acceleration that acts on every vertex.", label="gravity", cost="free"),
    ] = (0.0, 0.0, -9.81)
    wind: Annotated[
        tuple[Speed, Speed, Speed],
        number(
            "m/s",
            "Wind",
            "Mean velocity of the air. Still air brakes what moves, too: what says whether air acts is drag.",
            label="wind",
            cost="free",
        ),
    ] = (0.0, 0.0, 0.0)
    drag: Annotated[
        float,
        number(
            "",
            "Wind",
            "Drag coefficient C of a triangle that faces the air; a flat plate has about 1.2. Zero leaves "
            "out all of the air.",
            ge=0.0,
            le=10.0,
            slider=(0.0, 2.0),
            label="drag",
            formula="F = ½ ρ A (n·u) C u",
            cost="a few per cent of a step",
        ),
    ] = 0.0
    lift: Annotated[
        float,
        number(
            "",
            "Wind",
            "Lift coefficient of a triangle as part of its drag coefficient: a push square to the air.",
            ge=0.0,
            le=1.0,
            slider=(0.0, 1.0),
            label="lift",
            formula="F = ½ ρ A (n·u) C lift (|u| n − (n·u) u / |u|)",
            cost="free",
        ),
    ] = 0.0
    gust: Annotated[
        float,
        number(
            "",
            "Wind",
            "Root mean square of the gusts in each direction, as part of the mean wind; seeded.",
            ge=0.0,
            le=1.0,
            slider=(0.0, 1.0),
            label="gusts",
            formula="spectrum ~ f^(−5/3), carried by the mean wind",
            cost="a tenth of a millisecond for a thousand vertices",
        ),
    ] = 0.0
    contact: Annotated[
        Literal["none", "penalty", "impulse", "postprocess"],
        choice(
            "Contact",
            "How cloth answers obstacles and itself: penalty springs in the implicit system (soft, no "
            "guarantee), the same and then impulses until nothing would meet, or a step that feels nothing "
            "and is put right afterwards (cheap; loses volume and much of friction).",
            label="collision method",
            cost="impulses add detection until nothing meets; postprocess is the cheapest",
        ),
    ] = "impulse"
    detection: Annotated[
        Literal["static", "continuous"],
        choice(
            "Contact",
            "Look for contacts at one instant of a step only, or along the whole way of every vertex, "
            "edge and triangle, so that nothing fast is missed.",
            label="detection",
            cost="continuous costs a few times static",
        ),
    ] = "continuous"
    obstacles: Annotated[
        Literal["auto", "on", "off"],
        choice(
            "Contact",
            "Whether cloth feels obstacles.",
            choices=lambda: {
                "auto": "looked at in steps in which one may be within reach; the others give the same cloth",
                "on": "looked at in every step",
                "off": "cloth goes through them",
            },
            label="obstacles",
            cost="a few per cent of a step near one; auto makes it next to nothing elsewhere",
        ),
    ] = "auto"
    each_obstacle: Annotated[
        str,
        text(
            "Contact",
            "Single obstacles that are felt otherwise than `obstacles` says, by their names, or by their "
            "numbers from 0 where they have none.",
            pattern=SWITCHES,
            example="ball=off, 2=on",
            label="single obstacles",
            cost="what is off costs nothing",
        ),
    ] = ""
    self_collision: Annotated[
        Literal["auto", "on", "off"],
        choice(
            "Contact",
            "Whether a piece of cloth feels itself: all its vertices, edges and triangles.",
            choices=lambda: {
                **PAIRS,
                "off": "a piece goes through itself",
            },
            label="self-collision",
            cost="from a tenth to half of the step",
        ),
    ] = "auto"
    cloth_collision: Annotated[
        Literal["auto", "on", "off"],
        choice(
            "Contact",
            "Whether pieces of cloth feel each other.",
            choices=lambda: {
                **PAIRS,
                "off": "pieces go through each other",
            },
            label="cloth–cloth collision",
            cost="as self-collision, for what is near",
        ),
    ] = "auto"
    edge_edge: Annotated[
        Literal["auto", "on", "off"],
        choice(
            "Contact",
            "Whether edges of cloth feel edges, of cloth and of mesh obstacles, and not vertices and "
            "triangles alone.",
            choices=lambda: {
                **PAIRS,
                "off": "edges go through edges",
            },
            label="edge–edge tests",
            cost="about half of what collisions of cloth cost",
        ),
    ] = "auto"
    tangled: Annotated[
        Literal["refuse", "untangle", "keep"],
        choice(
            "Contact",
            "What to do where cloth crosses itself or a mesh obstacle at the start. Acts at the next start.",
            choices=lambda: {
                "refuse": "with impulses, which would never undo it, the start is refused; the others run",
                "untangle": "vertices are moved apart before the first step, or it is said that none helped",
                "keep": "it is run as it is; impulses promise nothing about what crosses",
            },
            label="tangled start",
            cost="a start alone: a look at all triangles, and up to some seconds to untangle",
        ),
    ] = "refuse"
    thickness: Annotated[
        float,
        number(
            "m",
            "Contact",
            "Distance that cloth keeps from obstacles, and from itself up to 0.4 of a typical edge.",
            ge=1e-5,
            le=0.1,
            scale="log",
            slider=(1e-3, 5e-2),
            label="thickness",
            formula="gap < thickness is a contact",
            cost="free",
        ),
    ] = 5e-3
    friction: Annotated[
        float,
        number(
            "",
            "Contact",
            "Coulomb friction coefficient μ of cloth on obstacles and on cloth.",
            ge=0.0,
            le=10.0,
            slider=(0.0, 1.0),
            label="friction",
            formula="|Jₜ| ≤ μ Jₙ",
            cost="free",
        ),
    ] = 0.3
    integrator: Annotated[
        str,
        choice(
            "Solver",
            "Time integration method. A step that feels a contact is always backward Euler, or explicit.",
            choices=lambda: {name: integrator.summary for name, integrator in INTEGRATORS.items()},
            label="integrator",
            cost="SDIRK2 and TR-BDF2 solve twice per step, the explicit one never",
        ),
    ] = "backward_euler"
    compensate: Annotated[
        Literal["off", "on"],
        choice(
            "Solver",
            "Take off the damping ratio of each spring what the integrator damps it by itself.",
            label="compensate damping",
            cost="free",
        ),
    ] = "off"
    dt: Annotated[
        float,
        number(
            "s",
            "Solver",
            "Time step h. Backward Euler adds a damping ratio of its own of about h ω / 2.",
            ge=1e-6,
            le=1.0,
            scale="log",
            slider=(1e-3, 1 / 30),
            label="time step",
            formula="M (v − v̂) = h f(x̂ + h v, v)",
            cost="half the step, twice the steps",
        ),
    ] = 1 / 60
    newton: Annotated[
        int,
        number(
            "",
            "Solver",
            "Largest number of Newton iterations per solve; 1 is the linearised step, which damps along old "
            "directions and so is first order; second-order integrators need 2 to be that.",
            ge=1,
            le=100,
            slider=(1, 10),
            label="Newton iterations",
            cost="each one is an assembly and a linear solve",
        ),
    ] = 1
    solver: Annotated[
        Literal["auto", "cg", "direct"],
        choice(
            "Solver",
            "How the linear systems of a step are solved.",
            choices=lambda: {
                "auto": "conjugate gradients, and a factorisation where they take longer than that",
                "cg": "conjugate gradients, to the tolerance",
                "direct": "a sparse factorisation, to rounding",
            },
            label="linear solver",
            cost="direct is faster on very stiff cloth and for many digits, and far slower on large cloth",
        ),
    ] = "auto"
    tolerance: Annotated[
        float,
        number(
            "m",
            "Solver",
            "Position error that a linear solve may leave at the worst vertex.",
            ge=1e-12,
            le=1e-2,
            scale="log",
            slider=(1e-7, 1e-3),
            label="tolerance",
            formula="estimated |x − x*| ≤ tolerance",
            cost="each digit costs more solver iterations",
        ),
    ] = 1e-4
    sleep: Annotated[
        Literal["off", "auto"],
        choice(
            "Solver",
            "Whether cloth that has come to rest is left out of steps until something could move it.",
            choices=lambda: {
                "off": "every step is taken",
                "auto": "without parts that are still: slower than 1e-5 of the cloth's size per second for "
                "half a second, with nothing that drives or touches them",
            },
            label="sleep",
            cost="a step at rest costs next to nothing",
        ),
    ] = "off"
    threads: Annotated[
        int,
        number(
            "",
            "Solver",
            "Processor threads for one simulation; the result is the same to the bit for any number. With 0, "
            "variants on the page share out all cores but one, and a script takes one.",
            ge=0,
            le=256,
            slider=(1, 4),
            label="threads",
        ),
    ] = 0
    jitter: Annotated[
        float,
        number(
            "m",
            "Solver",
            "Size of the seeded random offsets of the start positions, to break symmetry on purpose.",
            ge=0.0,
            le=1e-2,
            scale="log",
            slider=(1e-8, 1e-3),
            label="start jitter",
        ),
    ] = 0.0
    seed: Annotated[
        int, number("", "Solver", "Seed of everything random.", ge=0, le=2**31 - 1, label="seed")
    ] = 0
    ledger: Annotated[
        Literal["auto", "on", "off"],
        choice(
            READ_OUT,
            "Books of where energy went, entry by entry.",
            choices=lambda: {
                "auto": "kept where the page shows them, or somebody asks for them",
                "on": "kept from the first step",
                "off": "never kept",
            },
            label="ledger",
            cost="some per cent of a step",
        ),
    ] = "auto"
    local_error: Annotated[
        Literal["auto", "on", "off"],
        choice(
            READ_OUT,
            "The local error of a frame, measured beside the run where a page shows it.",
            choices=lambda: {
                "auto": "now and then, within a share of the time of steps",
                "on": "again as soon as the last measurement is done",
                "off": "never measured",
            },
            label="local error",
            cost="auto takes less than a per cent of the time of steps, on up to a processor core",
        ),
    ] = "auto"
    crossings: Annotated[
        Literal["auto", "on", "off"],
        choice(
            READ_OUT,
            "Counting the edges of cloth and mesh obstacles that go through triangles.",
            choices=lambda: {
                "auto": "on a page now and then, within a share of the time; by `muslin run` at the end",
                "on": "on a page after every frame; by `muslin run` after every step",
                "off": "never counted, but where cloth starts and where a study judges it",
            },
            label="crossings",
            cost="auto takes less than a per cent of the time; one count, up to as much as a step",
        ),
    ] = "auto"

    def __post_init__(self) -> None:
        for name, field in FIELDS.items():
            field.check(getattr(self, name))


@dataclass(frozen=True)
class Field:
    """What the page, the command line and the docs need to know about one setting."""

    name: str
    type: str  # "number", "integer", "vector", "choice" or "text"
    default: Any
    unit: str
    group: str
    label: str
    description: str
    formula: str
    cost: str
    scale: str = "linear"
    minimum: float | None = None
    maximum: float | None = None
    slider: tuple[float, float] | None = None
    ramps: bool = False
    choices: Callable[[], dict[str, str]] | None = None
    pattern: str | None = None
    example: str = ""

    @property
    def allowed(self) -> str:
        """The allowed values in words, as error messages and tooltips print them."""
        if self.choices is not None:
            return "one of " + ", ".join(f'"{name}"' for name in self.choices())
        if self.type == "text":
            return f'text such as "{self.example}"'
        if self.type == "vector":
            return f"three numbers from {self.minimum:g} to {self.maximum:g}"
        bounds = [f"≥ {self.minimum:g}" if self.minimum is not None else ""]
        bounds += [f"≤ {self.maximum:g}" if self.maximum is not None else ""]
        whole = "a whole number " if self.type == "integer" else ""
        return whole + (" and ".join(filter(None, bounds)) or "a finite number")

    def check(self, value: Any) -> None:
        """Raise ValueError where types and bounds alone let a wrong value pass."""
        numbers = value if isinstance(value, tuple) else (value,)
        finite = all(math.isfinite(v) for v in numbers if isinstance(v, float))
        wrong = self.pattern is not None and not re.search(self.pattern, str(value))
        if not finite or wrong or (self.choices is not None and value not in self.choices()):
            raise ValueError(self.refusal(value))

    def refusal(self, value: Any) -> str:
        """The line that says why `value` cannot be had."""
        return f"{self.name}: expected {self.allowed}, got {shown(value)}"

    def clamp(self, value: float) -> float:
        """The nearest allowed number; raises ValueError for what is not a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(self.refusal(value))
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        value = min(max(value, low), high)
        return round(value) if self.type == "integer" else float(value)


def _field(name: str, annotation: Any, default: Any) -> Field:
    base, meta = typing.get_args(annotation)
    extra = dict(meta.extra)
    choices = extra.pop("choices", None)
    if typing.get_origin(base) is Literal and choices is None:
        closed = dict.fromkeys(typing.get_args(base), "")
        choices = lambda: closed  # noqa: E731
    kind = "choice" if choices else {float: "number", int: "integer", str: "text"}.get(base, "vector")
    bounds = typing.get_args(typing.get_args(base)[0])[1] if kind == "vector" else meta
    extra["label"] = extra["label"] or name.replace("_", " ")
    return Field(
        name=name,
        type=kind,
        default=default,
        description=meta.description,
        minimum=bounds.ge,
        maximum=bounds.le,
        choices=choices,
        pattern=meta.pattern,
        **extra,
    )


_ANNOTATIONS = typing.get_type_hints(Settings, include_extras=True)

FIELDS: Mapping[str, Field] = types.MappingProxyType(
    {f.name: _field(f.name, _ANNOTATIONS[f.name], f.default) for f in msgspec.structs.fields(Settings)}
)
"""Every setting by name, in the order in which people should meet them."""

READ_OUTS = tuple(name for name, field in FIELDS.items() if field.group == READ_OUT)
"""Settings that change nothing of the cloth: each one switches what is measured of it."""


def only_read_outs(names: Collection[str]) -> bool:
    """Whether the settings of these names, of which there are some, change nothing of the cloth."""
    return bool(names) and all(name in READ_OUTS for name in names)


def change(settings: Settings, **changes: Any) -> Settings:
    """New settings with `changes` applied; ValueError names the field, the value and what is allowed."""
    checked = {name: convert(name, value) for name, value in changes.items()}
    return msgspec.structs.replace(settings, **checked)


def differing(settings: Settings, others: Settings) -> dict[str, Any]:
    """What must change of `settings` to have the `others`."""
    before = msgspec.structs.asdict(settings)
    return {name: value for name, value in msgspec.structs.asdict(others).items() if before[name] != value}


def convert(name: str, value: Any) -> Any:
    """`value` as setting `name` holds it; ValueError names the field, the value and what is allowed."""
    if name not in FIELDS:
        raise ValueError(f"{name}: no such setting; {nearest(name, FIELDS)}")
    value = _plain(value)
    if isinstance(value, list | tuple):
        value = [_plain(item) for item in value]
    field = FIELDS[name]
    try:
        value = msgspec.convert(value, _ANNOTATIONS[name])
    except msgspec.ValidationError:
        raise ValueError(field.refusal(value)) from None
    field.check(value)
    return value


def _plain(value: Any) -> Any:
    """`value` without NumPy: its scalars and arrays as numbers and lists."""
    return value.tolist() if hasattr(value, "tolist") else value


def quotient(text: str) -> float:
    """A number as people type it: 0.02, 1e-3 or 1/60; ValueError or ZeroDivisionError for others."""
    above, slash, below = text.partition("/")
    return float(above) / float(below) if slash else float(above)


def parse(name: str, text: str) -> Any:
    """The value that `text`, as typed on a command line in `name=text`, means for setting `name`."""
    if name not in FIELDS or FIELDS[name].type in ("choice", "text"):
        return convert(name, text)
    several = FIELDS[name].type == "vector"
    parts = text.strip("()[] ").split(",") if several else [text]
    try:
        value = [quotient(part) if "/" in part else json.loads(part) for part in parts]
    except (ValueError, ZeroDivisionError, RecursionError):
        value = []
    if len(value) != (3 if several else 1):
        raise ValueError(FIELDS[name].refusal(text))
    return convert(name, value if several else value[0])
