"""What other threads ask of the lab's, one thing after the other, and of many moves of a control the last."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Collection, Iterable
from typing import Any

Task = tuple[Callable, tuple]


class Inbox:
    """Tasks for one thread.

    Args:
        settling: Functions whose last argument is all that counts: of several calls in a row that differ in
            that alone, only the last is made.
    """

    def __init__(self, settling: Collection[Callable]):
        self._settling = settling
        self._posted: queue.SimpleQueue[Task] = queue.SimpleQueue()
        self._taken: deque[Task] = deque()

    def post(self, action: Callable, *args: Any) -> None:
        """Have `action(*args)` called soon. Any thread may post."""
        self._posted.put((action, args))

    def act(self, timeout: float) -> None:
        """Do all that has been posted by now; with nothing posted, wait so long [s] for something.

        What is posted meanwhile is left for the next time, so that a flood does not keep its thread from the
        rest of its work. Where something raises, what came after it is left, too.
        """
        if not self._taken:
            try:
                posted = [self._posted.get(timeout=timeout)]
            except queue.Empty:
                return
            posted += [self._posted.get() for _ in range(self._posted.qsize())]
            self._taken.extend(settled(posted, self._settling))
        while self._taken:
            action, args = self._taken.popleft()
            action(*args)


def settled(tasks: Iterable[Task], settling: Collection[Callable]) -> list[Task]:
    """The tasks without those whose effect a later one of the same run of `settling` ones replaces."""
    kept: list[Task] = []
    run: dict[tuple, Task] = {}
    for action, args in tasks:
        if action in settling:
            key = action, *args[:-1]
            run.pop(key, None)  # in the order of the last calls
            run[key] = action, args
        else:
            kept += [*run.values(), (action, args)]
            run = {}
    return kept + list(run.values())
