"""The `muslin` command: the lab in a browser, and headless runs and checks of scenes.

Heavy packages (numba, trimesh, viser) are imported by the commands that need them, so that help, checks and
lists answer at once. What goes wrong is one line on standard error and a non-zero exit code.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import sys
from dataclasses import dataclass
from typing import Annotated

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

import sim
from sim.bench import SECONDS, SIZES, STEPS
from sim.scene import SceneError, load_scene, scene_files

Texts = tuple[str, ...]
SceneName = Annotated[str, Positional, arg(metavar="SCENE")]


@dataclass(kw_only=True)
class Lab:
    """Open the lab in a browser; this is what `muslin` without a command does."""

    scene: Annotated[str, arg(metavar="SCENE")] = "drape"
    """Scene to begin with: a file, or one of `muslin scenes`."""
    port: int = 8080
    """Where to serve the page; the next free port if this one is taken."""
    host: str = "127.0.0.1"
    """Address to listen on; beyond this computer, whoever has the printed address and its token."""
    view_only: bool = False
    """Others watch: only the first printed address moves the controls."""
    no_browser: bool = False
    """Only serve the page."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        if not 0 <= self.port <= 65535:
            raise ValueError(f"--port: expected 0 to 65535, got {self.port}")
        load_scene(self.scene)
        from server.launch import run_lab

        run_lab(self.scene, self.host, self.port, not self.no_browser, self.view_only)
        return 0


@dataclass(kw_only=True)
class Run:
    """Run a scene without a page and say what it cost."""

    scene: SceneName
    """A scene file, or one of `muslin scenes`."""
    seconds: float = 2.0
    """Time to simulate [s]."""
    overrides: Annotated[UseAppendAction[tuple[Texts, ...]], arg(name="set", metavar="NAME=VALUE ...")] = ()
    """Settings that differ from the scene's, such as gamma=0.5."""
    out: Annotated[str | None, arg(metavar="FILE.npz")] = None
    """Record the positions of every frame."""
    fps: float = 60.0
    """Frames per simulated second in the recording; never more than steps."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write the table's numbers as JSON."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.headless import run

        overrides = parse_settings([text for texts in self.overrides for text in texts])
        return run(load_scene(self.scene), overrides, self.seconds, self.fps, self.out, self.json)


@dataclass(kw_only=True)
class Check:
    """Check scenes, build their cloth and say what looks like a mistake."""

    scenes: Annotated[Texts, Positional, arg(metavar="SCENE ...")] = ()
    """Scene files; all that come with Muslin if none is given."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from sim.check import check_scene

        failures = 0
        for name in self.scenes or map(str, scene_files()):
            try:
                mesh, warnings = check_scene(load_scene(name))
            except SceneError as error:
                failures += 1
                _complain(error)
                continue
            for warning in warnings:
                _say(f"{name}: {warning}")
            counts = f"{len(mesh.vertices):,} vertices, {len(mesh.triangles):,} triangles"
            warned = f", {len(warnings)} warning{'s' * (len(warnings) > 1)}" if warnings else ""
            _say(f"{name}: fine: {counts}, {len(mesh.pinned):,} pinned{warned}")
        return 1 if failures else 0


@dataclass(kw_only=True)
class Scenes:
    """List the scenes that come with Muslin."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from rich.console import Console
        from rich.table import Table

        table = Table("scene", "title", "vertices", "what to look for")
        table.columns[2].justify = "right"
        for path in scene_files():
            scene = load_scene(path)
            lesson = scene.lesson
            count = f"{n:,}" if (n := count_vertices(scene)) is not None else "–"
            table.add_row(path.stem, lesson.title if lesson else "", count, lesson.look_for if lesson else "")
        Console(width=None if sys.stdout.isatty() else 120).print(table)
        return 0


@dataclass(kw_only=True)
class Study:
    """Run a study: what a scene shows, measured; without a name, list them."""

    study: Annotated[str, Positional, arg(metavar="STUDY")] = ""
    """One of `muslin study`."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write the tables as JSON."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write what is printed as a page that needs no network."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.study import list_studies, run_study

        if self.study:
            return run_study(self.study, self.json, self.html)
        if self.json is not None or self.html is not None:
            raise ValueError("STUDY: expected the name of a study to write, got none")
        return list_studies()


