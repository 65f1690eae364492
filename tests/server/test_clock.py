"""The clock: how much simulated time a frame holds, and when it is due."""

import pytest

from server.clock import FRAME, Clock


def run(clock, wall, frames, step, cost):
    """Frames that cost a wall time each; the simulated time they held."""
    begin = clock.time
    for _ in range(frames):
        wall.now += clock.wait()
        clock.next_frame(step)
        wall.now += cost
    return clock.time - begin


@pytest.mark.parametrize("speed", [0.125, 1.0, 4.0])
def test_quick_simulation_runs_at_the_speed_asked_for(wall, speed):
    clock = Clock(wall)
    clock.speed = speed
    begin = wall.now
    simulated = run(clock, wall, 100, 1e-3, cost=0.001)
    assert simulated / (wall.now - begin) == pytest.approx(speed, rel=0.02)
    assert clock.real_time_factor == pytest.approx(speed, rel=0.05)


def test_slow_simulation_is_not_asked_to_catch_up(wall):
    clock = Clock(wall)
    run(clock, wall, 20, 1 / 60, cost=1.0)
    assert clock.next_frame(1 / 60) == 1 / 60, (
        "a single step per frame, so that it is shown as often as can be"
    )
    assert clock.real_time_factor == pytest.approx(1 / 60, rel=0.1)
    wall.now += 0.001
    assert clock.wait() <= FRAME


def test_frame_holds_at_least_the_longest_step(wall):
    clock = Clock(wall)
    clock.speed = 0.01
    assert clock.next_frame(0.1) == 0.1
    assert clock.wait() == pytest.approx(10.0)


def test_factor_is_unknown_until_measured_and_after_a_pause(wall):
    clock = Clock(wall)
    assert clock.real_time_factor is None
    run(clock, wall, 60, 1 / 60, cost=0.0)
    assert clock.real_time_factor is not None
    clock.hold()
    assert clock.real_time_factor is None


def test_pause_is_not_caught_up(wall):
    clock = Clock(wall)
    run(clock, wall, 5, 1 / 60, cost=0.0)
    wall.now += 100.0
    clock.hold()
    assert clock.next_frame(1 / 60) <= 2 * FRAME
    assert clock.wait() > 0.0


def test_reset_goes_back_to_zero(wall):
    clock = Clock(wall)
    clock.single_step(0.25)
    assert clock.time == 0.25
    clock.reset()
    assert clock.time == 0.0
