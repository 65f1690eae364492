"""The tables of the right dock, as HTML: numbers, energies and effects of every variant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from server import style
from server.digits import share_text, written
from server.labels import (
    OFF,
    ON_PURPOSE,
    effects,
    error_hint,
    error_text,
    is_old,
    is_unstable,
    what_is_wrong,
)
from server.meter import Meter
from server.palette import VARIANTS
from server.read_outs import ReadOut, read_outs
from sim.accounts import DISSIPATED, INJECTED, meaning
from sim.effects import cost, does, title

NOTHING = 1e-12
"""Energy [J] that rounding alone makes."""

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

BAR = 36.0
"""Length of the bar of an effect that takes the whole step [px]."""

SLIGHT = 1e-9
"""The same as a share of the largest energy beside it."""


def update(handle: Any, content: str) -> None:
    """Set HTML, unless it is the same already."""
    if handle.content != content:
        handle.content = content


def caption(text: str) -> str:
    """The line above a plot."""
    return f'<div class="muslin dim" style="padding-top:.5em">{escape(text)}</div>'


def color_key(names: Sequence[str], setting: str = "") -> str:
    """Which colour is which variant, by the values of a setting; nothing where there is one."""
    parts = (f"<span>{style.chip(VARIANTS[i])}{escape(name)}</span>" for i, name in enumerate(names))
    head = f"<span>{escape(setting)}</span>" if setting else ""
    return f'<div class="key">{head}{"".join(parts)}</div>' if len(names) > 1 else ""


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
            error_cell(meter),
            trouble_text(meter.inside),
            OFF if meter.is_off("crossings") else trouble_text(meter.crossings),
        ]
        first = f"<td>{style.chip(VARIANTS[i])}{escape(name)}</td>"
        rows.append(f"<tr>{first}{''.join(f'<td>{c}</td>' for c in cells)}</tr>")
        if trouble := meter.latest.refused or meter.latest.note:
            rows.append(f'<tr><td colspan="6" class="bad">{escape(trouble)}</td></tr>')
        if wrong := what_is_wrong(meter.latest.settings):
            phrase = escape(f"{ON_PURPOSE}: {wrong}")
            rows.append(f'<tr><td colspan="6" class="small">{phrase}</td></tr>')
    columns = {escape(setting): "", **COLUMNS}
    head = "".join(f'<th title="{hint}">{column}</th>' for column, hint in columns.items())
    return f'<div class="muslin many"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def error_cell(meter: Meter) -> str:
    """A local error with its trend, dim where it is old; pointed at, it says how it is known."""
    words = f"{error_text(meter.reading)} {meter.reading.trend}".rstrip()
    look = ' class="dim"' * is_old(meter)
    return f'<span{look} title="{escape(error_hint(meter.reading))}">{escape(words)}</span>'


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


class Row(NamedTuple):
    """A row of the table of sums.

    Attributes:
        title: What stands before the numbers.
        means: What that is, for those who point at it.
        cells: A number for each variant.
        ruled: Whether something new begins here, with a line above.
    """

    title: str
    means: str
    cells: list[str]
    ruled: bool = False

    def html(self) -> str:
        """As a row of HTML."""
        rule, cells = ' class="rule"' * self.ruled, "".join(f"<td>{cell}</td>" for cell in self.cells)
        return f'<tr{rule} title="{escape(self.means)}"><td class="dim">{escape(self.title)}</td>{cells}</tr>'


def sums_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Every kind of energy [J] and the size of both momenta, a column for each variant."""
    many = len(meters) > 2
    digits = 3 if many else 4
    rows = energy_rows(meters, digits) + ledger_rows(meters, digits) + momentum_rows(meters, digits)
    if not rows:
        return ""
    head = "".join(f"<th>{style.chip(VARIANTS[i])}{escape(n)}</th>" for i, n in enumerate(names))
    looks = "muslin many" if many else "muslin"
    lines = "".join(row.html() for row in rows)
    return f'<div class="{looks}"><table><tr><th></th>{head}</tr>{lines}</table></div>'


def energy_rows(meters: Sequence[Meter], digits: int) -> list[Row]:
    """A row for every kind of energy [J]: its name, and the variants' numbers."""
    energies = [meter.latest.energy for meter in meters]
    largest = max((abs(e) for energy in energies for e in energy.values()), default=0.0)
    floor = max(NOTHING, SLIGHT * largest)
    return [
        Row(
            kind,
            meaning(kind),
            [energy_text(e[kind], floor, digits) if kind in e else style.UNKNOWN for e in energies],
        )
        for kind in dict.fromkeys(kind for energy in energies for kind in energy)
    ]


