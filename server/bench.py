"""The bench: one simulation per variant, side by side on one clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

from server.clock import Clock
from server.comparison import Comparison
from server.lane import Advance, Change, Frame, Lane, Reset
from server.meter import Meter
from sim.settings import Settings

MOST_STEPS = 10
"""Single steps that may be asked for ahead of the one that is being made."""


class Bench:
    """Starts frames in every variant's lane and takes them in once all have made theirs.

    All of it is for one thread, the lab's; the lanes step in theirs.

    Args:
        watched: Whether anybody looks; a bench that nobody looks at stands still.
        on_frame: Called in a lane's thread after each new frame; must return at once.

    Attributes:
        lanes: One per variant, from left to right; none while kernels compile.
        meters: One per variant.
        finished: Each variant's newest frame, as of when all had made theirs.
        playing: Whether time runs.
        counting: Whether lanes count what crosses, as soon as they may.
    """

    def __init__(self, watched: Callable[[], bool], on_frame: Callable[[], None]):
        self._watched, self._on_frame = watched, on_frame
        self.clock = Clock()
        self.lanes: list[Lane] = []
        self.meters: list[Meter] = []
        self.finished: list[Frame] = []
        self.playing, self.counting, self._steps_asked = True, False, 0

    def clear(self, count: int) -> None:
        """Have no simulations, and make ready for those of `count` variants."""
        for lane in self.lanes:
            lane.stop()
        self.lanes, self.finished = [], []
        self.meters = [Meter() for _ in range(count)]
        self.clock.reset()

    def launch(self, build: Callable[[Settings], Any], comparison: Comparison) -> None:
        """Build a simulation for every variant, each in its lane."""
        variants = map(comparison.settings, range(comparison.count))
        self.lanes = [Lane(build, settings, self._on_frame, self.counting) for settings in variants]
        for lane in self.lanes:
            lane.start()

    def count_crossings(self) -> None:
        """Have lanes count what crosses, now that this compiles nothing."""
        self.counting = True
        for lane in self.lanes:
            lane.counting = True
            if not self.playing:
                lane.send(Advance(0.0, counted=True))

    def stop(self) -> None:
        """End all lanes. A step that is being made is waited for, but not for long."""
        for lane in self.lanes:
            lane.stop()
        deadline = perf_counter() + 2.0
        for lane in self.lanes:
            lane.join(timeout=max(0.0, deadline - perf_counter()))

    @property
    def ready(self) -> bool:
        """Whether there are simulations, or will be as soon as they are built."""
        return bool(self.lanes)

    @property
    def busy(self) -> bool:
        """Whether some variant has not made its frame."""
        return any(lane.busy for lane in self.lanes)

    def play(self) -> None:
        """Let time run."""
        self.playing = True

    def pause(self) -> None:
        """Stop time."""
        if self.playing:
            for lane in self.lanes:
                lane.send(Advance(0.0, counted=True))
        self.playing, self._steps_asked = False, 0

    def step(self) -> None:
        """Pause, and make one time step in every variant."""
        self.playing, self._steps_asked = False, min(self._steps_asked + 1, MOST_STEPS)

    def reset(self, comparison: Comparison) -> None:
        """Start every variant again."""
        for i, lane in enumerate(self.lanes):
            lane.send(Reset(comparison.settings(i)))
        self.meters = [Meter() for _ in self.meters]
        self.clock.reset()

    def change(self, index: int, changes: Mapping[str, Any]) -> None:
        """Change some settings of one variant; one that could not start with those before starts anew."""
        self.lanes[index].send(Change(changes))

    def wait(self) -> float | None:
        """Wall time [s] until the next frame is to be started; None while there is none to come."""
        return self.clock.wait() if self._wants_frame() else None

    def collect(self) -> None:
        """Take in the frames once all variants have made theirs."""
        if self.ready and not self.busy:
            self.finished = [lane.frame for lane in self.lanes]
            for meter, frame in zip(self.meters, self.finished, strict=True):
                meter.add(frame)

    def advance(self) -> None:
        """Start the next frame if it is due."""
        if not self._wants_frame():
            if not self.busy:
                self.clock.hold()
            return
        longest = self._longest_step()
        if self._steps_asked:
            self._steps_asked -= 1
            seconds = self.clock.single_step(longest)
        elif self.clock.wait() > 0:
            return
        else:
            seconds = self.clock.next_frame(longest)
        for lane in self.lanes:
            lane.send(Advance(seconds, counted=not self.playing))

    def _wants_frame(self) -> bool:
        """Whether there is a frame to be started now or soon."""
        if not self.ready or self.busy or all(lane.frame.refused for lane in self.lanes):
            return False
        return self._steps_asked > 0 or (self.playing and self._watched())

    def _longest_step(self) -> float:
        return max((lane.step_length for lane in self.lanes), default=0.0)

    def waiting(self, index: int) -> str:
        """What a variant has been doing for longer than a step should take; empty most of the time."""
        return self.lanes[index].waiting if self.lanes else ""

    def behind(self, index: int) -> float:
        """Simulated time [s] between a variant and the foremost, beyond what different time steps make."""
        times = [meter.latest.time for meter in self.meters]
        behind = max(times) - times[index]
        return behind if behind > 2 * self._longest_step() + 1e-6 else 0.0
