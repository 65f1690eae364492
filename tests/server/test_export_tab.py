"""What brings the cloths of the page back elsewhere says the same as the page."""

import shlex
import tomllib
from dataclasses import replace

import msgspec
import pytest
import tomli_w

import sim
from server.cli import main
from server.commands.options import parse_settings, parse_values
from server.comparison import Comparison
from server.export import as_command, as_html, as_toml
from sim.settings import Settings

CHANGED = Settings(
    gamma=0.35, gravity=(0.0, 0.5, -9.81), contact="penalty", dt=1 / 120, each_obstacle="ball=off"
)

BALL = {"name": "ball", "kind": "sphere", "center": [0, 0, 0], "radius": 0.1}


def compared(shared=CHANGED, by="rest_angle", values=(-0.5, 1.25)):
    return Comparison(shared, by, values)


@pytest.mark.parametrize("comparison", [compared(), compared(by="", values=())], ids=["two", "one"])
def test_its_tables_in_a_scene_file_open_the_same_cloths(comparison):
    table = {"cloth": {"kind": "grid"}, "obstacle": [BALL]}
    opened = sim.load_scene(tomllib.loads(as_toml(comparison)) | table)
    assert opened.settings == comparison.shared
    if comparison.by:
        assert Comparison.of_scene(opened) == comparison


def test_what_fails_on_purpose_still_does_where_it_is_left():
    failing = replace(compared(by="contact", values=("impulse", "none")), fails=("none", "penalty"))
    assert tomllib.loads(as_toml(failing))["compare"]["fails"] == ["none"]


def test_its_command_sets_what_differs_from_the_scene():
    scene = sim.load_scene("drape")
    shared = msgspec.structs.replace(scene.settings, gamma=0.35, gravity=(0.0, 0.5, -9.81), rest_angle=0.2)
    one, two = Comparison(shared), compared(shared)
    words = shlex.split(as_command(scene, one))
    assert words[:4] == ["muslin", "run", "drape", "--set"]
    assert parse_settings(words[4:]) == {"gamma": 0.35, "gravity": (0.0, 0.5, -9.81), "rest_angle": 0.2}
    words = shlex.split(as_command(scene, two))
    assert words[:4] == ["muslin", "compare", "drape", "--by"]
    assert parse_values(words[4]) == ("rest_angle", [-0.5, 1.25])
    assert parse_settings(words[6:]) == {"gamma": 0.35, "gravity": (0.0, 0.5, -9.81)}
    assert as_command(scene, Comparison(scene.settings)) == "muslin run drape"


def test_its_command_names_the_file_of_a_scene_of_ones_own(tmp_path, monkeypatch, capsys):
    file = tmp_path / "my drape.toml"
    table = {"cloth": {"kind": "grid", "resolution": [3, 3]}, "settings": {"contact": "none"}}
    file.write_bytes(tomli_w.dumps(table).encode())
    scene = sim.load_scene(file)
    command = as_command(scene, Comparison(msgspec.structs.replace(scene.settings, gamma=2.0)))
    assert main([*shlex.split(command)[1:], "--seconds", "0.1"]) == 0
    assert "gamma" in command
    assert str(file) in capsys.readouterr().out or "my drape" in command


def test_what_is_shown_is_text():
    scene = msgspec.structs.replace(sim.load_scene("drape"), source="<b>.toml")
    assert "<b>" not in as_html(scene, compared())
