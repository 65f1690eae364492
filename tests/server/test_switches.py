"""The effects as switches of the page: what they change, and how one is shown with and without."""

import pytest
from fake_world import FakeWorld, wait_until

from server.switches import setting_of
from sim.effects import EFFECTS, state, title


def switch(lab, name, choice):
    lab.post(lab.switch_effect, name, choice)


@pytest.mark.parametrize("name", ["gravity", "friction", "self_collision", "bending"])
def test_an_effect_that_is_switched_off_is_off_in_every_variant_and_comes_back_as_it_was(lab, client, name):
    before = getattr(lab.comparison.shared, setting_of(name))
    switch(lab, name, "off")
    wait_until(lambda: all(state(name, world.settings) == "off" for world in FakeWorld.made))
    switch(lab, name, "auto")
    wait_until(lambda: all(getattr(world.settings, setting_of(name)) == before for world in FakeWorld.made))


def test_an_effect_that_the_scene_has_not_is_brought_in(lab, client):
    switch(lab, "wind", "auto")
    wait_until(lambda: all(world.settings.drag > 0.0 for world in FakeWorld.made))


def test_switches_say_what_settings_make_of_them(lab, client):
    client.set(client.find("bending spring"), "none")
    handle = lab._page.panel._switches._handles["bending"]
    wait_until(lambda: handle.value == "off")
    client.set(client.find("bending spring"), "angle")
    wait_until(lambda: handle.value == "auto")


def test_a_switch_is_a_control_of_the_page(lab, client):
    client.set(client.find(title("strain_limiting")), "auto")
    wait_until(lambda: all(world.settings.strain_limit > 0.0 for world in FakeWorld.made))


def test_an_effect_is_shown_beside_a_cloth_without_it(lab, client):
    client.set(client.find("what does it do?"), "bending")
    wait_until(lambda: len(FakeWorld.made) == 4)
    assert lab.comparison.by == "bend"
    made = {world.settings.bend for world in FakeWorld.made[2:]}  # each in a thread of its own
    assert made == {"angle", "none"}
    wait_until(lambda: lab._page.panel._switches._question.value == "–")


def test_every_effect_has_one_setting_that_leaves_it_out():
    assert all(len(effect.off) == 1 for effect in EFFECTS.values())
