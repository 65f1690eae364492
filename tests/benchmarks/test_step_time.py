"""Milliseconds per step, and peak memory, of sheets that hang, fall on a sphere, and drape over it.

    uv run --group test pytest tests/benchmarks --benchmark-enable

prints medians; without the option each case is stepped once, as a test that it still runs.
"""

import contextlib
from pathlib import Path

import pytest

import sim
from sim.bench.memory import peak_memory
from sim.bench.sheet import KINDS, Sheet
from tests.worlds import ball, grid, scene

SETTLE, ROUNDS = 10, 110  # steps until it lands, and steps that are timed

SIDES, SMALL = (32, 64, 100, 200), 12  # of the bench's sheets, and of what a smoke test steps

LARGE, FEW = 100, 30  # sheets from that side on are timed over fewer steps


def forget_peak():
    """Let the peak of this process begin anew, where the system can: cases before were larger."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("side", SIDES, ids=[f"{side**2} vertices" for side in SIDES])
@pytest.mark.parametrize("kind", KINDS)
def test_sheet_of_the_bench(benchmark, kind, side, threads):
    """As `muslin bench` has it; memory is that of the process, Python, Numba and the building included."""
    forget_peak()
    world = sim.Simulation(Sheet(kind, side if benchmark.enabled else SMALL).scene(), threads=threads)
    for _ in range(SETTLE if benchmark.enabled else 0):
        world.step()
    report = benchmark.pedantic(world.step, rounds=FEW if side >= LARGE else ROUNDS, iterations=1)
    benchmark.extra_info["iterations of the last step"] = report.iterations
    benchmark.extra_info["peak memory [MB]"] = peak_memory()
    assert report.converged
    assert report.penetrations == 0


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("side", [32, 64], ids=["1024 vertices", "4096 vertices"])
def test_sheet_on_sphere(benchmark, side, threads):
    world = sim.Simulation(
        scene(
            grid(resolution=(side, side), position=[0, 0, 0.32]),
            ball(),
            gravity=[0, 0, -9.81],
            threads=threads,
        )
    )
    for _ in range(SETTLE if benchmark.enabled else 0):
        world.step()
    report = benchmark.pedantic(world.step, rounds=ROUNDS, iterations=1)
    benchmark.extra_info["iterations of the last step"] = report.iterations
    assert report.penetrations == 0
