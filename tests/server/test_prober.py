"""The prober: when it measures, when it does not, and what it costs."""

import threading
from types import SimpleNamespace

import pytest
from fake_world import FakeWorld, press_find, wait_until

import server.prober
from server.lane import Ask, Frame
from server.prober import MEASURING, OFF, Prober, Stopped
from sim.budget import Choice
from sim.probe import LocalError
from sim.report import StepError
from sim.settings import Settings


class Lane:
    """Answers at once, in the caller's thread."""

    def __init__(self):
        self.ready, self.frame, self.asked = True, Frame(time=1.0), 0
        self.state = SimpleNamespace(time=1.0, ramp=SimpleNamespace(target=None))

    def send(self, command):
        assert isinstance(command, Ask)
        self.asked += 1
        command.reply(self.state)


class Bench:
    ready = playing = True

    def __init__(self, count=2):
        self.lanes = [Lane() for _ in range(count)]
        self.finished = []

    def step(self, ms):
        self.finished = [Frame(steps=1, ms={"total": ms}, time=1.0) for _ in self.lanes]


@pytest.fixture
def rig(monkeypatch):
    """A prober whose measurements are numbers that the test says, and that are posted when it says so."""
    monkeypatch.setattr(server.prober, "SETTLE", 0.0)
    answers = []
    rig = SimpleNamespace(errors=[], gate=threading.Event(), answers=answers, vague=False, quick=[])

    def measure(probe, state, quick):
        rig.gate.wait(20)
        rig.quick.append(quick)
        found = rig.errors.pop(0) if rig.errors else 1e-3
        if isinstance(found, Exception):
            raise found
        return state, LocalError(found, found / 2 if quick and rig.vague else 0.0, 1 / 60, 1.0)

    monkeypatch.setattr(server.prober, "_measure", measure)
    monkeypatch.setattr("sim.probe.Probe", lambda world, between: SimpleNamespace(between=between))
    rig.gate.set()
    rig.prober = Prober(lambda action, *args: answers.append((action, args)))
    rig.prober.clear(lambda settings: None, 2)

    def answer():
        wait_until(lambda: answers)
        action, args = answers.pop(0)
        action(*args)

    rig.answer = answer
    yield rig
    rig.gate.set()
    rig.prober.stop()


def test_every_variant_is_measured_first_and_then_only_as_often_as_lanes_paid_for(rig):
    bench = Bench()
    for _ in range(2):
        rig.prober.tick(bench, True)
        rig.answer()
    assert [lane.asked for lane in bench.lanes] == [1, 1]
    assert all(reading.found.error == 1e-3 for reading in rig.prober.readings)
    rig.prober.spent, rig.prober.stepped, rig.prober._took = 0.5, 0.0, 0.5
    rig.prober.tick(bench, True)
    assert [lane.asked for lane in bench.lanes] == [1, 1]
    for asked in ([1, 1], [2, 1]):
        bench.step(0.5 * 1.01e3 / server.prober.SHARE)
        rig.prober.tick(bench, True)
        assert [lane.asked for lane in bench.lanes] == asked, "both lanes' time counts once"


