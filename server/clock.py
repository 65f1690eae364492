"""One clock for all variants: how much simulated time the next frame holds, and when it is due."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import perf_counter

FRAME = 1 / 30
"""Wall time of a frame [s]: nothing is published more often."""

MEMORY = 2.0
"""Wall time [s] over which the real-time factor is averaged."""


class Clock:
    """Paces frames so that simulated time runs at `speed` times wall time, or as near as the machine can.

    Every variant advances by the same simulated time in a frame, whatever its time step, and no frame starts
    before all have ended the one before. A machine that cannot keep up is not asked to catch up: simulated
    time then just runs slower, and `real_time_factor` says how much.
    """

    def __init__(self, now: Callable[[], float] = perf_counter):
        self.speed = 1.0
        self.time = 0.0
        """Simulated time [s] that every variant has been told to reach."""
        self._now = now
        self._due = now()
        self._late = False
        self._marks: deque[tuple[float, float]] = deque()

    def wait(self) -> float:
        """Wall time [s] until the next frame is due; 0 when it already is."""
        return max(0.0, self._due - self._now())

    def next_frame(self, longest_step: float) -> float:
        """Start a frame.

        Args:
            longest_step: The longest time step [s] among the variants: less simulated time than this would
                leave that variant standing still.

        Returns:
            Simulated time [s] that the frame holds. After a frame that took too long it is a single step, so
            that slow scenes are shown as often as they can be.
        """
        now = self._now()
        seconds = longest_step if self._late else max(longest_step, FRAME * self.speed)
        self._late = now > self._due + FRAME
        self._due = (now if self._late else self._due) + seconds / self.speed
        self.time += seconds
        self._marks.append((now, self.time))
        while len(self._marks) > 2 and self._marks[0][0] < now - MEMORY:
            self._marks.popleft()
        return seconds

    def single_step(self, seconds: float) -> float:
        """Advance by one time step [s], whatever the wall clock says; gives it back."""
        self.time += seconds
        self.hold()
        return seconds

    def hold(self) -> None:
        """Stand still, as in a pause: the next frame is due at once, and counts afresh."""
        self._due = self._now()
        self._late = False
        self._marks.clear()

    def reset(self) -> None:
        """Back to simulated time 0."""
        self.time = 0.0
        self.hold()

    @property
    def real_time_factor(self) -> float | None:
        """Simulated time per wall time, measured; None until half a second has been."""
        if not self._marks or self._marks[-1][0] - self._marks[0][0] < 0.5:
            return None
        (start, begin), (end, reached) = self._marks[0], self._marks[-1]
        return (reached - begin) / (end - start)
