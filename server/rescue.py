"""What the page offers when a variant cannot go on: undo the last change, or safe settings.

The variant stands where it was after its last good step, the others go on; both ways out are changes of
settings like any other. The buttons are there only while something stands still.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import viser

from server import style
from server.comparison import Comparison
from server.guard import Guard
from server.history import changed
from server.labels import likeliest
from server.lane import Frame
from server.palette import VARIANTS
from sim.safe import DOUBTFUL, safe_changes

if TYPE_CHECKING:
    from server.lab import Lab

UNDO, SAFE = "Undo the last change", "Safe settings"


def made_safe(comparison: Comparison, frames: Sequence[Frame]) -> Comparison:
    """The comparison with what is out of the ordinary put right in variants whose newest frame is refused.

    Settings that are shared change for all, so that the others stay comparable; the compared one only for
    those that stand still.
    """
    for i, frame in enumerate(frames):
        changes = safe_changes(comparison.settings(i), frame.blamed) if frame.refused else {}
        for name, value in changes.items():
            own = name == comparison.by
            comparison = comparison.with_value(i, value) if own else comparison.with_shared(name, value)
    return comparison


class Rescue:
    """The piece of the left dock that says what stands still, and why, and offers both ways out."""

    def __init__(self, server: viser.ViserServer, guard: Guard, lab: Lab):
        self._said = server.gui.add_html("", visible=False)
        self._undo = server.gui.add_button(UNDO, visible=False)
        self._safe = server.gui.add_button(SAFE, visible=False)
        for button, action in ((self._undo, lab.undo), (self._safe, lab.make_safe)):
            self._offer(guard, lab, button, action)

    @staticmethod
    def _offer(guard: Guard, lab: Lab, button: Any, action: Any) -> None:
        guard.watch(button, bool)

        @button.on_click
        async def _(event: viser.GuiEvent) -> None:
            if button.visible:
                lab.post(action)

    def show(self, comparison: Comparison, frames: Sequence[Frame], last_change: str) -> None:
        """Say what stands still and offer ways out, or be gone where nothing does.

        Args:
            comparison: The present settings.
            frames: The newest of each variant.
            last_change: What would be undone; empty where there is nothing.
        """
        stopped = [i for i, frame in enumerate(frames) if frame.refused]
        after = made_safe(comparison, frames)
        changes = changed(comparison, after)
        if stopped:
            self._write(self._said, content=self._text(comparison, frames, stopped))
        self._write(self._said, visible=bool(stopped))
        why = "; ".join(dict.fromkeys(DOUBTFUL.get(frames[i].blamed, "") for i in stopped))
        self._offer_if(stopped and last_change, self._undo, f"Back to before {last_change}.")
        self._offer_if(stopped and changes, self._safe, f"Changes {changes}. {why}".rstrip())

    def _offer_if(self, wanted: object, button: Any, hint: str) -> None:
        if wanted:
            self._write(button, hint=hint)
        self._write(button, visible=bool(wanted))

    @staticmethod
    def _text(comparison: Comparison, frames: Sequence[Frame], stopped: Sequence[int]) -> str:
        lines = []
        for i in stopped:
            frame = frames[i]
            chip = style.chip(VARIANTS[i]) if comparison.count > 1 else ""
            lines.append(f"<p>{chip}<b>▲ {escape(comparison.name(i))} stopped: {escape(frame.refused)}.</b>")
            if what := likeliest(frame.blamed, comparison.settings(i)):
                lines.append(f" Likeliest: <b>{escape(what)}</b>.")
            lines.append("</p>")
        return (
            f'<div class="muslin alarm">{"".join(lines)}<p class="small">The last good state is kept. '
            "Change a setting to go on, or:</p></div>"
        )

    @staticmethod
    def _write(handle: Any, **properties: Any) -> None:
        for name, value in properties.items():
            if getattr(handle, name) != value:
                setattr(handle, name, value)
