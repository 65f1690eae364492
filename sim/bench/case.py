"""One case, in a process of its own: `python -m sim.bench.case '{"measure": "steps", …}'`.

It prints lines of JSON, each all that was found by then, so that a process that is stopped has said what it
knew. What packages print goes to standard error.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from sim.bench import Case, Measured, solvers
from sim.bench.memory import peak_memory
from sim.bench.sheet import Sheet

Say = Callable[[Measured], None]


def main(text: str) -> None:
    """Measure the case that is given as JSON."""
    told = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def say(found: Measured) -> None:
        told.write(json.dumps(found) + "\n")
        told.flush()

    measure(Case(**json.loads(text)), say)


def measure(case: Case, say: Say) -> None:
    """Measure a case, and say what was found as soon as it was."""
    sheet = Sheet(case.kind, math.isqrt(case.size))
    MEASURES[case.measure](case, sheet, say)


def _steps(case: Case, sheet: Sheet, say: Say) -> None:
    from sim.bench.steps import measure_steps

    measure_steps(sheet, case.threads, case.steps, case.seconds, say)


def _frames(case: Case, sheet: Sheet, say: Say) -> None:
    from sim.bench.frames import measure_frames

    begin = time.perf_counter()
    peer = solvers()[case.solver].load()
    knobs = peer.FRAMES[case.setting]
    measure_frames(lambda: peer.start(sheet, knobs, case.threads), sheet, knobs, case.seconds, say, begin)


def _accuracy(case: Case, sheet: Sheet, say: Say) -> None:
    from sim.bench.accuracy import climb

    peer = solvers()[case.solver].load()

    def start(knobs: Any) -> Any:
        return peer.start(sheet, knobs, case.threads)

    for found in climb(start, peer.FRAMES, peer.LADDER, peer.OTHERS, case.seconds, sheet.strain):
        say({**found, "memory": peak_memory()})


MEASURES = {"steps": _steps, "frames": _frames, "accuracy": _accuracy}

if __name__ == "__main__":
    main(sys.argv[1])
