"""The effects as switches: auto, on or off for each, and a look at what one does, beside a cloth without it.

A switch changes the settings that leave its effect out or bring it in (`sim.effects`), and nothing else: the
settings' own controls follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from server.comparison import comparable
from sim.effects import CHOICES, EFFECTS, state
from sim.settings import Settings

if TYPE_CHECKING:
    from server.panel import Panel

NONE = "–"
"""No effect picked."""


def title(name: str) -> str:
    """An effect's name as people read it."""
    return name.replace("_", " ")


def setting_of(name: str) -> str:
    """The setting that leaves an effect out."""
    (setting,) = EFFECTS[name].off
    return setting


class Switches:
    """The switches, in the container in force.

    Args:
        panel: Makes the dropdowns, which all must go through its guard.
        choose: Called with an effect and "auto", "on" or "off".
        compare: Called with an effect to be shown with and without.
    """

    def __init__(self, panel: Panel, choose, compare) -> None:
        self._handles = {}
        for name, effect in EFFECTS.items():
            options = CHOICES if effect.on else ("auto", "off")
            hint = (
                f"What it does: {effect.changes}. Off: {setting_of(name)} = {effect.off[setting_of(name)]}."
            )
            self._handles[name] = panel.choice(
                title(name), options, "auto", lambda choice, name=name: choose(name, choice), hint
            )
        fields = {field.name for field in comparable()}
        shown = {title(name): name for name in EFFECTS if setting_of(name) in fields}
        self._question = panel.choice(
            "what does it do?",
            (NONE, *shown),
            NONE,
            lambda option: compare(shown[option]) if option in shown else None,
            "Puts a cloth without the effect beside one that has it. Starts the scene again.",
        )

    def show(self, variants: Sequence[Settings]) -> None:
        """Say how the effects are switched in the first variant, and let go of the question."""
        for name, handle in self._handles.items():
            if handle.value != (now := state(name, variants[0])):
                handle.value = now
        if self._question.value != NONE:
            self._question.value = NONE
