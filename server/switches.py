"""The effects as switches: auto, on or off for each, and a look at what one does, beside a cloth without it.

A switch changes the settings that leave its effect out or bring it in (`sim.effects`), and nothing else: the
settings' own controls follow. Every obstacle of the open scene has one, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from server.comparison import comparable
from server.controls import tooltip
from sim.effects import CHOICES, EFFECTS, Effect, effects_with, state, title
from sim.settings import FIELDS, READ_OUTS, Settings

if TYPE_CHECKING:
    from server.panel import Panel

NONE = "–"
"""No effect picked."""


def setting_of(name: str) -> str:
    """The setting that leaves out one of EFFECTS."""
    (setting,) = EFFECTS[name].off
    return setting


def hint(effect: Effect) -> str:
    """What an effect does, and how it is left out."""
    ((setting, value),) = effect.off.items()
    how = f'"{effect.obstacle}={value}"' if effect.obstacle else value
    what = f"What it does: {effect.changes}. Off: {setting} = {how}."
    return f"{what}  ·  {tooltip(FIELDS[setting])}" if setting in READ_OUTS else what


class Switches:
    """The switches, in the container in force.

    Args:
        panel: Makes the dropdowns, which all must go through its guard.
        choose: Called with an effect and "auto", "on" or "off".
        compare: Called with an effect to be shown with and without.
    """

    def __init__(self, panel: Panel, choose, compare) -> None:
        self._panel, self._choose, self._handles = panel, choose, {}
        for name, effect in EFFECTS.items():
            self._add(name, effect)
        self._single = panel.folder("Single obstacles")
        fields = {field.name for field in comparable()}
        shown = {title(name): name for name in EFFECTS if setting_of(name) in fields}
        self._question = panel.choice(
            "what does it do?",
            (NONE, *shown),
            NONE,
            lambda option: compare(shown[option]) if option in shown else None,
            "Puts a cloth without the effect beside one that has it. Starts the scene again.",
        )

    def _add(self, name: str, effect: Effect) -> None:
        options = CHOICES if effect.on else ("auto", "off")
        choose = lambda choice: self._choose(name, choice)  # noqa: E731
        self._handles[name] = self._panel.choice(title(name), options, "auto", choose, hint(effect))

    def offer(self, obstacles: Sequence[str]) -> None:
        """Have switches for obstacles that are called so: made when needed, then hidden, never removed."""
        effects = effects_with(obstacles)
        with self._single:
            for name, effect in effects.items():
                if name not in self._handles:
                    self._add(name, effect)
        self._single.visible = bool(obstacles)
        for name, handle in self._handles.items():
            if handle.visible != (name in effects):
                handle.visible = name in effects

    def show(self, variants: Sequence[Settings]) -> None:
        """Say how the effects are switched in the first variant, and let go of the question."""
        for name, handle in self._handles.items():
            if handle.value != (now := state(name, variants[0])):
                handle.value = now
        if self._question.value != NONE:
            self._question.value = NONE
