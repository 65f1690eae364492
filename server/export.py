"""What brings the cloths of the page back elsewhere: tables for a scene file, and a command."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import tomli_w
from msgspec import to_builtins

from server.commands.options import command_of
from server.comparison import Comparison
from sim.scene import SCENES, Scene
from sim.settings import Settings, differing


def as_toml(comparison: Comparison) -> str:
    """The tables [settings] and [compare], which take the place of a scene's own and of its [effects]."""
    tables: dict[str, Any] = {"settings": differing(Settings(), comparison.shared)}
    if comparison.by:
        tables["compare"] = {"by": comparison.by, "values": comparison.values}
        if fails := [value for value in comparison.values if value in comparison.fails]:
            tables["compare"]["fails"] = fails
    return tomli_w.dumps(to_builtins(tables))


def as_command(scene: Scene, comparison: Comparison) -> str:
    """What to type for the same cloths without the page."""
    file = Path(scene.source)
    called = file.stem if file.parent == SCENES else scene.source
    changed = differing(scene.settings, comparison.shared)
    changed.pop(comparison.by, None)
    texts = tuple(f"{name}={_typed(value)}" for name, value in changed.items())
    if not comparison.by:
        return command_of("run", called, (texts,))
    by = f"{comparison.by}={','.join(map(_typed, comparison.values))}"
    return command_of("compare", called, (texts,), by=by)


def _typed(value: Any) -> str:
    """A value as a command line takes it."""
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def as_html(scene: Scene, comparison: Comparison) -> str:
    """Both, each to be marked whole by one click, for the clipboard."""
    toml, command = escape(as_toml(comparison)), escape(as_command(scene, comparison))
    return (
        '<div class="muslin export"><p>For a scene file, in place of its [settings], [compare] and [effects] '
        f"(a click marks all of it):</p><pre>{toml}</pre>"
        f"<p>Without the page:</p><pre>{command}</pre></div>"
    )
