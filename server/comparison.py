"""What the variants share and what they differ in."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from server.digits import written
from server.palette import MAX_VARIANTS
from sim.scene import Scene
from sim.settings import FIELDS, READ_OUTS, Field, Settings, convert

CORES = os.cpu_count() or 1
"""Of this computer's processors."""

NOT_COMPARED = {"threads", "seed", *READ_OUTS}
"""Settings that change no cloth, or only by chance."""

SAYING_NOTHING = {"none", "off", "auto", "on"}
"""Values that mean nothing without the name of their setting."""

FAILS = "fails on purpose"
"""Said of a variant that is there to show what goes wrong with its setting."""


def comparable() -> list[Field]:
    """The settings that variants can differ in: numbers, and choices that leave one."""
    fields = [f for f in FIELDS.values() if f.name not in NOT_COMPARED and f.type not in ("vector", "text")]
    return [f for f in fields if f.choices is None or len(f.choices()) > 1]


def value_text(field: Field, value: Any) -> str:
    """A setting's value with its unit, as people read it."""
    if field.type == "vector":
        return "(" + ", ".join(f"{v:g}" for v in value) + ")" + f" {field.unit}".rstrip()
    text = value if isinstance(value, str) else written(value)
    return f"{text} {field.unit}".rstrip()


@dataclass(frozen=True)
class Comparison:
    """The settings of all variants: the shared ones, and the one that differs.

    Attributes:
        shared: Settings of every variant, except `by`.
        by: Name of the setting that differs, or "" for a single cloth.
        values: Its value in each variant, from left to right; empty without `by`.
        fails: Values that fail in this scene, and are there to show it.
    """

    shared: Settings
    by: str = ""
    values: tuple[Any, ...] = ()
    fails: tuple[Any, ...] = ()

    @classmethod
    def of_scene(cls, scene: Scene) -> Comparison:
        """As the scene's author meant it to be opened."""
        by, values = scene.compare.by, tuple(scene.compare.values)
        if by not in {f.name for f in comparable()} or len(values) < 2:
            return cls(scene.settings)
        values, fails = (tuple(convert(by, v) for v in some) for some in (values, scene.compare.fails))
        return cls(scene.settings, by, values, fails)

    @property
    def count(self) -> int:
        """How many variants there are."""
        return max(1, len(self.values))

    def settings(self, index: int) -> Settings:
        """All settings of one variant. All cores but the page's are shared out, unless one alone is told."""
        own = {self.by: self.values[index]} if self.by else {}
        told = self.shared.threads if self.count == 1 else 0
        own["threads"] = told or max(1, (CORES - 1) // self.count)
        return msgspec.structs.replace(self.shared, **own)

    def name(self, index: int) -> str:
        """What one variant is called: the value that sets it apart."""
        if not self.by:
            return "cloth"
        label, short = FIELDS[self.by].label, self.short_name(index)
        if short in SAYING_NOTHING:
            return f"{label} {short}"
        plain = FIELDS[self.by].type == "choice" or not label.split()[-1].isascii() or self.count > 2
        return short if plain else f"{label} {short}"

    def short_name(self, index: int) -> str:
        """The same where it is plain which setting is meant, or there is little room."""
        if not self.by:
            return "cloth"
        field, symbol = FIELDS[self.by], FIELDS[self.by].label.split()[-1]
        value = value_text(field, self.values[index])
        return value if symbol.isascii() else f"{symbol} {value}"

    def remark(self, index: int) -> str:
        """That one variant shows a failure; empty for those that do not."""
        return FAILS if self.by and self.values[index] in self.fails else ""

    def place(self, index: int) -> str:
        """Where one variant stands."""
        return ("left", "right")[index] if self.count == 2 else f"no. {index + 1}"

    def with_shared(self, name: str, value: Any) -> Comparison:
        """The same with one shared setting changed."""
        return replace(self, shared=msgspec.structs.replace(self.shared, **{name: value}))

    def with_value(self, index: int, value: Any) -> Comparison:
        """The same with one variant's own value changed."""
        return replace(self, values=(*self.values[:index], value, *self.values[index + 1 :]))

    def compared_by(self, by: str) -> Comparison:
        """Another setting compared, two variants: its present value beside one that makes a difference."""
        if not by:
            return Comparison(self.shared)
        present = getattr(self.shared, by)
        return Comparison(self.shared, by, (present, next_value(FIELDS[by], [present])))

    def with_count(self, count: int) -> Comparison:
        """The same with variants added or left out at the end."""
        values = list(self.values[:count])
        while len(values) < min(count, MAX_VARIANTS):
            values.append(next_value(FIELDS[self.by], values))
        return replace(self, values=tuple(values))


def next_value(field: Field, taken: list[Any]) -> Any:
    """A value for one more variant that shows a difference to those `taken`."""
    if field.choices is not None:
        options = [o for o in field.choices() if o not in taken]
        options.sort(key=lambda o: (o != "off", o == "none"))  # what is on is the same cloth as auto
        return options[0] if options else taken[-1]
    low, high = field.slider or (field.minimum or 0.0, field.maximum or 1.0)
    if field.scale == "log":
        ladder = [low * (high / low) ** (i / 4) for i in range(5)]
        distance = lambda a, b: abs(math.log(max(a, low) / max(b, low)))  # noqa: E731
    else:
        ladder = [low + (high - low) * i / 4 for i in range(5)]
        distance = lambda a, b: abs(a - b)  # noqa: E731
    value = max(ladder, key=lambda v: min(distance(v, t) for t in taken))
    return round(value) if field.type == "integer" else float(f"{value:.2g}")
