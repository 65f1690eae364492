"""The bench without a page: measure, print the tables, and write them as JSON, as a page or as Markdown."""

from __future__ import annotations

import datetime
import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace

from rich.console import Console

from server.study import cell_text, show, write
from sim import bench
from sim.studies import Progress, Result, Table

BUSY = 0.5
"""Load average from which on other processes disturb."""


def run_bench(
    sizes: Sequence[int],
    threads: Sequence[int] | None = None,
    steps: int = bench.STEPS,
    seconds: float = bench.SECONDS,
    peers: bool = False,
    **files: str | None,
) -> int:
    """Measure, print, and write to the files that are given as `json`, `html` and `markdown`.

    Returns:
        The exit code.

    Raises:
        ValueError, OSError: before anything is measured, for a call that makes no sense.
    """
    from sim.bench.hardware import hardware, versions
    from sim.bench.tables import tabulate
    from sim.export import check_outputs

    threads = _threads() if threads is None else threads
    bench.check(sizes, threads, steps, seconds)
    check_outputs(**files)
    computer = hardware()
    found = _run(bench.plan(sizes, threads, steps, seconds, peers))
    computer["threading_layer"] = next((result["layer"] for _, result in found if "layer" in result), None)
    about: dict[str, object] = {
        "command": command(sizes, threads, steps, seconds, peers),
        "date": datetime.date.today().isoformat(),
        "hardware": computer,
        "versions": versions(),
    }
    _hand_over(tabulate(found), "steps", about, **files)
    return 0


def run_scenes(scenes: Sequence[str], steps: int, cold: bool, **files: str | None) -> int:
    """The same for what effects cost whole scenes."""
    from sim.bench.scenes import WARM, measure_scenes

    bench.check_steps(steps, WARM + 2)
    words = ["--scenes", *scenes, "--steps", str(steps), *["--cold"] * cold]
    return _measured("scenes", words, lambda told: measure_scenes(scenes, steps, cold, told), **files)


def run_contact(sizes: Sequence[int], threads: Sequence[int] | None, steps: int, **files: str | None) -> int:
    """The same for what each response to contact costs, and what it keeps out."""
    from sim.bench.contact import WARM, measure_contact

    threads = _threads() if threads is None else threads
    bench.check(sizes, threads, steps, fewest=WARM + 2)
    words = ["--contact", "--sizes", *map(str, sizes), "--threads", *map(str, threads), "--steps", str(steps)]
    return _measured("contact", words, lambda told: measure_contact(sizes, threads, steps, told), **files)


def _measured(
    name: str, words: Sequence[str], measure: Callable[[Progress], Result], **files: str | None
) -> int:
    """Measure, say how far it is, and hand over what was found by `muslin bench` with these `words`."""
    from sim.bench.hardware import hardware, versions
    from sim.export import check_outputs

    check_outputs(**files)
    about: dict[str, object] = {
        "command": shlex.join(["muslin", "bench", *words]),
        "date": datetime.date.today().isoformat(),
        "hardware": hardware(),
        "versions": versions(),
    }
    with Console(stderr=True).status("starting") as status:
        result = measure(lambda done, what: status.update(f"{done:.0%}  {what}"))
    _hand_over(result, name, about, **files)
    return 0


def _hand_over(result: Result, bench: str, about: dict[str, object], **files: str | None) -> None:
    """Print a result with what it was measured by, and write it to the files that are given."""
    from sim.export import write_whole

    result = replace(result, notes=(*result.notes, *conditions(about)))
    show(result)
    write(result, {"bench": bench, **about}, files.get("json"), files.get("html"))
    if (path := files.get("markdown")) is not None:
        text = as_markdown(result).encode()
        write_whole(path, lambda stream: stream.write(text))


def _threads() -> list[int]:
    """1, and 2 where there are as many cores."""
    return list(range(1, min(2, os.cpu_count() or 1) + 1))


def _run(cases: list[bench.Case]) -> list[tuple[bench.Case, bench.Measured]]:
    """What was found; a terminal is told how far it is."""
    with Console(stderr=True).status("starting") as status:
        return bench.run(cases, lambda done, what: status.update(f"{done:.0%}  {what}"))


def command(sizes: Sequence[int], threads: Sequence[int], steps: int, seconds: float, peers: bool) -> str:
    """What to type for the same again."""
    words = ["muslin", "bench", "--sizes", *map(str, sizes), "--threads", *map(str, threads)]
    words += ["--steps", str(steps), "--seconds", f"{seconds:g}", *(["--peers"] if peers else [])]
    return shlex.join(words)


def conditions(about: dict[str, object]) -> tuple[str, ...]:
    """Sentences on what a result was measured with and by."""
    computer, versions = _items(about["hardware"]), _items(about["versions"])
    load = dict(computer).get("load")
    hardware = (
        f"{name.removesuffix('_gb').replace('_', ' ')} {_known(value)}" + " GB" * name.endswith("_gb")
        for name, value in computer
    )
    notes = [
        f"Measured on {about['date']} by `{about['command']}`.",
        f"Hardware: {', '.join(hardware)}. "
        f"Versions: {', '.join(f'{name} {value}' for name, value in versions)}.",
    ]
    if isinstance(load, float) and load > BUSY:
        notes.append(
            "The computer was busy with other things before this began: times are too long, and those with "
            "all cores most of all."
        )
    return tuple(notes)


def as_markdown(result: Result) -> str:
    """The result as Markdown."""
    parts = [f"# {result.title}"]
    for table in result.tables:
        parts += [f"## {table.caption}", _markdown_table(table)]
    return "\n\n".join([*parts, "## What this means", *result.notes]) + "\n"


def _items(mapping: object) -> list[tuple[str, object]]:
    return list(mapping.items()) if isinstance(mapping, dict) else []


def _known(value: object) -> str:
    return "unknown" if value is None else cell_text(value) if isinstance(value, float) else str(value)


def _markdown_table(table: Table) -> str:
    rows = [table.columns, tuple("---" for _ in table.columns)]
    rows += [tuple(cell_text(cell).replace("|", "\\|") for cell in row) for row in table.rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
