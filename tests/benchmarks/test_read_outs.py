"""What the page's read-outs add to a step, in percent of one of which nothing is asked.

    uv run --group test pytest tests/benchmarks/test_read_outs.py --benchmark-enable

prints it; without the option each scene is stepped a few times, as a test that it still runs. Both sides step
the same states in turn, in one process. What is done now and then goes by the share of the time that it is
held to, and energies and momenta by how many frames they serve, so that all is there, and not what medians
leave out.
"""

import sys
from statistics import median
from time import perf_counter

import numpy as np
import pytest

import sim
from server import lane, prober
from server.lab import build_world
from server.lane import Lane
from sim.scene import load_scene

SETTLE, ROUNDS, FEW = 60, 200, 2  # steps before those that are timed, these, and those of a smoke test

FRAME = 1 / 60
"""Wall time [s] from one frame to the next, at the speed of real time."""


class Timed:
    """Calls a function and keeps how long each call took [s]."""

    def __init__(self, function):
        self.function, self.took = function, []

    def __call__(self):
        begin = perf_counter()
        self.function()
        self.took.append(perf_counter() - begin)


@pytest.mark.parametrize("name", ["flag", "curtain", "drape"])
def test_read_outs(benchmark, name, monkeypatch, capsys):
    scene = load_scene(name)
    shown = Lane(lambda s: build_world(scene, s), scene.settings, lambda: None, counting=False)
    shown._start(scene.settings)
    plain = sim.Simulation(scene)
    monkeypatch.setattr(plain, "_effects", lambda report: {})  # no words of effects either
    for _ in range(SETTLE if benchmark.enabled else FEW):
        shown._step()
        plain.step()

    def asked():
        shown._figures_due = np.inf  # which are timed by themselves
        shown._step()
        shown._show()

    def alone():
        plain.step()
        plain.positions.astype(np.float32)  # what is drawn is no read-out
        plain.obstacle_poses()

    def figures():
        shown._figures_due = 0.0
        shown._energies()

    figures()
    with_all, without, read = Timed(asked), Timed(alone), Timed(figures)

    def before():
        without()
        read()

    benchmark.pedantic(with_all, setup=before, rounds=ROUNDS if benchmark.enabled else FEW, iterations=1)
    assert not shown._refused
    assert np.array_equal(shown._world.positions, plain.positions)
    step = median(without.took)
    more = median(a - b for a, b in zip(with_all.took, without.took, strict=True))
    parts = {
        "books, words and frame": more / step,
        "energies and momenta": median(read.took) * min(FRAME / lane.FIGURES_EVERY, 1.0) / step,
        "crossings": lane.SHARE,
        "probes": prober.SHARE,
    }
    told = {f"{part} [%]": round(100 * share, 2) for part, share in parts.items()}
    told |= {"step alone [ms]": round(1e3 * step, 2), "all [%]": round(100 * sum(parts.values()), 2)}
    benchmark.extra_info |= told
    if benchmark.enabled:
        with capsys.disabled():
            sys.stdout.write(f"\n{name}: {', '.join(f'{what} {value}' for what, value in told.items())}\n")
