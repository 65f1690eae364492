"""Milliseconds per step of a scene as it is, and with each of its effects left out.

    uv run --group test pytest tests/benchmarks/test_leave_one_out.py --benchmark-enable

prints medians; without the option each case is stepped once, as a test that it still runs. All cases step the
same states: every round starts from the same snapshot, taken where cloth lies on an obstacle and on cloth.
"""

import pytest

import sim
from sim.effects import EFFECTS, OBSTACLE, effects_with
from sim.settings import READ_OUTS
from tests.worlds import ball, grid

SIDE, SMALL = 40, 8  # vertices along a side of the larger sheet, and of what a smoke test steps

ROUNDS, SETTLE = 40, 60  # steps that are timed, and steps until both sheets have landed

LABELS = "ball", "floor"

CASES = ("nothing", *(name for name in effects_with(LABELS) if name not in READ_OUTS))


def busy(side: int) -> dict:
    """A sheet on a ball in the wind, and a smaller one on that: a scene that has every effect."""
    return {
        "cloth": [
            grid(resolution=(side, side), position=[0, 0, 0.31]),
            grid((0.5, 0.5), (side // 2, side // 2), position=[0.02, 0.01, 0.33], rotation=[0, 0, 0.4]),
        ],
        "obstacle": [ball(name="ball"), {"kind": "plane", "point": [0, 0, -0.4], "name": "floor"}],
        "settings": {
            "gravity": [0, 0, -9.81],
            "altitudes": "all",
            "bend": "angle",
            "gamma": 0.2,
            "drag": 1.2,
            "wind": [1.0, 0.5, 0.0],
            "strain_limit": 0.1,
            "friction": 0.3,
        },
    }


@pytest.mark.parametrize("name", CASES)
def test_step_without(benchmark, name):
    world = sim.Simulation(busy(SIDE if benchmark.enabled else SMALL))
    assert "off" not in world.effects.values()
    for _ in range(SETTLE if benchmark.enabled else 1):
        world.step()
    start = world.snapshot()
    if name != "nothing":
        world.switch(**sim.effects.switch(name, "off", world.settings))
    settings = {key: getattr(world.settings, key) for key in sim.settings.FIELDS}

    def again() -> None:
        world.restore(start)
        world.switch(**settings)

    again()
    world.step()  # what the switch has to build is no part of a step
    report = benchmark.pedantic(world.step, setup=again, rounds=ROUNDS, iterations=1)
    if name != "nothing":
        assert report.effects[name].startswith("off")
        assert not report.costs.get(name, 0.0)
    if name in EFFECTS or name.startswith(OBSTACLE):
        benchmark.extra_info["iterations of the last step"] = report.iterations
