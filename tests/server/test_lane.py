"""A lane: commands are carried out between steps, in its own thread."""

import itertools
import math
import threading
import time

import msgspec
import pytest
from fake_world import SCENE, FakeWorld, StepError, wait_until

from server.lane import FIGURES_EVERY, SHARE, Advance, Ask, Change, Lane, Reset
from sim import load_scene

STILL = 1 / 60


@pytest.fixture
def start():
    lanes = []

    def start(build=FakeWorld, **settings):
        FakeWorld.made.clear()
        scene = load_scene(SCENE)
        lane = Lane(
            lambda s: build(scene, s), msgspec.structs.replace(scene.settings, **settings), lambda: None
        )
        lanes.append(lane)
        lane.start()
        wait_until(lambda: not lane.busy)
        return lane

    yield start
    for lane in lanes:
        for world in FakeWorld.made:
            world.gate.set()
        lane.stop()
        lane.join(5)
        assert not lane.is_alive()


def finish(lane, *commands):
    for command in commands:
        lane.send(command)
    wait_until(lambda: not lane.busy)
    return lane.frame


def test_lane_advances_by_the_time_asked_for(start):
    frame = finish(start(dt=0.01), Advance(0.1))
    assert (frame.steps, frame.time) == (10, pytest.approx(0.1))
    assert frame.positions.dtype == "float32"
    assert frame.ms == {"solve": 1.0, "total": 1.0}
    assert [part.tolist() for part in frame.momentum] == [[3.0, 0.0, 4.0], [0.0, 2.5e-7, 0.0]]


def test_lanes_with_different_steps_stay_on_one_clock(start):
    """Lanes may be at most one step apart, and never drift."""
    coarse, fine = start(dt=0.03), start(dt=0.007)
    for _ in range(50):
        finish(coarse, Advance(0.033))
        finish(fine, Advance(0.033))
        assert abs(coarse.frame.time - fine.frame.time) < 0.03
    assert coarse.frame.time == pytest.approx(50 * 0.033, abs=0.03)


def test_a_lane_is_built_once_for_resets_in_a_row_and_what_was_asked_before_them_is_not_done(start):
    """Somebody presses the button again and again while a step takes long; who asks is answered anyway."""
    lane, answers = start(dt=0.01), []
    (world,) = FakeWorld.made
    world.gate.clear()
    lane.send(Advance(0.01))
    wait_until(lambda: lane.busy and not lane._commands.qsize())
    for gamma in (0.1, 0.2, 0.3):
        lane.send(Change({"gamma": 5.0}))
        lane.send(Ask(answers.append))
        lane.send(Reset(msgspec.structs.replace(load_scene(SCENE).settings, gamma=gamma)))
    lane.send(Change({"friction": 0.7}))
    world.gate.set()
    wait_until(lambda: not lane.busy)
    assert len(FakeWorld.made) == 2
    assert not world.updates
    assert lane.frame.settings.gamma == 0.3
    assert list(FakeWorld.made[1].updates) == [{"friction": 0.7}]
    assert len(answers) == 3


def test_change_takes_effect_between_two_steps_of_one_advance(start):
    lane = start(dt=0.01)
    (world,) = FakeWorld.made
    world.gate.clear()
    lane.send(Advance(0.1))
    lane.send(Change({"gamma": 0.7}))
    world.gate.set()
    wait_until(lambda: not lane.busy)
    assert list(world.updates) == [{"gamma": 0.7}]
    assert world.steps == 10


def test_flood_of_changes_is_carried_out_as_one(start):
    lane = start()
    (world,) = FakeWorld.made
    world.gate.clear()
    lane.send(Advance(STILL))
    wait_until(lambda: lane.waiting)
    for i in range(1000):
        lane.send(Change({"gamma": i / 1000}))
    world.gate.set()
    wait_until(lambda: not lane.busy)
    assert list(world.updates) == [{"gamma": 0.999}]


def test_refused_step_stops_the_lane_until_a_change_revives_it(start):
    lane = start()
    frame = finish(lane, Change({"density": 200.0}), Advance(STILL))
    assert "too heavy" in frame.refused
    assert finish(lane, Advance(10.0)).time == 0.0, "time that passes meanwhile is not owed"
    frame = finish(lane, Change({"density": 0.2}), Advance(STILL))
    assert (frame.refused, frame.steps) == ("", 1)


class Crossed(FakeWorld):
    """Takes 2 ms to count what crosses."""

    def __init__(self, *about):
        super().__init__(*about)
        self.counts = []

    def crossings(self):
        begin = time.perf_counter()
        time.sleep(2e-3)
        self.counts.append((begin, time.perf_counter()))
        return self.steps


def test_what_crosses_is_counted_at_the_start_and_then_within_a_share_of_the_time(start):
    lane, frames = start(Crossed, dt=0.01), []
    (world,) = FakeWorld.made
    assert lane.frame.crossings == 0
    while len(world.counts) < 4:
        frames.append(finish(lane, Advance(0.1)))
    counted = [frame for frame in frames if frame.crossings is not None]
    assert len(counted) == 3 < len(frames)
    assert all(frame.crossings == round(frame.time / 0.01) for frame in counted)
    for (begin, end), (again, _) in itertools.pairwise(world.counts[1:]):
        assert end - begin <= SHARE * (again - begin)
    assert finish(lane, Reset(lane.frame.settings)).crossings == 0, "the start is seen whenever it comes"


