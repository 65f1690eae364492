"""The changes that can be undone: what the comparison was before each of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

from server.comparison import Comparison, value_text
from sim.settings import FIELDS

LONGEST = 100
"""Changes that are remembered."""

GESTURE = 1.0
"""Wall time [s] within which changes of one control follow each other while it is dragged: they are one."""


class Change(NamedTuple):
    """A change that can be undone.

    Attributes:
        before: The comparison before it.
        anew: Whether the scene started again with it, and does when it is undone.
    """

    before: Comparison
    anew: bool


class History:
    """Remembers comparisons of one scene."""

    def __init__(self, now: Callable[[], float] = perf_counter):
        self._now = now
        self._changes: deque[Change] = deque(maxlen=LONGEST)
        self.clear()

    def clear(self) -> None:
        """Forget everything: from here nothing leads back."""
        self._changes.clear()
        self._control, self._touched = object(), -GESTURE

    def note(self, before: Comparison, control: object, anew: bool = False) -> None:
        """Remember what was before a change by a control; those of one gesture count as one change."""
        now = self._now()
        same = control == self._control and now < self._touched + GESTURE and self._changes
        self._control, self._touched = control, now
        if not same:
            self._changes.append(Change(before, anew))

    def undo(self) -> Change | None:
        """The last change, which is forgotten with this; None where there is none."""
        self._control = object()
        return self._changes.pop() if self._changes else None

    def last(self, present: Comparison) -> str:
        """The last change in words; empty where there is none."""
        return changed(self._changes[-1].before, present) if self._changes else ""


def changed(before: Comparison, after: Comparison) -> str:
    """What differs between two comparisons, in words; empty where nothing does."""
    if (before.by, before.count) != (after.by, after.count):
        return f"{_compared(before)} → {_compared(after)}"
    shared = [name for name in FIELDS if name != before.by]
    parts = [_words(name, getattr(before.shared, name), getattr(after.shared, name)) for name in shared]
    for i, pair in enumerate(zip(before.values, after.values, strict=False)):
        parts.append(_words(before.by, *pair, f" ({after.place(i)})"))
    parts = [part for part in parts if part]
    return "; ".join(parts[:2]) + (f" and {len(parts) - 2} more" if len(parts) > 2 else "")


def _compared(comparison: Comparison) -> str:
    """What is compared: a setting, and its values from left to right."""
    if not comparison.by:
        return "one cloth"
    field = FIELDS[comparison.by]
    return f"{field.label} {' / '.join(value_text(field, value) for value in comparison.values)}"


def _words(name: str, old: object, new: object, where: str = "") -> str:
    field = FIELDS[name]
    return f"{field.label}{where}: {value_text(field, old)} → {value_text(field, new)}" if old != new else ""