def ledger_rows(meters: Sequence[Meter], digits: int) -> list[Row]:
    """What went where since the start [J]: each entry that any variant has, and what does not add up."""
    ledgers = [meter.latest.ledger for meter in meters]
    known = [ledger for ledger in ledgers if ledger is not None]
    if any(meter.is_off("ledger") for meter in meters):  # in all of them: it is nothing to compare by
        return [Row("energy ledger", "Where energy went, entry by entry.", [OFF] * len(meters), True)]
    if not known:
        return []
    floor = max(NOTHING, SLIGHT * max(ledger.turnover for ledger in known))

    def cells(value: Callable[[Any], float]) -> list[str]:
        return [style.UNKNOWN if one is None else energy_text(value(one), floor, digits) for one in ledgers]

    rows = [Row("at the start", "All energy when the books were opened.", cells(lambda one: one.start), True)]
    for sign, part, entries in ("+", "injected", INJECTED), ("−", "dissipated", DISSIPATED):
        for name in getattr(known[0], part):
            flows = cells(lambda one, part=part, name=name: getattr(one, part)[name])
            if any(cell not in ("0", style.UNKNOWN) for cell in flows):
                rows.append(Row(f"{sign} {name}", entries[name], flows))
    now = cells(lambda one: sum(one.energy.values()))
    left = [style.UNKNOWN if one is None else residual_text(one) for one in ledgers]
    return [
        *rows,
        Row("= now", "All energy now.", now, True),
        Row("residual", "What does not add up, of all energy that changed its kind.", left),
    ]


def residual_text(ledger: Any) -> str:
    """What does not add up, as a part of all energy that changed its kind."""
    part = abs(ledger.residual) / ledger.turnover if ledger.turnover > NOTHING else 0.0
    return f"{written(100.0 * part, 1)} %"


def momentum_rows(meters: Sequence[Meter], digits: int) -> list[Row]:
    """The same for the sizes of linear and angular momentum; none before there is a simulation.

    What rounding alone makes is shown: that it is no more than that is what there is to be seen.
    """
    momenta = [meter.latest.momentum for meter in meters]
    if all(momentum is None for momentum in momenta):
        return []

    def cells(k: int) -> list[str]:
        sizes = [None if m is None else float(np.linalg.norm(m[k])) for m in momenta]
        return [style.UNKNOWN if size is None else written(size, digits) for size in sizes]

    return [
        Row("|P| [kg m/s]", "Size of the linear momentum.", cells(0), True),
        Row("|L| [kg m²/s]", "Size of the angular momentum about the origin.", cells(1)),
    ]


def energy_text(energy: float, floor: float, digits: int) -> str:
    """An energy [J], or 0 where it is smaller than what means anything."""
    return "0" if abs(energy) < floor else written(energy, digits)


def effects_table(names: Sequence[str], meters: Sequence[Meter]) -> str:
    """Which effects ran in each variant and what they took of the newest step, or why they did not run."""
    parts = []
    for i, (name, meter) in enumerate(zip(names, meters, strict=True)):
        beside = read_outs(meter)
        said = ((*pair, meter.latest.report, beside.get(pair[0])) for pair in effects(meter).items())
        rows = "".join(effect_row(*about) for about in said)
        parts.append(
            f"<h1>{style.chip(VARIANTS[i])}{escape(name)}</h1><table>{rows or style.UNKNOWN}</table>"
        )
    return f'<div class="muslin effects">{"".join(parts)}</div>'


def effect_row(name: str, word: str, report: Any, beside: ReadOut | None = None) -> str:
    """What a step, or who reads out beside it, says about an effect, and its part of the step's time.

    An unstable one is bad.
    """
    total = report.ms.get("total", 0.0)
    word, took = (beside.words, beside.cost(name, report)) if beside else (word, cost(name, word, report))
    look = "bad" if is_unstable(word) else "dim" if word.startswith(IDLE) else ""
    share = share_text(took, total)
    part = escape(share)
    if took.ms and total > 0.0:
        wide = BAR * min(took.ms / total, 1.0) * (not took.most)
        looks = f"border-left:{wide:.1f}px solid currentColor;height:.5em;display:inline-block"
        part = f'<div style="{looks}"></div> {part}<br>{"&lt; " * took.most}{written(took.ms, 2)} ms'
    hint = took.why if took.ms is None else f"{share} of the step: {took.why}"
    called, words = escape(title(name)), escape(word.replace("_", " "))
    return (
        f'<tr class="{look}" title="{escape(does(name))}"><td>{called}</td>'
        f'<td title="{escape(hint)}">{part}</td><td>{words}</td></tr>'
    )
