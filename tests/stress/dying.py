"""Tasks for other processes, which import this and little else."""

import os


def die_of(task):
    """End the process of the task with seed 1, as a crash in compiled code would."""
    if task.seed == 1:
        os._exit(3)
    from sim.stress.probe import Outcome

    return Outcome(task, trouble="fine")


def hold_to_nothing(task):
    """Run a task with no motion allowed at rest, which no cloth keeps to."""
    from sim.stress import contact
    from sim.stress.probe import run_task

    contact.STILL = 0.0
    return run_task(task)
