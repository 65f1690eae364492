"""Runs of a scene without a page: step, record, and say what it cost."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

import sim
from server.commands.speech import complain
from server.digits import share_text
from sim.effects import cost, does
from sim.export import Recording, check_outputs, check_size, save_json
from sim.scene import Scene
from sim.settings import convert

if TYPE_CHECKING:
    from sim.simulation import Simulation, StepReport

LONGEST = 1e5
"""Runs longer than this [s] are most likely a slip of the keyboard."""

INTERRUPTED = "interrupted"


@dataclass
class Outcome:
    """What came of a run: the simulation as it ended, a report for each step, what crossed, why it ended."""

    world: Simulation
    reports: list[StepReport] = field(default_factory=list)
    wall: float = 0.0
    stopped: str = ""
    crossings: list[int] = field(default_factory=list)

    def step(self) -> None:
        """Take a step, and count what crosses after it where that is forced on."""
        self.reports.append(self.world.step())
        if self.world.settings.crossings == "on":
            self.count("after every step")

    def count(self, when: str) -> None:
        """Count what crosses now, and have the last step tell of it."""
        if not self.reports:
            self.crossings.append(self.world.crossings())
            return
        report = self.reports[-1]
        with report.spent("crossings"):
            self.crossings.append(self.world.crossings())
        report.effects["crossings"] = f"ran: counted {when}"


def run(
    scene: Scene,
    overrides: dict[str, Any],
    seconds: float = 2.0,
    fps: float = 60.0,
    out: str | None = None,
    json: str | None = None,
) -> int:
    """Run a scene, print a table, and write a recording to `out` and the numbers to `json` where given.

    Returns:
        The exit code: 0, also after Ctrl-C, or 1 where a step failed; what was done by then is written.

    Raises:
        ValueError, OSError: before anything is simulated, for a call that makes no sense.
    """
    _check(scene, overrides, seconds, fps)
    check_outputs(out=out, json=json)
    outcome, recording = _simulate(scene, overrides, seconds, fps, record=out is not None)
    if recording is not None and out is not None:
        recording.save(out)
        sys.stdout.write(f"{out}: {len(recording):,} frames\n")
    summary = summarise(outcome)
    if json is not None:
        save_json(json, summary)
    Console(width=None if sys.stdout.isatty() else 100, markup=False).print(_table(summary))
    if outcome.stopped:
        sys.stderr.write(f"muslin: stopped at {outcome.world.time:.4g} s: {outcome.stopped}\n")
    return 1 if outcome.stopped and outcome.stopped != INTERRUPTED else 0


def _check(scene: Scene, overrides: dict[str, Any], seconds: float, fps: float) -> None:
    if not 0.0 < seconds <= LONGEST:
        raise ValueError(f"--seconds: expected > 0 and ≤ {LONGEST:g}, got {seconds:g}")
    if not 0.0 < fps <= 1e6:
        raise ValueError(f"--fps: expected > 0 and ≤ 1e+06, got {fps:g}")
    for name, value in overrides.items():
        convert(name, value)


def _simulate(
    scene: Scene, overrides: dict[str, Any], seconds: float, fps: float, record: bool
) -> tuple[Outcome, Recording | None]:
    with _progress() as progress:
        task = progress.add_task("getting kernels ready (the first run compiles them)", total=None)
        from sim.simulation import Simulation

        world = Simulation(scene, **overrides)
        for line in world.mesh.warnings + ((f"{scene.source}: {world.note}",) if world.note else ()):
            complain(line)
        steps = max(1, math.ceil(seconds / world.settings.dt - 1e-6))
        if record:
            check_size(len(world.positions), 1 + min(steps, math.ceil(seconds * fps)))
        recording = Recording(world, 1.0 / fps) if record else None
        outcome = Outcome(world)
        _step_on(outcome, recording, steps, lambda: progress.update(task, total=steps, advance=1))
    return outcome, recording


def _step_on(outcome: Outcome, recording: Recording | None, steps: int, stepped: Any) -> None:
    """Take the steps, up to a failure or Ctrl-C; what was done until then stays."""
    from sim.simulation import StepError

    begin = time.perf_counter()
    try:
        for _ in range(steps):
            outcome.step()
            if recording is not None and recording.due:
                recording.add()
            stepped()
    except KeyboardInterrupt:
        outcome.stopped = INTERRUPTED
    except StepError as error:
        outcome.stopped = str(error)
    outcome.wall = time.perf_counter() - begin


def _progress() -> Progress:
    """A line on a terminal that says how far it is; nothing elsewhere."""
    console = Console(stderr=True)
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def summarise(outcome: Outcome) -> dict[str, Any]:
    """The run as numbers: medians over the steps, so that the one that compiled does not count."""
    world, reports = outcome.world, outcome.reports
    if world.settings.crossings != "off" and not outcome.crossings:
        outcome.count("at the end")
    phases = dict.fromkeys(name for report in reports for name in report.ms)
    ms = {name: median(report.ms.get(name, 0.0) for report in reports) for name in phases}
    dt = world.settings.dt
    linear, angular = world.momentum()
    effects = reports[-1].effects if reports else {}
    return {
        "scene": world.scene.name,
        "version": sim.__version__,
        "settings": msgspec.to_builtins(world.settings),
        "vertices": len(world.positions),
        "triangles": len(world.triangles),
        "seconds": world.time,
        "steps": len(reports),
        "stopped": outcome.stopped,
        "wall_seconds": outcome.wall,
        "ms": ms,
        "real_time_factor": 1e3 * dt / ms["total"] if ms.get("total") else None,
        "iterations": _spread(report.iterations for report in reports),
        "contacts": _spread(report.contacts for report in reports),
        "penetrations": _spread(report.penetrations for report in reports),
        "crossings": outcome.crossings[-1] if outcome.crossings else None,
        "crossings_most": max(outcome.crossings, default=None),
        "energy": world.energy(),
        "energy_injected": sum(report.energy_injected for report in reports),
        "energy_jumps": sum(report.energy_jumps for report in reports),
        "momentum": {"linear": linear.tolist(), "angular": angular.tolist()},
        "effects": effects,
        "does": {name: does(name) for name in effects},
        "shares": {name: _share(name, reports) for name in effects},
    }


def _share(name: str, reports: Sequence[StepReport]) -> dict[str, Any]:
    """What an effect took of the steps: medians, and where the figure is from, or why there is none."""
    costs = [cost(name, report.effects[name], report) for report in reports]
    known, last = [each.ms for each in costs if each.ms is not None], costs[-1]
    middle, total = median(known) if known else None, median(report.ms["total"] for report in reports)
    text = share_text(last._replace(ms=middle), total)
    return {"ms": middle, "at_most": last.most, "text": text, "why": last.why}


def _spread(values: Any) -> dict[str, float]:
    values = list(values) or [0]
    return {"mean": fmean(values), "most": max(values), "last": values[-1]}


def _table(summary: dict[str, Any]) -> Table:
    title = f"{summary['scene']}: {summary['steps']:,} steps, {summary['seconds']:.4g} s"
    table = Table(title=title, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_row("vertices, triangles", f"{summary['vertices']:,}, {summary['triangles']:,}")
    for name, value in sorted(summary["ms"].items(), key=lambda item: item[0] != "total"):
        table.add_row(f"{name} [ms per step, median]", f"{value:.2f}")
    if summary["real_time_factor"] is not None:
        table.add_row("real-time factor", f"{summary['real_time_factor']:.2f}")
    for name in ("iterations", "contacts", "penetrations"):
        spread = summary[name]
        table.add_row(f"{name}: mean, most", f"{spread['mean']:.1f}, {spread['most']:,}")
    crossings = "off"
    if summary["crossings"] is not None:
        crossings = f"{summary['crossings']:,}, {summary['crossings_most']:,}"
    table.add_row("crossings: at the end, most", crossings)
    for name, value in summary["energy"].items():
        table.add_row(f"{name} energy at the end [J]", f"{value:.4g}")
    for name, unit in (("linear", "kg m/s"), ("angular", "kg m²/s")):
        table.add_row(f"{name} momentum at the end [{unit}]", f"{math.hypot(*summary['momentum'][name]):.4g}")
    for name, words in summary["effects"].items():
        table.add_row(f"{name} in the last step", words)
    for name, share in summary["shares"].items():
        table.add_row(f"{name} [part of the step, median]", share["text"])
    return table
