"""Controls come from the definition of the settings, and from nothing else."""

import math

import pytest
from fake_world import wait_until

from server.controls import tooltip
from sim import springs
from sim.settings import FIELDS


def test_every_setting_has_a_control(client):
    for field in FIELDS.values():
        client.find(f"{field.label} [{field.unit}]" if field.unit else field.label)


def test_new_spring_kind_appears_in_the_dropdown(monkeypatch, request):
    monkeypatch.setitem(springs.BENDING, "whalebone", springs.BENDING["cross"])
    client = request.getfixturevalue("client")
    uuid = client.find("bending spring")
    assert "whalebone" in client.controls[uuid]["props"]["options"]
    assert "whalebone" in client.controls[uuid]["props"]["hint"]


def test_log_slider_and_its_box_follow_each_other(lab, client):
    slider = client.find("stretch stiffness [N]", "Slider")
    box = client.find("stretch stiffness [N]", "Text")
    client.set(slider, 3.0)
    wait_until(lambda: client.values.get(box) == "1000")
    client.set(box, "100")
    wait_until(lambda: client.values.get(slider) == pytest.approx(2.0))
    wait_until(lambda: lab.comparison.shared.stretch == 100.0)


def test_a_box_takes_quotients_as_lessons_have_them_and_refuses_what_is_no_number(lab, client):
    box, slider = client.find("time step [s]", "Text"), client.find("time step [s]", "Slider")
    client.set(box, "1/960")
    wait_until(lambda: lab.comparison.shared.dt == 1 / 960)
    wait_until(lambda: client.values.get(slider) == pytest.approx(-math.log10(960)))
    for nonsense in ("1/0", "1/", "/60", "1/60/2", "1/nan", "a/b", True):
        client.set(box, nonsense)
        wait_until(lambda: client.values.get(box) == "1/960")
        client.values.clear()
    assert lab.comparison.shared.dt == 1 / 960


def test_setting_that_cannot_act_is_greyed_with_the_reason(lab, client):
    friction = client.find("friction")
    client.set(client.find("● left"), "none")
    client.set(client.find("● right"), "none")
    wait_until(
        lambda: any(
            m.get("uuid") == friction and "Cannot act now" in str(m.get("updates", {}).get("hint"))
            for m in client.messages
        )
    )


@pytest.mark.parametrize("field", FIELDS.values(), ids=lambda f: f.name)
def test_tooltip_says_what_it_is_and_what_it_costs(field):
    assert field.description in tooltip(field)
    assert field.cost in tooltip(field)
    assert field.formula in tooltip(field)
