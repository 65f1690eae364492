"""Where runs are made that nobody times: here, in local processes, or on a Dask cluster.

A run depends on its case alone, so it gives the same bits wherever it is made. Timed runs never come here.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any

from sim.bench.process import POOLS

if TYPE_CHECKING:
    from sim.studies.cost.trace import Case, Trace

EXTRA = "cluster"
"""What has to be installed for a cluster: `pip install 'muslin[cluster]'`."""

CONNECT = "10s"
"""How long to wait for a cluster that does not answer."""

RunAll = Callable[[Sequence["Case"]], "Iterator[Trace]"]
"""Makes runs, and gives their traces in the order of the cases."""


def run_here(case: Case) -> Trace:
    """Make a run in this process."""
    from sim.studies.cost.trace import run

    return run(case)


def in_turn(cases: Sequence[Case]) -> Iterator[Trace]:
    """Make runs here, one after the other."""
    return map(run_here, cases)


@contextlib.contextmanager
def workers(jobs: int | None = None, cluster: str | None = None) -> Iterator[RunAll]:
    """What makes runs: `jobs` local processes, as many as there are cores if left out, or a `cluster`.

    Args:
        jobs: Processes; 1 makes all runs in this one.
        cluster: Address of a Dask scheduler, such as tcp://10.0.0.1:8786.

    Raises:
        ValueError: for a cluster that cannot be had.
    """
    jobs = jobs or os.cpu_count() or 1
    if cluster is None and jobs == 1:
        yield in_turn
        return
    with _pool(jobs) if cluster is None else _dask(cluster) as executor:

        def run_all(cases: Sequence[Case]) -> Iterator[Trace]:
            try:
                yield from executor.map(run_here, cases)
            except BrokenProcessPool:
                raise ValueError("a process that made a run died; is there enough memory?") from None

        yield run_all


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[concurrent.futures.Executor]:
    fresh = multiprocessing.get_context("spawn")  # a fork would inherit threads, and thereby their locks
    before = {name: os.environ.get(name) for name in POOLS}
    os.environ.update(dict.fromkeys(POOLS, "1"))
    pool = concurrent.futures.ProcessPoolExecutor(jobs, mp_context=fresh)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


@contextlib.contextmanager
def _dask(address: str) -> Iterator[Any]:
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ValueError(f"--cluster: not installed: pip install 'muslin[{EXTRA}]'") from None
    try:
        client = Client(address, timeout=CONNECT)
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"--cluster: no scheduler at {address}: {error}") from None
    with client, client.get_executor(pure=False) as executor:
        yield executor
