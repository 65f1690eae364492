"""The kernels of a step beside the time that their bytes alone would take.

    uv run --group test pytest tests/benchmarks/test_kernel_bounds.py --benchmark-enable --benchmark-json=out

A kernel must read each of its arrays once and write each once, in place both. How fast that can go, a triad
a = b + s c tells (McCalpin 1995), over arrays that fit in a core's cache, over some that are as large as a
kernel's, and over some larger than any cache. A kernel far above its bound waits for arithmetic, latency or
threads. Without the option each runs once on a small sheet, as a test that it writes what is counted.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest

import sim
from sim import elements, model
from sim.bench.sheet import Sheet
from sim.solve import cg, preconditioner, system
from sim.springs import BENDING, STRETCH
from sim.springs.build import Springs, build_springs
from sim.threads import processor_threads

SIDE, SMALL = 100, 12
"""Vertices along the sheet: 10,000 in all where time counts, and a few for a smoke test."""

SETTLE = 10
"""Steps after which the sheet swings, no longer flat."""

ROUNDS, WARM = 100, 5

TRIADS = {"in cache": 32_000, "alike": 500_000, "beyond cache": 8_000_000}
"""Numbers in each of a triad's three arrays, which take 768 kB, 12 MB and 192 MB."""

TINY = 1_000
"""As many in a smoke test."""

LONG = 100_000
"""Numbers that are timed in one go at least: the clock and the call take a while, too."""

REPEATS = 20
"""Triads of which the fastest counts, as of kernels: the others were disturbed."""


@numba.njit(parallel=True, nogil=True, cache=True)
def add_scaled(a, b, c, s):
    """Fill a = b + s c."""
    for i in numba.prange(len(a)):
        a[i] = b[i] + s * c[i]