@dataclass(kw_only=True)
class Bench:
    """Measure what a step costs and how exact it is, and what other simulators of cloth need for the same."""

    sizes: Annotated[tuple[int, ...], arg(metavar="VERTICES ...")] = SIZES
    """Vertices of the square sheets; square numbers."""
    threads: Annotated[tuple[int, ...], arg(metavar="THREADS ...")] = ()
    """Processor threads; 1, and 2 where there are as many cores, if none is given."""
    steps: int = STEPS
    """Steps of Muslin for each sheet."""
    seconds: float = SECONDS
    """Time for each case of a peer [s]; accuracies and Muslin's own steps get more."""
    peers: bool = False
    """Measure other simulators, too: those of the extra `peers` that are installed."""
    scenes: Annotated[tuple[str, ...], arg(metavar="SCENE ...")] = ()
    """In place of sheets, step these scenes with effects forced on, as they are, and as their audit would."""
    cold: bool = False
    """Of scenes, measure the cold start, too, each with all kernels compiled anew."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write the tables as JSON, with hardware and versions."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write what is printed as a page that needs no network."""
    markdown: Annotated[str | None, arg(metavar="FILE.md")] = None
    """Write the tables as Markdown, with hardware, versions, date and command."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.benchmark import run_bench, run_scenes

        files = {"json": self.json, "html": self.html, "markdown": self.markdown}
        if self.scenes:
            return run_scenes(self.scenes, self.steps, self.cold, **files)
        return run_bench(self.sizes, self.threads or None, self.steps, self.seconds, self.peers, **files)


@dataclass(kw_only=True)
class Cost:
    """Measure what accuracy costs on a scene: error against time for many settings, and which to take."""

    scene: Annotated[str, Positional, arg(metavar="SCENE")] = ""
    """A scene file, or one of `muslin scenes`."""
    seconds: float = 1.0
    """Time to simulate [s]; positions are compared for as long as that means something."""
    overrides: Annotated[UseAppendAction[tuple[Texts, ...]], arg(name="set", metavar="NAME=VALUE ...")] = ()
    """Settings that differ from the scene's; together they are the chosen ones."""
    target: float = 0.01
    """Relative error that the recommendation is for."""
    quick: bool = False
    """Fewer runs: about a minute."""
    full: bool = False
    """All integrators, finer steps, more repeats: as long as it takes."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write all numbers as JSON, with hardware and versions."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write a page with plots and tables that needs no network."""
    plots: Annotated[str | None, arg(metavar="DIR")] = None
    """Write each plot as PNG and SVG into a folder."""
    jobs: int = 0
    """Processes for runs that are not timed; as many as there are cores if 0."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A Dask scheduler for these instead, such as tcp://10.0.0.1:8786; needs the extra `cluster`."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema, run_study

        if self.schema:
            return print_schema("cost")
        if self.quick and self.full:
            raise ValueError("--quick: expected one of --quick and --full, got both")
        scene, overrides = _scene_and_settings(self.scene, self.overrides)

        def measure(progress):
            from sim.studies.cost.plan import FULL, QUICK, USUAL
            from sim.studies.cost.study import cost

            effort = QUICK if self.quick else FULL if self.full else USUAL
            about = overrides, self.seconds, effort, self.target, progress, self.jobs or None, self.cluster
            return cost(scene, *about)

        options = {"seconds": self.seconds, "target": self.target, "quick": self.quick, "full": self.full}
        command = _command("cost", self.scene, self.overrides, **options)
        return run_study(measure, command, self.json, self.html, self.plots)


@dataclass(kw_only=True)
class Compare:
    """Run a scene under several values of one setting, and say what each costs and how wrong it is."""

    scene: Annotated[str, Positional, arg(metavar="SCENE")] = ""
    """A scene file, or one of `muslin scenes`."""
    by: Annotated[str, arg(metavar="NAME=A,B,C")] = ""
    """The setting and its values, such as contact=penalty,impulse; what the scene compares if left out."""
    seconds: float = 1.0
    """Time to simulate [s]; errors are told for as long as that means something."""
    overrides: Annotated[UseAppendAction[tuple[Texts, ...]], arg(name="set", metavar="NAME=VALUE ...")] = ()
    """Other settings that differ from the scene's."""
    repeats: int = 3
    """Timed runs of each value."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write all numbers as JSON, with hardware and versions."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write a page with plots and tables that needs no network."""
    plots: Annotated[str | None, arg(metavar="DIR")] = None
    """Write each plot as PNG and SVG into a folder."""
    jobs: int = 0
    """Processes for runs that are not timed; as many as there are cores if 0."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """A Dask scheduler for these instead, such as tcp://10.0.0.1:8786; needs the extra `cluster`."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema, run_study

        if self.schema:
            return print_schema("compare")
        scene, overrides = _scene_and_settings(self.scene, self.overrides)
        name, values = parse_values(self.by) if self.by else (scene.compare.by, list(scene.compare.values))

        def measure(progress):
            from sim.studies.cost.compare import compare

            about = overrides, self.seconds, self.repeats, progress, self.jobs or None, self.cluster
            return compare(scene, name, values, *about)

        by = self.by or f"{name}={','.join(map(str, values))}"
        options = {"by": by, "seconds": self.seconds, "repeats": self.repeats}
        command = _command("compare", self.scene, self.overrides, **options)
        return run_study(measure, command, self.json, self.html, self.plots)


