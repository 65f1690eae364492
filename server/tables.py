"""The tables of the right dock, as HTML: numbers, energies and effects of every variant."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from server import style
from server.digits import written
from server.meter import Meter
from server.palette import VARIANTS

NOTHING = 1e-12
"""Energy [J] that rounding alone makes."""

SLIGHT = 1e-9
"""The same as a share of the largest energy beside it."""


def update(handle: Any, content: str) -> None:
    """Set HTML, unless it is the same already."""
    if handle.content != content:
        handle.content = content


def caption(text: str) -> str:
    """The line above a plot."""
    return f'<div class="muslin dim" style="padding-top:.5em">{escape(text)}</div>'


def number(value: float | None, digits: int = 1) -> str:
    """A measured number, or the sign for one that is not."""
    return style.UNKNOWN if value is None else f"{value:.{digits}f}"


def variant_table(setting: str, names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Name, cost, work and trouble of each variant; what is bad is bold."""
    rows = []
    for i, (name, meter) in enumerate(zip(names, meters, strict=True)):
        report = meter.latest.report
        cells = [
            number(meter.ms["total"] if meter.ms else None),
            style.UNKNOWN if report is None else str(report.iterations),
            style.UNKNOWN if report is None else str(report.contacts),
            style.UNKNOWN
            if meter.inside is None
            else f'<span class="{"bad" if meter.inside else ""}">{meter.inside}</span>',
        ]
        title = f"<td>{style.chip(VARIANTS[i])}{escape(name)}</td>"
        rows.append(f"<tr>{title}{''.join(f'<td>{c}</td>' for c in cells)}</tr>")
        if trouble := meter.latest.refused or meter.latest.note:
            rows.append(f'<tr><td colspan="5" class="bad">{escape(trouble)}</td></tr>')
    head = "".join(f"<th>{h}</th>" for h in (escape(setting), "ms/step", "iterations", "contacts", "inside"))
    return f'<div class="muslin"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def energy_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Every kind of energy, a column for each variant."""
    kinds = dict.fromkeys(k for m in meters for k in m.latest.energy)
    head = "".join(f"<th>{style.chip(VARIANTS[i])}{escape(n)}</th>" for i, n in enumerate(names))
    largest = max((abs(e) for m in meters for e in m.latest.energy.values()), default=0.0)
    floor = max(NOTHING, SLIGHT * largest)
    rows = []
    for kind in kinds:
        cells = "".join(
            f"<td>{energy_text(m.latest.energy[kind], floor)}</td>"
            if kind in m.latest.energy
            else f"<td>{style.UNKNOWN}</td>"
            for m in meters
        )
        rows.append(f'<tr><td class="dim">{escape(kind)}</td>{cells}</tr>')
    return f'<div class="muslin"><table><tr><th></th>{head}</tr>{"".join(rows)}</table></div>' if rows else ""


def energy_text(energy: float, floor: float) -> str:
    """An energy [J], or 0 where it is smaller than what means anything."""
    return "0" if abs(energy) < floor else written(energy)


def effects_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Which effects ran in each variant, and why not, where they did not."""
    parts = []
    for i, (name, meter) in enumerate(zip(names, meters, strict=True)):
        report = meter.latest.report
        effects = getattr(report, "effects", None) or {}
        rows = "".join(
            f"<tr><td>{escape(str(k))}</td><td>{escape(str(v))}</td></tr>" for k, v in effects.items()
        )
        parts.append(
            f"<h1>{style.chip(VARIANTS[i])}{escape(name)}</h1><table>{rows or style.UNKNOWN}</table>"
        )
    return f'<div class="muslin">{"".join(parts)}</div>'
