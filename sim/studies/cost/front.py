"""The Pareto front: runs that none other beats in both cost and error."""

from __future__ import annotations

from collections.abc import Sequence


def front(costs: Sequence[float], errors: Sequence[float], floor: float = 0.0) -> list[bool]:
    """Which points are on the front: whatever costs as little or less has a larger error.

    Of points alike in both, the first is. Errors that differ by no more than `floor` are alike.
    """
    order = sorted(range(len(costs)), key=lambda i: (costs[i], errors[i]))
    on, best = [False] * len(costs), float("inf")
    for i in order:
        if errors[i] < best - floor:
            on[i], best = True, errors[i]
    return on


def cheapest(costs: Sequence[float], errors: Sequence[float], target: float) -> int | None:
    """The cheapest point with an error of at most `target`; None where there is none."""
    met = [i for i, error in enumerate(errors) if error <= target]
    return min(met, key=lambda i: (costs[i], errors[i]), default=None)