def test_what_crosses_is_counted_where_that_is_asked_for_whatever_it_takes(start):
    lane = start(Crossed, dt=0.01)
    frames = [finish(lane, Advance(0.01, counted=True)) for _ in range(5)]
    assert [frame.crossings for frame in frames] == [1, 2, 3, 4, 5]
    assert finish(lane, Advance(0.0, counted=True)).crossings == 5


def test_crossings_that_are_on_are_counted_after_every_frame_and_what_that_takes_is_told(start):
    lane = start(Crossed, dt=0.01, crossings="on")
    frames = [finish(lane, Advance(0.02)) for _ in range(5)]
    assert [frame.crossings for frame in frames] == [2, 4, 6, 8, 10]
    assert frames[-1].counting > 1.0, "2 ms for two steps that say that they take 1 ms each"


def test_crossings_that_are_off_are_never_counted_whoever_asks_and_again_at_once_when_they_are_not(start):
    lane = start(Crossed, dt=0.01, crossings="off")
    frames = [lane.frame, *(finish(lane, Advance(0.01, counted=True)) for _ in range(5))]
    (world,) = FakeWorld.made
    assert not world.counts
    assert {(frame.crossings, frame.counting) for frame in frames} == {(None, None)}
    for choice in "auto", "off", "auto":
        counted = finish(lane, Change({"crossings": choice})).crossings
        assert counted == (None if choice == "off" else 5)


class Weighed(FakeWorld):
    """Counts how often it is asked for its energy."""

    asked = 0

    def energy(self):
        self.asked += 1
        return {"steps": float(self.steps)}


def test_energies_are_computed_no_more_often_than_they_are_read_while_time_runs(start):
    lane, begin = start(Weighed, dt=0.01), time.perf_counter()
    frames = [finish(lane, Advance(0.01)) for _ in range(50)]
    (world,) = FakeWorld.made
    assert world.steps == 50
    assert world.asked <= 1 + math.ceil((time.perf_counter() - begin) / FIGURES_EVERY)
    assert all(frame.energy and frame.momentum is not None for frame in frames)
    time.sleep(FIGURES_EVERY)
    assert finish(lane, Advance(0.01)).energy == {"steps": 51.0}


def test_energies_are_of_the_frame_itself_where_none_may_follow_it_or_a_setting_has_changed(start):
    lane = start(Weighed, dt=0.01)
    frames = [finish(lane, Advance(0.01, counted=True)) for _ in range(3)]
    assert [frame.energy["steps"] for frame in frames] == [1.0, 2.0, 3.0]
    (world,) = FakeWorld.made
    asked = world.asked
    finish(lane, Change({"gamma": 0.3}))
    assert world.asked == asked + 1
    finish(lane, Advance(0.01))
    world.settings = msgspec.structs.replace(world.settings, density=200.0)
    refused = finish(lane, Advance(0.01))
    assert refused.refused
    assert refused.energy == {"steps": 4.0}
    assert finish(lane, Reset(lane.frame.settings)).energy == {"steps": 0.0}


def test_reset_revives_and_starts_again(start):
    lane = start()
    finish(lane, Advance(0.5), Change({"density": 200.0}), Advance(STILL))
    frame = finish(lane, Reset(load_scene(SCENE).settings))
    assert (frame.refused, frame.time, frame.report, frame.ms) == ("", 0.0, None, None)


def test_refused_change_is_noted_and_steps_go_on(start):
    lane = start()
    frame = finish(lane, Change({"gamma": 13.0}), Advance(STILL))
    assert (frame.note, frame.steps) == ("gamma: unlucky", 1)
    assert finish(lane, Change({"gamma": 1.0})).note == ""


def test_simulation_that_cannot_be_built_says_why_and_can_be_tried_again(start):
    attempts = []

    def build(scene, settings):
        attempts.append(settings)
        if len(attempts) == 1:
            raise StepError("no such thing", "solve", "dt")
        return FakeWorld(scene, settings)

    lane = start(build)
    assert "no such thing" in lane.frame.refused
    assert not lane.ready
    finish(lane, Change({"gamma": 1.0}), Advance(STILL))
    assert finish(lane, Reset(load_scene(SCENE).settings), Advance(STILL)).steps == 1


def test_lane_stops_in_the_middle_of_an_advance(start):
    lane = start(dt=1e-6)
    lane.send(Advance(1e9))
    wait_until(lambda: FakeWorld.made[0].steps > 10)
    lane.stop()
    lane.join(5)
    assert not lane.is_alive()


class Kept(FakeWorld):
    def snapshot(self):
        assert threading.get_ident() == self.thread
        return self.steps


def test_state_is_handed_over_between_two_steps_in_the_lanes_thread(start):
    lane, states = start(Kept, dt=0.01), []
    frame = finish(lane, Advance(0.05))
    lane.send(Ask(states.append))
    wait_until(lambda: states == [5])
    assert lane.frame is frame, "which holds what was measured of the steps, and may not have been taken in"


def test_simulation_without_a_state_to_hand_over_says_so(start):
    states = []
    start().send(Ask(states.append))
    wait_until(lambda: states == [None])


def test_lanes_step_in_threads_of_their_own(start):
    start(), start()
    assert len({w.thread for w in FakeWorld.made} | {threading.get_ident()}) >= 2