def test_the_first_reading_is_of_what_has_begun_unless_it_is_paused_before(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    bench.lanes[0].frame = Frame(time=0.1)
    rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 0
    bench.playing = False
    rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 1


def test_while_time_runs_readings_are_quick_and_in_a_pause_they_are_measured_better(rig):
    bench, seen = Bench(), []
    rig.vague = True
    rig.errors = [1e-3, 1e-3, 2e-3, 2e-3]
    for _ in range(2):
        rig.prober.tick(bench, True)
        rig.answer()
    assert rig.quick == [True, True]
    rig.prober.spent, rig.prober.stepped = 1.0, 0.0
    rig.prober.tick(bench, True)
    assert not rig.prober._busy, "from now on they are regular, and not paid for"
    bench.playing = False
    for _ in range(2):
        rig.prober.tick(bench, True)
        rig.answer()
        seen.append([(reading.quick, reading.found.error) for reading in rig.prober.readings])
    assert rig.quick[2:] == [False, False]
    assert seen == [[(False, 2e-3), (True, 1e-3)], [(False, 2e-3)] * 2]
    assert all(reading.trend == "" for reading in rig.prober.readings), "they were beside another run"
    rig.prober.tick(bench, True)
    assert not rig.prober._busy
    bench.playing = True
    rig.errors = [3e-3, 4e-3, 9e-3, 3e-3, 3e-3]
    for _ in range(3):
        rig.prober.spent = -1.0
        rig.prober.tick(bench, True)
        rig.answer()
    assert rig.quick[4:] == [True, True, True]
    assert [(reading.quick, reading.trend) for reading in rig.prober.readings] == [(True, "↗"), (True, "")]


def test_what_is_measured_in_a_pause_ends_when_time_runs_again(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    rig.vague = True
    bench.playing = False
    rig.prober.tick(bench, True)
    rig.answer()
    rig.gate.clear()
    rig.prober.tick(bench, True)
    token = rig.prober._run, 0, rig.prober._versions[0]
    assert rig.prober._holds(token)
    bench.playing = True
    rig.prober.tick(bench, True)
    assert not rig.prober._holds(token), "so that it stops before its next step"
    rig.gate.set()
    rig.answer()
    assert rig.prober.readings[0].quick, "what was known before still is"


def test_what_a_change_has_measured_is_made_up_for_by_fewer_regular_ones(rig, monkeypatch):
    """Its processor time is in the account, whose share the lanes' next steps bring back to its limit."""
    now = iter(range(100))
    monkeypatch.setattr(server.prober, "thread_time", lambda: 0.02 * next(now))
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    for _ in range(3):
        rig.prober.changed(0)
        rig.prober.tick(bench, True)
        rig.answer()
    assert rig.prober.spent == pytest.approx(0.06)
    asked = bench.lanes[0].asked
    while bench.lanes[0].asked == asked:
        bench.step(100.0)
        rig.prober.tick(bench, True)
    assert rig.prober.stepped == pytest.approx(0.06 / server.prober.SHARE, abs=0.2)
    rig.answer()
    bench.playing = False
    rig.prober.changed(0)
    rig.prober.tick(bench, True)
    rig.answer()
    assert rig.prober.spent == pytest.approx(0.08), "in a pause nothing is taken from anyone"


def test_not_more_is_owed_than_some_seconds_make_up_for(rig, monkeypatch):
    now = iter(range(100))
    monkeypatch.setattr(server.prober, "thread_time", lambda: 10.0 * next(now))
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    bench.step(1e3)
    rig.prober.tick(bench, True)
    rig.answer()
    assert rig.prober.spent == pytest.approx(server.prober.SHARE + server.prober.DEBT)


def test_a_quick_reading_that_is_known_to_a_tenth_needs_no_better_one(rig):
    bench = Bench()
    rig.prober.spent = 1.0
    for _ in range(2):
        rig.prober.tick(bench, True)
        rig.answer()
    rig.prober.tick(bench, True)
    assert rig.quick == [True, True]
    assert not rig.prober._busy


def test_what_probes_spend_is_processor_time_which_is_all_that_lanes_feel(rig):
    """A thread that stands back waits for long where others compute; here it only waits."""
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    rig.prober.tick(bench, True)
    rig.answer()
    rig.prober.spent = -1.0  # paid for
    rig.gate.clear()
    rig.prober.tick(bench, True)
    threading.Event().wait(0.5)
    rig.gate.set()
    rig.answer()
    assert 0.0 < rig.prober.spent + 1.0 < 0.25


def test_nothing_is_measured_while_nobody_looks_or_one_is_being_measured(rig):
    bench = Bench()
    rig.prober.tick(bench, False)
    assert [lane.asked for lane in bench.lanes] == [0, 0]
    rig.prober.tick(bench, True)
    rig.prober.tick(bench, True)
    assert [lane.asked for lane in bench.lanes] == [1, 0]


def test_a_change_makes_a_reading_stale_and_ends_its_measurement(rig):
    bench = Bench()
    rig.gate.clear()
    rig.prober.tick(bench, True)
    rig.prober.changed(0)
    rig.gate.set()
    rig.answer()
    assert rig.prober.readings[0] is MEASURING, "what was measured was of other settings"
    rig.prober.tick(bench, True)
    rig.answer()
    assert rig.prober.readings[0].found is not None
    rig.prober.changed(0)
    assert rig.prober.readings[0] is MEASURING


def test_work_that_nobody_asks_for_any_more_is_stopped_between_two_steps(rig):
    bench, got, began = Bench(), [], threading.Event()

    def work(probe, state):
        began.set()
        rig.gate.wait(20)
        probe.between()
        return "done"

    rig.gate.clear()
    rig.prober.ask(bench, 0, work, got.append)
    began.wait(20)
    rig.prober.changed(0)
    rig.gate.set()
    rig.answer()
    assert isinstance(got[0], Stopped)


def test_trend_says_whether_errors_grow(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    rig.errors = [1e-3, 2e-3, 2.1e-3, 1e-3]
    seen = []
    for _ in range(4):
        rig.prober.spent = -1.0  # paid for
        rig.prober.tick(bench, True)
        rig.answer()
        seen.append(rig.prober.readings[0].trend)
    assert seen == ["", "↗", "→", "↘"]


def test_a_frame_that_cannot_be_measured_says_why_and_is_tried_again(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    rig.errors = [StepError("too far", "solve", "dt")]
    rig.prober.tick(bench, True)
    rig.answer()
    assert "too far" in rig.prober.readings[0].why_not
    rig.prober.spent = -1.0
    rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 1, "but not over and over, which would fill the log"
    rig.prober._failed -= server.prober.RETRY
    rig.prober.tick(bench, True)
    rig.answer()
    assert rig.prober.readings[0].found is not None


def test_in_a_pause_each_new_state_is_measured_once(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    bench.playing = False
    for time in (0.0, 0.5):
        bench.lanes[0].frame = Frame(time=time)
        bench.lanes[0].state.time = time
        rig.prober.tick(bench, True)
        rig.answer()
        for _ in range(3):
            rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 2


def switched(bench, choice):
    """Have frames of a scene whose local error is switched so."""
    for lane in bench.lanes:
        lane.frame = Frame(time=lane.frame.time, settings=Settings(local_error=choice))


def test_a_local_error_that_is_off_is_never_measured_and_what_is_under_way_ends(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    rig.gate.clear()
    rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 1
    switched(bench, "off")
    rig.prober.tick(bench, True)
    assert not rig.prober._holds((rig.prober._run, 0, 0)), "so that it stops before its next step"
    rig.gate.set()
    rig.answer()
    rig.prober.changed(0)
    for playing in True, False:
        bench.playing, rig.prober.spent = playing, -1.0
        rig.prober.tick(bench, True)
    assert rig.prober.readings[0] is OFF
    assert bench.lanes[0].asked == 1
    switched(bench, "auto")
    rig.prober.tick(bench, True)
    assert rig.prober.readings[0] is MEASURING
    assert bench.lanes[0].asked == 2


def test_a_local_error_that_is_on_is_measured_again_as_soon_as_the_last_is_done(rig):
    bench = Bench(1)
    rig.prober.clear(lambda settings: None, 1)
    for _ in range(4):
        switched(bench, "on")
        bench.step(10.0)
        rig.prober.tick(bench, True)
        rig.answer()
        rig.prober.spent = 1.0  # far more than lanes have paid for
    assert bench.lanes[0].asked == 4
    assert rig.prober.readings[0].share == pytest.approx(rig.prober.taken / rig.prober.stepped)
    switched(bench, "auto")
    rig.prober.tick(bench, True)
    assert bench.lanes[0].asked == 4


def test_a_simulation_without_states_is_not_asked_over_and_over(lab, client):
    wait_until(lambda: lab._prober.readings[0].why_not or lab._prober.readings[1].why_not)
    assert lab._prober._build is None
    assert len(FakeWorld.made) == 2, "and none was built for measuring"


def test_a_budget_that_cannot_be_worked_out_says_so_and_time_goes_on(lab, client):
    press_find(client, "time per frame [ms]", 3.0)
    wait_until(lambda: "no state to measure from" in lab._page.charts.budget._answer.content)
    wait_until(lambda: lab._bench.playing)


def test_a_budget_is_for_the_cloth_that_is_chosen(lab, client, monkeypatch):
    asked = []
    monkeypatch.setattr(lab._prober, "ask", lambda bench, index, *_: asked.append(index))
    client.set(client.find("for the"), "second cloth")
    press_find(client, "time per frame [ms]", 3.0)
    wait_until(lambda: asked == [1])
    client.set(client.find("for the"), "third cloth")
    press_find(client, "time per frame [ms]", 3.0)
    wait_until(lambda: "There are 2 cloths only" in lab._page.charts.budget._answer.content)
    assert asked == [1]


def test_what_a_budget_sets_is_one_change_that_one_undo_takes_back(lab, client, monkeypatch):
    before, changes = lab.comparison, {"newton": 7, "tolerance": 1e-5, "dt": 1 / 120}
    found = LocalError(error=1e-3, floor=1e-5, seconds=1 / 60, ms=1.0)
    choice = Choice(changes, True, "These.", found, found)
    monkeypatch.setattr(lab._prober, "ask", lambda *a, **booked: booked or lab.post(a[-1], choice))
    press_find(client, "time per frame [ms]", 3.0)
    wait_until(lambda: lab.comparison.shared.newton == 7)
    assert {name: getattr(lab.comparison.shared, name) for name in changes} == changes
    lab.post(lab.undo)
    wait_until(lambda: lab.comparison == before)


@pytest.mark.parametrize("nonsense", [0.0, -1.0, float("nan"), float("inf"), True, "many", None])
def test_a_budget_is_a_positive_number_whatever_a_client_sends(lab, client, nonsense):
    before = lab._page.charts.budget._most.value
    client.set(client.find("at most"), nonsense)
    client.set(client.find("rest angle θ₀ [rad]"), 0.3)
    wait_until(lambda: lab.comparison.shared.rest_angle == 0.3)
    assert lab._page.charts.budget._most.value == before
