"""The table of settings in docs/settings.md, written from the definition of the settings.

    uv run python -m sim.docs

writes it anew; a test fails while the file and the definition differ.
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

from sim.settings import FIELDS, Field

SETTINGS_PAGE = Path(__file__).resolve().parent.parent / "docs" / "settings.md"

HEAD = """# Settings

Every setting of a simulation, as the page, the command line (`--set name=value`), scene files (`[settings]`)
and Python (`sim.Simulation(scene, name=value)`, `world.update(name=value)`) know it. A value outside the
allowed range is refused with one line that says what is allowed.

This page is written by `uv run python -m sim.docs` from `sim/settings.py`; edit that.
"""


def settings_page() -> str:
    """The whole text of docs/settings.md."""
    groups = groupby(FIELDS.values(), key=lambda field: field.group)
    return "\n".join([HEAD, *(_group(name, list(fields)) for name, fields in groups)])


def _group(name: str, fields: list[Field]) -> str:
    rows = ["| name | unit | default | allowed | what it does |", "|---|---|---|---|---|"]
    return "\n".join([f"## {name}", "", *rows, *map(_row, fields), ""])


def _row(field: Field) -> str:
    words = [field.description]
    if field.formula:
        words.append(f"`{field.formula}`")
    if field.choices is not None:
        words += [f"`{value}`: {meaning}." for value, meaning in field.choices().items() if meaning]
    if field.cost:
        words.append(f"Cost: {field.cost}.")
    cells = [f"`{field.name}`", field.unit or "–", _value(field.default), field.allowed, " ".join(words)]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(map(_value, value)) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    SETTINGS_PAGE.parent.mkdir(exist_ok=True)
    SETTINGS_PAGE.write_text(settings_page(), encoding="utf-8")
