"""Muslin's whole steps: milliseconds, iterations of the linear solver, and the error that they leave."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sim.bench.memory import peak_memory
from sim.bench.sheet import Sheet
from sim.scene import load_scene

WARM = 10
"""Steps that are not timed: caches fill, and flat cloth is easy."""

SAMPLES = 3
"""Steps that are done again with the reference solver."""

AUDIT = 10
"""Steps between two looks for edges that cross triangles."""

DIRECT = 10_000
"""Vertices up to which the reference is a direct solve; beyond, its factors take minutes."""

CLOSE = 1e-9
"""Tolerance of the reference beyond that [m]."""


def reference(count: int) -> dict[str, Any]:
    """The settings of a step that is as good as exact, for a sheet of `count` vertices."""
    return {"solver": "direct"} if count <= DIRECT else {"tolerance": CLOSE}


def measure_steps(
    sheet: Sheet,
    threads: int,
    steps: int,
    seconds: float,
    say: Callable[[dict[str, Any]], None],
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Step a sheet.

    Args:
        sheet: Which one.
        threads: That a step may use.
        steps: At most.
        seconds: After which no more steps are begun [s].
        say: Is told "kernels" [s] (imports, and compiling or loading of kernels), "build" [s], "ms" and
            "iterations" of each warm step, "crossings" after every tenth step, "memory" [MB], "layer" of
            Numba's threads, and, one by one, "errors" [m]: the largest distance of a vertex from where the
            reference puts it.
        clock: Tells the time [s].
    """
    begin = clock()
    from sim.contact.intersections import intersections
    from sim.simulation import Simulation
    from sim.threads import threading_layer
    from sim.warmup import warm_up

    scene = load_scene(sheet.scene())
    warm_up(scene)
    compiled = clock()
    world = Simulation(scene, threads=threads)
    found: dict[str, Any] = {
        "kernels": compiled - begin,
        "build": clock() - compiled,
        "ms": [],
        "iterations": [],
        "crossings": [],
    }
    say(found)
    limit = clock() + seconds
    warm = min(WARM, steps // 2)
    sampled = {int(i) for i in np.linspace(warm, steps - 1, SAMPLES)}
    before_after = []
    for i in range(steps):
        if clock() > limit and found["ms"]:
            break
        before = world.snapshot() if i in sampled else None
        report = world.step()
        if i >= warm:
            found["ms"].append(report.ms["total"])
            found["iterations"].append(report.iterations)
        if i % AUDIT == 0 and not sheet.hangs:
            found["crossings"].append(len(intersections(world.positions, world.triangles)))
        if before is not None:
            before_after.append((before, world.positions.copy()))
    say(found := {**found, "memory": peak_memory(), "layer": threading_layer(), "errors": []})
    for before, after in before_after:
        if found["errors"] and clock() > limit + seconds:
            break
        found["errors"].append(step_error(world, before, after, reference(sheet.count)))
        say(found)


def step_error(world: Any, before: Any, after: np.ndarray, settings: dict[str, Any]) -> float:
    """How far `after` (n, 3) [m] is at most from the end of the same step with other `settings` [m].

    Args:
        world: The simulation; it ends somewhere else.
        before: Its snapshot before the step.
        after: The positions after it.
        settings: Of the better step.
    """
    world.restore(before)
    world.update(**settings)
    world.step()
    return float(np.linalg.norm(world.positions - after, axis=1).max())