def bandwidth(count: int, threads: int) -> float:
    """Bytes per second of a triad of `count` numbers per array, a store counted once."""
    a, b, c = np.ones((3, count))  # zeros would be one and the same page of memory until written
    inner, seconds = -(-LONG // count), []
    with processor_threads(threads):
        add_scaled(a, b, c, 0.5)
        for _ in range(REPEATS):
            begin = time.perf_counter()
            for _ in range(inner):
                add_scaled(a, b, c, 0.5)
            seconds.append((time.perf_counter() - begin) / inner)
    return 3 * a.nbytes / min(seconds)


@pytest.fixture(scope="session")
def triad():
    """The bandwidth of a triad by size and threads, each measured once."""
    return cache(bandwidth)


@dataclass
class Kernel:
    """A kernel to be timed.

    Attributes:
        run: Calls it once; what it returns, if anything, must be positive.
        read: Arrays that it reads.
        written: Arrays of which it writes every number, and reads none.
        updated: Arrays that it changes in place.
    """

    run: Callable[[], Any]
    read: list[np.ndarray]
    written: list[np.ndarray]
    updated: list[np.ndarray]

    @property
    def bytes(self) -> int:
        """That must be moved at least."""
        return sum(a.nbytes for a in (*self.read, *self.written, *self.updated, *self.updated))


@dataclass
class Stage:
    """A sheet that swings, its matrix filled and its preconditioner fresh, and vectors to play with.

    Attributes:
        r, x, y: (n, 3), zero on pinned vertices.
    """

    world: sim.Simulation
    r: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @property
    def model(self) -> model.Model:
        return self.world.model

    @property
    def springs(self) -> list[Springs]:
        return self.model.springs


@cache
def swinging(side: int) -> sim.Simulation:
    world = sim.Simulation(Sheet("hang", side).scene())
    for _ in range(SETTLE):
        world.step()
    return world


def set_stage(side: int) -> Stage:
    from sim.contact.gap import NO_GAP_SPRINGS

    world = swinging(side)
    own, h = world.model, world.settings.dt
    own.linearise(world.positions.copy(), world.velocities.copy(), NO_GAP_SPRINGS, h)
    preconditioner.refresh(own.preconditioner, own.matrix)
    vectors = np.random.default_rng(0).standard_normal((3, *world.positions.shape)) * own.free[:, None]
    return Stage(world, *vectors)


def fields(arrays, *names) -> list[np.ndarray]:
    """The arrays of these names."""
    return [getattr(arrays, name) for name in names]


def of_all(stage, *names) -> list[np.ndarray]:
    """The arrays of these names, of all kinds of springs."""
    return [array for s in stage.springs for array in fields(s.elements, *names)]


def measure(name):
    def build(stage):
        kind = {**STRETCH, **BENDING}[name]
        springs = build_springs(name, kind, stage.world.mesh)
        springs.apply(stage.world.settings)
        positions, e = stage.world.positions.copy(), springs.elements
        read = [positions, *fields(e, "nodes", "memory")]
        return Kernel(lambda: springs.measure(positions), read, fields(e, "q", "gradient", "new_memory"), [])

    return build


def set_damping(stage):
    masses, ratios = stage.model.inverse_masses, stage.model.damping_ratios

    def run():
        for s in stage.springs:
            elements.set_damping(s.elements, masses, ratios)

    return Kernel(
        run, [masses, *of_all(stage, "nodes", "stiffness", "gradient")], of_all(stage, "damping"), []
    )


def set_tension(stage):
    velocities = stage.world.velocities.copy()

    def run():
        for s in stage.springs:
            elements.set_tension(s.elements, velocities)

    read = of_all(stage, "nodes", "rest", "stiffness", "damping", "drift", "q", "gradient")
    return Kernel(run, [velocities, *read], of_all(stage, "tension"), [])


def set_matrix_factors(stage):
    h = stage.world.settings.dt

    def run():
        for s in stage.springs:
            elements.set_matrix_factors(s.elements, h, model.BENDS[s.kind.bends])

    read, written = of_all(stage, "rest", "stiffness", "damping", "q"), of_all(stage, "along")
    for s in stage.springs:
        if s.kind.bends != "none":
            read += fields(s.elements, "gradient")
            written += fields(s.elements, "weight", "tensor")
        if s.kind.bends == "normal":
            read += fields(s.elements, "new_memory")
    return Kernel(run, read, written, [])


def assemble(stage):
    own, pool, gather = stage.model, stage.model.pool, stage.model.gather
    read = [own.masses, *fields(gather, "row", "place", "first", "middle", "element", "a", "b")]
    read.append(gather.mirror[: len(gather.mirror) // 2])  # those of blocks left of the diagonal
    for s in stage.springs:
        read += fields(
            s.elements, *(("along", "gradient") if s.kind.bends == "none" else ("weight", "tensor"))
        )
    written = fields(own.matrix, "diagonal", "block")
    return Kernel(lambda: system.assemble(pool, gather, own.masses, own.matrix), read, written, [])


def add_forces(stage):
    pool, gather, forces = stage.model.pool, stage.model.gather, np.zeros_like(stage.x)
    own = gather.row[:-1]
    count = int((gather.first[own + 1] - gather.first[own]).sum())  # those of diagonal blocks
    read = [pool.tension, pool.gradient, gather.row, gather.first[own]]
    read += [gather.element[:count], gather.a[:count]]
    return Kernel(lambda: system.add_forces(pool, gather, forces), read, [], [forces])


def refresh(stage):
    whole, matrix = stage.model.preconditioner, stage.model.matrix
    local, coarse = whole.local, whole.coarse
    read = [local.single, *fields(matrix, "diagonal", "block")]
    read.append(local.inverse[local.single])  # is written, but a copy: counted only
    read += fields(coarse, "upper", "lower", "of_target", "source", "weight")
    for patches in (whole.patches, whole.coarsest):
        read += fields(patches, "of_source", "source", "place")
    written = [whole.patches.band, whole.coarsest.band, *fields(coarse, "diagonal", "block")]
    written.append(coarse.inverse[: coarse.level[-2]])
    return Kernel(lambda: preconditioner.refresh(whole, matrix), read, written, [])


def apply_preconditioner(stage):
    whole, work, r, z = stage.model.preconditioner, stage.model.work, stage.r, stage.y
    local, coarse = whole.local, whole.coarse
    names = ("single", "of_place", "place", "of_vertex", "node", "node_weight")
    read = [r, local.inverse[local.single], *fields(local, *names, "of_node", "vertex", "vertex_weight")]
    read += fields(coarse, "first", "middle", "column", "block", "inverse", "of_up", "up", "up_weight")
    for patches in (whole.patches, whole.coarsest):
        read += fields(patches, "vertex", "band")
    room = [whole.patches.room, whole.coarsest.room, *fields(coarse, "x", "b")]

    def run():
        return preconditioner.precondition(whole, r, z, work.partial, work.largest)[0]

    return Kernel(run, read, [z], room)


def multiply(stage):
    matrix, coupling = stage.model.matrix, stage.model.coupling
    free, partial = stage.model.free, stage.model.work.partial
    read = [free, stage.x, *fields(matrix, "diagonal", "first", "column", "block")]
    return Kernel(lambda: cg.multiply(matrix, coupling, free, stage.x, stage.y, partial), read, [stage.y], [])


def step_along(stage):
    p, ap = np.random.default_rng(1).standard_normal((2, *stage.x.shape))
    return Kernel(lambda: cg.step_along(0.5, p, ap, stage.x, stage.r), [p, ap], [], [stage.x, stage.r])


def turn(stage):
    return Kernel(lambda: cg.turn(stage.x, stage.r, 0.5), [stage.r], [], [stage.x])


KERNELS: dict[str, Callable[[Stage], Kernel]] = {
    **{f"measure {name}": measure(name) for name in ("edge", "altitude", "cross", "modified", "angle")},
    "set damping": set_damping,
    "set tension": set_tension,
    "set matrix factors": set_matrix_factors,
    "assemble": assemble,
    "add forces": add_forces,
    "refresh": refresh,
    "multiply": multiply,
    "apply preconditioner": apply_preconditioner,
    "step along": step_along,
    "turn": turn,
}
"""By name, in the order of a step; those of elements stand for all kinds in force."""


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_writes_the_bytes_that_bound_its_time(benchmark, triad, name, threads):
    """Arrays that it writes hold no number before, and finite ones in every place after it."""
    stage = set_stage(SIDE if benchmark.enabled else SMALL)
    kernel = KERNELS[name](stage)
    for array in kernel.written:
        array[:] = np.nan
    with processor_threads(threads):
        result = benchmark.pedantic(kernel.run, rounds=ROUNDS, iterations=1, warmup_rounds=WARM)
    assert result is None or result > 0.0  # xᵀ A x and rᵀ P⁻¹ r
    assert all(np.isfinite(array).all() for array in (*kernel.written, *kernel.updated))
    assert kernel.bytes > 0
    compare(benchmark, triad, kernel.bytes, threads)


def compare(benchmark, triad, moved, threads):
    """Note the bytes that are `moved`, the bounds, and how far above them the kernel is."""
    benchmark.extra_info["bytes"] = moved
    for place, count in TRIADS.items():
        speed = triad(count if benchmark.enabled else TINY, threads)
        benchmark.extra_info[f"triad {place} [GB/s]"] = 1e-9 * speed
        benchmark.extra_info[f"bound {place} [ms]"] = 1e3 * moved / speed
        if benchmark.enabled:
            benchmark.extra_info[f"fastest / bound {place}"] = benchmark.stats.stats.min * speed / moved
