"""Measures each variant's local error now and then, in a thread of its own that lanes hardly feel.

The time that probes take is accounted for: while time runs, all together take at most SHARE of the time that
steps take, of which a thread that steps aside takes no more than its own processor time. Steps of several
lanes count once: lanes wait for each other, so that what one of them loses, all do. What a change made out of
date is measured as soon as changes have settled, paid for or not; regular ones wait until that is made up
for, unless the read-out is forced on. All of these are quick: one that is late is of another cloth. In a
pause, when no lane waits for anything, they are measured to a tenth as well, until time runs again. While
nobody looks nothing is measured, nor where the read-out is off.
"""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter, thread_time
from typing import TYPE_CHECKING, Any, NamedTuple

from server.lane import Ask, Frame
from sim.report import StepError

if TYPE_CHECKING:
    from server.bench import Bench
    from server.lane import Lane

_log = logging.getLogger(__name__)

SHARE = 0.0075
"""Of the time of steps that probes may take: of one cloth of a thousand vertices, one in some 14 s of it.

With ledger, words of effects, crossings and figures all stays below 5 %, which a benchmark measures."""

DEBT = 0.1
"""Processor time [s] that may be owed for what changes had measured, which 13 s of steps make up for.

More is forgiven, or a while of changes would leave no regular reading for much longer than it took."""

OPENING = 0.5
"""Simulated time [s] before which nothing is measured while time runs: nothing has happened yet, and where
steps are slow the next reading is far away."""

SETTLE = 0.25
"""Wall time [s] without a change after which something out of date is measured again."""

RETRY = 5.0
"""Wall time [s] between a measurement that failed and the next regular one: it may fail at once."""

NICE = 10
"""By how much the thread stands back where the machine is busy, on systems that have it."""

RISING = 1.2
"""Times that an error must have grown, or shrunk, since the one before for that to be said."""


class Stopped(Exception):
    """Nobody asks any more."""


Work = Callable[[Any, Any], Any]
"""Makes something of a sim.probe.Probe and a snapshot."""


@dataclass(frozen=True)
class Reading:
    """What is known of one variant's local error.

    Attributes:
        found: A sim.probe.LocalError; None while there is none.
        measuring: Whether there will be one.
        why_not: Why it could not be measured; empty otherwise.
        trend: How it goes: "↗", "→", "↘", or nothing yet.
        time: Simulated time [s] of the state that it is of.
        quick: Whether it is beside a run that is not much finer, and so not known to a tenth.
        off: Whether it is never measured.
        share: What all measurements had taken by then of the time of steps, as a part.
    """

    found: Any = None
    measuring: bool = False
    why_not: str = ""
    trend: str = ""
    time: float = -1.0
    quick: bool = False
    off: bool = False
    share: float = 0.0


NO_READING, MEASURING, OFF = Reading(), Reading(measuring=True), Reading(off=True)


class _Due(NamedTuple):
    """A measurement of a variant: a quick one, or to a tenth; regular, or due to a change or a pause."""

    variant: int
    quick: bool = False
    regular: bool = False


