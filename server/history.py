"""The changes of settings that can be undone: what the comparison was before each of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import perf_counter

from server.comparison import Comparison, value_text
from sim.settings import FIELDS

LONGEST = 100
"""Changes that are remembered."""

GESTURE = 1.0
"""Wall time [s] within which changes of one control follow each other while it is dragged: they are one."""


class History:
    """Remembers comparisons. Starts anew with each scene, and each choice of what is compared."""

    def __init__(self, now: Callable[[], float] = perf_counter):
        self._now = now
        self._before: deque[Comparison] = deque(maxlen=LONGEST)
        self.clear()

    def clear(self) -> None:
        """Forget everything: from here nothing leads back."""
        self._before.clear()
        self._control, self._touched = object(), -GESTURE

    def note(self, before: Comparison, control: object) -> None:
        """Remember what was before a change by a control; those of one gesture count as one change."""
        now = self._now()
        same = control == self._control and now < self._touched + GESTURE and self._before
        self._control, self._touched = control, now
        if not same:
            self._before.append(before)

    def undo(self) -> Comparison | None:
        """What was before the last change, which is forgotten with this; None where there is none."""
        self._control = object()
        return self._before.pop() if self._before else None

    def last(self, present: Comparison) -> str:
        """The last change in words; empty where there is none."""
        return changed(self._before[-1], present) if self._before else ""


def changed(before: Comparison, after: Comparison) -> str:
    """What differs between two comparisons of the same setting, in words; empty where nothing does."""
    shared = [name for name in FIELDS if name != before.by]
    parts = [_words(name, getattr(before.shared, name), getattr(after.shared, name)) for name in shared]
    for i, pair in enumerate(zip(before.values, after.values, strict=False)):
        parts.append(_words(before.by, *pair, f" ({after.place(i)})"))
    parts = [part for part in parts if part]
    return "; ".join(parts[:2]) + (f" and {len(parts) - 2} more" if len(parts) > 2 else "")


def _words(name: str, old: object, new: object, where: str = "") -> str:
    field = FIELDS[name]
    return f"{field.label}{where}: {value_text(field, old)} → {value_text(field, new)}" if old != new else ""
