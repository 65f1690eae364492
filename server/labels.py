"""What stands above each cloth: name, milliseconds per step, vertices inside; or why it stands still."""

from __future__ import annotations

import textwrap

from server.meter import Meter
from server.style import UNKNOWN

WIDTH = 34
"""Characters of a line; two cloths side by side leave no room for more."""


def label(name: str, meter: Meter, waiting: str = "", behind: float = 0.0) -> tuple[str, bool]:
    """The text above a cloth, and whether it is an alarm.

    Args:
        name: Of the variant.
        meter: What was measured of it.
        waiting: What it waits for, if it is not ready.
        behind: Simulated time [s] that it lags behind the others after having been stopped.
    """
    if meter.latest.refused:
        return "\n".join([f"▲ {name} stopped", *textwrap.wrap(meter.latest.refused, WIDTH)[:4]]), True
    if waiting:
        return f"{name}\n{waiting}", False
    ms = UNKNOWN if meter.ms is None else f"{meter.ms['total']:.1f}"
    inside = UNKNOWN if meter.inside is None else str(meter.inside)
    mark = "▲ " if meter.inside else ""
    late = f"\n{behind:.1f} s behind" if behind else ""
    return f"{name}\n{ms} ms · {mark}{inside} inside{late}", False
