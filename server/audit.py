"""What `muslin audit` found, as a table, sentences and a plot."""

from __future__ import annotations

import math

from matplotlib import rc_context
from matplotlib.ticker import FuncFormatter

from server.figures import HATCHES, LOOKS, Figures, axes_for
from server.palette import INK, STONE
from sim.effects import title
from sim.studies import Result, Table
from sim.studies.cost.report import AuditedEffect, AuditReport
from sim.studies.cost.verdict import percent

KEPT = "●"
"""Marks effects that matter."""

SMALLEST = 1e-9
"""Influences below this are drawn at the edge of the plot, if it reaches as far."""

DECADES = 4.0
"""That the plot reaches below the numerical error: what is smaller is of no account."""


def audit_result(report: AuditReport) -> Result:
    """The audit as a table."""
    columns = (
        "",
        "effect",
        "now",
        "verdict",
        "influence [%]",
        "in errors",
        "cost [%]",
        "ran [%]",
        "last step",
    )
    effects = sorted(report.effects, key=lambda e: (e.now == "off", -_moves(e)))
    about = (
        f"numerical error {percent(report.numerical_error)}; {report.ms:.3g} ms per step as it is; costs to "
        f"± {percent(report.cost_noise)} of that"
    )
    caption = f"Every effect left out, or brought in where it is off ({KEPT}: matters); {about}"
    table = Table(caption, columns, tuple(map(_row, effects)))
    return Result(f"What {report.scene} needs", (table,), ())


def _row(effect: AuditedEffect) -> tuple[str | float | None, ...]:
    return (
        KEPT if effect.verdict == "matters" else "",
        effect.name,
        effect.now,
        effect.verdict if effect.now != "off" else f"brought in: {effect.verdict}",
        None if effect.influence is None else 100.0 * effect.influence,
        effect.errors,
        round(100.0 * effect.cost_share, 1) + 0.0,  # no "-0"
        100.0 * effect.ran,
        effect.why,
    )


def cost_text(share: float) -> str:
    """What an effect costs, as part of a step; a difference of times that is noise may be below zero.

    Where cloth goes wild without it, and each step takes more than twice as long, that is said instead.
    """
    if share < -1.0:
        return f"{1.0 - share:.3g} × the time without it"
    return f"for {100.0 * share + 0.0:.1f} % of a step".replace("-", "−")


def _moves(effect: AuditedEffect) -> float:
    """How far the cloth goes without an effect, infinitely where it cannot do without."""
    return float("inf") if effect.influence is None else effect.influence


def sentence(report: AuditReport) -> str:
    """What to do about it."""
    if not report.recommended:
        return (
            f"Within {percent(report.tolerance)} {report.scene} needs every effect that runs: "
            f"{report.ms:.3g} ms per step."
        )
    *first, last = map(title, report.recommended)
    names = f"{', '.join(first)} and {last}" if first else last
    return (
        f"Within {percent(report.tolerance)} {report.scene} does without {names}: "
        f"{report.ms:.3g} ms per step become {report.recommended_ms:.3g}, and the cloth moves by "
        f"{percent(report.recommended_error)}."
    )


def audit_figures(report: AuditReport) -> Figures:
    """Influence beside cost, a pair of bars for each effect that the scene has."""
    known = [e for e in report.effects if e.now != "off" and e.ran > 0.0]
    known.sort(key=_moves)
    if not known:
        return {}
    with rc_context(LOOKS):
        figure, axes = axes_for((12.0, 2.0 + 0.5 * len(known)))
        error = max(report.numerical_error, SMALLEST)
        least, most = error * 10.0**-DECADES, max(1.0, 10.0 * error)
        for i, effect in enumerate(known):
            width = min(max(_moves(effect), least), most)
            axes.barh(i, width, color=STONE.css, edgecolor=INK.css, hatch=HATCHES[0], height=0.6)
            words = (
                f"  {percent(effect.influence)}" if effect.influence is not None else "  cannot be left out"
            )
            beside = {"va": "center", "zorder": 4, "bbox": {"fc": "white", "ec": "none", "pad": 1.5}}
            axes.text(1.15 * width, i, f"{words}, {cost_text(effect.cost_share)}", **beside)
        axes.axvline(error, color=INK.css, linestyle="--")
        axes.set_yticks(range(len(known)), [title(e.name) for e in known])
        axes.set(xscale="log", xlabel="moves the cloth by, relative; dashed: the numerical error")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{100 * x:g} %"))
        axes.set_xlim(least, 300.0 * most)  # room for words
        axes.set_xticks(
            [10.0**k for k in range(math.ceil(math.log10(least)), math.floor(math.log10(most)) + 1)]
        )
        axes.set_xticks([], minor=True)
        axes.grid(False, axis="y")
        noise = percent(report.cost_noise)
        caption = f"What each effect changes, and what part of a step it costs, to ± {noise}."
        return {"influence": (caption, figure)}
