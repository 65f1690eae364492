"""Kernels are compiled in a thread of their own: the page lives meanwhile and says how far it is."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import msgspec

from server.comparison import Comparison
from sim.scene import Scene

Progress = Callable[[int, int, str], None]
"""Told how many kernels are done, of how many, and the name of the next."""

Later = Callable[[], None]
"""Compiles what is not needed for a first step."""

Prepare = Callable[[Scene, Progress], Later | None]
"""Compiles what a scene needs, reporting each kernel; gives what may be done after the first frame."""

_log = logging.getLogger(__name__)


def compile_kernels(scene: Scene, progress: Progress) -> Later | None:
    """Compile every kernel that a scene's steps need, reporting each one; later, what counts crossings."""
    from sim.crossings import compile_counting
    from sim.warmup import warm_up

    warm_up(scene, progress=progress)
    return compile_counting if scene.settings.crossings != "off" else None


class Compiler:
    """Compiles what the variants of a scene need; of several requests only the newest is answered.

    Args:
        prepare: Does the work.
        post: Has another thread call a function with arguments soon. All that follow are called like that.
        on_progress: As kernels are compiled.
        on_failure: With what went wrong. The simulation that lacks a kernel will say so again.
        on_ready: When all is done that steps need, or that can be.
        on_whole: When the rest is done, too.
    """

    def __init__(
        self,
        prepare: Prepare,
        post: Callable,
        on_progress: Progress,
        on_failure: Callable[[str], None],
        on_ready: Callable[[], None],
        on_whole: Callable[[], None],
    ):
        self._prepare, self._post = prepare, post
        self._on_progress, self._on_failure = on_progress, on_failure
        self._on_ready, self._on_whole = on_ready, on_whole
        self._newest = 0
        self._one_at_a_time = threading.Lock()

    def start(self, scene: Scene, comparison: Comparison) -> None:
        """Compile for these variants instead of what was asked for before; returns at once."""
        self._newest += 1
        arguments = (self._newest, scene, comparison)
        threading.Thread(target=self._run, args=arguments, name="muslin compiler", daemon=True).start()

    def stop(self) -> None:
        """Begin no further part of the work, and answer nobody."""
        self._newest += 1

    def _run(self, request: int, scene: Scene, comparison: Comparison) -> None:
        def progress(done: int, total: int, name: str) -> None:
            self._post(self._answer, request, self._on_progress, done, total, name)

        variants, later = map(comparison.settings, range(comparison.count)), None
        try:
            for settings in variants:  # what one has compiled, the next finds ready
                with self._one_at_a_time:
                    if request == self._newest:
                        later = self._prepare(msgspec.structs.replace(scene, settings=settings), progress)
        except Exception as error:  # shown on the page, and again by the lane that cannot start
            self._fail(error)
        self._post(self._answer, request, self._on_ready)
        try:
            with self._one_at_a_time:
                if later is not None and request == self._newest:
                    later()
        except Exception as error:
            self._fail(error)
        self._post(self._answer, request, self._on_whole)

    def _fail(self, error: Exception) -> None:
        _log.error("kernels could not be compiled", exc_info=error)
        self._post(self._on_failure, f"kernels could not be compiled: {error}")

    def _answer(self, request: int, answer: Callable, *args: object) -> None:
        """In the other thread: pass on an answer, unless something else has been asked for since."""
        if request == self._newest:
            answer(*args)
