"""How many processor threads the kernels of one simulation use."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

import numba

LAUNCHED: int = numba.config.NUMBA_NUM_THREADS  # pyright: ignore
"""Threads that Numba starts, by default one per processor core."""

_one_at_a_time = threading.Lock()


def threads_of(count: int) -> int:
    """How many threads a setting of `count` means: one where that is 0, and no more than there are."""
    return min(max(count, 1), LAUNCHED)


@contextlib.contextmanager
def processor_threads(count: int) -> Iterator[None]:
    """Run kernels in the block on as many threads as `count` means.

    Several simulations may be in such a block at once, except on Numba's workqueue layer, which may only be
    entered by one Python thread at a time.
    """
    numba.set_num_threads(threads_of(count))
    with _one_at_a_time if threading_layer() == "workqueue" else contextlib.nullcontext():
        yield


def threading_layer() -> str:
    """Numba's threading layer: "omp", "tbb" or "workqueue"; "" before the first parallel kernel has run."""
    try:
        return numba.threading_layer()  # pyright: ignore[reportPrivateImportUsage]
    except ValueError:
        return ""
