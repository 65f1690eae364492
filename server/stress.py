"""The battery without a page: run it, print what each case found, and write it as JSON or as a page."""

from __future__ import annotations

import datetime
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

import sim
from server.palette import BRAND, INK, WHITE
from server.study import WIDTH, cell_text
from sim import stress
from sim.refusal import counted
from sim.stress import Figure
from sim.stress.verdict import Verdict

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

BAD, GOOD = "#b3261e", "#00694c"
"""Of verdicts; words say the same."""


def run_stress(
    names: Sequence[str] = (),
    full: bool = False,
    seed: int = 0,
    runs: int | None = None,
    jobs: int | None = None,
    json: str | None = None,
    html: str | None = None,
    keep: str | None = None,
    cluster: str | None = None,
) -> int:
    """Run cases, print each as it is done, and write files where asked for.

    Args:
        names: Of cases; those of the battery where empty.
        full: Every case with all its runs, rather than a few minutes' worth.
        seed: Of the first run of each case.
        runs: Of each case, if not for it to say.
        jobs: Processes; as many as there are cores if left out.
        json: File for what was found, as numbers.
        html: File for the same as a page, with pictures.
        keep: Folder for what failures leave behind.
        cluster: Address of a Dask scheduler.

    Returns:
        0, 1 where a case failed, or 130 after Ctrl-C, which ends it with what was found by then.

    Raises:
        ValueError, OSError: before anything is run, for a call that makes no sense.
    """
    from sim.export import check_outputs, check_writable, save_json, write_whole
    from sim.stress.executor import run_tasks

    _check(seed, runs, jobs)
    check_outputs(json=json, html=html)
    if keep is not None:
        _make_folder(keep)
        check_writable(Path(keep) / "probe")
    chosen = stress.choose(names, full)
    tasks = stress.plan(chosen, full, seed, runs)
    verdicts = {c.name: Verdict(c, sum(task.name == c.name for task in tasks)) for c in chosen}
    tasks.sort(key=lambda task: -verdicts[task.name].case.seconds)  # long ones first, so that none is left
    printer, interrupted = Printer(), False
    try:
        with printer.status(len(tasks)) as done:
            for outcome in run_tasks(tasks, jobs, cluster):
                verdict = verdicts[outcome.task.name]
                verdict.add(outcome)
                if keep is not None:
                    verdict.kept += keep_failure(outcome, keep)
                done(outcome.task.name)
                if verdict.complete:
                    printer.verdict(verdict)
    except KeyboardInterrupt:
        interrupted = True
    found = list(verdicts.values())
    printer.summary(found)
    about = conditions("chosen" if names else "full" if full else "short", seed)
    if json is not None:
        save_json(json, as_json(found, about))
    if html is not None:
        page = as_html(found, about).encode()
        write_whole(html, lambda stream: stream.write(page))
    if interrupted:
        return INTERRUPTED
    return 0 if all(verdict.passed for verdict in found) else 1


def _check(seed: int, runs: int | None, jobs: int | None) -> None:
    if not 0 <= seed < 2**31 - 10_000:
        raise ValueError(f"--seed: expected 0 to {2**31 - 10_001}, got {seed}")
    for name, value in (("runs", runs), ("jobs", jobs)):
        if value is not None and not 1 <= value <= 10_000:
            raise ValueError(f"--{name}: expected 1 to 10,000, got {value}")


def keep_failure(outcome, folder: str) -> list[str]:
    """Write what a failure left behind; the files' paths."""
    if not outcome.kept:
        return []
    from sim.stress.keep import save

    return [
        str(file) for file in save(outcome.kept, Path(folder) / f"{outcome.task.name}-{outcome.task.seed}")
    ]