@dataclass(kw_only=True)
class Audit:
    """Leave out each effect of a scene in turn: which it needs, what each one costs and changes."""

    scene: Annotated[str, Positional, arg(metavar="SCENE")] = ""
    """A scene file, or one of `muslin scenes`."""
    seconds: float = 1.0
    """Time to simulate [s]."""
    overrides: Annotated[UseAppendAction[tuple[Texts, ...]], arg(name="set", metavar="NAME=VALUE ...")] = ()
    """Settings that differ from the scene's."""
    tolerance: float = 0.01
    """How far all that is left out may move the cloth, as part of its diagonal."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write all numbers as JSON, with hardware and versions."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write a page with a plot and the table that needs no network."""
    schema: bool = False
    """Only print the JSON schema of what --json writes."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.cost import print_schema, run_study

        if self.schema:
            return print_schema("audit")
        scene, overrides = _scene_and_settings(self.scene, self.overrides)

        def measure(progress):
            from sim.studies.audit import audit

            return audit(scene, overrides, self.seconds, self.tolerance, progress)

        options = {"seconds": self.seconds, "tolerance": self.tolerance}
        command = _command("audit", self.scene, self.overrides, **options)
        return run_study(measure, command, self.json, self.html, None)


@dataclass(kw_only=True)
class Stress:
    """Run the battery of hard cases: what each measured, held against its mark."""

    short: bool = False
    """The cases that take minutes, with a few seeds each; this is what happens anyway."""
    full: bool = False
    """All cases with all their seeds, within an hour."""
    case: Annotated[Texts, arg(metavar="NAME ...")] = ()
    """Only these cases, or themes: numerics, contact, sweep; C2 means all whose names begin with C2-."""
    seed: int = 0
    """Of the first run of each case; those of the others follow."""
    runs: int | None = None
    """Runs of each case; a case knows how many it needs if left out."""
    jobs: int | None = None
    """Processes, one thread each; as many as there are cores if left out."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write what was found as JSON."""
    html: Annotated[str | None, arg(metavar="FILE.html")] = None
    """Write the same as a page, with a picture of how each case ended."""
    keep: Annotated[str | None, arg(metavar="FOLDER")] = None
    """Keep scene, settings and state of what fails."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Run on the workers of a Dask scheduler, such as tcp://10.0.0.1:8786 (the extra `cluster`)."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.stress import run_stress

        if self.short and self.full:
            raise ValueError("--short: expected only one of --short and --full, got both")
        how = self.full, self.seed, self.runs, self.jobs
        return run_stress(self.case, *how, self.json, self.html, self.keep, self.cluster)


COMMANDS = {
    "lab": Lab,
    "run": Run,
    "check": Check,
    "scenes": Scenes,
    "cost": Cost,
    "compare": Compare,
    "audit": Audit,
    "stress": Stress,
    "study": Study,
    "bench": Bench,
}

DESCRIPTION = """Try cloth simulation methods side by side.

