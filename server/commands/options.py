"""What several commands ask for in the same words, and what their texts mean.

A group of options is written once, here. A command has it as an `Inline` field after its own, and so the
help has them in that order.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from server.commands.speech import complain
from sim.scene import Scene, read_scene

T = TypeVar("T")
Texts = tuple[str, ...]
SceneName = Annotated[str, Positional, arg(metavar="SCENE")]
SceneOrSchema = Annotated[
    str, Positional, arg(metavar="SCENE", help_behavior_hint="(required, but for --schema)")
]
Overrides = Annotated[UseAppendAction[tuple[Texts, ...]], arg(name="set", metavar="NAME=VALUE ...")]
Inline = Annotated[T, OmitArgPrefixes, arg(name="")]


@dataclass(kw_only=True)
class Files:
    """What to write besides the tables that are printed."""

    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write all numbers as JSON."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write a page that needs no network."""


@dataclass(kw_only=True)
class FilesAndPlots(Files):
    """The same, and plots."""

    plots: Annotated[str | None, arg(metavar="DIR")] = None
    """Write each plot as PNG and SVG into a folder."""


@dataclass(kw_only=True)
class Workers:
    """Who computes what is not timed."""

    jobs: int = 0
    """Processes for runs that are not timed; as many as there are cores if 0."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A Dask scheduler for these instead, such as tcp://10.0.0.1:8786; needs the extra `cluster`."""

    @property
    def asked(self) -> dict[str, Any]:
        """As studies take it."""
        return {"jobs": self.jobs or None, "cluster": self.cluster}


def parse_settings(texts: list[str]) -> dict[str, object]:
    """Settings by name from texts `name=value`; ValueError names the setting and what is allowed."""
    from sim.settings import parse

    settings: dict[str, object] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise ValueError(f"--set: expected name=value, got {text!r}")
        settings[name.strip()] = parse(name.strip(), value.strip())
    return settings


def parse_values(text: str) -> tuple[str, list[object]]:
    """A setting and its values from a text `name=a,b,c`; ValueError names the setting and what is allowed.

    Between vectors stand semicolons: gravity=0,0,-9.81;0,0,-1.62.
    """
    from sim.settings import FIELDS, parse

    name, equals, values = (part.strip() for part in text.partition("="))
    if not equals or not values:
        raise ValueError(f"--by: expected name=a,b,c, got {text!r}")
    between = ";" if name in FIELDS and FIELDS[name].type == "vector" else ","
    return name, [parse(name, value.strip()) for value in values.split(between)]


def scene_and_settings(name: str, overrides: tuple[Texts, ...]) -> tuple[Scene, dict[str, object]]:
    """The scene that a study is about, and the settings that differ from its own; says what was mended."""
    if not name:
        raise ValueError("SCENE: expected a scene file, or one of `muslin scenes`, got none")
    from sim.mesh import build_mesh

    scene, settings = read_scene(name), parse_settings([text for texts in overrides for text in texts])
    for warning in build_mesh(scene).warnings:
        complain(warning)
    return scene, settings


def command_of(name: str, scene: str, overrides: tuple[Texts, ...], **options: object) -> str:
    """What to type for the same measurement again."""
    words = ["muslin", name, scene]
    for option, value in options.items():
        words += [f"--{option}"] if value is True else [f"--{option}", f"{value}"] if value else []
    settings = [text for texts in overrides for text in texts]
    return shlex.join([*words, *(["--set", *settings] if settings else [])])
