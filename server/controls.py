"""One control for one setting, of whichever kind its definition in `sim.settings` asks for.

A control reads label, unit, range, scale and tooltip from the setting's Field and nothing else, so that a new
setting, or a new choice of an old one, appears without an edit here. What a client sends goes through the
guard with the check that is given here: sliders clamp to the range that they show, boxes to what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser

from server import style
from server.digits import number_text, round_below, short
from server.guard import Guard, handle_id
from server.palette import Rgb
from server.relevance import AT_RESET
from sim.settings import Field, convert, quotient

LINEAR_STEPS, DECADE_STEPS = 200, 20
"""Positions of a slider over its range, and over one power of ten."""


def tooltip(field: Field) -> str:
    """What a setting is, its formula, its allowed values and what it costs."""
    parts = [field.description, field.formula]
    if field.choices is not None:
        parts += [f"{name}: {summary}" for name, summary in field.choices().items() if summary]
    else:
        parts.append(f"Allowed: {field.allowed}{f' {field.unit}' if field.unit else ''}.")
    parts.append(f"Cost: {field.cost}." if field.cost else "")
    parts.append("Acts at the next reset." if field.name in AT_RESET else "")
    return "  ·  ".join(filter(None, parts))


class Control:
    """A setting's control. Subclasses make the inputs and keep them to one value.

    Args:
        gui: Where to put it; the container in force is the one it lands in.
        guard: Checks what clients send.
        field: The setting.
        value: What to show at first.
        on_change: Called, on viser's event loop, with each allowed value that a client sets; must be quick.
        label: Instead of the setting's own name.
        color: The variant that it belongs to, if it is not shared.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        guard: Guard,
        field: Field,
        value: Any,
        on_change: Callable[[Any], None],
        label: str = "",
        color: Rgb | None = None,
    ):
        self.field, self.color = field, color
        self.inputs: list[Any] = []
        self._gui, self._guard, self._on_change = gui, guard, on_change
        self._label = label or (f"{field.label} [{field.unit}]" if field.unit else field.label)
        self._hint = tooltip(field)
        self.make(value)

    def make(self, value: Any) -> None:
        """Add the inputs."""
        raise NotImplementedError

    def slider_range(self) -> tuple[float, float]:
        """The useful part of the setting's range."""
        assert self.field.slider is not None, "make_control gives a slider only to fields with a range for it"
        return self.field.slider

    def show(self, value: Any) -> None:
        """Show another value, without an `on_change`."""
        self.inputs[0].value = value

    def css(self) -> str:
        """Style rules of this control's own."""
        if self.color is None:
            return ""
        own, color = handle_id(self.inputs[0]), self.color.css
        return (
            f'label[for="{own}"]{{color:{color};font-weight:700}}'
            f'[id="{own}"] .mantine-Slider-bar,[id="{own}"] .mantine-Slider-thumb'
            f"{{background:{color}!important;border-color:{color}!important}}"
            f'input[id="{own}"]{{border-left:4px solid {color}}}'
        )

    def enable(self, why_not: str) -> None:
        """Let it act, or grey it with a reason."""
        hint = f"Cannot act now: {why_not}." if why_not else self._hint
        for handle in self.inputs:
            if handle.hint != hint:
                handle.disabled, handle.hint = bool(why_not), hint

    @property
    def visible(self) -> bool:
        """Whether it can be seen."""
        return self.inputs[0].visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        for handle in self.inputs:
            handle.visible = visible

    def name(self, label: str) -> None:
        """Call it something else."""
        for handle in self.inputs:
            if handle.label != label:
                handle.label = label

    def _watch(
        self, handle: Any, check: Callable[[Any], Any], read: Callable[[Any], Any] = lambda v: v
    ) -> None:
        """Register an input: what may be sent for it, and which setting's value that means."""
        self._guard.watch(handle, check)
        self.inputs.append(handle)

        @handle.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client_id is not None:  # not our own `show`
                value = read(handle.value)
                self.follow(handle, value)
                self._on_change(value)

    def follow(self, changed: Any, value: Any) -> None:
        """Keep other inputs of the same control to a value that a client set in one of them."""


class Choice(Control):
    """A dropdown."""

    def make(self, value: Any) -> None:
        """Add the dropdown."""
        assert self.field.choices is not None
        options = list(self.field.choices())
        handle = self._gui.add_dropdown(self._label, options, initial_value=value, hint=self._hint)
        self._watch(handle, lambda v: convert(self.field.name, v))


