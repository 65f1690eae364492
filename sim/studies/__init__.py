"""The lessons as studies: each is a scene to watch, and a few tables of numbers that say what it shows.

A study is a module here, with `run(progress)` that returns a `Result`, and one line in the registry below.

This module imports no numba: listing and documenting studies must be quick.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import TypeVar

Cell = str | float | int | None
"""What a table holds; None where there is nothing to say, or nothing was found."""

Progress = Callable[[float, str], None]
"""Is told the part that is done, 0 to 1, and what is being done."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class Table:
    """Numbers under a caption.

    Attributes:
        caption: What they are, and of what.
        columns: Headings, with units.
        rows: One cell for each column.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def column(self, heading: str) -> tuple[Cell, ...]:
        """All cells under a heading."""
        place = self.columns.index(heading)
        return tuple(row[place] for row in self.rows)


@dataclass(frozen=True)
class Result:
    """What a study found.

    Attributes:
        title: Of the study.
        tables: Its numbers.
        notes: What they mean, a sentence or two each.
    """

    title: str
    tables: tuple[Table, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """What there is to know of a study before it runs.

    Attributes:
        module: Import path of the module with `run`.
        summary: One line for lists.
        scene: Name of the scene that shows the same on the page.
    """

    module: str
    summary: str
    scene: str

    def load(self) -> ModuleType:
        """The study's module, imported on first use."""
        return importlib.import_module(self.module)

    def run(self, progress: Progress | None = None) -> Result:
        """Run the study; what it cannot find is a cell without a number."""
        return self.load().run(progress)


STUDIES: dict[str, Study] = {
    "oscillator": Study("sim.studies.oscillator", "one spring against its closed form", "oscillator"),
    "ghost": Study("sim.studies.ghost", "bending rules that push and turn cloth out of nothing", "ghost"),
    "cantilever": Study("sim.studies.cantilever", "bending springs against the elastica", "cantilever"),
    "interference": Study(
        "sim.studies.interference", "what bending springs add to the stiffness in the plane", "interference"
    ),
    "lumping": Study("sim.studies.lumping", "constant against area mass: iterations and errors", "lumping"),
}


def watched(items: Sequence[Item], progress: Progress | None, words: Callable[[Item], str]) -> Iterator[Item]:
    """The items one by one; `progress` is told of each before it is its turn."""
    for i, item in enumerate(items):
        if progress is not None:
            progress(i / len(items), words(item))
        yield item
