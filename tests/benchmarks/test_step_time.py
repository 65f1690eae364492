"""Milliseconds per step of a sheet that falls on a sphere and drapes over it.

    uv run --group test pytest tests/benchmarks --benchmark-enable

prints medians; without the option each case is stepped once, as a test that it still runs.
"""

import pytest

import sim
from tests.worlds import ball, grid, scene

SETTLE, ROUNDS = 10, 110  # steps until it lands, and steps that are timed


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
