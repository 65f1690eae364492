"""Studies without a page: run one, print its tables, and write them as JSON or as a page of their own."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Printed

import sim
from sim.studies import STUDIES, Cell, Result, Table

WIDTH = 120
"""Characters of a line where no terminal says how many it has."""

OPEN: dict[str, Any] = {"box": SIMPLE_HEAD, "pad_edge": False, "collapse_padding": True}
"""The look of a table without lines between its columns."""

HTML = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="UTF-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>{{stylesheet}} body {{{{ color: {{foreground}}; background: {{background}}; margin: 2em; }}}}</style>
</head>
<body><pre style="font-family: Menlo, 'DejaVu Sans Mono', Consolas, monospace">{{code}}</pre></body>
</html>
"""
"""A page that needs nothing but itself, as rich fills it in."""


def list_studies() -> int:
    """Print what there is and return the exit code."""
    table = Printed("study", "what it measures", "scene")
    for name, study in STUDIES.items():
        table.add_row(name, study.summary, study.scene)
    Console(width=None if sys.stdout.isatty() else WIDTH).print(table)
    return 0


def run_study(name: str, json: str | None = None, html: str | None = None) -> int:
    """Run a study, print its tables and notes, and write them to the files that are given.

    Returns:
        The exit code.

    Raises:
        ValueError, OSError: before anything is computed, for a call that makes no sense; ValueError also for
            a study whose simulation failed.
    """
    _check(name, json, html)
    result = _run(name)
    show(result)
    write(result, {"study": name}, json, html)
    return 0


def show(result: Result) -> None:
    """Print a result."""
    _print(result, Console(width=None if sys.stdout.isatty() else WIDTH, markup=False, highlight=False))


def write(result: Result, about: dict[str, object], json: str | None, html: str | None) -> None:
    """Write a result to the files that are given; the JSON begins with what it is `about`."""
    from sim.export import save_json, write_whole

    if json is not None:
        save_json(json, as_json(result, about))
    if html is not None:
        page = as_html(result).encode()
        write_whole(html, lambda stream: stream.write(page))


def _check(name: str, json: str | None, html: str | None) -> None:
    if name not in STUDIES:
        raise ValueError(f"{name}: no such study; expected one of {', '.join(STUDIES)}")
    from sim.export import check_outputs

    check_outputs(json=json, html=html)


def _run(name: str) -> Result:
    """The study's result; a terminal is told how far it is."""
    with Console(stderr=True).status("getting kernels ready (the first run compiles them)") as status:
        try:
            return STUDIES[name].run(lambda done, what: status.update(f"{done:.0%}  {what}"))
        except (sim.EquilibriumError, sim.StepError) as error:
            raise ValueError(f"{name}: {error}") from None


def as_json(result: Result, about: dict[str, object]) -> dict[str, object]:
    """The result as plain data, after what it is `about`; cells keep all digits, not finite ones are null."""
    tables = [
        {
            "caption": table.caption,
            "columns": list(table.columns),
            "rows": [[_finite(cell) for cell in row] for row in table.rows],
        }
        for table in result.tables
    ]
    return {
        **about,
        "title": result.title,
        "tables": tables,
        "notes": list(result.notes),
        "version": sim.__version__,
    }


def as_html(result: Result) -> str:
    """The result as a page of its own."""
    console = Console(record=True, file=io.StringIO(), width=WIDTH, markup=False, highlight=False)
    _print(result, console)
    return console.export_html(code_format=HTML.format(title=result.title))


def _print(result: Result, console: Console) -> None:
    console.print(result.title, style="bold")
    for table in result.tables:
        console.print()
        console.print(table.caption, style="italic")
        console.print(_printed(table, console))
    for note in result.notes:
        console.print()
        console.print(note)


def _printed(table: Table, console: Console) -> Printed:
    """A table in which no word is cut: with no lines between columns if need be, else with several in one."""
    texts = [[heading, *(cell_text(row[k]) for row in table.rows)] for k, heading in enumerate(table.columns)]
    left = [any(isinstance(row[k], str) for row in table.rows) for k in range(len(texts))]
    count, gap = len(texts), 2
    if widths := _widths(texts, console.width - 3 * count - 1):
        return _laid_out(texts, left, widths, {})
    if widths := _widths(texts, console.width - gap * count - gap):
        return _laid_out(texts, left, widths, OPEN)
    for lines in range(2, count):
        folded = _folded(texts, left, lines)
        if widths := _widths(folded, console.width - gap * len(folded) - gap, breaks="\n"):
            return _laid_out(folded, [True] * len(folded), widths, {**OPEN, "leading": 1})
    return _laid_out(texts, left, [None] * count, OPEN)


def _laid_out(
    texts: Sequence[Sequence[str]], left: Sequence[bool], widths: Sequence[int | None], look: dict[str, Any]
) -> Printed:
    """The table of columns that are a heading and its cells each."""
    printed = Printed(**look)
    for (heading, *_), words, width in zip(texts, left, widths, strict=True):
        printed.add_column(heading, justify="left" if words else "right", width=width)
    for row in zip(*(column[1:] for column in texts), strict=True):
        printed.add_row(*row)
    return printed


def _folded(texts: Sequence[Sequence[str]], left: Sequence[bool], lines: int) -> list[list[str]]:
    """Columns that hold several each, one below the other: a row then takes so many lines."""
    fewer = math.ceil(len(texts) / lines)
    folded = []
    for k in range(fewer):
        stack = list(zip(texts[k::fewer], left[k::fewer], strict=True))
        width = max(len(text) for column, _ in stack for text in column)
        sides = [[text.ljust(width) if words else text.rjust(width) for text in c] for c, words in stack]
        sides += [[""] * len(texts[0])] * (lines - len(sides))
        folded.append(["\n".join(cells) for cells in zip(*sides, strict=True)])
    return folded


def _widths(texts: Sequence[Sequence[str]], room: int, breaks: str | None = None) -> list[int] | None:
    """Characters of each column, so that no word is cut, within `room` for all of them; None for too little.

    What is left goes to columns that need least to have all in one line. Words are what stands between
    `breaks`; by default, between blanks.
    """
    widths = [max(len(word) for text in column for word in [*text.split(breaks), " "]) for column in texts]
    spare = room - sum(widths)
    if spare < 0:
        return None
    more = [max(map(len, column)) - width for column, width in zip(texts, widths, strict=True)]
    for k in sorted(range(len(widths)), key=lambda k: more[k]):
        given = max(0, min(more[k], spare))
        widths[k] += given
        spare -= given
    return widths


def cell_text(cell: Cell) -> str:
    """A cell as people read it."""
    if cell is None:
        return "–"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return cell if isinstance(cell, str) else f"{cell:,}"


def _finite(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
