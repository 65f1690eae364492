"""Where tasks run: local processes, one thread each, or the workers of a Dask cluster.

What a task finds depends on nothing but the case and its seed, so it is the same wherever it runs and in
whatever order; outcomes come as they are done.
"""

from __future__ import annotations

import concurrent.futures
import os
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

from sim.stress import Task
from sim.workers import connect, local_pool

if TYPE_CHECKING:
    from sim.stress.probe import Outcome


def run_tasks(
    tasks: Sequence[Task], jobs: int | None = None, cluster: str | None = None
) -> Iterator[Outcome]:
    """Run all tasks, and give each outcome as soon as it is there.

    Args:
        tasks: What to run; those that come first begin first.
        jobs: Local processes; as many as there are cores where left out.
        cluster: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers run the tasks.

    Raises:
        ValueError: for a cluster that cannot be had.
    """
    if cluster is not None:
        return _submitted(connect(cluster), tasks)
    return _locally(tasks, min(jobs or os.cpu_count() or 1, len(tasks)))


def run_here(task: Task) -> Outcome:
    """Run a task in this process; imports what it needs."""
    from sim.stress.probe import run_task

    return run_task(task)


def _locally(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    left = list(tasks)
    for outcome in _pooled(left, jobs):
        left.remove(outcome.task)
        yield outcome
    for task in left:  # a worker died, and nobody can say of which: each by itself
        yield next(_pooled([task], 1), None) or _died(task)


def _pooled(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Outcomes from a pool of `jobs` processes, until all are there or one of the processes dies."""
    with local_pool(jobs) as pool:
        futures = [pool.submit(run_here, task) for task in tasks]
        try:
            for future in concurrent.futures.as_completed(futures):
                yield future.result()
        except BrokenProcessPool:
            return


def _died(task: Task) -> Outcome:
    from sim.stress.probe import Outcome

    return Outcome(task, trouble="the process that ran it died")


def _submitted(client, tasks: Sequence[Task]) -> Iterator[Outcome]:
    from distributed import as_completed

    with client:
        futures = {client.submit(run_here, task, pure=False): task for task in tasks}
        for future in as_completed(futures):
            yield future.result() if future.status == "finished" else _died(futures[future])
