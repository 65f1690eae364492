"""`muslin cost`, `compare` and `audit` without the lab: measure, print, and write JSON, a page and plots."""

from __future__ import annotations

import datetime
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
)
from rich.text import Text

from server.study import show
from sim.studies import Result

if TYPE_CHECKING:
    from server.figures import Figures
    from server.pages import Report

TOLD = 0.02
"""Part that must be done before anybody can say how long the rest takes."""


class Remaining(ProgressColumn):
    """How long the rest takes if it goes on as it went so far; more and more while nothing comes of it."""

    def render(self, task: Task) -> Text:
        """What a terminal shows."""
        done, elapsed = task.percentage / 100.0, task.elapsed or 0.0
        if done <= TOLD:
            return Text("")
        minutes, seconds = divmod(round(elapsed * (1.0 - done) / done), 60)
        return Text(f"{minutes}:{seconds:02} left", style="progress.remaining")


PLOTS = (".png", ".svg")
"""Files of each plot."""


def run_study(
    measure: Callable[[Callable[[float, str], None]], Report],
    command: str,
    json: str | None = None,
    html: str | None = None,
    plots: str | None = None,
) -> int:
    """Measure, print the tables, and write the files that are asked for.

    Args:
        measure: Makes the report, and tells how far it is.
        command: What to type for the same again.
        json: A file.
        html: A file.
        plots: A folder.

    Returns:
        The exit code.

    Raises:
        ValueError, OSError: before anything is measured, for files that cannot be written; ValueError also
            for what cannot be measured.
    """
    from sim.export import check_outputs

    check_outputs(json=json, html=html)
    _check_folder(plots)
    report = _measured(measure)
    report = msgspec.structs.replace(report, command=command, date=datetime.date.today().isoformat())
    from server import pages

    result = pages.result(report)
    _write(report, result, json, html, plots)
    show(result)
    return 0


def print_schema(study: str) -> int:
    """Print the JSON schema of what a study writes."""
    from sim.studies.cost.report import schema

    sys.stdout.write(json.dumps(schema(study), indent=2, ensure_ascii=False) + "\n")
    return 0


def _check_folder(plots: str | None) -> None:
    if plots is None:
        return
    if plots == "":
        raise ValueError("--plots: expected a folder, got an empty name")
    folder = Path(plots)
    if folder.exists() and not folder.is_dir():
        raise OSError(f"{plots}: cannot be written: it is not a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{plots}: cannot be written: {error.strerror}") from None


def _measured(measure: Callable[[Callable[[float, str], None]], Report]) -> Report:
    """What was found; a terminal is told how far it is, and how long it will take."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        Remaining(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("starting", total=1.0)
        return measure(lambda done, what: progress.update(task, completed=done, description=what))


def _write(report: Report, result: Result, json: str | None, html: str | None, plots: str | None) -> None:
    from server import pages
    from sim.export import save_json, write_whole

    if json is not None:
        save_json(json, msgspec.to_builtins(report))
    if html is None and plots is None:
        return
    figures = pages.figures(report)
    if html is not None:
        page = pages.page(report, result, figures).encode()
        write_whole(html, lambda stream: stream.write(page))
    if plots is not None:
        _write_plots(Path(plots), figures)


def _write_plots(folder: Path, figures: Figures) -> None:
    from server.figures import png, svg
    from sim.export import write_whole

    for name, (_, figure) in figures.items():
        for ending, draw in zip(PLOTS, (png, svg), strict=True):
            picture = draw(figure)
            write_whole(folder / f"{name}{ending}", lambda stream, picture=picture: stream.write(picture))
