"""What variants share and what they differ in."""

from types import SimpleNamespace

import pytest
from fake_world import SCENE
from msgspec.structs import replace

from server.comparison import Comparison, comparable, next_value, value_text
from server.relevance import AT_RESET, NEEDS, why_idle
from sim import Settings, load_scene
from sim.settings import FIELDS, convert


@pytest.fixture
def comparison():
    return Comparison.of_scene(load_scene(SCENE))


def test_scene_opens_as_its_author_meant(comparison):
    assert (comparison.by, comparison.values) == ("contact", ("penalty", "impulse"))
    assert [comparison.settings(i).contact for i in range(2)] == ["penalty", "impulse"]
    assert [comparison.place(i) for i in range(2)] == ["left", "right"]


def test_values_that_a_scene_says_fail_are_remarked_on_as_long_as_they_are_compared():
    needle = Comparison.of_scene(load_scene("needle"))
    assert [needle.remark(i) for i in range(2)] == ["fails on purpose", ""]
    assert needle.with_value(0, "continuous").remark(0) == ""
    assert needle.compared_by("friction").remark(0) == ""
    assert needle.compared_by("").remark(0) == ""


@pytest.mark.parametrize("name", [f.name for f in comparable()])
def test_every_setting_can_be_compared_with_up_to_four_allowed_values(comparison, name):
    compared = comparison.compared_by(name).with_count(4)
    for i, value in enumerate(compared.values):
        assert convert(name, value) == value
        assert getattr(compared.settings(i), name) == value
        assert compared.name(i)
    assert compared.values[0] == getattr(comparison.shared, name)
    assert compared.values[0] != compared.values[1]


def test_next_numbers_are_far_from_those_there_are():
    assert next_value(FIELDS["gamma"], [0.2]) == 2.0
    assert next_value(FIELDS["stretch"], [50.0]) == 1e4
    assert isinstance(next_value(FIELDS["newton"], [1]), int)


def test_one_cloth_is_compared_with_nothing(comparison):
    alone = comparison.compared_by("")
    assert (alone.count, alone.name(0)) == (1, "cloth")
    assert replace(alone.settings(0), threads=0) == alone.shared


def test_variants_share_out_all_cores_but_one_unless_told(monkeypatch):
    of_scene = Comparison(Settings(), "contact", ("none", "impulse"))
    for cores, alone, each in ((1, 1, 1), (2, 1, 1), (8, 7, 3)):
        monkeypatch.setattr("server.comparison.CORES", cores)
        assert Comparison(Settings()).settings(0).threads == alone
        assert [of_scene.settings(i).threads for i in range(2)] == [each, each]
    assert Comparison(Settings(threads=2)).settings(0).threads == 2


def test_values_read_with_their_units():
    assert value_text(FIELDS["stretch"], 1e4) == "10000 N"
    assert value_text(FIELDS["bend"], "angle") == "angle"
    assert value_text(FIELDS["gravity"], (0.0, 0.0, -9.81)) == "(0, 0, -9.81) m/s²"


def test_names_carry_the_symbol_of_what_differs(comparison):
    assert comparison.compared_by("gamma").name(0) == "γ 0.2"
    assert comparison.compared_by("stretch").name(0) == "stretch stiffness 50 N"
    assert comparison.compared_by("stretch").short_name(0) == "50 N"
    assert comparison.compared_by("stretch").with_count(3).name(0) == "50 N"


def test_names_that_mean_nothing_alone_carry_what_differs(comparison):
    switched = comparison.compared_by("self_collision")
    assert [switched.name(i) for i in range(2)] == ["self-collision auto", "self-collision off"]
    assert comparison.compared_by("contact").name(0) == comparison.shared.contact


def test_friction_is_idle_only_where_no_variant_looks_for_contacts():
    none, some = Settings(contact="none"), Settings(contact="penalty")
    assert why_idle("friction", [none, some]) == ""
    assert "none" in why_idle("friction", [none, none])


BARE = {"altitudes": "none", "bend": "none", "integrator": "symplectic_euler", "gamma": 0.0}
"""Of settings, what leaves others idle."""


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("altitude", {"altitudes": "all"}),
        ("adhoc_rule", {"bend": "adhoc"}),
        ("newton", {"integrator": "backward_euler"}),
        ("tolerance", {"integrator": "backward_euler"}),
        ("compensate", {"gamma": 0.2}),
    ],
)
def test_setting_idles_in_all_variants_or_in_none(name, changes):
    idle, acting = SimpleNamespace(**BARE), SimpleNamespace(**{**BARE, **changes})
    assert why_idle(name, [idle, idle])
    assert why_idle(name, [idle, acting]) == ""


def test_what_idles_are_settings():
    assert set(NEEDS) | AT_RESET <= set(FIELDS)
