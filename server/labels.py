"""What is said of each cloth: name, cost, local error, what is inside or crosses; or what is wrong."""

from __future__ import annotations

import textwrap

from server.comparison import value_text
from server.digits import written
from server.meter import Meter
from server.prober import Reading
from server.style import UNKNOWN
from sim.settings import FIELDS, Settings
from sim.springs import BENDING

WIDTH = 25
"""Characters of a line; four cloths side by side leave no room for more."""

ALARM_WIDTH = 22
"""The same of what is written larger."""

OLD = 5.0
"""Simulated time [s] after which a local error is said to be of an earlier moment."""

OFF = "off"
"""Said in the place of a read-out that is switched off."""

ON_PURPOSE = "wrong on purpose"
"""Said of a variant that shows a mistake."""

UNSTABLE = "unstable"
"""How an effect begins that cannot work with the present time step."""

TUNNELS = "may tunnel"
"""What contact says of itself after a step that may have let something through."""


def what_is_wrong(settings: Settings | None) -> str:
    """What is wrong, on purpose, with the spring kind of a variant; empty for the right ones."""
    kind = BENDING.get(settings.bend) if settings else None
    return getattr(kind, "wrong", "")


def wrong_on_purpose(settings: Settings | None) -> str:
    """That a variant shows a mistake; empty for those that do not."""
    return ON_PURPOSE if what_is_wrong(settings) else ""


def is_unstable(effect: object) -> bool:
    """Whether a step's word about one of its effects is that it was unstable."""
    return str(effect).startswith(UNSTABLE)


def may_tunnel(effect: object) -> bool:
    """Whether a step's word about one of its effects is that something may have gone through."""
    return TUNNELS in str(effect)


def likeliest(blamed: str, settings: Settings | None) -> str:
    """The setting most likely to blame and its value, in words; empty where none is named."""
    if blamed not in FIELDS or settings is None:
        return ""
    field = FIELDS[blamed]
    return f"{field.label} {value_text(field, getattr(settings, blamed))}"


def effects(meter: Meter) -> dict[str, str]:
    """Each effect of the newest step and whether it ran, or why not; none before the first."""
    return getattr(meter.latest.report, "effects", None) or {}


def label(
    name: str, meter: Meter, waiting: str = "", behind: float = 0.0, remark: str = ""
) -> tuple[str, bool]:
    """The text above a cloth, and whether it is an alarm.

    Args:
        name: Of the variant.
        meter: What was measured of it.
        waiting: What it waits for, if it is not ready.
        behind: Simulated time [s] that it lags behind the others after having been stopped.
        remark: What else is to be said of it.
    """
    alarm = bool(meter.latest.refused)
    ran = [] if alarm else effects(meter).values()  # of a step that was done
    remarks = [
        remark,
        wrong_on_purpose(meter.latest.settings),
        "▲ unstable step" if any(map(is_unstable, ran)) else "",
        "▲ may tunnel" if any(map(may_tunnel, ran)) else "",
    ]
    if alarm:
        why = textwrap.wrap(meter.latest.refused, ALARM_WIDTH, max_lines=3, placeholder=" …")
        suspected = likeliest(meter.latest.blamed, meter.latest.settings)
        lines = [f"▲ {name} stopped", *why, f"likeliest: {suspected}" if suspected else ""]
    elif waiting:
        lines = [name, waiting]
    else:
        late = f"{behind:.1f} s behind" if behind else ""
        lines = [name, measured(meter), late]
    width = ALARM_WIDTH if alarm else WIDTH
    said = "\n".join([*lines, *remarks]).split("\n")
    return "\n".join(short for line in said for short in textwrap.wrap(line, width)), alarm


def error_text(reading: Reading) -> str:
    """A local error in percent; where it is not known to a tenth, what it is about, at least, or at most."""
    found = reading.found
    if reading.off:
        return OFF
    if found is None:
        return "measuring" if reading.measuring else f"{UNKNOWN} %"
    sign, error = "", found.error
    if not found.sure:
        sign, error = ("≥ ", found.least) if found.least > 0.0 else ("< ", found.most)
        if reading.quick and found.least > 0.0:
            sign, error = "≈ ", found.error
    return f"{sign}{written(100.0 * error, 2)} %"


def error_hint(reading: Reading) -> str:
    """What a local error is, and how it is known; why it is not, if so."""
    if reading.found is None:
        return "Switched off." if reading.off else reading.why_not or "Not measured yet."
    at = f"Of a frame from {reading.time:.2f} s, as part of the cloth's size"
    if reading.quick:
        quick = "about so much, beside a run with a quarter of the step. In a pause it is measured better."
        return f"{at}: {quick}"
    return f"{at}, beside a finer run that is known to a tenth of it, or has a sixteenth of the step."


def is_old(meter: Meter) -> bool:
    """Whether time has run on since the local error was measured, so that it is of another cloth by now."""
    return meter.reading.found is not None and abs(meter.latest.time - meter.reading.time) > OLD


def measured(meter: Meter) -> str:
    """Milliseconds per step and local error; below, its time if old, what is inside and what crosses."""
    ms = UNKNOWN if meter.ms is None else f"{meter.ms['total']:.1f}"
    what = "error " * meter.reading.off
    at = [f"% as of {meter.reading.time:.1f} s"] * is_old(meter)
    return "\n".join([f"{ms} ms · {what}{error_text(meter.reading)}", *at, *crossed(meter)])


def crossed(meter: Meter) -> list[str]:
    """Vertices in obstacles and edges through triangles, a line for each where there are some."""
    vertices = f"▲ {meter.inside} in obstacles" if meter.inside else ""
    if meter.is_off("crossings"):
        return list(filter(None, [vertices, f"crossings {OFF}"]))
    if meter.inside is None or meter.crossings is None:
        return [f"{UNKNOWN} crossings"]
    edges = f"▲ {meter.crossings} crossing{'s' * (meter.crossings != 1)}" if meter.crossings else ""
    return list(filter(None, [vertices, edges])) or ["nothing crosses"]
