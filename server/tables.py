"""The tables of the right dock, as HTML: numbers, energies and effects of every variant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from server import style
from server.digits import written
from server.labels import ON_PURPOSE, effects, error_text, is_unstable, what_is_wrong
from server.meter import Meter
from server.palette import VARIANTS
from sim.effects import EFFECTS

NOTHING = 1e-12
"""Energy [J] that rounding alone makes."""

RULED = ("at the start", "= now", "|P| [kg m/s]")
"""Rows with a line above them."""

COLUMNS = {
    "ms": "Milliseconds per step.",
    "× real": "Simulated time per time that steps take: below 1 it cannot keep up by itself.",
    "error": "Local error of a frame, as part of the cloth's size.",
    "inside": "Vertices inside an obstacle that has an inside.",
    "cross": "Edges of cloth and of mesh obstacles that go through triangles.",
}
"""Of the table of variants, and what they mean."""

IDLE = ("off", "skipped")
"""How what a step says of an effect begins that did nothing."""

ENTRIES = {
    "kinetic": "Of motion.",
    "gravity": "Of height, from the origin.",
    "at the start": "All energy when the books were opened.",
    "+ settings": "Put in by changes of settings.",
    "+ wind": "Work of the air.",
    "+ obstacles": "Put in by obstacles that move.",
    "− damping": "Taken by the damping of the springs, which γ sets.",
    "− friction": "Taken by friction.",
    "− contact": "Taken by impacts.",
    "− strain limiting": "Taken where edges were kept from being too long.",
    "− linearisation": "Taken, or put in, as steps take forces for linear; more Newton iterations lessen it.",
    "− integrator": "Taken, or put in, by the time step itself; shorter steps lessen it.",
    "+ switched springs": "Put in as springs began or ceased to act.",
    "+ wrong springs": "Put in by springs that are wrong on purpose.",
    "− sleep": "Of motion, when cloth fell asleep.",
    "= now": "All energy now.",
    "residual": "What does not add up, of all energy that changed its kind.",
    "|P| [kg m/s]": "Size of the linear momentum.",
    "|L| [kg m²/s]": "Size of the angular momentum about the origin.",
}
"""What rows of the table of sums mean; the others are energies of springs."""

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
        cells = [
            number(meter.ms["total"] if meter.ms else None),
            style.UNKNOWN if (factor := real_time(meter)) is None else written(factor, 2),
            f"{error_text(meter.reading)} {meter.reading.trend}".rstrip(),
            trouble_text(meter.inside),
            trouble_text(meter.crossings),
        ]
        title = f"<td>{style.chip(VARIANTS[i])}{escape(name)}</td>"
        rows.append(f"<tr>{title}{''.join(f'<td>{c}</td>' for c in cells)}</tr>")
        if trouble := meter.latest.refused or meter.latest.note:
            rows.append(f'<tr><td colspan="6" class="bad">{escape(trouble)}</td></tr>')
        if wrong := what_is_wrong(meter.latest.settings):
            phrase = escape(f"{ON_PURPOSE}: {wrong}")
            rows.append(f'<tr><td colspan="6" class="small">{phrase}</td></tr>')
    columns = {escape(setting): "", **COLUMNS}
    head = "".join(f'<th title="{hint}">{column}</th>' for column, hint in columns.items())
    return f'<div class="muslin many"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def trouble_text(count: int | None) -> str:
    """How many are where they should not be: bold where some are."""
    if count is None:
        return style.UNKNOWN
    return f'<span class="bad">{count}</span>' if count else "0"


def threads_line(meters: Sequence[Meter]) -> str:
    """How many processor threads each variant's kernels use, and by which of Numba's layers they run."""
    settings = next((meter.latest.settings for meter in meters if meter.ms), None)
    if settings is None:
        return ""
    from sim.threads import LAUNCHED, threading_layer, threads_of

    count = threads_of(settings.threads)
    each = " each" if len(meters) > 1 else ""
    layer = f", Numba's {name} layer" if (name := threading_layer()) else ""
    return caption(f"{count} of {LAUNCHED} threads{each}{layer}")


def real_time(meter: Meter) -> float | None:
    """Simulated time per time that a variant's steps take: below 1 it cannot keep up by itself."""
    if not meter.ms or meter.dt is None:
        return None
    return 1e3 * meter.dt / max(meter.ms["total"], 1e-6)


