"""Measures, when asked, the damping that each variant's cloth really has, in a thread of its own."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import msgspec

from server import style
from server.comparison import Comparison
from server.digits import written
from server.palette import VARIANTS
from sim.scene import Scene

LONGEST = 2.0
"""Period [s] of the slowest mode that is measured: slower ones would be waited for too long."""

EXPLANATION = (
    "Deflects the resting cloth a little in the shape of its slowest mode, lets go, and fits the motion. "
    f"Obstacles are left out, and modes with a period over {LONGEST:g} s."
)

Results = Sequence[Any]
"""For each variant a ModalDamping, a reason why there is none, or None while it is measured."""

_log = logging.getLogger(__name__)


def measure_damping(scene: Scene) -> Any:
    """The real measurement of a scene with its settings."""
    import sim

    return sim.modal_damping(scene, longest=LONGEST)


class RingDown:
    """Measures variants one after the other; of several requests only the newest is answered.

    Args:
        measure: Does it for one scene; what it raises is shown as the reason.
        post: Has another thread call a function with arguments soon.
        on_results: Called like that with the results so far, as each variant's comes in.
    """

    def __init__(
        self, measure: Callable[[Scene], Any], post: Callable, on_results: Callable[[Results], None]
    ):
        self._measure, self._post, self._on_results = measure, post, on_results
        self._newest = 0
        self._one_at_a_time = threading.Lock()

    def start(self, scene: Scene, comparison: Comparison) -> None:
        """Measure all variants of a scene; returns at once."""
        self._newest += 1
        scenes = [
            msgspec.structs.replace(scene, settings=comparison.settings(i)) for i in range(comparison.count)
        ]
        arguments = (self._newest, scenes)
        threading.Thread(target=self._run, args=arguments, name="muslin ring-down", daemon=True).start()

    def stop(self) -> None:
        """Begin no further measurement, and answer nobody."""
        self._newest += 1

    def _run(self, request: int, scenes: list[Scene]) -> None:
        results: list[Any] = [None] * len(scenes)
        with self._one_at_a_time:
            for i, scene in enumerate(scenes):
                self._post(self._answer, request, list(results))
                if request != self._newest:
                    return
                try:
                    results[i] = self._measure(scene)
                except (ValueError, ArithmeticError, RuntimeError) as error:
                    results[i] = str(error)
                except Exception as error:
                    _log.exception("damping could not be measured")
                    results[i] = str(error)
            self._post(self._answer, request, list(results))

    def _answer(self, request: int, results: Results) -> None:
        if request == self._newest:
            self._on_results(results)


def damping_table(names: Sequence[str], results: Results) -> str:
    """What was set, what the springs make of it, what the time step adds, and what was measured."""
    rows = []
    for i, (name, found) in enumerate(zip(names, results, strict=False)):
        title = f"<td>{style.chip(VARIANTS[i])}{escape(name)}</td>"
        if found is None:
            rows.append(f'<tr>{title}<td colspan="5">measuring …</td></tr>')
        elif isinstance(found, str):
            rows.append(f'<tr>{title}<td colspan="5">{style.UNKNOWN} {escape(found)}</td></tr>')
        else:
            period = 2.0 * math.pi / found.frequency
            numbers = (period, found.gamma, found.modal, found.integrator_share, found.measured)
            rows.append(f"<tr>{title}{''.join(f'<td>{written(x, 3)}</td>' for x in numbers)}</tr>")
    head = "".join(f"<th>{h}</th>" for h in ("", "period [s]", "γ set", "springs", "+ step", "measured"))
    return f'<div class="muslin many"><table><tr>{head}</tr>{"".join(rows)}</table></div>' if rows else ""
