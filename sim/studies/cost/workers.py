"""Where runs are made that nobody times: here, in local processes, or on a Dask cluster.

A run depends on its case alone, so it gives the same bits wherever it is made. Timed runs never come here.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any

from sim.workers import connect, local_pool

if TYPE_CHECKING:
    from sim.studies.cost.trace import Case, Trace

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
        ValueError: for a cluster that cannot be had, or fewer processes than none.
    """
    if jobs is not None and jobs < 0:
        raise ValueError(f"--jobs: expected 0 or more, got {jobs}")
    jobs = jobs or os.cpu_count() or 1
    if cluster is None and jobs == 1:
        yield in_turn
        return
    with local_pool(jobs) if cluster is None else _dask(cluster) as executor:

        def run_all(cases: Sequence[Case]) -> Iterator[Trace]:
            try:
                yield from executor.map(run_here, cases)
            except BrokenProcessPool:
                raise ValueError("a process that made a run died; is there enough memory?") from None

        yield run_all


@contextlib.contextmanager
def _dask(address: str) -> Iterator[Any]:
    with connect(address) as client, client.get_executor(pure=False) as executor:
        yield executor
