"""Read-outs as effects: off, nothing of them is computed; on, they always are; cloth is the same."""

import json

import numpy as np
import pytest

import sim
from server import headless
from sim.effects import cost
from sim.ledger import Part, Tally
from sim.probe import Probe
from sim.report import StepReport
from sim.settings import READ_OUTS, only_read_outs
from tests.worlds import ball, grid, scene

CLOTH = scene(grid(position=[0, 0, 0.305]), ball(radius=0.3), gravity=[0, 0, -9.81])


class Counted:
    """How often a function is called."""

    def __init__(self, monkeypatch, owner, name):
        self.calls, function = 0, getattr(owner, name)

        def call(*about, **how):
            self.calls += 1
            return function(*about, **how)

        monkeypatch.setattr(owner, name, call)


def test_read_outs_are_the_settings_that_change_nothing_of_the_cloth():
    assert READ_OUTS == ("ledger", "local_error", "crossings")
    assert only_read_outs(["ledger", "crossings"])
    assert not only_read_outs(["ledger", "gamma"])
    assert not only_read_outs([])


@pytest.mark.parametrize("settings", [{}, {"integrator": "bdf2", "contact": "none"}, {"sleep": "auto"}])
def test_cloth_has_the_same_bits_however_read_outs_are_switched_and_whenever(settings):
    made = {**CLOTH, "settings": {**CLOTH["settings"], **settings}}
    ways = [sim.Simulation(made, effects=dict.fromkeys(READ_OUTS, how)) for how in ("off", "auto", "on")]
    switched = sim.Simulation(made)
    for k in range(60):
        if k % 3 == 0:
            change = switched.switch if k % 2 else switched.update
            change(**dict.fromkeys(READ_OUTS, ("off", "on", "auto")[k // 3 % 3]))
        if k == 20:
            for world in (*ways, switched):
                world.update(stretch=80.0)
        for world in (*ways, switched):
            world.step()
    for world in (*ways[1:], switched):
        assert np.array_equal(world.positions, ways[0].positions)
        assert np.array_equal(world.velocities, ways[0].velocities)


def test_switching_a_read_out_wakes_no_cloth_and_ends_no_way_to_other_settings():
    world = sim.Simulation(CLOTH)
    world.step()
    world.update(stretch=80.0)
    for change in world.update, world.switch:
        ramp = world.snapshot().ramp
        change(ledger="on" if change == world.update else "off")
        now = world.snapshot().ramp
        assert (now.start, now.elapsed) == (ramp.start, ramp.elapsed)


def test_a_ledger_that_is_off_is_never_kept_whoever_asks(monkeypatch):
    parts, tallies = (Counted(monkeypatch, owner, "__init__") for owner in (Part, Tally))
    world = sim.Simulation(CLOTH, ledger="off")
    world.keep_ledger()
    for _ in range(3):
        report = world.step()
    world.restore(world.snapshot())
    assert world.ledger is None
    assert parts.calls == tallies.calls == 0
    assert report.effects["ledger"] == "off: ledger is off"
    assert "ledger" not in report.costs
    world.update(ledger="auto")
    report = world.step()
    assert report.effects["ledger"] == "ran", "it was asked for"
    assert abs(world.ledger.residual) < 1e-3 * world.ledger.turnover, "from where it was switched"


def test_a_ledger_that_is_on_is_kept_from_the_first_step_unless_somebody_wants_none():
    on, auto = (sim.Simulation(CLOTH, ledger=how) for how in ("on", "auto"))
    auto.keep_ledger()
    for _ in range(3):
        report = on.step()
        auto.step()
    assert report.effects["ledger"] == "ran"
    assert on.ledger == auto.ledger
    on.keep_ledger(False)
    report = on.step()
    assert on.ledger is None
    assert report.effects["ledger"].startswith("skipped: nobody looks; saves ")
    assert sim.Simulation(CLOTH).step().effects["ledger"] == "skipped: nobody looks"


def test_what_a_ledger_takes_is_told_and_is_not_the_springs_as_well(monkeypatch):
    report = StepReport(costs={"stretch": 1.0}, costs_below={"damping": 1.0})
    with report.spent("ledger", alone=True):
        report.costs["stretch"] += 5.0
        report.costs_below["damping"] += 5.0
        report.costs["bending"] = 5.0
    assert report.costs.pop("ledger") > 0.0
    assert (report.costs, report.costs_below) == ({"stretch": 1.0}, {"damping": 1.0})
    world = sim.Simulation(CLOTH, ledger="on")
    kept = world.step()
    assert 0.0 < kept.costs["ledger"] < kept.ms["total"]
    assert cost("ledger", "ran", kept).ms == kept.costs["ledger"]


def test_a_snapshot_of_another_choice_is_gone_on_from_with_that():
    on, off = (sim.Simulation(CLOTH, ledger=how) for how in ("on", "off"))
    on.step()
    off.step()
    off.restore(on.snapshot())
    on.step()
    off.step()
    assert off.ledger == on.ledger
    on.restore(sim.Simulation(CLOTH, ledger="off").snapshot())
    assert on.ledger is None


def test_a_probe_keeps_no_ledger_of_its_own():
    world = sim.Simulation(CLOTH, ledger="on")
    world.step()
    probe = Probe(sim.Simulation(CLOTH))
    probe.measure(world.snapshot(), 4)
    assert probe._world.ledger is None


@pytest.mark.parametrize("how", ["off", "on", "auto"])
def test_a_scene_switches_them_in_its_block(how):
    made = sim.load_scene({**CLOTH, "effects": dict.fromkeys(READ_OUTS, how)})
    world = sim.Simulation(made)
    assert {world.effects[name] for name in READ_OUTS} == {how}
    for name in READ_OUTS:
        assert getattr(made.settings, name) == how


@pytest.mark.parametrize(
    ("how", "counts", "words"),
    [
        ("off", 0, "off: crossings is off"),
        ("auto", 1, "ran: counted at the end"),
        ("on", 6, "ran: counted after every step"),
    ],
)
def test_a_run_counts_what_crosses_at_the_end_or_after_every_step_or_never(
    how, counts, words, monkeypatch, tmp_path, capsys
):
    counted = Counted(monkeypatch, sim.Simulation, "crossings")
    made = sim.load_scene({**CLOTH, "effects": {"crossings": how, "ledger": "on"}})
    assert headless.run(made, {}, seconds=0.1, json=str(tmp_path / "run.json")) == 0
    written = json.loads((tmp_path / "run.json").read_text())
    assert counted.calls == counts
    assert written["effects"]["crossings"] == words
    assert written["crossings"] == written["crossings_most"] == (None if how == "off" else 0)
    assert written["effects"]["ledger"] == "ran"
    assert written["shares"]["ledger"]["ms"] > 0.0
    assert written["effects"]["local_error"] == "skipped: nobody looks"
    assert (written["shares"]["crossings"]["ms"] > 0.0) == (how == "on")
    assert ("off" in capsys.readouterr().out.partition("crossings: at the end")[2].splitlines()[0]) == (
        how == "off"
    )
