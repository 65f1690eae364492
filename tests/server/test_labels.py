"""What is said of each cloth, above it and in the tables beside it."""

import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

import sim
from server.labels import label, wrong_on_purpose
from server.lane import Frame
from server.meter import Meter
from server.prober import Reading
from server.stage import ALARM, LABEL, MANY
from server.tables import BAR, effects_table, sums_table, variant_table
from sim import Settings
from sim.effects import EFFECTS, TOLD_BESIDES
from sim.probe import LocalError
from sim.springs import BENDING


def meter(**frame):
    meter = Meter()
    meter.add(Frame(**frame))
    return meter


VIEW, CHARACTER = 672.0, 5.4
"""Width between the docks on a 1280 x 720 screen, and of a character of a label of size 1 [CSS px]."""

BOOKED = ("injected", "dissipated")


@pytest.fixture
def mistaken(monkeypatch):
    """Settings with a bending kind that is wrong on purpose."""
    stub = SimpleNamespace(summary="a stub", wrong="pushes on <nothing>")
    monkeypatch.setitem(BENDING, "stub", stub)
    return msgspec.structs.replace(Settings(), bend="stub")


def report(effects, costs=None, **more):
    usual = {"iterations": 1, "contacts": 0, "penetrations": 0, "costs_below": {}, "ms": {"total": 10.0}}
    return SimpleNamespace(effects=effects, costs=costs or {}, **usual | more)


def test_mistake_is_labelled_as_wrong_on_purpose_and_is_no_alarm(mistaken):
    assert label("stub", meter(settings=mistaken)) == (
        "stub\n– ms · – %\n– crossings\nwrong on purpose",
        False,
    )
    table = variant_table("bending spring", ["stub"], [meter(settings=mistaken)])
    assert "wrong on purpose: pushes on &lt;nothing&gt;" in table
    assert 'class="bad"' not in table


@pytest.mark.parametrize("bend", ["none", "cross", "angle"])
def test_right_springs_and_variants_that_are_not_ready_say_nothing(bend):
    assert wrong_on_purpose(Settings(bend=bend)) == ""
    assert wrong_on_purpose(None) == ""
    assert "purpose" not in variant_table("", ["one"], [meter(settings=Settings(bend=bend))])


def test_stopped_mistake_says_both(mistaken):
    text, alarm = label("stub", meter(settings=mistaken, refused="step refused: too fast"))
    assert text.split("\n") == ["▲ stub stopped", "step refused: too fast", "wrong on purpose"]
    assert alarm


def test_unstable_step_is_a_line_of_the_label_and_bold_in_the_table():
    shaky = meter(report=report({"gravity": "ran", "integrator": "unstable: dt is 10 ms"}))
    assert label("one", shaky)[0].split("\n")[-1] == "▲ unstable step"
    table = effects_table(["one"], [shaky])
    assert f'<tr class="bad" title="{TOLD_BESIDES["integrator"]}"><td>integrator</td>' in table
    assert "<td>unstable: dt is 10 ms</td></tr>" in table
    assert table.count('class="bad"') == 1


def test_what_did_nothing_is_dim_and_each_effect_says_what_it_does():
    said = {"gravity": "ran", "wind": "off: drag is zero", "cloth_collision": "skipped: there is one piece"}
    table = effects_table(["one"], [meter(report=report(said))])
    assert re.findall(r'<tr class="(.*?)" title="(.*?)"><td>(.*?)</td>', table) == [
        ("", EFFECTS["gravity"].changes, "gravity"),
        ("dim", EFFECTS["wind"].changes, "wind"),
        ("dim", EFFECTS["cloth_collision"].changes, "cloth–cloth collision"),
    ]


@pytest.mark.parametrize(
    ("inside", "crossings", "said"),
    [
        (0, 0, ["nothing crosses"]),
        (3, 0, ["▲ 3 in obstacles"]),
        (0, 1, ["▲ 1 crossing"]),
        (25, 6, ["▲ 25 in obstacles", "▲ 6 crossings"]),
        (3, None, ["– crossings"]),
    ],
)
def test_what_is_inside_and_what_crosses_has_a_line_each_and_is_bold_in_the_table(inside, crossings, said):
    step = SimpleNamespace(**vars(report({"gravity": "ran"})) | {"penetrations": inside})
    measured = meter(report=step, steps=1, ms={"total": 1.0}, crossings=crossings).read()
    assert label("one", measured)[0].split("\n")[2:] == said
    assert re.findall(r'class="bad">(\d+)<', variant_table("", ["one"], [measured])) == [
        str(n) for n in (inside, crossings) if n
    ]


def test_each_effect_has_its_part_of_the_step():
    said = {"self_collision": "ran", "gravity": "ran", "damping": "ran", "wind": "off: drag is zero"}
    said |= {"friction": "ran", "integrator": "midpoint"}
    step = report(said, {"self_collision": 2.5, "gravity": 0.002}, costs_below={"damping": 0.31})
    step.ms |= {"solve": 4.0}
    rows = re.findall(r"<td>([^<]*)</td><td title=\"([^\"]*)\">(.*?)</td>", table_of(step))
    found = {name: (unescape(hint), unescape(cell)) for name, hint, cell in rows}
    assert all(
        "<" not in cell.replace("<div", "").replace("</div", "").replace("<br", "") for *_, cell in rows
    )
    plain = "without what it adds to the work of the solver"
    assert found["self-collision"][0] == f"25 % of the step: {plain}"
    assert f"border-left:{0.25 * BAR:.1f}px" in found["self-collision"][1]
    assert found["self-collision"][1].endswith("25 %<br>2.5 ms")
    assert found["gravity"][1].endswith("< 0.1 %<br>0.002 ms")
    assert found["damping"][0] == "< 3.1 % of the step: it is computed along with the forces of springs"
    assert found["damping"][1].endswith("< 3.1 %<br>< 0.31 ms")
    assert "border-left:0.0px" in found["damping"][1]
    assert found["wind"] == ("0 of the step: nothing of it is computed", "0")
    assert found["friction"] == ("in the figure of contact, which has it of one piece", "in contact")
    assert f"border-left:{0.4 * BAR:.1f}px" in found["integrator"][1]


