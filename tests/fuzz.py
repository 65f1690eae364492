"""Budgets for tests that try things at random: a fixed time, the same examples each time.

MUSLIN_FUZZ=60 gives each of them sixty seconds and new examples in place of the few seconds of usual runs.
"""

import os
import time
from collections.abc import Callable
from functools import wraps

from hypothesis import HealthCheck, settings

LONG = float(os.environ.get("MUSLIN_FUZZ", "0"))
ENOUGH = 5
"""Examples that are tried however slow the machine is."""


def within(seconds: float) -> Callable:
    """Decorates a hypothesis test, above `given`: as many examples as fit in a time, ENOUGH at least."""

    def decorate(test: Callable) -> Callable:
        inner, begin, tried = test.hypothesis.inner_test, None, 0

        @wraps(inner)
        def timed(*args: object, **kwargs: object) -> None:
            nonlocal begin, tried
            begin = begin or time.monotonic()
            tried += 1
            if tried <= ENOUGH or time.monotonic() < begin + (LONG or seconds):
                inner(*args, **kwargs)

        test.hypothesis.inner_test = timed
        few, slow = HealthCheck.function_scoped_fixture, HealthCheck.too_slow
        return settings(
            max_examples=100_000 if LONG else 300,
            deadline=None,
            derandomize=not LONG,
            database=None,
            suppress_health_check=[few, slow, HealthCheck.data_too_large],
        )(test)

    return decorate
