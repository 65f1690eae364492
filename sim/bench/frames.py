"""Milliseconds per frame of any solver."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from sim.bench.memory import peak_memory
from sim.bench.peers import Knobs, Run, words
from sim.bench.sheet import Sheet

MOST = 60
"""Frames that are timed; one second."""


def measure_frames(
    start: Callable[[], Run],
    sheet: Sheet,
    knobs: Knobs,
    seconds: float,
    say: Callable[[dict[str, Any]], None],
    begin: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> None:
    """Time the frames of a sheet, after one in a run of its own that compiles what there is to compile.

    Args:
        start: Makes a run.
        sheet: What runs.
        knobs: Its settings, to be named in what is said.
        seconds: After which no more frames are begun [s].
        say: Is told "settings", "start_up" [s], "ms" of each frame, "memory" [MB] and "strain", the largest
            of an edge, first before any frame and then at the end.
        begin: When its start-up began, by the clock [s].
        clock: Tells the time [s].
    """
    begin = clock() if begin is None else begin
    start().frame()
    found: dict[str, Any] = {"settings": words(knobs), "start_up": clock() - begin, "ms": []}
    say(found)
    run = start()
    limit = clock() + seconds
    while len(found["ms"]) < MOST and clock() < limit:
        before = clock()
        run.frame()
        found["ms"].append(1e3 * (clock() - before))
    say({**found, "memory": peak_memory(), "strain": sheet.strain(run.positions())})
