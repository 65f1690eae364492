"""Helpers of kernels, compiled for calls from tests."""

from collections.abc import Callable

import numba


def compiled(function: Callable) -> Callable:
    """`function`, an `inner` one, as kernels have it; called as it stands, Python would interpret it."""
    return numba.njit(error_model="numpy")(function)