class Printer:
    """What a terminal is told."""

    def __init__(self) -> None:
        width = None if sys.stdout.isatty() else WIDTH
        self._console = Console(width=width, markup=False, highlight=False)
        self._live = Console(stderr=True)

    def status(self, total: int):
        """How far it is, on a terminal."""
        return _Status(self._live, total)

    def verdict(self, verdict: Verdict) -> None:
        """A case: what it does, what was found, and how to see it again."""
        head = Text()
        head.append(
            "passed  " if verdict.passed else "FAILED  ", style="green" if verdict.passed else "bold red"
        )
        head.append(f"{verdict.case.name}  ", style="bold")
        head.append(f"{verdict.case.title}")
        self._console.print(head)
        self._say(verdict.case.about)
        for figure in verdict.figures:
            self._say(figure_text(figure), style=None if figure.passed else "bold red")
        for trouble in verdict.troubles:
            self._say(trouble, style="bold red")
        if verdict.failures:
            seeds = ", ".join(str(outcome.task.seed) for outcome in verdict.failures)
            self._say(f"{len(verdict.failures)} of {verdict.runs} runs failed: seeds {seeds}")
        for file in verdict.kept:
            self._say(f"kept: {file}")
        self._say(verdict.command, style="dim")
        self._console.print()

    def _say(self, words: str, style: str | None = None) -> None:
        self._console.print(Text(f"        {words}", style=style or ""), soft_wrap=True)

    def summary(self, verdicts: Sequence[Verdict]) -> None:
        """One line for each case."""
        table = Table(
            "case",
            "what",
            "figure",
            "mark",
            "runs",
            "s",
            "",
            caption=counts(verdicts),
            caption_justify="left",
        )
        for column in (2, 3, 4, 5):
            table.columns[column].justify = "right"
        for verdict in verdicts:
            table.add_row(*row(verdict), style=None if verdict.passed else "bold red")
        self._console.print(table)


class _Status:
    """A spinner that says how many tasks are done."""

    def __init__(self, console: Console, total: int) -> None:
        self._status, self._total, self._done = console.status("getting kernels ready"), total, 0

    def __enter__(self):
        self._status.__enter__()
        return self._tell

    def __exit__(self, *error) -> None:
        self._status.__exit__(*error)

    def _tell(self, name: str) -> None:
        self._done += 1
        self._status.update(f"{self._done} of {self._total} runs; the last was of {name}")


def figure_text(figure: Figure) -> str:
    """A figure beside its mark."""
    value = f"{figure.what}: {cell_text(figure.value)} {figure.unit}".rstrip()
    return value if figure.mark is None else f"{value} ({mark_text(figure)})"


def mark_text(figure: Figure) -> str:
    """What a figure is held against."""
    if figure.mark is None:
        return "reported"
    return f"{'≥' if figure.least else '≤'} {cell_text(float(figure.mark))} {figure.unit}".rstrip()


def row(verdict: Verdict) -> tuple[str, ...]:
    """A case in the table: its figure that is nearest to its mark, or farthest beyond."""
    worst = verdict.worst
    what, value, mark = (
        ("–", "–", "–") if worst is None else (worst.what, cell_text(worst.value), mark_text(worst))
    )
    if verdict.troubles and (worst is None or worst.passed):
        what, value, mark = verdict.troubles[0], "–", "–"
    state = "passed" if verdict.passed else "FAILED" if verdict.failures else "not done"
    return (verdict.case.name, what, value, mark, str(len(verdict.outcomes)), f"{verdict.seconds:.0f}", state)


def _make_folder(keep: str) -> None:
    try:
        Path(keep).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"--keep: {keep}: no folder can be there: {error.strerror}") from None


def counts(verdicts: Sequence[Verdict]) -> str:
    """What was run, in a sentence."""
    failed = sum(not verdict.passed for verdict in verdicts)
    runs, steps = (sum(n) for n in zip(*((len(v.outcomes), v.steps) for v in verdicts), strict=True))
    auditors = " or ".join(dict.fromkeys(v.auditor for v in verdicts if v.auditor))
    judged = f" Intersections were judged by {auditors}." if auditors else ""
    outcome = f"{failed} failed" if failed else "all passed"
    done = ", ".join((counted(len(verdicts), "case"), counted(runs, "run"), counted(steps, "step")))
    return f"{done}: {outcome}.{judged}"


def conditions(battery: str, seed: int) -> dict[str, object]:
    """What a battery was run with and by."""
    from sim.bench.hardware import hardware, versions

    return {
        "battery": battery,
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "version": sim.__version__,
        "hardware": hardware(),
        "versions": versions(),
    }


def as_json(verdicts: Sequence[Verdict], about: dict[str, object]) -> dict[str, object]:
    """The battery as plain data."""
    return {
        **about,
        "passed": all(verdict.passed for verdict in verdicts),
        "steps": sum(verdict.steps for verdict in verdicts),
        "cases": [verdict.builtins() for verdict in verdicts if verdict.outcomes],
    }


