"""The audit: what it says of effects that are known to matter, or not to, and how it is written."""

import json

import numpy as np
import pytest

import sim
from server import pages
from server.audit import cost_text
from server.cli import main
from sim.effects import EFFECTS
from sim.settings import READ_OUTS
from sim.studies.audit import audit
from tests.worlds import ball, grid, scene

pytestmark = pytest.mark.alone

EARTH = [0.0, 0.0, -9.81]


def named(report, name):
    (found,) = (effect for effect in report.effects if effect.name == name)
    return found


JUDGED = [name for name in EFFECTS if name not in READ_OUTS]


def test_every_effect_is_there_once_but_read_outs_which_change_nothing(audited):
    assert [effect.name for effect in audited.effects] == [*JUDGED, "obstacle 0"]
    assert any("change nothing of the cloth" in note for note in audited.notes)


def test_gravity_and_the_obstacle_matter(audited):
    gravity, obstacle = named(audited, "gravity"), named(audited, "obstacles")
    assert gravity.verdict == obstacle.verdict == "matters"
    assert gravity.errors > 3.0
    assert "without it cloth gets into something" in obstacle.why


def test_the_influence_of_gravity_is_the_way_that_it_makes_cloth_fall():
    """In free fall from rest half g t², as part of the diagonal; backward Euler adds g h t / 2."""
    h, windows = 1 / 60, 5
    report = audit(scene(grid(size=(3.0, 4.0)), gravity=EARTH, contact="none", bend="none"), seconds=10 * h)
    t = 10 * h / windows
    fallen = 0.5 * 9.81 * t * (t + h) / 5.0
    assert named(report, "gravity").influence == pytest.approx(fallen, rel=1e-6)
    assert report.numerical_error == pytest.approx(fallen - 0.5 * 9.81 * t * (t + h / 2) / 5.0, rel=1e-6)


def test_an_effect_made_void_is_below_the_numerical_error_and_recommended_to_be_off(audited):
    bending = named(audited, "bending")
    assert bending.verdict == "below the numerical error"
    assert bending.ran == 1.0
    assert audited.recommended["bending"] == "off"
    assert audited.recommended_error <= audited.tolerance
    assert "gravity" not in audited.recommended
    assert "obstacles" not in audited.recommended


def test_what_is_off_is_brought_in_and_not_recommended(audited):
    wind = named(audited, "wind")
    assert (wind.now, wind.ran) == ("off", 0.0)
    assert wind.influence > 0.0
    assert not {"wind", "altitudes", "strain_limiting"} & audited.recommended.keys()


def test_costs_are_told_between_steps_of_the_same_moment_and_how_noisy_they_are(monkeypatch):
    """Gravity costs 1 ms in the four last and heavy steps of ten; one at either end is left out."""
    step, noise, rng = sim.Simulation.step, 0.0, np.random.default_rng(0)

    def timed(world):
        report, heavy = step(world), world.time > 6.5 / 60
        pulled = heavy and any(world.settings.gravity)
        report.ms["total"] = 4.0 + 20.0 * heavy + pulled + noise * rng.uniform(-1.0, 1.0)
        return report

    monkeypatch.setattr(sim.Simulation, "step", timed)
    cloth = scene(grid(resolution=(3, 3)), gravity=EARTH, contact="none", bend="none", dt=1 / 60)
    quiet = audit(cloth, seconds=10 / 60)
    assert named(quiet, "gravity").cost_share == pytest.approx((3 / 8) / ((5 * 4 + 3 * 25) / 8))
    assert named(quiet, "damping").cost_share == quiet.cost_noise == 0.0
    noise = 2.0
    loud = audit(cloth, seconds=10 / 60)
    assert 0.01 < loud.cost_noise < 0.3
    assert "costs to ± " in pages.result(loud).tables[0].caption


def test_what_effects_seem_to_cost_that_there_is_nothing_for_is_noise(monkeypatch):
    """Steps without obstacles take 0.5 ms of 4 less here, by chance, and there are no obstacles anyway."""
    step = sim.Simulation.step

    def timed(world):
        report = step(world)
        report.ms["total"] = 4.0 - 0.5 * (world.settings.obstacles == "off")
        return report

    monkeypatch.setattr(sim.Simulation, "step", timed)
    found = audit(scene(grid(resolution=(3, 3)), gravity=EARTH, dt=1 / 60), seconds=10 / 60)
    assert found.cost_noise == pytest.approx(named(found, "obstacles").cost_share) == pytest.approx(0.125)


