"""Read-outs on the page: what switches them, what it shows of those that are off, and what they took."""

from types import SimpleNamespace

import pytest
from fake_world import FakeWorld, wait_until

from server.labels import label
from server.lane import Frame
from server.meter import Meter
from server.prober import MEASURING, OFF, Reading
from server.read_outs import read_outs
from server.tables import effects_table, sums_table, variant_table
from server.tradeoff import Tradeoff
from sim.probe import LocalError
from sim.settings import READ_OUTS, Settings

FOUND = Reading(LocalError(1e-3, 0.0, 1 / 60, 1.0), time=2.0, share=0.01)


def meter(reading=FOUND, counting=0.02, **settings):
    """Of a variant after one step of 10 ms."""
    report = SimpleNamespace(
        ms={"total": 10.0},
        penetrations=0,
        effects=dict.fromkeys(READ_OUTS, "skipped: nobody looks"),
        costs={},
        costs_below={},
    )
    made = Meter()
    made.add(
        Frame(
            steps=1,
            ms=report.ms,
            time=2.0,
            report=report,
            crossings=3,
            counting=counting,
            settings=Settings(**settings),
            momentum=([0.0], [0.0]),
        )
    )
    made.reading = reading
    return made.read()


def test_what_is_read_out_beside_steps_is_told_among_the_effects_with_its_share():
    table = effects_table(["cloth"], [meter()])
    assert "ran: counted now and then" in table
    assert "ran: last at 2.0 s" in table
    assert "2 %<br>0.2 ms" in table
    assert "1 %<br>0.1 ms" in table
    assert "ran: counted after every frame" in effects_table(["cloth"], [meter(crossings="on")])


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (MEASURING, "ran: being measured"),
        (Reading(why_not="too far"), "skipped: too far"),
        (Reading(), "skipped: cloth stands still"),
    ],
)
def test_a_local_error_that_is_not_there_says_why(reading, words):
    assert read_outs(meter(reading))["local_error"].words == words


def test_the_place_of_a_read_out_that_is_off_says_so_and_not_what_was_read_last():
    off = meter(OFF, None, **dict.fromkeys(READ_OUTS, "off"))
    assert off.crossings is None
    text, _ = label("cloth", off)
    assert "error off" in text
    assert "crossings off" in text
    table = variant_table("", ["cloth"], [off])
    assert table.count(">off<") == 2
    assert ">0<" in table, "what is inside is no read-out"
    assert "energy ledger" in sums_table(["cloth"], [off])
    effects = effects_table(["cloth"], [off])
    assert all(f"off: {name} is off".replace("_", " ") in effects for name in READ_OUTS)
    chart = Tradeoff()
    chart.add([meter()])
    assert chart.trails[0]
    chart.add([off])
    assert not chart.trails[0]
    assert "local error: off" in chart.svg(["cloth"], [off])


@pytest.mark.parametrize("name", READ_OUTS)
def test_a_switch_of_the_page_switches_it_in_every_variant_and_asks_for_no_measurement(
    lab, client, name, monkeypatch
):
    changed, forgotten = [], []
    wait_until(lambda: len(lab.frames) == 2 and all(frame.settings for frame in lab.frames))
    monkeypatch.setattr(lab._prober, "changed", changed.append)
    monkeypatch.setattr(lab, "_forget_damping", lambda: forgotten.append(name))
    for choice in "off", "on":
        client.set(client.find(name.replace("_", " ")), choice)
        wait_until(lambda choice=choice: {getattr(w.settings, name) for w in FakeWorld.made} == {choice})
    assert not changed
    assert not forgotten
    lab.post(lab.undo)
    wait_until(lambda: {getattr(w.settings, name) for w in FakeWorld.made} == {"auto"})
    lab.post(lab.set_shared, "gamma", 0.3)
    wait_until(lambda: sorted(changed) == [0, 1] and forgotten)


@pytest.mark.parametrize("name", READ_OUTS)
def test_there_is_nothing_to_compare_by_a_read_out(lab, client, name):
    panel = lab._page.panel
    assert name not in panel._by_label.values()
    assert name.replace("_", " ") not in panel._switches._question.options
