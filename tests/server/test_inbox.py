"""The lab's inbox: order, floods, and errors."""

import pytest

from server.inbox import Inbox, settled


class Listener:
    def __init__(self):
        self.heard = []

    def set(self, name, value):
        self.heard.append((name, value))

    def other(self):
        self.heard.append("other")


@pytest.fixture
def listener():
    return Listener()


def test_of_many_moves_of_a_control_the_last_is_made_and_none_goes_past_something_else(listener):
    calls = [("a", 1), ("b", 2), ("a", 3), None, ("a", 4), ("b", 5), ("a", 6)]
    tasks = [(listener.other, ()) if call is None else (listener.set, call) for call in calls]
    for action, args in settled(tasks, (listener.set,)):
        action(*args)
    assert listener.heard == [("b", 2), ("a", 3), "other", ("b", 5), ("a", 6)]


def test_a_flood_that_goes_on_does_not_keep_the_thread_from_its_work(listener):
    inbox = Inbox(())

    def again():
        listener.heard.append(1)
        inbox.post(again)

    inbox.post(again)
    inbox.act(1.0)
    assert listener.heard == [1]


def test_what_comes_after_an_error_is_done_the_next_time(listener):
    inbox = Inbox((listener.set,))
    for action, *args in ((listener.other,), (int, "no number"), (listener.set, "a", 1)):
        inbox.post(action, *args)
    with pytest.raises(ValueError, match="no number"):
        inbox.act(1.0)
    inbox.act(1.0)
    assert listener.heard == ["other", ("a", 1)]


def test_with_nothing_to_do_it_waits_and_returns(listener):
    Inbox(()).act(0.01)