class Slider(Control):
    """A slider over the useful part of the range; stretches to values from elsewhere outside of it."""

    def make(self, value: Any) -> None:
        """Add the slider."""
        low, high = self.slider_range()
        whole = self.field.type == "integer"
        step = 1 if whole else round_below((high - low) / LINEAR_STEPS)
        handle = self._gui.add_slider(
            self._label, min(low, value), max(high, value), step, value, hint=self._hint
        )
        self._watch(handle, lambda v: min(max(self.field.clamp(v), handle.min), handle.max))

    def show(self, value: Any) -> None:
        """Show another value."""
        handle = self.inputs[0]
        handle.min, handle.max = min(handle.min, value), max(handle.max, value)
        handle.value = value


class LogSlider(Control):
    """A slider over the exponent, beside a box with the value itself, which takes any allowed number."""

    def make(self, value: float) -> None:
        """Add slider and box."""
        low, high = (math.log10(v) for v in self.slider_range())
        self._low, self._high = low, high
        ends = ((low, short(10**low)), (high, short(10**high)))
        slider = self._gui.add_slider(
            self._label, low, high, 1 / DECADE_STEPS, self._exponent(value), marks=ends, hint=self._hint
        )
        box = self._gui.add_text(self._label, number_text(value), hint=self._hint)
        self._watch(slider, self._check_exponent, lambda e: self.field.clamp(float(f"{10**e:.3g}")))
        self._watch(box, self._check_text, quotient)

    def _exponent(self, value: float) -> float:
        return min(max(math.log10(value), self._low), self._high) if value > 0 else self._low

    def _check_exponent(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(self.field.refusal(value))
        return min(max(float(value), self._low), self._high)

    def _check_text(self, text: Any) -> str:
        """Refuses rather than clamps: on the way to 0.02 a hand types 0, which nobody means."""
        try:
            convert(self.field.name, quotient(str(text)))
        except (ValueError, TypeError, ZeroDivisionError):
            raise ValueError(self.field.refusal(str(text)[:40])) from None
        return str(text)

    def follow(self, changed: Any, value: float) -> None:
        """The box after the slider, the slider after the box."""
        slider, box = self.inputs
        if changed is slider:
            box.value = number_text(value)
        else:
            slider.value = self._exponent(value)

    def show(self, value: float) -> None:
        """Show another value."""
        self.inputs[0].value = self._exponent(value)
        self.inputs[1].value = number_text(value)

    def css(self) -> str:
        """Box and slider in one row: the box stands where the slider would show its exponent."""
        slider, box = (handle_id(handle) for handle in self.inputs)
        row = f'div:has(> .mantine-Flex-root label[for="{box}"])'
        return super().css() + (
            f'[id="{slider}"]~.mantine-NumberInput-root{{visibility:hidden}}'
            f"{row}{{margin:-{style.ROW}em 0 0 auto;width:{style.BOX + 1.25}em;position:relative;z-index:4}}"
            f'{row} div:has(>p>label[for="{box}"]){{display:none}}'
            f"{row} input{{min-height:1.875em!important;height:1.875em!important}}"
            f"{row} input{{padding:0 .25em!important;letter-spacing:-.5px}}"
        )


class Number(Control):
    """A box, for numbers without a useful range."""

    def make(self, value: Any) -> None:
        """Add the box."""
        handle = self._gui.add_number(self._label, value, step=1 if self.field.type == "integer" else None)
        handle.hint = self._hint
        self._watch(handle, self.field.clamp)


class Words(Control):
    """A box for a text."""

    def make(self, value: Any) -> None:
        """Add the box."""
        handle = self._gui.add_text(self._label, value, hint=self._hint)
        self._watch(handle, lambda v: convert(self.field.name, v))


class Vector(Control):
    """Three boxes."""

    def make(self, value: Any) -> None:
        """Add the boxes."""
        handle = self._gui.add_vector3(self._label, value, step=0.01, hint=self._hint)
        self._watch(handle, lambda v: convert(self.field.name, v))


def make_control(
    gui: viser.GuiApi, guard: Guard, field: Field, value: Any, on_change: Callable, **options: Any
):
    """The control that a setting's definition asks for; arguments as for Control."""
    if field.choices is not None:
        kind = Choice
    elif field.type == "vector":
        kind = Vector
    elif field.type == "text":
        kind = Words
    elif field.slider is None:
        kind = Number
    else:
        kind = LogSlider if field.scale == "log" else Slider
    return kind(gui, guard, field, value, on_change, **options)