`muslin` opens the lab in a browser, and takes the options of `muslin lab`."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code: 0, 1 for what went wrong, 2 for a wrong call."""
    arguments = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):  # γ and ≥ must not end the command on a terminal without them
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if arguments[:1] == ["--version"]:
        _say(f"muslin {sim.__version__}")
        return 0
    try:
        return _parse(arguments)()
    except (ValueError, OSError) as error:
        _complain(error)
        return 1
    except KeyboardInterrupt:
        return 130


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


def count_vertices(scene: sim.Scene) -> int | None:
    """Vertices of a scene without building its mesh; None where only building it can tell."""
    from sim.scene import Arrays, Equilateral, Grid

    total = 0
    for cloth in scene.cloth:
        if isinstance(cloth, Grid | Equilateral):
            total += cloth.resolution[0] * cloth.resolution[1]
            total += cloth.resolution[1] // 2 if isinstance(cloth, Equilateral) else 0
        elif isinstance(cloth, Arrays):
            total += len(cloth.vertices)
        else:
            from sim.meshclaims import vertex_count

            claimed = vertex_count(cloth.file, scene.folder)
            if claimed is None:
                return None
            total += claimed
    return total


def _parse(arguments: list[str]):
    """The command that the arguments mean; SystemExit after help, or after one line on what is wrong."""
    first = arguments[0] if arguments else "lab"
    if first not in COMMANDS and first not in ("-h", "--help"):
        if not first.startswith("-"):
            _complain(f"{first}: no such command; expected one of {', '.join(COMMANDS)}")
            raise SystemExit(2)
        first = "lab"
        arguments = ["lab", *arguments]
    arguments = arguments or ["lab"]
    problem = io.StringIO()
    try:
        with contextlib.redirect_stderr(problem):
            return tyro.cli(
                Lab | Run | Check | Scenes | Cost | Compare | Audit | Stress | Study | Bench,
                prog="muslin",
                description=DESCRIPTION,
                args=arguments,
                config=(FlagCreatePairsOff,),
            )
    except SystemExit as ending:
        if ending.code:
            _complain(f"{first}: {_first_line(problem.getvalue())}; see muslin {first} --help")
        raise


def _scene_and_settings(name: str, overrides: tuple[Texts, ...]) -> tuple[sim.Scene, dict[str, object]]:
    """The scene that a study is about, and the settings that differ from its own."""
    if not name:
        raise ValueError("SCENE: expected a scene file, or one of `muslin scenes`, got none")
    return load_scene(name), parse_settings([text for texts in overrides for text in texts])


def _command(name: str, scene: str, overrides: tuple[Texts, ...], **options: object) -> str:
    """What to type for the same measurement again."""
    words = ["muslin", name, scene]
    for option, value in options.items():
        words += [f"--{option}"] if value is True else [f"--{option}", f"{value}"] if value else []
    settings = [text for texts in overrides for text in texts]
    return shlex.join([*words, *(["--set", *settings] if settings else [])])


def _first_line(box: str) -> str:
    """The message in a box that tyro drew: what stands between the title and the first rule after it."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", box)
    message: list[str] = []
    for line in text.splitlines()[1:]:
        words = line.strip("│| ")
        if not set(words) <= set("─-╭╮╰╯+"):
            message.append(words)
        elif message:
            break
    return " ".join(message) or "wrong call"


def _complain(problem: object) -> None:
    text = " ".join(str(problem).split())
    sys.stderr.write(f"muslin: {text}\n")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