class Prober:
    """Keeps a reading for every variant. All but the measuring itself is for the lab's thread.

    Args:
        post: Has the lab's thread call a function with arguments soon.

    Attributes:
        readings: By variant.
        spent: Processor time [s] that probes took while time ran and that is not forgiven, of `stepped` that
            the slowest lane stepped; `taken` is all of it.
    """

    def __init__(self, post: Callable) -> None:
        self._post = post
        self._jobs: queue.SimpleQueue = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._run = 0
        self.clear()

    def clear(self, build: Callable[[Any], Any] | None = None, count: int = 0) -> None:
        """Forget all: now there are `count` variants of the scene that `build` makes simulations of."""
        self._run += 1
        self._build, self._probe, self._busy = build, None, False
        self._patient: int | None = None
        self._versions, self._turn = [0] * count, 0
        self._seen: Sequence[Frame | None] = [None] * count
        self.readings = [MEASURING] * count
        self._changed, self._failed = perf_counter(), -RETRY
        self.spent = self.taken = self.stepped = self._took = 0.0

    def changed(self, index: int) -> None:
        """A setting of a variant has changed, or it began again: what was measured holds no longer."""
        if index < len(self._versions):
            self._forget(index, MEASURING)

    def _forget(self, index: int, reading: Reading) -> None:
        """Have this reading instead of what was measured of a variant, or is."""
        self._versions[index] += 1
        self.readings[index] = reading
        self._changed = perf_counter()

    def stop(self) -> None:
        """End the thread after the step that it is in, which is waited for, but not for long.

        Python that ends while a thread is in a kernel may be aborted by it.
        """
        self.clear()
        self._jobs.put(None)
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def tick(self, bench: Bench, watched: bool) -> None:
        """Take in what the lanes stepped, and begin the next measurement if it is due."""
        frames = zip(bench.finished, self._seen, strict=False)
        took = [1e-3 * f.ms["total"] * f.steps for f, seen in frames if f is not seen and f.ms]
        self.stepped += max(took, default=0.0)
        self._seen = bench.finished or self._seen
        for i, choice in enumerate(map(_choice, bench.lanes[: len(self.readings)])):
            if (choice == "off") != self.readings[i].off:
                self._forget(i, OFF if choice == "off" else MEASURING)
        if bench.playing and self._patient is not None:
            self._versions[self._patient] += 1  # it would take from the lanes, for seconds
            self._patient = None
        if self._busy or self._build is None or not watched or not bench.ready:
            return
        if (due := self._next(bench)) is not None:
            if due.regular:
                self._turn = due.variant + 1
            self._patient = None if due.quick else due.variant
            take = partial(self._take, due)
            self.ask(bench, due.variant, partial(_measure, quick=due.quick), take, booked=bench.playing)

    def ask(
        self, bench: Bench, index: int, work: Work, then: Callable[[Any], None], booked: bool = False
    ) -> None:
        """Do `work` on the present state of a variant, and `then` take its result, or what it raised.

        A change of that variant's settings ends the work with Stopped. What is `booked` counts as spent.
        """
        token = self._run, index, self._versions[index]
        self._busy = True
        bench.lanes[index].send(Ask(lambda state: self._jobs.put((token, state, work, then, booked))))
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="muslin prober", daemon=True)
            self._thread.start()

    def _next(self, bench: Bench) -> _Due | None:
        """What is to be measured now."""
        if perf_counter() < self._changed + SETTLE:
            return None
        able = [i for i, lane in enumerate(bench.lanes) if lane.ready and not lane.frame.refused]
        able = [i for i in able if not self.readings[i].off]
        able = [i for i in able if not bench.playing or bench.lanes[i].frame.time >= OPENING]
        for i in able:
            reading = self.readings[i]
            moved = not bench.playing and reading.time != bench.lanes[i].frame.time and not reading.why_not
            if reading is MEASURING or moved:
                return _Due(i, quick=True)
        if not bench.playing:
            return next((_Due(i) for i in able if self.readings[i].quick), None)
        forced = any(_choice(bench.lanes[i]) == "on" for i in able)
        paid = forced or self.spent + self._took <= SHARE * self.stepped
        if not able or not paid or perf_counter() < self._failed + RETRY:
            return None
        return _Due(next((i for i in able if i >= self._turn), able[0]), quick=True, regular=True)

    def _take(self, due: _Due, found: Any) -> None:
        """Keep what was found, or why nothing was."""
        if not due.quick:
            self._patient = None
        if isinstance(found, Stopped):
            return
        if isinstance(found, ValueError):  # simulations that hand over no state
            self._build = None
        state, found = found if isinstance(found, tuple) else (None, found)
        if state is None:
            self.readings[due.variant], self._failed = Reading(why_not=str(found)), perf_counter()
            return
        before, trend, quick = self.readings[due.variant], "", due.quick and not found.sure
        if before.found is not None and (before.quick == quick):  # else it was beside another run
            ratio = found.error / max(before.found.error, 1e-300)
            trend = "↗" if ratio > RISING else "↘" if ratio * RISING < 1.0 else "→"
        if due.quick:
            self._took = found.took
        share = self.taken / max(self.stepped, 1e-9)
        self.readings[due.variant] = Reading(found, False, "", trend, state.time, quick, share=share)

    # The prober's own thread.

    def _work(self) -> None:
        with contextlib.suppress(AttributeError, OSError):  # Linux has a priority for each thread
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        while (job := self._jobs.get()) is not None:
            token, state, work, then, booked = job
            begin = thread_time()
            result = self._result(token, state, work)
            self._post(self._answer, token, result, then, thread_time() - begin, booked)

    def _result(self, token: tuple[int, int, int], state: Any, work: Work) -> Any:
        from sim.probe import Probe

        if state is None:
            return ValueError("there is no state to measure from")
        try:
            if self._probe is None or self._probe[0] != token[0]:
                build = self._build
                if build is None:
                    return Stopped()
                self._probe = token[0], build(state.ramp.target)
            return work(Probe(self._probe[1], lambda: self._go_on(token)), state)
        except (StepError, ValueError, Stopped) as error:
            return error
        except Exception as error:
            _log.exception("an error could not be measured")
            return error

    def _go_on(self, token: tuple[int, int, int]) -> None:
        if not self._holds(token):
            raise Stopped

    def _holds(self, token: tuple[int, int, int]) -> bool:
        """Whether what was asked for is still asked for; may be asked by any thread."""
        run, index, version = token
        versions = self._versions
        return run == self._run and index < len(versions) and versions[index] == version

    def _answer(
        self, token: tuple[int, int, int], result: Any, then: Callable, took: float, booked: bool
    ) -> None:
        if token[0] == self._run:
            self._busy = False
            if booked:
                self.taken += took
                self.spent = min(self.spent + took, SHARE * self.stepped + DEBT)
        then(result if self._holds(token) else Stopped())


def _choice(lane: Lane) -> str:
    """How the read-out is switched in a variant; auto before there is one."""
    return "auto" if lane.frame.settings is None else lane.frame.settings.local_error


def _measure(probe: Any, state: Any, quick: bool) -> Any:
    from sim.probe import QUICK, REFINED

    return state, probe.measure(state, QUICK if quick else REFINED[-1])
