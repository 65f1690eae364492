"""`muslin cost`, `compare`, `audit` and `study`: what a scene shows in numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from server.commands.options import (
    Files,
    FilesAndPlots,
    Inline,
    Overrides,
    SceneOrSchema,
    Workers,
    command_of,
    parse_values,
    scene_and_settings,
)

if TYPE_CHECKING:
    from server.pages import Report

Progress = Callable[[float, str], None]


@dataclass(kw_only=True)
class Cost:
    """Measure what accuracy costs on a scene: error against time for many settings, and which to take."""

    scene: SceneOrSchema = ""
    """A scene file, or one of `muslin scenes`."""
    seconds: float = 1.0
    """Time to simulate [s]; positions are compared for as long as that means something."""
    overrides: Overrides = ()
    """Settings that differ from the scene's; together they are the chosen ones."""
    target: float = 0.01
    """Relative error that the recommendation is for."""
    quick: bool = False
    """Fewer runs: a minute or two."""
    full: bool = False
    """All integrators, finer steps, more repeats: as long as it takes."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""
    files: Inline[FilesAndPlots] = field(default_factory=FilesAndPlots)
    workers: Inline[Workers] = field(default_factory=Workers)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema

        if self.schema:
            return print_schema("cost")
        if self.quick and self.full:
            raise ValueError("--quick: expected one of --quick and --full, got both")
        scene, overrides = scene_and_settings(self.scene, self.overrides)

        def measure(progress):
            from sim.studies.cost.plan import FULL, QUICK, USUAL
            from sim.studies.cost.study import cost

            effort = QUICK if self.quick else FULL if self.full else USUAL
            about = overrides, self.seconds, effort, self.target, progress
            return cost(scene, *about, **self.workers.asked)

        return _measured(self, measure, target=self.target, quick=self.quick, full=self.full)


@dataclass(kw_only=True)
class Compare:
    """Run a scene under several values of one setting, and say what each costs and how wrong it is."""

    scene: SceneOrSchema = ""
    """A scene file, or one of `muslin scenes`."""
    by: Annotated[str, arg(metavar="NAME=A,B,C", help_behavior_hint="(of the scene)")] = ""
    """The setting and its values, such as contact=penalty,impulse; what the scene compares if left out."""
    seconds: float = 1.0
    """Time to simulate [s]; errors are told for as long as that means something."""
    overrides: Overrides = ()
    """Other settings that differ from the scene's."""
    repeats: int = 3
    """Timed runs of each value."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""
    files: Inline[FilesAndPlots] = field(default_factory=FilesAndPlots)
    workers: Inline[Workers] = field(default_factory=Workers)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema

        if self.schema:
            return print_schema("compare")
        scene, overrides = scene_and_settings(self.scene, self.overrides)
        name, values = parse_values(self.by) if self.by else (scene.compare.by, list(scene.compare.values))

        def measure(progress):
            from sim.studies.cost.compare import compare

            about = overrides, self.seconds, self.repeats, progress
            return compare(scene, name, values, *about, **self.workers.asked)

        by = self.by or f"{name}={','.join(map(str, values))}"
        return _measured(self, measure, by=by, repeats=self.repeats)


@dataclass(kw_only=True)
class Audit:
    """Leave out each effect of a scene in turn: which it needs, what each one costs and changes."""

    scene: SceneOrSchema = ""
    """A scene file, or one of `muslin scenes`."""
    seconds: float | None = None
    """Time to simulate [s]; unless given, 1, or until moving obstacles have gone their ways, at most 5."""
    overrides: Overrides = ()
    """Settings that differ from the scene's."""
    tolerance: float = 0.01
    """How far all that is left out may move the cloth, as part of its diagonal."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""
    files: Inline[Files] = field(default_factory=Files)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema

        if self.schema:
            return print_schema("audit")
        scene, overrides = scene_and_settings(self.scene, self.overrides)

        def measure(progress):
            from sim.studies.audit import audit

            return audit(scene, overrides, self.seconds, self.tolerance, progress)

        return _measured(self, measure, tolerance=self.tolerance)


def _measured(asked: Cost | Compare | Audit, measure: Callable[[Progress], Report], **options: object) -> int:
    """Measure what is asked for, print it and write its files; `options` are those besides the time."""
    from server.cost import run_study

    name, options = type(asked).__name__.lower(), {"seconds": asked.seconds, **options}
    command = command_of(name, asked.scene, asked.overrides, **options)
    return run_study(measure, command, **vars(asked.files))


@dataclass(kw_only=True)
class Study:
    """Run a study: what a scene shows, measured; without a name, list them."""

    study: Annotated[str, Positional, arg(metavar="STUDY", help_behavior_hint="(optional)")] = ""
    """One of `muslin study`."""
    files: Inline[Files] = field(default_factory=Files)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.study import list_studies, run_study

        if self.study:
            return run_study(self.study, self.files.json, self.files.html)
        if self.files.json is not None or self.files.html is not None:
            raise ValueError("STUDY: expected the name of a study to write, got none")
        return list_studies()
