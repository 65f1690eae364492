"""The damping tab: measured in a thread, one variant after the other, forgotten when out of date."""

import threading

import pytest
from fake_world import SCENE, FakeWorld, RawClient, nothing_to_compile, wait_until

from server.comparison import Comparison
from server.lab import Lab
from server.ringdown import RingDown, damping_table
from sim.ringdown import ModalDamping
from sim.scene import load_scene

FOUND = ModalDamping(4.0, 0.2, 3e-5, 0.034, 0.0339, 3.99)


def test_each_variant_is_measured_with_its_own_settings_and_errors_are_shown():
    scene, seen, answers = load_scene(SCENE), [], []
    comparison = Comparison.of_scene(scene)

    def measure(one):
        seen.append(one.settings)
        if len(seen) == 2:
            raise ValueError("cloth[0]: nothing holds it")
        return FOUND

    RingDown(measure, lambda action, *args: action(*args), answers.append).start(scene, comparison)
    wait_until(lambda: answers and None not in answers[-1])
    assert seen == [comparison.settings(0), comparison.settings(1)]
    assert answers == [[None, None], [FOUND, None], [FOUND, "cloth[0]: nothing holds it"]]


def test_only_the_newest_request_is_answered():
    scene, gate, answers = load_scene(SCENE), threading.Event(), []
    began = []

    def measure(one):
        began.append(one)
        gate.wait(10)
        return FOUND

    ringdown = RingDown(measure, lambda action, *args: action(*args), answers.append)
    ringdown.start(scene, Comparison.of_scene(scene))
    wait_until(lambda: began)
    ringdown.stop()
    gate.set()
    threading.Event().wait(0.2)
    assert answers == [[None, None]]


def test_table_shows_what_is_set_made_of_it_added_and_measured():
    html = damping_table(["a", "b", "<c>"], [FOUND, None, "nothing <holds> it"])
    for text in (
        "1.57",
        "0.2",
        "3·10⁻⁵",
        "0.034",
        "0.0339",
        "measuring",
        "nothing &lt;holds&gt; it",
        "&lt;c&gt;",
    ):
        assert text in html


@pytest.fixture
def measuring_lab():
    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile, measure=lambda scene: FOUND)
    lab.start()
    wait_until(lambda: len(FakeWorld.made) == 2)
    yield lab
    lab.stop()


def test_button_measures_and_a_change_of_settings_takes_the_numbers_away(measuring_lab):
    client = RawClient(measuring_lab.url, origin=measuring_lab.url)
    client.look()
    handle = measuring_lab._page.charts._damping
    client.set(client.find("ring-down"), "Measure the damping")
    wait_until(lambda: "0.0339" in handle.content)
    client.set(client.find("friction"), 0.7)
    wait_until(lambda: handle.content == "")
    client.close()