def sums_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Every kind of energy [J] and the size of both momenta, a column for each variant."""
    many = len(meters) > 2
    digits = 3 if many else 4
    rows = energy_rows(meters, digits) + ledger_rows(meters, digits) + momentum_rows(meters, digits)
    if not rows:
        return ""
    head = "".join(f"<th>{style.chip(VARIANTS[i])}{escape(n)}</th>" for i, n in enumerate(names))
    lines = [
        f'<tr{look(title)}><td class="dim">{escape(title)}</td>{"".join(f"<td>{c}</td>" for c in cells)}</tr>'
        for title, cells in rows
    ]
    looks = "muslin many" if many else "muslin"
    return f'<div class="{looks}"><table><tr><th></th>{head}</tr>{"".join(lines)}</table></div>'


def look(title: str) -> str:
    """How a row looks, where what begins something new has a line above it, and what it says if asked."""
    rule = ' class="rule"' if title in RULED else ""
    return f'{rule} title="{ENTRIES.get(title, "Stored in springs of this kind.")}"'


def energy_rows(meters: Sequence[Meter], digits: int) -> list[tuple[str, list[str]]]:
    """A row for every kind of energy [J]: its name, and the variants' numbers."""
    energies = [meter.latest.energy for meter in meters]
    largest = max((abs(e) for energy in energies for e in energy.values()), default=0.0)
    floor = max(NOTHING, SLIGHT * largest)
    return [
        (kind, [energy_text(e[kind], floor, digits) if kind in e else style.UNKNOWN for e in energies])
        for kind in dict.fromkeys(kind for energy in energies for kind in energy)
    ]


def ledger_rows(meters: Sequence[Meter], digits: int) -> list[tuple[str, list[str]]]:
    """What went where since the start [J]: each entry that any variant has, and what does not add up."""
    ledgers = [meter.latest.ledger for meter in meters]
    known = [ledger for ledger in ledgers if ledger is not None]
    if not known:
        return []
    floor = max(NOTHING, SLIGHT * max(ledger.turnover for ledger in known))

    def row(title: str, value: Callable[[Any], float], always: bool = False) -> list[tuple[str, list[str]]]:
        cells = [style.UNKNOWN if one is None else energy_text(value(one), floor, digits) for one in ledgers]
        return [(title, cells)] if always or any(cell not in ("0", style.UNKNOWN) for cell in cells) else []

    rows = row("at the start", lambda ledger: ledger.start, always=True)
    for sign, part in (("+", "injected"), ("−", "dissipated")):
        for name in getattr(known[0], part):
            rows += row(f"{sign} {name}", lambda ledger, part=part, name=name: getattr(ledger, part)[name])
    rows += row("= now", lambda ledger: sum(ledger.energy.values()), always=True)
    rows.append(("residual", [style.UNKNOWN if one is None else residual_text(one) for one in ledgers]))
    return rows


def residual_text(ledger: Any) -> str:
    """What does not add up, as a part of all energy that changed its kind."""
    part = abs(ledger.residual) / ledger.turnover if ledger.turnover > NOTHING else 0.0
    return f"{written(100.0 * part, 1)} %"


def momentum_rows(meters: Sequence[Meter], digits: int) -> list[tuple[str, list[str]]]:
    """The same for the sizes of linear and angular momentum; none before there is a simulation.

    What rounding alone makes is shown: that it is no more than that is what there is to be seen.
    """
    momenta = [meter.latest.momentum for meter in meters]
    if all(momentum is None for momentum in momenta):
        return []
    return [
        (
            title,
            [style.UNKNOWN if m is None else written(float(np.linalg.norm(m[k])), digits) for m in momenta],
        )
        for k, title in enumerate(("|P| [kg m/s]", "|L| [kg m²/s]"))
    ]


def energy_text(energy: float, floor: float, digits: int) -> str:
    """An energy [J], or 0 where it is smaller than what means anything."""
    return "0" if abs(energy) < floor else written(energy, digits)


def effects_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Which effects ran in each variant, and why not, where they did not."""
    parts = []
    for i, (name, meter) in enumerate(zip(names, meters, strict=True)):
        costs, total = effect_costs(meter)
        rows = "".join(effect_row(k, v, costs.get(k), total) for k, v in effects(meter).items())
        parts.append(
            f"<h1>{style.chip(VARIANTS[i])}{escape(name)}</h1><table>{rows or style.UNKNOWN}</table>"
        )
    return f'<div class="muslin effects">{"".join(parts)}</div>'


def effect_costs(meter: Meter) -> tuple[Mapping[str, float], float]:
    """Milliseconds of the newest step by effect, and of all of it; none before there is one."""
    report = meter.latest.report
    total = getattr(report, "ms", None) or {}
    return getattr(report, "costs", None) or {}, total.get("total", 0.0)


def effect_row(name: str, word: str, cost: float | None = None, total: float = 0.0) -> str:
    """What a step says about one effect, and its part of the step's milliseconds; an unstable one is bad."""
    look, bar = "bad" if is_unstable(word) else "dim" if word.startswith(IDLE) else "", ""
    if cost is not None and total > 0.0:
        part = min(100.0 * cost / total, 100.0)
        looks = f"border-left:{part:.1f}px solid currentColor;height:.5em;display:inline-block"
        hint = f"{part:.0f} % of the step, without what it adds to the work of the solver"
        bar = f'<div style="{looks}" title="{hint}"></div> {cost:.2f} ms'
    does = EFFECTS[name].changes if name in EFFECTS else ""
    title, words = escape(name.replace("_", " ")), escape(word.replace("_", " "))
    return f'<tr class="{look}" title="{escape(does)}"><td>{title}</td><td>{bar}</td><td>{words}</td></tr>'
