"""What contact costs and keeps out: each response, with either detection, on the sheet that drapes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from statistics import median

import numpy as np
from msgspec.structs import replace

from sim.bench.sheet import Sheet
from sim.bench.tables import percentile
from sim.contact.intersections import intersections
from sim.contact.response import RESPONSES
from sim.contact.time_of_impact import KINDS, time_of_impact
from sim.report import StepError, StepReport
from sim.scene import load_scene
from sim.settings import change
from sim.simulation import Simulation
from sim.studies import Cell, Progress, Result, Table, watched
from sim.threads import processor_threads
from sim.warmup import warm_up

WARM = 10
"""Steps that are not timed."""

QUERIES, REPEATS = 100_000, 5
"""Pairs that are asked for at once, and how often; the median counts."""

PHASES = "detect", "solve", "respond"

COLUMNS = (
    "vertices",
    "response",
    "detection",
    "threads",
    "steps",
    "ms, median",
    "ms, 90 %",
    *PHASES,
    "else",
    "pairs felt, most",
    "steps with crossings",
    "crossings, most",
    "deepest [mm]",
    "held back",
    "substeps, most",
)

NOTES = (
    f"Of each way to make contact the first {WARM} steps are not timed; phases are medians, too. The sheet "
    "is that of `muslin bench`: 1 m × 1 m, it falls from 1 cm above it on a sphere of 0.3 m, feels itself, "
    "and takes one linearised step for 1/60 s. Where a step is refused, as too much of the cloth comes near "
    "itself, it goes on no farther.",
    "Crossings are edges that cross triangles, counted at the end of every step, in time of its own; deepest "
    "is how far a vertex was inside the sphere. Held back are vertices that no impulse led past what they "
    "would have met, in all steps: the failsafe. With impulses crossings must be 0.",
    "Queries are of random pairs in a unit cube, by one thread; half of them end anywhere else in it, the "
    "others go a tenth as far.",
)


DETECTIONS = "static", "continuous"

WAYS = [(r, d) for r in RESPONSES for d in DETECTIONS] + [("none", "–")]
"""Each response with each detection; without a response there is nothing to detect."""


def measure_contact(
    sizes: Sequence[int], threads: Sequence[int], steps: int, progress: Progress | None = None
) -> Result:
    """Drape sheets in every way, for `steps` steps.

    Args:
        sizes: Vertices of the sheets; square numbers.
        threads: That a step may use; each number is measured.
        steps: Of each.
        progress: Is told how far it is.
    """
    cases = [(size, count, steps, *way) for size in sizes for count in threads for way in WAYS]
    told = watched(cases, progress, lambda case: f"{case[0]:,} vertices, {case[3]}, {case[4]}")
    rows = [_row(*case) for case in told]
    tables = (
        Table(f"Milliseconds per step of draped sheets over {steps} steps", COLUMNS, tuple(rows)),
        Table("Continuous queries", ("pair", "queries", "meet [%]", "µs per query"), tuple(_queries())),
    )
    return Result("What contact costs", tables, NOTES)


def _row(size: int, threads: int, steps: int, response: str, detection: str) -> tuple[Cell, ...]:
    scene = load_scene(Sheet("drape", round(size**0.5)).scene())
    chosen = {"contact": response, **({"detection": detection} if detection in DETECTIONS else {})}
    scene = replace(scene, settings=change(scene.settings, **chosen))
    warm_up(scene)
    world = Simulation(scene, threads=threads)
    reports: list[StepReport] = []
    crossings: list[int] = []
    for _ in range(steps):
        try:
            reports.append(world.step())
        except StepError:
            break
        crossings.append(len(intersections(world.positions, world.triangles)))
    return (size, response, detection, threads, *_figures(reports, crossings))


def _figures(reports: Sequence[StepReport], crossings: Sequence[int]) -> tuple[Cell, ...]:
    timed = reports[WARM:] or reports
    ms = [report.ms["total"] for report in timed]
    phases = [median(report.ms.get(name, 0.0) for report in timed) for name in PHASES]
    beside = median(report.ms["total"] - sum(report.ms.get(p, 0.0) for p in PHASES) for report in timed)
    return (
        len(reports),
        median(ms),
        percentile(ms, 0.9),
        *phases,
        beside,
        max(report.contacts for report in reports),
        sum(count > 0 for count in crossings),
        max(crossings),
        1e3 * max(report.deepest for report in reports),
        sum(report.held_back for report in reports),
        max(report.substeps for report in reports),
    )


def _queries() -> list[tuple[Cell, ...]]:
    rng, rows = np.random.default_rng(0), []
    x = rng.random((QUERIES, 8, 3))
    slow = rng.random(QUERIES) < 0.5
    x[slow, 4:] = x[slow, :4] + 0.1 * x[slow, 4:]
    for kind in KINDS:
        times = time_of_impact(kind, x)
        rows.append((kind, QUERIES, 100.0 * float(np.isfinite(times).mean()), _microseconds(kind, x)))
    return rows


def _microseconds(kind: str, x: np.ndarray) -> float:
    seconds: list[float] = []
    with processor_threads(1):
        for _ in range(REPEATS):
            begin = time.perf_counter()
            time_of_impact(kind, x)
            seconds.append(time.perf_counter() - begin)
    return 1e6 * median(seconds) / len(x)
