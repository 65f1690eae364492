"""A task for other processes, which import this and little else."""

import os


def die_of(task):
    """End the process of the task with seed 1, as a crash in compiled code would."""
    if task.seed == 1:
        os._exit(3)
    from sim.stress.probe import Outcome

    return Outcome(task, trouble="fine")