STYLE = (
    f"body{{font:15px/1.45 system-ui,sans-serif;color:{INK.css};background:{WHITE.css};margin:2em auto;"
    "max-width:82em;padding:0 1.5em}"
    f"h1{{font-size:1.5em;margin:0 0 .2em}}h2{{font-size:1.1em;margin:0}}a{{color:{BRAND.css}}}"
    "table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}"
    "th,td{text-align:left;padding:.2em .8em .2em 0;vertical-align:top}th{font-weight:600}"
    "tr{border-bottom:1px solid #e6e2dc}td.n,th.n{text-align:right;white-space:nowrap}"
    ".scroll{overflow-x:auto}.dim{color:#6f675f}.cards{display:grid;gap:1.2em;margin-top:2em;"
    "grid-template-columns:repeat(auto-fill,minmax(min(24em,100%),1fr))}"
    ".card{border:1px solid #e6e2dc;border-radius:6px;overflow:hidden;display:flex;flex-direction:column}"
    ".card svg{display:block;width:100%;height:auto}.card>div{padding:.7em 1em 1em}"
    ".card table{font-size:.87em;margin:.5em 0}.card p{margin:.3em 0}"
    "code{font:.8em ui-monospace,Menlo,'DejaVu Sans Mono',monospace;overflow-wrap:anywhere}"
    f".good{{color:{GOOD}}}.bad{{color:{BAD};font-weight:650}}.card.failed{{border-color:{BAD}}}"
)


def as_html(verdicts: Sequence[Verdict], about: dict[str, object]) -> str:
    """The battery as a page that needs nothing but itself."""
    from server.drawing import BACKGROUND

    heads = ("case", "what", "figure", "mark", "runs", "s", "")
    numeric = (False, False, True, True, True, True, False)
    head = "".join(f'<th class="{"n" if n else ""}">{h}</th>' for h, n in zip(heads, numeric, strict=True))
    lines = []
    for verdict in verdicts:
        cells = [escape(cell) for cell in row(verdict)]
        cells[0] = f'<a href="#{escape(verdict.case.name)}">{cells[0]}</a>'
        tone = "good" if verdict.passed else "bad"
        cells[-1] = f'<span class="{tone}">{cells[-1]}</span>'
        tds = "".join(f'<td class="{"n" if n else ""}">{c}</td>' for c, n in zip(cells, numeric, strict=True))
        lines.append(f"<tr>{tds}</tr>")
    cards = "".join(card(verdict) for verdict in verdicts if verdict.outcomes)
    versions = about["versions"] if isinstance(about["versions"], dict) else {}
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="UTF-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Muslin: the battery</title><style>{STYLE}.card svg{{background:{BACKGROUND}}}</style></head>"
        "<body>"
        f"<h1>Muslin: the battery, {about['battery']} cases</h1><p>{escape(counts(verdicts))}</p>"
        f'<p class="dim">{about["date"]}, seed {about["seed"]}; {escape(packages)}</p>'
        f'<div class="scroll"><table><tr>{head}</tr>{"".join(lines)}</table></div>'
        f'<div class="cards">{cards}</div></body></html>\n'
    )


def card(verdict: Verdict) -> str:
    """A case with its picture."""
    from server.drawing import drawing

    shown, name, title = verdict.shown, escape(verdict.case.name), escape(verdict.case.title)
    seen = drawing(shown.picture, verdict.case.title) if shown and shown.picture is not None else ""
    rows = "".join(
        f"<tr><td>{escape(figure.what)}</td>"
        f'<td class="n {"" if figure.passed else "bad"}">{cell_text(figure.value)}</td>'
        f'<td class="n dim">{escape(mark_text(figure))}</td></tr>'
        for figure in verdict.figures
    )
    troubles = "".join(f'<p class="bad">{escape(trouble)}</p>' for trouble in verdict.troubles)
    seeds = ", ".join(str(outcome.task.seed) for outcome in verdict.failures)
    failed = f'<p class="bad">failed with seeds {seeds}</p>' if seeds else ""
    return (
        f'<section class="card {"" if verdict.passed else "failed"}" id="{name}">{seen}<div>'
        f'<h2>{name} <span class="dim">{title}</span></h2><p>{escape(verdict.case.about)}</p>'
        f"<table>{rows}</table>{troubles}{failed}<code>{escape(verdict.command)}</code></div></section>"
    )
