"""Measurements put into tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Any

from sim.bench import PEER_SIZE, Case, Measured, solvers
from sim.bench.accuracy import HORIZON, TARGETS
from sim.bench.peers import MUSLIN
from sim.bench.sheet import BENDING, DENSITY, FRAME, KINDS, RADIUS, SPRING
from sim.bench.steps import CLOSE, DIRECT, WARM
from sim.studies import Cell, Result, Table

Found = Sequence[tuple[Case, Measured]]
Row = tuple[Cell, ...]


def tabulate(found: Found) -> Result:
    """All that was measured, with what it means."""
    steps = [(case, result) for case, result in found if case.measure == "steps"]
    frames = [(case, result) for case, result in found if case.measure == "frames"]
    accuracy = [(case, result) for case, result in found if case.measure == "accuracy"]
    tables = _steps(steps), _growth(steps), _frames(frames), _accuracy(accuracy)
    notes = _notes(bool(frames or accuracy))
    return Result("What a step of Muslin costs", tuple(table for table in tables if table.rows), notes)


def _steps(found: Found) -> Table:
    columns = (
        "sheet",
        "vertices",
        "threads",
        "steps",
        "ms, median",
        "ms, 90 %",
        "µs per vertex",
        "iterations",
        "most",
        "error [mm]",
        "crossings",
        "memory [MB]",
        "build [s]",
        "kernels [s]",
    )
    caption = f"Whole steps of Muslin, h = 1/{1 / FRAME:.0f} s, one linearised step, tolerance 0.1 mm"
    return Table(caption, columns, tuple(_steps_row(case, result) for case, result in found))


def _steps_row(case: Case, result: Measured) -> Row:
    ms, iterations = result.get("ms"), result.get("iterations")
    names = case.kind, case.size, case.threads
    if not ms or not iterations:
        return (*names, None, _why_not(result), *(None,) * 9)
    errors = result.get("errors")
    return (
        *names,
        len(ms),
        float(median(ms)),
        percentile(ms, 0.9),
        1e3 * median(ms) / case.size,
        float(median(iterations)),
        max(iterations),
        1e3 * max(errors) if errors else None,
        max(result.get("crossings") or [0]),
        result.get("memory"),
        result.get("build"),
        result.get("kernels"),
    )


def _growth(found: Found) -> Table:
    """From the smallest to the largest size, for each sheet and number of threads."""
    rows: list[Row] = []
    for kind, threads in dict.fromkeys((case.kind, case.threads) for case, _ in found):
        of = [(c, r) for c, r in found if (c.kind, c.threads) == (kind, threads) and r.get("ms")]
        if len(of) < 2:
            continue
        (small, first), (large, last) = min(of, key=_size), max(of, key=_size)
        iterations = median(last["iterations"]) / max(1, median(first["iterations"]))
        cost = median(last["ms"]) / large.size / (median(first["ms"]) / small.size)
        rows.append((kind, threads, f"{small.size:,} to {large.size:,}", iterations, cost))
    columns = ("sheet", "threads", "vertices", "iterations ×", "cost per vertex ×")
    return Table("Growth from the smallest sheet to the largest", columns, tuple(rows))


def _size(pair: tuple[Case, Measured]) -> int:
    return pair[0].size


def _frames(found: Found) -> Table:
    columns = (
        "sheet",
        "vertices",
        "solver",
        "settings",
        "frames",
        "ms",
        "ms, 90 %",
        "/ Muslin",
        "longest edge [%]",
        "start-up [s]",
        "memory [MB]",
    )
    muslin = {(c.kind, c.size): r["ms"] for c, r in found if c.solver == MUSLIN and r.get("ms")}
    rows = [_frames_row(c, r, muslin.get((c.kind, c.size))) for c, r in sorted(found, key=_by_sheet)]
    caption = (
        f"Milliseconds per frame of {1e3 * FRAME:.3g} ms with each solver's own settings, up to one second"
    )
    return Table(caption, columns, tuple(rows))


def _by_sheet(pair: tuple[Case, Measured]) -> tuple[int, int]:
    case = pair[0]
    return list(KINDS).index(case.kind), case.size


def _frames_row(case: Case, result: Measured, muslin: Sequence[float] | None) -> Row:
    names = case.kind, case.size, case.solver, result.get("settings")
    ms, startup = result.get("ms"), result.get("start_up")
    if not ms:
        return (
            *names,
            0 if startup else None,
            _why_not(result, case.seconds),
            None,
            None,
            None,
            startup,
            None,
        )
    strain = result.get("strain")
    return (
        *names,
        len(ms),
        float(median(ms)),
        percentile(ms, 0.9),
        median(ms) / median(muslin[: len(ms)]) if muslin else None,
        100.0 * strain if strain is not None and math.isfinite(strain) else None,
        startup,
        result.get("memory"),
    )


def _accuracy(found: Found) -> Table:
    columns = ["vertices", "solver"]
    for target in TARGETS:
        columns += [
            f"{_length(target)}: ms",
            f"{_length(target)}: / Muslin",
            f"{_length(target)}: by",
        ]
    columns += ["own error [mm]", "longest edge [%]", "converged [%]", "settled to [mm]"]
    muslin = {c.size: r["met"] for c, r in found if c.solver == MUSLIN and r.get("met")}
    rows = [_accuracy_row(c, r, muslin.get(c.size)) for c, r in sorted(found, key=_size)]
    caption = (
        f"The cheapest settings with which the hanging sheet is, after {HORIZON * FRAME:.3g} s, within 1 cm "
        "or 1 mm of the same solver's converged one"
    )
    return Table(caption, tuple(columns), tuple(rows))


def _accuracy_row(case: Case, result: Measured, muslin: Sequence[Any] | None) -> Row:
    if "met" not in result:
        return (case.size, case.solver, _why_not(result), *(None,) * (3 * len(TARGETS) + 3))
    cells: list[Cell] = []
    for place, met in enumerate(result["met"]):
        if met is None:
            best = result["best"]
            error = f"{1e3 * best['error']:.2g} mm" if best["error"] is not None else "not settled"
            cells += ["not reached", None, f"{best['settings']}: {error}, {best['ms']:.3g} ms"]
            continue
        ours = muslin[place] if muslin else None
        cells += [met["ms"], met["ms"] / ours["ms"] if ours else None, met["settings"]]
    own = result["own"]["error"]
    percent = [None if result[name] is None else 100.0 * result[name] for name in ("own_strain", "strain")]
    settled = result["settled"]
    millimetres = [None if number is None else 1e3 * number for number in (own, settled)]
    return (case.size, case.solver, *cells, millimetres[0], *percent, millimetres[1])


def _why_not(result: Measured, seconds: float | None = None) -> str:
    """Why there is no number."""
    if "missing" in result:
        return str(result["missing"])
    if "failed" in result:
        return f"failed: {result['failed']}"
    if "stopped" in result and seconds is not None and "start_up" in result:
        return f"more than {1e3 * seconds:,.0f}"  # not even one frame within the time that all of them had
    if "stopped" in result:
        return f"nothing within {result['stopped']:.0f} s"
    return "not done in time"


def percentile(values: Sequence[float], part: float) -> float:
    """The value below which `part` of `values` lie, interpolated between neighbours."""
    ordered = sorted(values)
    place = part * (len(ordered) - 1)
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))


def _length(metres: float) -> str:
    return f"{100 * metres:g} cm" if metres >= 0.01 else f"{1e3 * metres:g} mm"


def _notes(peers: bool) -> tuple[str, ...]:
    notes = [
        f"The sheet is 1 m × 1 m, {DENSITY} kg/m², with edge springs of {SPRING:g} N/m along its grid, all "
        f"altitude springs alike, and cross springs of {BENDING:g} N m. It hangs from two corners, or falls "
        f"from 1 cm above it on a sphere of {RADIUS} m. There cloth feels cloth, by impulses with continuous "
        "detection, and edges that cross triangles are counted after every tenth step.",
        f"The first {WARM} steps are not timed. The error is the largest distance of a vertex from where a "
        f"direct solve of the same step puts it, the worst of three steps; beyond {DIRECT:,} vertices, from "
        f"where the iterations end with a tolerance of {CLOSE:g} m. Memory is the peak of the process, "
        "before any direct solve.",
        "Every row is a process of its own. Kernels are compiled in the first row that needs them and loaded "
        "from the cache by the others.",
    ]
    if not peers:
        return tuple(notes)
    notes += [
        f"Peers get sheets of up to {PEER_SIZE:,} vertices and as many threads as Muslin; start-up "
        "has imports, compilers and the first frame. Ratios are medians over the frames that both "
        "solvers made, in this run; few frames are those before the sheet has swung or landed. "
        "Materials and contact differ, so small differences mean nothing:",
        *(peer.note for peer in solvers().values()),
        f"The error is the largest distance of a vertex after {HORIZON} frames from the same "
        "solver's own reference: its ladder of settings, refined in time and iterations until a "
        "rung changes less than a tenth of a millimetre, or time is out. What the last rung changed "
        "is added to every error. 1 cm is what an eye sees of a sheet of 1 m, 1 mm what a contact "
        "at a distance of 5 mm can bear. The time is short because wrinkles decide soon after: at "
        "0.25 s, halving Muslin's step once more still moved vertices by millimetres. Besides its "
        "ladder, Muslin tries more settings than its peers; Taichi none.",
        "Settings are substeps of a frame × iterations in each (Newton iterations of Muslin) and the method; "
        "where a target is not reached, they are those with the smallest error. The longest edge is the "
        "largest strain of any edge: where own settings exceed the converged value, the solver is softer "
        "than its material.",
    ]
    return tuple(notes)
