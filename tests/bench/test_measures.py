"""The bench's measurements, on solvers that are made up."""

import itertools
import json
import math
import subprocess
import sys
from dataclasses import asdict

import numpy as np
import pytest

import sim
from sim.bench import Case
from sim.bench.accuracy import HORIZON, TARGETS, Trial, assess, climb
from sim.bench.case import measure
from sim.bench.frames import MOST, measure_frames
from sim.bench.memory import peak_memory
from sim.bench.process import measure_apart
from sim.bench.sheet import DENSITY, SPRING, Sheet
from sim.bench.steps import DIRECT, reference, step_error
from sim.bench.tables import percentile

pytestmark = pytest.mark.alone


class Clock:
    """Tells the time that runs have put on it."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class FirstOrder:
    """A run of one vertex whose error is 16 mm over the substeps, and whose frame costs a second for each."""

    def __init__(self, substeps, clock):
        self.substeps, self.clock = substeps, clock

    def frame(self):
        self.clock.now += self.substeps

    def positions(self):
        return np.array([[0.016 / self.substeps, 0.0, 0.0]])


def climbed(seconds, ladder, others=()):
    clock = Clock()

    def start(knobs):
        return FirstOrder(knobs["substeps"], clock)

    knobs = [[{"substeps": n} for n in numbers] for numbers in ([1], ladder, others)]
    return list(climb(start, *knobs, seconds, lambda positions: float(positions[0, 0]), clock))


def test_a_ladder_finds_the_cheapest_settings_for_each_target():
    last = climbed(1e6, [2**k for k in range(12)], others=[3, 20])[-1]
    assert last["settled"] == pytest.approx(
        0.016 / 256
    )  # a tenth of 1 mm is met by the change from 128 to 256
    assert last["reference"] == "256"
    assert [met["settings"] for met in last["met"]] == ["2", "16"]
    assert last["met"][0]["ms"] == 2000.0
    for met in last["met"]:  # the error that is said is a bound of the true one
        assert met["error"] >= 0.016 / int(met["settings"]) - 1e-12


def test_a_ladder_without_time_says_what_is_the_best_it_has():
    last = climbed(94.0, [2**k for k in range(12)])[-1]
    assert last["met"][1] is None
    assert last["settled"] == pytest.approx(0.004)
    assert last["best"]["settings"] == "4"


def test_a_single_rung_proves_nothing():
    (first,) = climbed(24.0, [3, 6])
    assert climbed(4.0, [1, 2]) == []  # not even its own settings were done
    assert first["settled"] is None
    assert first["best"]["error"] is None
    assert first["met"] == [None] * len(TARGETS)


def test_what_blows_up_meets_no_target():
    def at(x, ms):
        return Trial({"substeps": 1}, ms, np.array([[x, 0.0, 0.0]]))

    found = assess(
        [at(math.nan, 1.0)], [at(1e-5, 2.0), at(0.0, 3.0)], lambda positions: float(positions[0, 0])
    )
    assert found["own"]["error"] is None
    assert found["own_strain"] is None
    assert [met["ms"] for met in found["met"]] == [2.0, 2.0]


def test_frames_are_timed_after_one_that_compiles_and_until_time_is_out():
    clock, said, sheet = Clock(), [], Sheet("hang", 4)

    class Slow(FirstOrder):
        def positions(self):
            return 2.0 * sheet.mesh.vertices

    knobs = {"substeps": 3}
    for seconds, count in ((10.0, 4), (1e9, MOST)):
        measure_frames(lambda: Slow(3, clock), sheet, knobs, seconds, said.append, clock=clock)
        assert said[-1]["ms"] == [3000.0] * count
        assert said[-1]["start_up"] == 3.0
        assert said[-1]["strain"] == pytest.approx(1.0)
        assert said[-1]["settings"] == "3"


def test_the_error_of_a_step_is_the_distance_to_the_better_one():
    world = sim.Simulation(Sheet("hang", 6).scene(), tolerance=1e-3)
    for _ in range(5):
        world.step()
    before = world.snapshot()
    world.step()
    after = world.positions.copy()
    error = step_error(world, before, after, {"solver": "direct"})
    assert 0.0 < error < 1e-2
    assert step_error(world, before, world.positions.copy(), {"solver": "direct"}) == 0.0
    shifted = world.positions + np.array([0.0, 0.0, 0.25])
    assert step_error(world, before, shifted, {"solver": "direct"}) == pytest.approx(0.25)


def test_the_reference_is_direct_where_factors_are_to_be_had():
    assert reference(DIRECT) == {"solver": "direct"}
    assert reference(DIRECT + 1)["tolerance"] < 1e-8


@pytest.mark.parametrize("kind", ["hang", "drape"])
def test_steps_of_muslin_are_measured(kind):
    said = []
    measure(Case("steps", "Muslin", kind, 36, 1, 8, 60.0), said.append)
    last = said[-1]
    assert len(last["ms"]) == len(last["iterations"]) == 4  # half of so few steps warm it
    assert len(last["errors"]) == 3
    assert max(last["errors"]) < 1e-4 * 10  # the tolerance is of the mass-weighted mean, not of a vertex
    assert "ms" in said[0]  # what is known is said before a step that may not end


def test_an_accuracy_of_muslin_is_measured():
    said = []
    measure(Case("accuracy", "Muslin", "hang", 16, 1, 1, 1.5), said.append)
    assert said[-1]["own"]["settings"] == "1×1 backward_euler"
    assert len(said[-1]["met"]) == len(TARGETS)
    assert HORIZON > 0


def test_a_case_that_fails_says_why_and_one_that_takes_too_long_is_ended():
    failed = measure_apart(Case("no such measure", "Muslin", "hang", 7, 1, 1, 1.0))
    assert failed == {"failed": "KeyError: 'no such measure'"}
    late = measure_apart(Case("steps", "Muslin", "hang", 16, 1, 3, 0.0), start_up=0.01)
    assert late == {"stopped": 0.01}


def test_a_case_prints_what_it_finds_and_what_packages_print_goes_elsewhere():
    probe = (
        "from sim.bench import case\n"
        "def loud(case, sheet, say):\n"
        "    print('banner', flush=True)\n"
        "    say({'x': sheet.side})\n"
        "case.MEASURES['steps'] = loud\n"
        f"case.main({json.dumps(asdict(Case('steps', 'Muslin', 'hang', 16, 1, 1, 0.5)))!r})"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout == '{"x": 4}\n'
    assert "banner" in done.stderr


def test_a_case_in_a_process_of_its_own_finds_frames():
    found = measure_apart(Case("frames", "Muslin", "hang", 16, 1, 1, 0.5))
    assert found["settings"] == "1×1 backward_euler"
    assert found["ms"]


def test_the_sheet_weighs_and_is_as_stiff_as_it_should_at_every_size():
    for kind, side in itertools.product(("hang", "drape"), (4, 8)):
        world = sim.Simulation(Sheet(kind, side).scene())
        assert len(world.positions) == side**2
        assert world.masses.sum() == pytest.approx(DENSITY)
        spacing = np.linalg.norm(world.positions[1] - world.positions[0])
        assert world.settings.stretch / spacing == pytest.approx(SPRING)
        assert len(world.pinned) == (2 if kind == "hang" else 0)


def test_strain_is_that_of_the_longest_edge():
    sheet = Sheet("hang", 4)
    positions = sheet.mesh.vertices.copy()
    assert sheet.strain(positions) == 0.0
    assert sheet.strain(positions * [1.5, 1.0, 1.0]) == pytest.approx(0.5)


def test_percentiles_are_interpolated():
    assert percentile([3.0], 0.9) == 3.0
    values = [5.0, 1.0, 4.0, 2.0]
    assert percentile(values, 0.9) == pytest.approx(np.percentile(values, 90))
    assert percentile(values, 1.0) == 5.0


def test_memory_is_that_of_this_process():
    peak = peak_memory()
    assert peak is None or 10.0 < peak < 1e6