def table_of(step):
    return effects_table(["one"], [meter(report=step)])


def test_effect_that_only_speaks_of_unstable_steps_is_none():
    calm = meter(report=report({"integrator": "ran: unstable above 1 ms"}))
    assert "unstable" not in label("one", calm)[0]
    assert 'class="bad"' not in effects_table(["one"], [calm])


def test_a_step_that_may_have_let_something_through_says_so():
    fast = meter(report=report({"contact": "ran: 3 contacts; may tunnel: moved 90 mm, thickness 5 mm"}))
    assert label("one", fast)[0].split("\n")[-1] == "▲ may tunnel"
    assert not label("one", fast)[1]
    slow = meter(report=report({"contact": "ran: 3 contacts"}))
    assert "tunnel" not in label("one", slow)[0]


def test_a_remark_stands_under_what_was_measured():
    assert label("one", meter(), remark="fails on purpose")[0].split("\n")[1:] == [
        "– ms · – %",
        "– crossings",
        "fails on purpose",
    ]


@pytest.mark.parametrize(
    "refused", ["", "step refused: the load of vertex 3 is too heavy for what carries it"]
)
def test_lines_of_a_label_have_room_beside_those_of_three_other_cloths(refused):
    step = report({"contact": "ran: 3 contacts; may tunnel: moved 90 mm, thickness 5 mm"})
    one = meter(report=step, steps=9, ms={"total": 485.5}, crossings=12, time=61.2, refused=refused).read()
    one.reading = Reading(LocalError(4.1e-6, 1e-9, 0.1, 1.0, 0), time=11.9)
    text, alarm = label("modified beside a long name", one, remark="fails on purpose, as is to be seen")
    room = VIEW / 4 / MANY / (ALARM if alarm else LABEL) / CHARACTER
    assert max(map(len, text.split("\n"))) <= room
    assert alarm or "485.5 ms · 0.00041 %\n% as of 11.9 s\n" in text


def test_sizes_of_both_momenta_stand_under_the_energies():
    momentum = np.array([3.0, 0.0, 4.0]), np.array([0.0, 2.5e-7, 0.0])
    table = sums_table(["one", "two"], [meter(energy={"kinetic": 1.0}, momentum=momentum), meter()])
    assert table.index("kinetic") < table.index("|P| [kg m/s]") < table.index("|L| [kg m²/s]")
    assert "|P| [kg m/s]</td><td>5</td><td>–</td>" in table
    assert "|L| [kg m²/s]</td><td>2.5·10⁻⁷</td><td>–</td>" in table


def test_no_momentum_is_claimed_before_there_is_a_simulation():
    assert sums_table(["one"], [meter()]) == ""


@pytest.mark.parametrize("bend", list(BENDING))
def test_every_energy_entry_and_effect_of_a_real_step_has_its_own_words(bend):
    world = sim.Simulation("drape", bend=bend, altitudes="all", contact="impulse")
    world.keep_ledger()
    report, ledger = world.step(), world.ledger
    everything = replace(ledger, **{part: dict.fromkeys(getattr(ledger, part), 1.0) for part in BOOKED})
    full = meter(report=report, energy=world.energy(), ledger=everything, momentum=world.momentum())
    rows = re.findall(r'title="(.+?)"><td class="dim">(.+?)</td>', sums_table(["one"], [full]))
    assert len({words for words, _ in rows}) == len(rows) == len(world.energy()) + 17
    stored = {title: words for words, title in rows}
    assert stored[bend].startswith(f"Stored in {bend} springs: ")
    hints = re.findall(r'<tr class="\w*" title="(.*?)"><td>', effects_table(["one"], [full]))
    assert len(set(hints)) == len(hints) == len(report.effects)
    assert "" not in hints


def test_energies_and_effects_that_nobody_knows_are_an_error_and_no_spring():
    with pytest.raises(KeyError, match="unheard"):
        sums_table(["one"], [meter(energy={"unheard": 1.0})])
    with pytest.raises(ValueError, match="unheard"):
        effects_table(["one"], [meter(report=report({"unheard": "ran"}))])


def test_stopped_variant_leaves_a_gap_in_plots():
    momentum = np.array([3.0, 0.0, 4.0]), np.array([0.0, 0.0, 2.0])
    going = meter(energy={"kinetic": 1.0, "gravity": 2.0}, momentum=momentum)
    assert going.energies() == (3.0, 1.0)
    assert going.momenta() == (5.0, 2.0)
    stopped = meter(energy={"kinetic": 1.0}, momentum=momentum, refused="too fast")
    assert np.isnan([*stopped.energies(), *stopped.momenta(), *meter().energies(), *meter().momenta()]).all()
