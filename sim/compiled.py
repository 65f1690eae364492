"""How kernels are compiled, and small vectors for them.

`kernel` is for what is called from Python: it releases the GIL and is cached on disk. `inner` is for
helpers, which are compiled with the kernels that call them; where Python calls one, Python interprets it.
Kernels take arrays or NamedTuples of arrays and have no globals and no I/O; float64 throughout, no fast-math,
so that a result does not depend on how the compiler reorders a sum. `unordered` is the exception, for long
sums inside preconditioners: the compiler may add them up several terms at a time.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple

from sim.cache import choose_cache

choose_cache()  # before Numba reads where its cache is

# Threads wait for each other awake, for at most so many turns. Where another process has taken a core,
# OpenMP's own count keeps a step waiting ten times as long as it computes.
os.environ.setdefault("GOMP_SPINCOUNT", "20000")

# LLVM may do like operations on a vector's components at once (superword-level parallelism), as C compilers
# have it do. That reorders no sum: bits are the same, products of 3 × 3 blocks take a third less time. Numba
# turned it off when an older LLVM had faults there; a test compares the bits.
os.environ.setdefault("NUMBA_SLP_VECTORIZE", "1")

import numba  # noqa: E402
import numpy as np  # noqa: E402
from numba.core.dispatcher import Dispatcher  # noqa: E402
from numba.extending import register_jitable  # noqa: E402

# Who imported numba before this module had it read these before they were chosen.
numba.config.CACHE_DIR = os.environ.get("NUMBA_CACHE_DIR", "")  # pyright: ignore
numba.config.SLP_VECTORIZE = int(os.environ["NUMBA_SLP_VECTORIZE"])  # pyright: ignore

OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Of every kernel; wrappers for calls from C take time to compile, and nobody calls them."""

# No wrappers for calls from Python either: they would take a sixth of the work of a cold start.
inner = register_jitable(no_cpython_wrapper=True, **OPTIONS)
unordered = register_jitable(no_cpython_wrapper=True, fastmath={"reassoc"}, **OPTIONS)

KERNELS: list[Dispatcher] = []
"""Every kernel of the modules imported so far, for those who want to watch them compile."""


def kernel(function: Callable) -> Dispatcher:
    """Compile `function` for calls from Python."""
    return _listed(numba.njit(nogil=True, **OPTIONS)(function))


def parallel_kernel(function: Callable) -> Dispatcher:
    """Compile `function` with its `prange` loop shared between threads.

    The loop runs over CHUNKS shares, and leaves each `share` to an `inner` function with a loop of its own.
    Inside a `prange`, Numba 0.68 loses what `tuple.array[i] = value` writes, and a call for every single
    item would hand over all arrays of the tuple every time.
    """
    return _listed(numba.njit(nogil=True, parallel=True, **OPTIONS)(function))


def _listed(dispatcher: Dispatcher) -> Dispatcher:
    KERNELS.append(dispatcher)
    return dispatcher


def indices(array: np.ndarray) -> np.ndarray:
    """`array` as indices for kernels: unsigned, so that no kernel looks whether one counts from the end."""
    return np.ascontiguousarray(array, dtype=np.uint32)


def offsets(array: np.ndarray) -> np.ndarray:
    """`array` as the places where runs of something start, for kernels; a range of unsigned is unsigned."""
    return np.ascontiguousarray(array, dtype=np.uint64)


CHUNKS = 32
"""Parts that every loop and sum is split into; more threads than this find no work."""


@inner
def share(chunk, n):
    """Begin and end of a chunk's part of n items."""
    return chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS


def even_shares(starts: np.ndarray) -> np.ndarray:
    """(CHUNKS + 1,) n runs of work, which start at `starts` (n + 1,), split into parts of about as much."""
    ends = np.searchsorted(starts, np.linspace(0, starts[-1], CHUNKS + 1))
    ends[-1] = len(starts) - 1  # with those at the end that are no work
    return ends.astype(np.int64)


class Vec3(NamedTuple):
    """A point or direction in a kernel; reads like the paper and compiles to scalars."""

    x: float
    y: float
    z: float


@inner
def row(array, i):
    """Row i of an (n, 3) array."""
    return Vec3(array[i, 0], array[i, 1], array[i, 2])


@inner
def put(array, i, a):
    """Write `a` to row i of an (n, 3) array."""
    array[i, 0] = a.x
    array[i, 1] = a.y
    array[i, 2] = a.z


@inner
def corner(array, i, a):
    """Entry (i, a) of an (n, k, 3) array."""
    return Vec3(array[i, a, 0], array[i, a, 1], array[i, a, 2])


@inner
def put_corner(array, i, a, v):
    """Write `v` to entry (i, a) of an (n, k, 3) array."""
    array[i, a, 0] = v.x
    array[i, a, 1] = v.y
    array[i, a, 2] = v.z


@inner
def add(a, b):
    """A + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inner
def sub(a, b):
    """A − b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inner
def scale(s, a):
    """S a."""
    return Vec3(s * a.x, s * a.y, s * a.z)


@inner
def dot(a, b):
    """A · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inner
def cross(a, b):
    """A × b."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inner
def norm(a):
    """|a|."""
    return math.sqrt(dot(a, a))
