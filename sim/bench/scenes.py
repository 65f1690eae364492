"""What effects cost whole scenes: steps with all that can be skipped forced on, with auto, and as audited.

The three are stepped in turn, so that whatever else the computer does slows all of them down alike, and with
one accuracy: on and auto give the same bits, and what the audit leaves out changes less than its tolerance.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from sim.effects import effects_with, state
from sim.scene import load_scene
from sim.settings import READ_OUTS
from sim.simulation import Simulation
from sim.studies import Cell, Progress, Result, Table, watched
from sim.studies.audit import audit
from sim.studies.cost.measures import distances, size
from sim.warmup import warm_up

WARM = 5
"""Steps that are not timed."""

COLUMNS = (
    "scene",
    "vertices",
    "effects",
    "ms, median",
    "ms, 90 %",
    "lists per step",
    "steps without a list [%]",
    "looks along the way per step",
    "steps without one [%]",
    "moved by [%]",
    "cold start [s]",
)

COLD = (
    "import sys, sim, sim.warmup; s = sim.load_scene(sys.argv[1]); sim.warmup.warm_up(s); "
    "sim.Simulation(s).step()"
)
"""A program that takes the first step of a scene."""

NOTES = (
    "On has every effect looked at in full that auto may skip; auto is the scene as it comes, and gives the "
    "same bits; audited leaves out, besides, what `muslin audit` recommends, and names it. Moved is how far "
    "cloth is at the end from where it is with auto, as part of its diagonal.",
    "A list is a broad phase; a look along the way is a continuous check of a list's pairs. Auto does "
    "without them where bounds show that nothing can act.",
    "All three take each step one after the other. Cold start is from an empty kernel cache to the first "
    "step, in a process of its own, where it was asked for.",
)


def measure_scenes(
    scenes: Sequence[str], steps: int, cold: bool = False, progress: Progress | None = None
) -> Result:
    """Step each of the `scenes`, at most `steps` times, in three ways.

    Args:
        scenes: Names or paths.
        steps: Of each.
        cold: Whether to measure cold starts, which compiles all kernels once for every scene.
        progress: Is told how far it is.

    Raises:
        SceneError, ValueError: for scenes that cannot be used.
    """
    for name in scenes:
        load_scene(name)
    rows: list[tuple[Cell, ...]] = []
    for name in watched(list(scenes), progress, lambda name: name):
        rows += _rows(name, steps, cold)
    caption = f"Milliseconds per step of scenes over {steps} steps, {WARM} of them not timed"
    return Result("What effects cost", (Table(caption, COLUMNS, tuple(rows)),), NOTES)


def _rows(name: str, steps: int, cold: bool) -> list[tuple[Cell, ...]]:
    scene = load_scene(name)
    start = cold_start(name) if cold else None
    warm_up(scene)
    found = audit(scene, seconds=steps * scene.settings.dt)
    effects = effects_with(scene.obstacle_labels)
    skipped = (name for name, effect in effects.items() if effect.on and name not in READ_OUTS)
    on = {name: "on" for name in skipped if state(name, scene.settings) != "off"}
    ways = {
        "on": on,
        "auto": {},
        f"audited: no {', '.join(found.recommended) or 'changes'}": found.recommended,
    }
    worlds = {way: Simulation(scene, effects=forced) for way, forced in ways.items()}
    reports: dict[str, list[Any]] = {way: [] for way in ways}
    for _ in range(steps):
        for way, world in worlds.items():
            reports[way].append(world.step())
    auto = worlds["auto"]
    return [
        (
            scene.name,
            len(auto.positions),
            way,
            *_figures(reports[way][WARM:]),
            100.0 * float(distances(world.positions[None], auto.positions[None], auto.masses, size(auto))[0]),
            start if way == "auto" else None,
        )
        for way, world in worlds.items()
    ]


def _figures(reports: Sequence[Any]) -> tuple[float, ...]:
    ms = [report.ms["total"] for report in reports]
    lists, sweeps = ([getattr(r, what) for r in reports] for what in ("lists", "sweeps"))
    quiet = [100.0 * sum(not n for n in many) / len(many) for many in (lists, sweeps)]
    per_step = [sum(many) / len(many) for many in (lists, sweeps)]
    high = quantiles(ms, n=10)[-1] if len(ms) > 1 else ms[0]
    return median(ms), high, per_step[0], quiet[0], per_step[1], quiet[1]


def cold_start(name: str) -> float:
    """Seconds from starting Python with no compiled kernel to the end of the scene's first step."""
    from time import perf_counter

    with tempfile.TemporaryDirectory() as cache:
        path = os.pathsep.join(filter(None, (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))))
        begin = perf_counter()
        command = [sys.executable, "-c", COLD, name]
        env = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": path}
        subprocess.run(command, env=env, check=True, capture_output=True)
        return perf_counter() - begin
