"""What can be undone, and what counts as one change."""

import pytest
from fake_world import SCENE

from server.comparison import Comparison
from server.history import GESTURE, LONGEST, History, changed
from sim.scene import load_scene

START = Comparison.of_scene(load_scene(SCENE))


@pytest.fixture
def history(wall):
    return History(wall)


def move(history, comparison, name, value):
    history.note(comparison, name)
    return comparison.with_shared(name, value)


def undone(history):
    """What was before each change, the last one first."""
    return [change.before for change in iter(history.undo, None)]


def test_changes_are_undone_one_after_the_other(history):
    first = move(history, START, "gamma", 1.0)
    second = move(history, first, "friction", 0.5)
    assert history.last(second) == "friction: 0.3 → 0.5"
    assert undone(history) == [first, START]
    assert history.undo() is None
    assert history.last(START) == ""


def test_a_drag_is_one_change_and_a_pause_makes_two(history, wall):
    comparison = START
    for i in range(10):
        comparison = move(history, comparison, "gamma", 0.3 + 0.1 * i)
        wall.now += 0.9 * GESTURE
    let_go = comparison
    wall.now += GESTURE
    comparison = move(history, comparison, "gamma", 2.0)
    assert undone(history) == [let_go, START]


def test_what_is_changed_after_an_undo_is_a_change_of_its_own(history):
    first = move(history, START, "gamma", 1.0)
    move(history, first, "friction", 0.5)
    assert history.undo().before == first
    move(history, first, "friction", 0.6)
    assert history.undo().before == first


def test_only_so_many_changes_are_kept(history):
    comparison = START
    for i in range(2 * LONGEST):
        comparison = move(history, comparison, ("gamma", "friction")[i % 2], i / 1000)
    assert len(undone(history)) == LONGEST


def test_changes_are_told_with_units_and_places():
    after = START.with_shared("dt", 0.5).with_value(1, "none")
    assert changed(START, after) == "time step: 0.01667 s → 0.5 s; collision method (right): impulse → none"
    assert changed(START, after.with_shared("gamma", 1.0)).endswith(" and 1 more")


def test_another_comparison_is_told_by_what_is_compared_and_its_values():
    other = START.compared_by("density").with_value(1, 20.0)
    words = "collision method penalty / impulse → density 0.2 kg/m² / 20 kg/m²"
    assert changed(START, other) == words
    assert changed(other, other.compared_by("")) == "density 0.2 kg/m² / 20 kg/m² → one cloth"
    assert changed(other.with_count(3), other).startswith("density 0.2 kg/m² / 20 kg/m² / ")
