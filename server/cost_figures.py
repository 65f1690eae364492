"""Figures of `muslin cost` and `compare`: error against cost, and where time and error come from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from server.figures import COLORS, DASHES, HATCHES, LOOKS, MARKERS, TALL, Figures, axes_for
from server.palette import BLACK, INK, STONE, Rgb
from sim.studies.cost.measures import UNITS
from sim.studies.cost.plan import NEWTON, RESPONSE, SOLVED, STEP, TOLERANCE
from sim.studies.cost.reference import MARGIN
from sim.studies.cost.report import CompareReport, CostReport, Run
from sim.studies.cost.verdict import FRAME, in_words, percent, value_in_words

TITLES = {
    "backward_euler": "backward Euler",
    "bdf2": "BDF2",
    "sdirk2": "SDIRK2",
    "tr_bdf2": "TR-BDF2",
    "symplectic_euler": "symplectic Euler",
}
"""Integrators as people write them; others are written as they are named."""

MOST_BARS = 7
"""Bars for runs on the front; more cannot be read from the back row."""


def cost_figures(report: CostReport) -> Figures:
    """The figures of `muslin cost`, the one for the slide first."""
    with rc_context(LOOKS):
        found: Figures = {
            "work-precision": (
                "Error against cost. Down and to the left is better; the grey staircase is the Pareto front: "
                "nothing beats it in both. Filled: Newton iterations as chosen; hollow: solved fully. In the "
                "grey band above the floor an error is not known to a tenth.",
                _work_precision(
                    report, lambda run: run.ms * FRAME, "time per frame of 1/60 s  [ms]", "front"
                ),
            ),
            "work-precision-matvecs": (
                "The same with work that no computer makes faster or slower: matrix–vector products.",
                _work_precision(
                    report,
                    lambda run: run.matvecs,
                    "matrix–vector products per simulated second",
                    "front_by_work",
                ),
            ),
            "knobs": (
                "One knob turned at a time, all others as chosen (the star). One that moves points to the "
                "right but not down is paid for in vain.",
                _knobs(report),
            ),
            "sources": (
                "What each knob, turned towards accuracy by itself, changes of the chosen run.",
                _sources(report),
            ),
            "phases": (
                "Where the time goes: the chosen settings, and some on the front with their errors.",
                _phases(report),
            ),
            "horizon": (
                "How long positions can be compared: runs that differ by a hair drift apart, and the "
                "reference is known less and less well.",
                _horizon(report),
            ),
        }
        if report.bands:
            found["ensemble"] = (
                "Seeded runs past the horizon: mean and standard deviation of what can still be compared.",
                _bands(report),
            )
        return found


def compare_figures(report: CompareReport) -> Figures:
    """The figures of `muslin compare`."""
    with rc_context(LOOKS):
        found: Figures = {}
        if report.horizon is not None:
            found["error-cost"] = (
                "Error against cost. Down and to the left is better.",
                _variants(report),
            )
        timed = [v for v in report.variants if v.ms is not None]
        if timed:
            bars = [(v.name, v.phases) for v in timed]
            title = f"{report.scene} by {report.by}: where the time goes"
            found["phases"] = ("Where the time of a frame goes.", _bars(title, bars))
        return found


def _log_log(axes: Axes, across: str, up: str) -> None:
    axes.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
    plain = FuncFormatter(lambda x, _: f"{x:g}")
    axes.xaxis.set_major_formatter(plain)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
    low, high = axes.get_xlim()
    digits = "25" if high / low > 8.0 else "2345678"
    minor = FuncFormatter(lambda x, _: f"{x:g}" if f"{x:.0e}"[0] in digits else "")
    axes.xaxis.set_minor_formatter(minor if high / low < 200.0 else NullFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _line(
    axes: Axes, points: Sequence[tuple[float, float]], index: int, label: str, hollow: bool = False
) -> None:
    color = COLORS[index % len(COLORS)].css
    axes.plot(
        *zip(*sorted(points), strict=True),
        color=color,
        marker=MARKERS[index % len(MARKERS)],
        linestyle=DASHES[index % len(DASHES)],
        markerfacecolor="white" if hollow else color,
        alpha=0.75 if hollow else 1.0,
        linewidth=1.2 if hollow else 2.4,
        label=label,
        zorder=3,
    )


def _work_precision(report: CostReport, cost: Callable[[Run], float], across: str, on: str) -> Figure:
    figure, axes = axes_for()
    worked = [run for run in report.runs if cost(run) > 0.0]
    _front(axes, [(cost(run), run.error) for run in worked if getattr(run, on)])
    names = [c.name.removesuffix(f", {SOLVED}") for c in report.curves if c.name.endswith(SOLVED)]
    for i, name in enumerate(names):
        for curve, hollow in ((name, False), (f"{name}, {SOLVED}", True)):
            points = [(run.settings.dt, cost(run), run.error) for run in worked if curve in run.curves]
            if points:
                _line_by_step(axes, points, i, TITLES.get(name, name) + f", {SOLVED}" * hollow, hollow)
    _marks(axes, report, cost)
    _log_log(axes, across, "error, relative")
    axes.set_title(f"{report.scene}: what accuracy costs, first {report.horizon:.3g} s", loc="left")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _line_by_step(
    axes: Axes, points: Sequence[tuple[float, float, float]], index: int, label: str, hollow: bool
) -> None:
    """A curve whose points are joined in the order of the time step."""
    color = COLORS[index % len(COLORS)].css
    _, costs, errors = zip(*sorted(points), strict=True)
    axes.plot(
        costs,
        errors,
        color=color,
        marker=MARKERS[index % len(MARKERS)],
        linestyle=DASHES[index % len(DASHES)],
        markerfacecolor="white" if hollow else color,
        linewidth=1.3 if hollow else 2.6,
        label=label,
        zorder=3 - hollow,
    )


def _front(axes: Axes, points: Sequence[tuple[float, float]]) -> None:
    """The Pareto front, as a staircase behind everything."""
    costs, errors = zip(*sorted(points), strict=True)
    axes.step(
        costs, errors, where="post", color=STONE.css, linewidth=9, alpha=0.45, zorder=1, label="Pareto front"
    )


def _marks(axes: Axes, report: CostReport, cost: Callable[[Run], float]) -> None:
    """The chosen settings, the recommended ones, the target and the floor."""
    chosen, advised = report.runs[0], _advised(report)
    spot = {"color": BLACK.css, "zorder": 5, "markeredgecolor": "white", "linestyle": "none"}
    if cost(chosen) > 0.0:
        axes.plot(cost(chosen), chosen.error, marker="*", markersize=24, label="chosen now", **spot)
    if advised is not chosen and cost(advised) > 0.0:
        ring = {"markerfacecolor": "none", "markeredgecolor": BLACK.css, "markeredgewidth": 2.2}
        axes.plot(
            cost(advised), advised.error, marker="o", markersize=22, label="recommended", **{**spot, **ring}
        )
    axes.axhline(report.verdict.target, color=INK.css, linewidth=1.0, linestyle=(0, (6, 4)), zorder=1)
    note = {"transform": axes.get_yaxis_transform(), "fontsize": 12, "va": "bottom", "ha": "right"}
    axes.text(0.995, report.verdict.target, f"target {percent(report.verdict.target)}", **note)
    axes.axhspan(report.floor, MARGIN * report.floor, color=STONE.css, alpha=0.18, zorder=0)
    axes.axhline(report.floor, color=INK.css, linewidth=1.6, zorder=1)
    axes.text(0.995, report.floor, f"floor: the reference is known to {percent(report.floor)}", **note)


def _advised(report: CostReport) -> Run:
    wanted = report.verdict
    return next(run for run in report.runs if run.ms == wanted.ms and run.error == wanted.error)


def _knobs(report: CostReport) -> Figure:
    figure, axes = axes_for()
    for i, name in enumerate((STEP, NEWTON, TOLERANCE)):
        points = [(_place(run, name), run.ms * FRAME, run.error) for run in report.runs if name in run.curves]
        if len(points) > 1:
            _line_by_step(axes, points, i, name, hollow=False)
    responses = [run for run in report.runs if RESPONSE in run.curves]
    for i, run in enumerate(responses):
        color = COLORS[(3 + i) % len(COLORS)].css
        label = f"{run.settings.contact}, {run.settings.detection}"
        axes.plot(
            run.ms * FRAME,
            run.error,
            color=color,
            marker=MARKERS[(3 + i) % len(MARKERS)],
            markersize=13,
            linestyle="none",
            markeredgecolor=BLACK.css,
            label=label,
            zorder=4,
        )
    _marks(axes, report, lambda run: run.ms * FRAME)
    _log_log(axes, "time per frame of 1/60 s  [ms]", "error, relative")
    axes.set_title(f"{report.scene}: one knob at a time", loc="left")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _place(run: Run, curve: str) -> float:
    """Where a run is along a curve."""
    return {STEP: run.settings.dt, NEWTON: float(run.settings.newton), TOLERANCE: run.settings.tolerance}[
        curve
    ]


def _sources(report: CostReport) -> Figure:
    figure, axes = axes_for((12.0, 4.5))
    known = [(s.source, s.what, s.change) for s in report.sources if s.change]
    known.sort(key=lambda row: row[2])
    for i, (_, what, change) in enumerate(known):
        axes.barh(i, change, color=STONE.css, edgecolor=INK.css, hatch=HATCHES[i % len(HATCHES)], height=0.6)
        axes.text(change, i, f"  {percent(change)}   ({what})", va="center")
    axes.set_yticks(range(len(known)), [row[0] for row in known])
    axes.set(xscale="log", xlabel="moves the cloth by, relative")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{100 * x:g} %"))
    if known:
        axes.set_xlim(0.3 * known[0][2], 60.0 * known[-1][2])
    axes.grid(False, axis="y")
    axes.set_title(f"{report.scene}: where the error of the chosen settings comes from", loc="left")
    return figure


def _phases(report: CostReport) -> Figure:
    shown = sorted((run for run in report.runs if run.front), key=lambda run: run.ms)
    shown = [shown[round(i)] for i in np.linspace(0, len(shown) - 1, min(MOST_BARS, len(shown)))]
    rows = [("chosen now", report.runs[0].phases)]
    rows += [(f"{percent(run.error)}: {_short(run)}", run.phases) for run in shown]
    return _bars(f"{report.scene}: where the time goes", rows)


def _short(run: Run) -> str:
    """Method and step of a run, and what else was changed; not a tolerance that only goes with these."""
    method = TITLES.get(run.settings.integrator, run.settings.integrator)
    also = {name: value for name, value in run.changed.items() if name not in ("integrator", "dt")}
    if len(run.changed) > 1:
        also.pop("tolerance", None)
    return ", ".join([method, f"h = {value_in_words('dt', run.settings.dt)}", *[in_words(also)] * bool(also)])


def _bars(title: str, rows: Sequence[tuple[str, dict[str, float]]]) -> Figure:
    """Milliseconds per frame by phase, stacked."""
    figure, axes = axes_for((12.0, 2.2 + 0.55 * len(rows)))
    phases = list(dict.fromkeys(name for _, spent in rows for name in spent))
    left = [0.0] * len(rows)
    for k, phase in enumerate(phases):
        widths = [FRAME * spent.get(phase, 0.0) for _, spent in rows]
        look: dict[str, Any] = {
            "color": COLORS[k % len(COLORS)].toward(Rgb(255, 255, 255), 0.35).css,
            "hatch": HATCHES[k],
        }
        axes.barh(range(len(rows)), widths, left=left, label=phase, edgecolor=INK.css, height=0.65, **look)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    for i, total in enumerate(left):
        axes.text(total, i, f"  {total:.3g} ms", va="center")
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.set(xlabel="time per frame of 1/60 s  [ms]", xlim=(0.0, 1.15 * max(left, default=1.0)))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(phases))
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def _horizon(report: CostReport) -> Figure:
    figure, axes = axes_for()
    lines = [
        (report.growth.times, report.growth.distance, f"{report.growth.members} runs moved by a hair", 1),
        (report.reference.times, report.reference.floor_by_time, "floor of the reference", 0),
    ]
    for times, values, label, i in lines:
        points = [(t, v) for t, v in zip(times, values, strict=True) if t > 0.0 and v > 0.0]
        if points:
            _line(axes, points, i, label)
    axes.axvline(report.horizon, color=INK.css, linewidth=2)
    axes.text(
        report.horizon,
        1.0,
        f" compared up to {report.horizon:.3g} s",
        transform=axes.get_xaxis_transform(),
        va="top",
    )
    axes.set(yscale="log", xlabel="simulated time  [s]", ylabel="relative distance")
    axes.set_xlim(left=0.0)
    axes.set_title(f"{report.scene}: how long runs can be compared", loc="left")
    axes.legend(loc="best")
    return figure


def _bands(report: CostReport) -> Figure:
    names = list(dict.fromkeys(band.observable for band in report.bands))[:4]
    figure = Figure(figsize=TALL, layout="constrained")
    for k, name in enumerate(names):
        axes = figure.add_subplot(2, 2, k + 1)
        for i, band in enumerate(b for b in report.bands if b.observable == name):
            color = COLORS[i].css
            low = [m - d for m, d in zip(band.mean, band.deviation, strict=True)]
            high = [m + d for m, d in zip(band.mean, band.deviation, strict=True)]
            axes.fill_between(
                band.times, low, high, color=color, alpha=0.25, hatch=HATCHES[i + 1], linewidth=0.0
            )
            label = f"{band.settings}, {band.members} runs"
            axes.plot(band.times, band.mean, color=color, linestyle=DASHES[i], label=label)
        axes.axvline(report.horizon, color=INK.css, linewidth=1)
        axes.set(title=name, xlabel="simulated time  [s]" if k > 1 else "", ylabel=f"[{UNITS[name]}]")
        if k == 0:
            axes.legend()
    return figure


def _variants(report: CompareReport) -> Figure:
    figure, axes = axes_for()
    for i, v in enumerate(report.variants):
        if v.ms is not None and v.error:
            _line(axes, [(v.ms * FRAME, v.error)], i, v.name)
    floors = [v.floor for v in report.variants if v.floor]
    if floors:
        axes.axhline(max(floors), color=INK.css, linewidth=1.6)
        note = {"transform": axes.get_yaxis_transform(), "fontsize": 12, "va": "bottom"}
        axes.text(0.005, max(floors), f"floor: the reference is known to {percent(max(floors))}", **note)
    _log_log(axes, "time per frame of 1/60 s  [ms]", "error, relative")
    axes.margins(x=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title=report.by)
    axes.set_title(f"{report.scene}: first {report.horizon:.3g} s, by {report.by}", loc="left")
    return figure
