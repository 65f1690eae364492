"""Processes that work on what nobody times: local ones, one thread each, or those of a Dask cluster.

What they are given depends on nothing but itself, so that it comes to the same bits wherever it runs.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from typing import Any

from sim.bench.process import POOLS

EXTRA = "cluster"
"""What has to be installed for a cluster: `pip install 'muslin[cluster]'`."""

CONNECT = "10s"
"""How long to wait for a cluster that does not answer."""


@contextlib.contextmanager
def local_pool(jobs: int) -> Iterator[concurrent.futures.ProcessPoolExecutor]:
    """A pool of `jobs` processes; who leaves early, with Ctrl-C say, ends them in the midst of it."""
    others = set(multiprocessing.active_children())
    with _one_thread_each():
        fresh = multiprocessing.get_context("spawn")  # a fork would inherit threads, and thereby their locks
        # Ctrl-C in a terminal goes to all processes of a command: to end these is up to the first of them.
        leave_it = signal.signal, (signal.SIGINT, signal.SIG_IGN)
        pool = concurrent.futures.ProcessPoolExecutor(jobs, fresh, *leave_it)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise
        pool.shutdown()


def connect(address: str) -> Any:
    """A client of the Dask scheduler at `address`, such as tcp://10.0.0.1:8786.

    Raises:
        ValueError: for a cluster that cannot be had.
    """
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ValueError(f"--cluster: not installed: pip install 'muslin[{EXTRA}]'") from None
    try:
        return Client(address, timeout=CONNECT)
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"--cluster: no scheduler at {address}: {error}") from None


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that start in the block use one thread in linear algebra; Muslin asks for its own."""
    before = {name: os.environ.get(name) for name in POOLS}
    os.environ.update(dict.fromkeys(POOLS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})
