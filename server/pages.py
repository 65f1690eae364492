"""Reports of cost, comparison and audit as tables for a terminal, and as a page that needs no network."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

from jinja2 import Environment, PackageLoader, Template, select_autoescape

from server.audit import audit_figures, audit_result, sentence
from server.benchmark import conditions
from server.cost_figures import compare_figures, cost_figures
from server.figures import Figures, inline_svg
from server.study import cell_text
from sim.studies import Cell, Result, Table
from sim.studies.cost.measures import UNITS
from sim.studies.cost.report import AuditReport, Balance, CompareReport, CostReport, Run, Variant
from sim.studies.cost.verdict import FRAME, in_words, value_in_words

FRONT = "●"
"""Marks runs on the Pareto front."""

Row = tuple[Cell, ...]


Report = CostReport | CompareReport | AuditReport


def result(report: Report) -> Result:
    """The report as tables and sentences; what to do about it comes last, where a terminal still shows it."""
    about = {
        "command": report.command,
        "date": report.date,
        "hardware": report.hardware,
        "versions": report.versions,
    }
    if isinstance(report, AuditReport):
        made = audit_result(report)
    else:
        made = _cost_result(report) if isinstance(report, CostReport) else _compare_result(report)
    last = (words.rstrip() for words in _top(report) if words)
    return Result(made.title, made.tables, (*made.notes, *report.notes, *conditions(about), *last))


def figures(report: Report) -> Figures:
    """The report as plots."""
    if isinstance(report, AuditReport):
        return audit_figures(report)
    return cost_figures(report) if isinstance(report, CostReport) else compare_figures(report)


def page(report: Report, result: Result, figures: Figures) -> str:
    """The report as a page."""
    *sentences, toml = (words.rstrip() for words in _top(report))
    return _template().render(
        title=result.title,
        about=f"{report.vertices:,} vertices; {report.seconds:.3g} s simulated{_told(report)}. "
        f"{report.command} · {report.date}",
        sentences=sentences[::-1],
        toml=toml,
        figures=[
            {"name": name, "caption": caption, "svg": inline_svg(figure, name)}
            for name, (caption, figure) in figures.items()
        ],
        tables=[_laid_out(table) for table in result.tables],
        notes=[note for note in result.notes if note not in (*sentences, toml)],
    )


def _top(report: Report) -> tuple[str, ...]:
    """What a terminal ends with: sentences, the one to act on last, and what to paste into the scene."""
    if isinstance(report, AuditReport):
        return sentence(report), report.toml
    if isinstance(report, CostReport):
        return report.verdict.dominates, report.verdict.sentence, report.verdict.toml
    return ("",)


def _told(report: Report) -> str:
    """For how long errors are told."""
    if isinstance(report, AuditReport):
        return ""
    return "; errors are " + ("not told" if report.horizon is None else f"told up to {report.horizon:.3g} s")


@cache
def _template() -> Template:
    environment = Environment(loader=PackageLoader("server"), autoescape=select_autoescape())
    return environment.get_template("study.html")


SHORT = 24
"""Characters of words that are never put on two lines."""


def _laid_out(table: Table) -> dict[str, object]:
    """A table as the template wants it: how columns look, and which rows are marked."""
    looks = [_look([row[k] for row in table.rows]) for k in range(len(table.columns))]
    rows = [
        {"cells": list(zip(map(cell_text, row), looks, strict=True)), "marked": FRONT in row}
        for row in table.rows
    ]
    return {"caption": table.caption, "columns": list(zip(table.columns, looks, strict=True)), "rows": rows}


def _look(column: Sequence[Cell]) -> str:
    """The class of a column: numbers have none."""
    words = [cell for cell in column if isinstance(cell, str)]
    if not words:
        return ""
    return "long words" if max(map(len, words)) > SHORT else "words"


# muslin cost


def _cost_result(report: CostReport) -> Result:
    tables = [_runs(report), _phases(report), _sources(report)]
    tables += [table for table in (_meshes(report), _failed(report), _curves(report)) if table.rows]
    checks = ", ".join(f"{name} {apart:.1e}" for name, apart in report.reference.checks.items())
    fold = report.growth.e_fold
    drift = f"grow apart e times every {fold:.2g} s" if fold else "do not grow apart exponentially"
    notes = (
        f"Positions are compared up to {report.horizon:.3g} s: {report.why_horizon}. Runs moved by a hair "
        f"{drift}.",
        f"Reference: SDIRK2 with steps of {1e3 * report.reference.dt:.3g} ms. Its distance from what checks "
        f"it: {checks}; the larger one is the floor.",
    )
    return Result(f"What accuracy costs: {report.scene}", tuple(tables), notes)


KNOBS = ("integrator", "dt", "newton", "tolerance")
"""Settings that have a column of their own."""


def _runs(report: CostReport) -> Table:
    columns = ("", "integrator", "h", "Newton", "tol. [m]", "other", "ms/frame", "× real", "error %")
    columns += ("energy %", "matvecs/s", "queries/s")
    order = sorted(report.runs, key=lambda run: run.ms)
    caption = f"Runs by cost ({FRONT}: on the Pareto front); milliseconds per frame of 1/60 s, medians"
    return Table(caption, columns, tuple(_run_row(report, run) for run in order))


def _run_row(report: CostReport, run: Run) -> Row:
    other = {name: value for name, value in run.changed.items() if name not in KNOBS}
    return (
        FRONT if run.front else "",
        *(value_in_words(name, getattr(run.settings, name)) for name in KNOBS),
        "as chosen" if run is report.runs[0] else ", ".join(map(str, other.values())),
        FRAME * run.ms,
        1e3 / run.ms,
        *(100.0 * error for error in (run.error, run.error_energy)),
        round(run.matvecs),
        round(run.queries),
    )


def _name(report: CostReport, run: Run) -> str:
    return "as chosen" if run is report.runs[0] else in_words(run.changed)


def _phases(report: CostReport) -> Table:
    """Where the time goes, for the chosen run and those on the front."""
    shown = [run for run in sorted(report.runs, key=lambda r: r.ms) if run.front or run is report.runs[0]]
    phases = list(dict.fromkeys(name for run in shown for name in run.phases))
    rows = tuple(
        (_name(report, run), *(FRAME * run.phases.get(phase, 0.0) for phase in phases)) for run in shown
    )
    return Table("Milliseconds per frame by phase, on the front", ("settings", *phases), rows)


def _sources(report: CostReport) -> Table:
    names = list(dict.fromkeys(name for source in report.sources for name in source.observables))
    columns = ("source", "turned from … to", "moves the cloth by [%]", *(f"{n} [{UNITS[n]}]" for n in names))
    rows = tuple(
        (
            source.source,
            source.reason or source.what,
            None if source.change is None else 100.0 * source.change,
            *(source.observables.get(name) for name in names),
        )
        for source in report.sources
    )
    return Table(
        "Where the error of the chosen settings comes from: what each knob changes by itself", columns, rows
    )


def _meshes(report: CostReport) -> Table:
    names = list(report.meshes[0].observables) if report.meshes else []
    columns = ("vertices", "ms per frame", *(f"{n} [{UNITS[n]}]" for n in names))
    rows = tuple(
        (level.vertices, FRAME * level.ms, *(level.observables[name] for name in names))
        for level in report.meshes
    )
    return Table("The same cloth on nested meshes; compare observables only", columns, rows)


def _failed(report: CostReport) -> Table:
    rows = tuple((f.curves[0], in_words(f.changed), f.reason) for f in report.failed)
    return Table("Runs that failed", ("curve", "differs in", "why"), rows)


def _curves(report: CostReport) -> Table:
    rows = tuple((c.name, c.order, c.expected) for c in report.curves if c.order is not None)
    return Table(
        "Slopes of the errors over the time step", ("curve", "observed order", "where motion is smooth"), rows
    )


# muslin compare


def _compare_result(report: CompareReport) -> Result:
    horizon = "no error is told" if report.horizon is None else f"errors up to {report.horizon:.3g} s"
    notes = (f"Reference: {report.reference}; {horizon}.",)
    tables = _cost(report), _state(report), _balance(report), _observables(report), _stopped(report)
    title = f"{report.scene} by {report.by}, {report.seconds:.3g} s"
    return Result(title, tuple(table for table in tables if table.rows), notes)


def _cost(report: CompareReport) -> Table:
    phases = list(dict.fromkeys(name for v in report.variants for name in v.phases))
    columns = (report.by, "ms per frame", "× real time", *(f"{name} [ms]" for name in phases))
    columns += ("matvecs / s", "queries / s", "error [%]", "floor [%]")
    return Table("Cost by phase, and error", columns, tuple(_cost_row(v, phases) for v in report.variants))


def _cost_row(v: Variant, phases: Sequence[str]) -> Row:
    ms = None if v.ms is None else FRAME * v.ms
    errors = (None if error is None else 100.0 * error for error in (v.error, v.floor))
    spent = (FRAME * v.phases.get(name, 0.0) for name in phases)
    return v.name, ms, 1e3 / v.ms if v.ms else None, *spent, round(v.matvecs), round(v.queries), *errors


def _state(report: CompareReport) -> Table:
    columns = (report.by, "energy [J]", "change [J]", "largest rise [J]", "vertices inside", "deepest [mm]")
    columns += ("most crossings", "longest edge [%]")
    rows = tuple(
        (
            v.name,
            sum(v.energy.values()),
            v.energy_change,
            v.energy_rise,
            v.penetrations,
            1e3 * v.deepest,
            v.crossings,
            100.0 * v.stretch,
        )
        for v in report.variants
    )
    return Table("Energy at the end, and how the cloth fared on the way", columns, rows)


def _balance(report: CompareReport) -> Table:
    """Where energy went, a column for each variant: what stands above “= at the end” adds up to it."""
    balances = [v.balance for v in report.variants]

    def row(title: str, value: Callable[[Balance], float | None]) -> Row:
        return title, *map(value, balances)

    def rows(before: str, part: str) -> list[Row]:
        """Of the entries that any variant has."""
        parts = [getattr(b, part) for b in balances]
        names = dict.fromkeys(name for entries in parts for name in entries)
        return [
            row(f"{before} {name}", lambda b, name=name: getattr(b, part).get(name))
            for name in names
            if any(entries.get(name) for entries in parts)
        ]

    kinds = rows("  of it", "energy")
    flows = [*rows("+", "injected"), *rows("−", "dissipated"), row("± residual", lambda b: b.residual)]
    ends = row("at the start", lambda b: b.start), row("= at the end", lambda b: sum(b.energy.values()))
    columns = (report.by, *(v.name for v in report.variants))
    caption = "Where energy went [J]; what was taken (−) and is below zero was put in"
    return Table(caption, columns, (ends[0], *flows, ends[1], *kinds))


def _observables(report: CompareReport) -> Table:
    names = list(dict.fromkeys(name for v in report.variants for name in v.observables))
    rows = tuple((v.name, *(v.observables.get(name) for name in names)) for v in report.variants)
    return Table("Observables at the end", (report.by, *(f"{n} [{UNITS[n]}]" for n in names)), rows)


def _stopped(report: CompareReport) -> Table:
    rows = tuple((v.name, v.stopped) for v in report.variants if v.stopped)
    return Table("Runs that failed", (report.by, "why"), rows)
