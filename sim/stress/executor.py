"""Where tasks run: local processes, one thread each, or the workers of a Dask cluster.

What a task finds depends on nothing but the case and its seed, so it is the same wherever it runs and in
whatever order; outcomes come as they are done.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING

from sim.bench.process import POOLS
from sim.stress import Task

if TYPE_CHECKING:
    from sim.stress.probe import Outcome

EXTRA = "cluster"
"""What has to be installed for a cluster: `pip install 'muslin[cluster]'`."""

CONNECT = "10s"
"""How long to wait for a cluster that does not answer."""


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
        return _on_cluster(tasks, cluster)
    return _locally(tasks, min(jobs or os.cpu_count() or 1, len(tasks)))


def run_here(task: Task) -> Outcome:
    """Run a task in this process; imports what it needs."""
    from sim.stress.probe import run_task

    return run_task(task)


def _locally(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    left = list(tasks)
    with _one_thread_each():
        for outcome in _pooled(left, jobs):
            left.remove(outcome.task)
            yield outcome
        for task in left:  # a worker died, and nobody can say of which: each by itself
            yield next(_pooled([task], 1), None) or _died(task)


def _pooled(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """Outcomes from a pool of `jobs` processes, until all are there or one of the processes dies."""
    fresh = multiprocessing.get_context("spawn")  # a fork would inherit threads, and thereby their locks
    pool = concurrent.futures.ProcessPoolExecutor(jobs, mp_context=fresh)
    futures = [pool.submit(run_here, task) for task in tasks]
    try:
        for future in concurrent.futures.as_completed(futures):
            yield future.result()
    except BrokenProcessPool:
        return
    finally:  # whoever stops asking, with Ctrl-C say, does not wait for what nobody began
        pool.shutdown(wait=False, cancel_futures=True)


def _died(task: Task) -> Outcome:
    from sim.stress.probe import Outcome

    return Outcome(task, trouble="the process that ran it died")


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that start in the block use one thread in linear algebra; Muslin asks for its own."""
    before = {name: os.environ.get(name) for name in POOLS}
    os.environ.update(dict.fromkeys(POOLS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _on_cluster(tasks: Sequence[Task], address: str) -> Iterator[Outcome]:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise ValueError(f"--cluster: not installed: pip install 'muslin[{EXTRA}]'") from None
    try:
        client = Client(address, timeout=CONNECT)
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(f"--cluster: no scheduler at {address}: {error}") from None
    return _submitted(client, tasks, as_completed)


def _submitted(client, tasks: Sequence[Task], as_completed) -> Iterator[Outcome]:
    with client:
        futures = {client.submit(run_here, task, pure=False): task for task in tasks}
        for future in as_completed(futures):
            yield future.result() if future.status == "finished" else _died(futures[future])
