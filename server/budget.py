"""The budget tab: give a time per frame, or an error, and settings that meet it are found, said and set."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any

import viser

from server.tables import caption, update

if TYPE_CHECKING:
    from server.guard import Guard
    from server.lab import Lab
    from server.panel import Panel

TIME, ERROR = "time per frame [ms]", "local error [%]"
FIND = "Find settings"

LARGEST = 1e6
"""Of an amount; nobody means more."""

DECIMALS = 6
"""That may be typed; by itself a box takes no more than its first value has."""

CLOTHS = ("first cloth", "second cloth", "third cloth", "fourth cloth")
"""Whose state and settings are measured from, from left to right."""

EXPLANATION = (
    "Measures integrators, time steps, Newton iterations and tolerances from where one of the cloths is now, "
    "and sets, in all of them, those that meet the budget and that none other beats."
)


def amount(value: Any) -> float:
    """A positive number as a client may send it; ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= LARGEST:
        raise ValueError(f"at most: expected a number above 0 and up to {LARGEST:g}, got {str(value)[:40]}")
    return float(value)


class BudgetTab:
    """The controls of the tab, made where it is constructed."""

    def __init__(self, gui: viser.GuiApi) -> None:
        gui.add_html(caption(EXPLANATION))
        self._kind = gui.add_dropdown("budget", (TIME, ERROR), initial_value=TIME)
        self._most = gui.add_number("at most", 5.0, min=0.0, step=1.0)
        self._most.precision = DECIMALS
        self._cloth = gui.add_dropdown("for the", CLOTHS, initial_value=CLOTHS[0])
        self._find = gui.add_button_group("find", (FIND,))
        self._answer = gui.add_html("")

    def connect(self, panel: Panel, guard: Guard, lab: Lab) -> None:
        """Have the lab do what is asked for here."""
        guard.watch(self._most, amount)
        panel.act(self._kind, (TIME, ERROR), lambda _: None)
        panel.act(self._cloth, CLOTHS, lambda _: None)
        panel.act(self._find, (FIND,), lambda _: lab.find_settings(self.index, **self.asked()))

    @property
    def index(self) -> int:
        """Which cloth the budget is for, from the left."""
        return CLOTHS.index(self._cloth.value)

    def asked(self) -> dict[str, float]:
        """The budget, as `sim.budget.choose_settings` takes it."""
        most = float(self._most.value)
        if not math.isfinite(most) or most <= 0.0:
            return {}
        return {"ms": most} if self._kind.value == TIME else {"error": 0.01 * most}

    def say(self, line: str) -> None:
        """Write the answer, or how far it is."""
        update(self._answer, f'<div class="muslin"><p>{escape(line)}</p></div>')