def test_effects_whose_absence_together_slows_steps_down_are_kept(monkeypatch):
    """Each of two effects alone costs 1 ms in 4; both left out cost 4 more, as in cloth that tangles."""
    step = sim.Simulation.step

    def timed(world):
        report, settings = step(world), world.settings
        away = (settings.bending == 0.0 or settings.bend == "none", settings.gamma == 0.0)
        report.ms["total"] = 8.0 if all(away) else 4.0 - any(away)
        return report

    monkeypatch.setattr(sim.Simulation, "step", timed)
    cloth = scene(grid(resolution=(3, 3)), gravity=EARTH, contact="none", dt=1 / 60)
    found = audit(cloth, seconds=10 / 60)
    assert named(found, "bending").cost_share == named(found, "damping").cost_share == 0.25
    assert len({"bending", "damping"} & found.recommended.keys()) == 1
    assert (found.ms, found.recommended_ms) == (4.0, 3.0)


@pytest.mark.parametrize(("path", "seconds"), [([], 1.0), ([0.5], 1.0), ([0.5, 1.5], 1.5), ([9.0], 5.0)])
def test_an_audit_looks_until_obstacles_have_gone_their_ways(path, seconds):
    keys = [{"time": time, "position": [0.0, 0.0, -time]} for time in path]
    away = ball(center=[5.0, 0.0, 0.0], radius=0.2, path=keys)
    cloth = scene(grid(resolution=(2, 2)), away, gravity=EARTH, dt=0.1)
    assert audit(cloth).seconds == pytest.approx(seconds)


def test_the_recommended_block_loads_and_says_what_it_was_measured_with(audited):
    assert audited.toml.startswith("# audit over 0.15 s, tolerance 1 %:\n# ")
    assert max(map(len, audited.toml.splitlines())) < 80, (
        "a terminal would break a comment, which then is none"
    )
    import tomllib

    table = tomllib.loads(audited.toml)
    assert table == {"effects": audited.recommended}
    world = sim.Simulation({**scene(grid()), **table})
    assert world.effects["bending"] == "off"


def test_an_audit_of_the_same_gives_the_same_but_for_times(audited):
    cloth = grid(size=(0.3, 0.3), resolution=(5, 5), position=[0.0, 0.0, 0.22])
    one, other = (audit(scene(cloth, ball(radius=0.2), gravity=EARTH), seconds=0.04) for _ in range(2))
    assert [(e.influence, e.errors, e.verdict) for e in one.effects] == [
        (e.influence, e.errors, e.verdict) for e in other.effects
    ]


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.105, "for 10.5 % of a step"),
        (-0.018, "for −1.8 % of a step"),
        (-56.505, "57.5 × the time without it"),
    ],
)
def test_what_makes_steps_slower_by_its_absence_has_no_cost_in_percent(share, words):
    assert cost_text(share) == words


def test_the_page_has_the_block_to_paste_the_plot_and_a_row_for_each_effect(audited):
    figures = pages.figures(audited)
    page = pages.page(audited, pages.result(audited), figures)
    assert "[effects]" in page
    assert list(figures) == ["influence"]
    for name in JUDGED:
        assert f">{name}</td>" in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["audit"], "SCENE: expected a scene file, or one of `muslin scenes`, got none"),
        (["audit", "drape", "--tolerance", "0"], "--tolerance: expected > 0, got 0"),
        (["audit", "drape", "--seconds", "0"], "--seconds: expected > 0 and ≤ 3600, got 0"),
        (["audit", "drape", "--set", "gamma=-1"], "gamma: expected ≥ 0 and ≤ 1000, got -1"),
    ],
)
def test_a_wrong_call_is_refused_in_one_line(capsys, arguments, words):
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"muslin: {words}")
    assert said.err.count("\n") == 1


def test_the_command_prints_the_table_and_writes_json(tmp_path, capsys):
    file = tmp_path / "audit.json"
    assert main(["audit", "oscillator", "--seconds", "0.05", "--json", str(file)]) == 0
    assert "What oscillator needs" in capsys.readouterr().out
    written = json.loads(file.read_text())
    assert written["command"].startswith("muslin audit oscillator --seconds 0.05")
    assert {effect["name"] for effect in written["effects"]} == set(JUDGED)
