"""`sim.time_of_impact`: continuous detection of single pairs, in an exact order and scale."""

from __future__ import annotations

import math

import numba
import numpy as np

from sim.compiled import CHUNKS, corner, inner, parallel_kernel, share
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE, impact
from sim.threads import processor_threads

KINDS = {"vertex-triangle": VERTEX_TRIANGLE, "edge-edge": EDGE_EDGE}

MOST = 256
"""Jumps after which the time reached is taken for the contact. More than 64 are very rare."""


def time_of_impact(kind: str, x: np.ndarray) -> np.ndarray:
    """When pairs of primitives first meet, as their vertices go straight from their start to their end.

    Args:
        kind: "vertex-triangle" or "edge-edge".
        x: (n, 8, 3) float64, in any unit: of each pair the vertex and the triangle's three, or the ends of
            one edge and of the other, at time 0, then the same four at time 1.

    Returns:
        (n,) earliest times in [0, 1], inf where the pair does not meet.

    Raises:
        ValueError: Unknown kind, wrong shape, or a number that is not finite.

    No contact is missed, and no time is later than the truth. A pair counts as meeting where it comes closer
    than 2⁻⁴⁶ (1.4e-14) of its size, which is the largest difference of a coordinate between two of its
    vertices, at the start or the end; the time is that at which it does. (Of a million degenerate queries
    about one is found from 1e-11 of its size on.)

    Neither the order of a triangle's vertices, of the edges or of their ends, nor a power of two that scales
    everything changes a bit. Whether they meet does not change either when start and end are swapped.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    try:
        x = np.ascontiguousarray(x, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"x: expected numbers, got {error}") from None
    if x.ndim != 3 or x.shape[1:] != (8, 3):
        raise ValueError(f"x: expected an array of shape (n, 8, 3), got {x.shape}")
    wrong = np.flatnonzero(~np.isfinite(x).all(axis=(1, 2)))
    if len(wrong):
        raise ValueError(f"x[{wrong[0]}]: expected finite numbers, got {x[wrong[0]].tolist()}")
    times = np.empty(len(x))
    with processor_threads(numba.get_num_threads()):
        _times(KINDS[kind], x, times)
    return times


@parallel_kernel
def _times(kind, x, times):
    for chunk in numba.prange(CHUNKS):
        _times_share(kind, x, times, chunk)


@inner
def _times_share(kind, x, times, chunk):
    first, last = share(chunk, len(x))
    pair = np.empty((2, 4, 3))
    for i in range(first, last):
        for backwards in range(2):
            _normalise(kind, x[i], 4 * backwards, 4 - 4 * backwards, pair)
            a0, a1, a2, a3 = corner(pair, 0, 0), corner(pair, 0, 1), corner(pair, 0, 2), corner(pair, 0, 3)
            b0, b1, b2, b3 = corner(pair, 1, 0), corner(pair, 1, 1), corner(pair, 1, 2), corner(pair, 1, 3)
            t = impact(kind, a0, a1, a2, a3, b0, b1, b2, b3, 0.0, MOST)[0]
            if not backwards or t == math.inf:  # neither way overlooks a contact: what one misses is none
                times[i] = t
            if t == math.inf:
                break


@inner
def _normalise(kind, x, start, end, pair):
    """Fill `pair` with rows `start` + k of x, then `end` + k: relative to the first vertex, ½ to 1 in size.

    The order of k depends on their values only, and the scale is a power of two.
    """
    a, b, c, d = 0, 1, 2, 3
    if kind == VERTEX_TRIANGLE:
        if _after(x, b, c, start, end):
            b, c = c, b
        if _after(x, c, d, start, end):
            c, d = d, c
        if _after(x, b, c, start, end):
            b, c = c, b
    else:
        if _after(x, a, b, start, end):
            a, b = b, a
        if _after(x, c, d, start, end):
            c, d = d, c
        if _after(x, a, c, start, end) or (not _after(x, c, a, start, end) and _after(x, b, d, start, end)):
            a, b, c, d = c, d, a, b
    down = math.frexp(np.abs(x).max())[1] + 1  # so that differences do not overflow
    size = 0.0
    for j, k in enumerate((a, b, c, d)):
        for side, row in enumerate((start, end)):
            for axis in range(3):
                value = math.ldexp(x[row + k, axis], -down) - math.ldexp(x[row + a, axis], -down)
                pair[side, j, axis] = value
                size = max(size, abs(value))
    up = math.frexp(size)[1]
    for side in range(2):
        for j in range(4):
            for axis in range(3):
                pair[side, j, axis] = math.ldexp(pair[side, j, axis], -up)


@inner
def _after(x, j, k, start, end):
    """Whether the path of vertex j comes after that of k in lexicographic order."""
    for row in (start, end):
        for axis in range(3):
            if x[row + j, axis] != x[row + k, axis]:
                return x[row + j, axis] > x[row + k, axis]
    return False
