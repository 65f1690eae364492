"""The chart of error against cost, and what stands beside it."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from server.labels import OLD, error_text, label
from server.lane import Frame
from server.meter import Meter
from server.prober import MEASURING, NO_READING, Reading
from server.tables import sums_table, threads_line, variant_table
from server.tradeoff import TRAIL, Tradeoff, point
from sim import Settings
from sim.ledger import Ledger
from sim.probe import LocalError
from sim.threads import LAUNCHED, threading_layer


def reading(error, floor=0.0, trend=""):
    return Reading(LocalError(error, floor, 1 / 60, 1.0), trend=trend)


def meter(ms, found, dt=1 / 60):
    made = Meter()
    report = SimpleNamespace(penetrations=0, contacts=0, iterations=1, effects={})
    made.add(Frame(steps=1, ms=ms and {"total": ms}, settings=Settings(dt=dt), report=report))
    made.read()
    made.reading = found
    return made


def circles(svg):
    found = re.findall(r'<circle class="variant(\d)" cx="([\d.]+)" cy="([\d.]+)" r="5" fill="(#\w+)"', svg)
    return {int(i): (float(x), float(y), fill) for i, x, y, fill in found}


def test_a_point_is_the_cost_of_a_frame_and_the_error_whatever_the_step():
    assert point(meter(4.0, reading(1e-3))) == pytest.approx((4.0, 1e-3))
    assert point(meter(4.0, reading(1e-3), dt=1 / 240)) == pytest.approx((16.0, 1e-3))
    assert point(meter(4.0, MEASURING)) is None


def test_dearer_is_to_the_right_and_more_wrong_is_above_in_even_decades():
    chart, names = Tradeoff(), ["a", "b", "c"]
    meters = [meter(2.0, reading(1e-4)), meter(20.0, reading(1e-4)), meter(2.0, reading(1e-3))]
    chart.add(meters)
    (x, y, _), (right, same, _), (here, above, _) = circles(chart.svg(names, meters)).values()
    assert right > x == here
    assert above < y == same
    meters[1] = meter(200.0, reading(1e-4))
    chart.clear(3)
    chart.add(meters)
    first, second, _ = circles(chart.svg(names, meters)).values()
    assert first[0] < second[0]


def test_a_point_that_is_measured_anew_is_hollow_and_stays_where_it_was():
    chart, sure = Tradeoff(), meter(3.0, reading(1e-3))
    chart.add([sure])
    before = circles(chart.svg(["a"], [sure]))[0]
    stale = meter(3.0, MEASURING)
    chart.add([stale])
    after = circles(chart.svg(["a"], [stale]))[0]
    assert after[:2] == before[:2]
    assert before[2] != "#ffffff" == after[2]


def test_a_quick_reading_is_marked_as_such_and_an_old_one_says_of_when_it_is():
    made = meter(6.1, Reading(LocalError(1e-3, 4e-4, 1 / 60, 1.0), quick=True))
    assert label("a", made)[0] == "a\n6.1 ms · ≈ 0.1 %\n– crossings"
    assert "In a pause it is measured better." in variant_table("", ["a"], [made])
    made.reading = Reading(LocalError(1e-3, 0.0, 1 / 60, 1.0), time=0.25)
    made.latest = replace(made.latest, time=0.25 + OLD + 0.1)
    assert label("a", made)[0] == "a\n6.1 ms · 0.1 %\n% as of 0.2 s\n– crossings"
    assert re.search('class="dim" title="Of a frame from 0.25 s', variant_table("", ["a"], [made]))
    made.latest = replace(made.latest, time=0.25 + OLD - 0.1)
    assert label("a", made)[0] == "a\n6.1 ms · 0.1 %\n– crossings"


def test_a_trail_leads_to_the_point_and_is_forgotten_after_a_while():
    chart = Tradeoff()
    for k in range(3 * TRAIL):
        chart.add([meter(2.0 + k, reading(1e-3))])
    assert len(chart.trails[0]) <= TRAIL
    assert chart.trails[0][-1] == pytest.approx((1.0 + 3 * TRAIL, 1e-3))
    for _ in range(50):
        chart.add([meter(2.0, reading(1e-3))])
    assert len(set(chart.trails[0])) == len(chart.trails[0]), "to stand still leaves no trail"


def test_no_error_is_claimed_before_one_is_measured():
    chart = Tradeoff()
    nothing = [meter(2.0, MEASURING)]
    chart.add(nothing)
    svg = chart.svg(["<b>"], nothing)
    assert "measuring" in svg
    assert not circles(svg)


def test_names_are_no_html():
    chart, made = Tradeoff(), meter(2.0, reading(1e-3))
    chart.add([made])
    assert "<title>&lt;b&gt;</title>" in chart.svg(["<b>"], [made])


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (reading(1.23e-4), "0.012 %"),
        (reading(1e-4, floor=5e-6), "0.01 %"),
        (reading(1e-4, floor=4e-5), "≥ 0.006 %"),
        (reading(1e-4, floor=2e-4), "< 0.03 %"),
        (MEASURING, "measuring"),
        (NO_READING, "– %"),
        (Reading(why_not="step refused"), "– %"),
    ],
)
def test_an_error_is_said_as_well_as_it_is_known(found, text):
    assert error_text(found) == text
    assert label("one", meter(6.1, found))[0] == f"one\n6.1 ms · {text}\n– crossings"


def test_the_table_has_the_trend_and_how_real_time_is_kept():
    table = variant_table("", ["one"], [meter(8.0, reading(1e-3, trend="↗"), dt=0.02)])
    assert re.search(r"<td>2.5</td><td><span title=.*>0.1 % ↗</span></td>", table)


def test_threads_and_their_layer_are_said_once_a_step_is_measured():
    assert threads_line([meter(None, NO_READING)]) == ""
    line = threads_line([meter(8.0, NO_READING), meter(8.0, NO_READING)])
    assert f">1 of {LAUNCHED} threads each" in line
    assert (layer := threading_layer()) in line
    assert ("layer" in line) == bool(layer)  # no parallel kernel may have run yet


def test_the_ledger_stands_under_the_energies_with_what_does_not_add_up():
    made = meter(1.0, NO_READING)
    flows = {"damping": 0.25, "friction": 0.0}, {"settings": 0.5, "obstacles": 0.0}
    ledger = Ledger(2.0, {"kinetic": 2.26}, *flows, turnover=10.0)
    made.latest = Frame(energy=ledger.energy, ledger=ledger)
    table = sums_table(["one", "two"], [made, Meter()])
    rows = re.findall(r'<tr.*?><td class="dim">(.*?)</td><td>(.*?)</td><td>(.*?)</td></tr>', table)
    assert rows == [
        ("kinetic", "2.26", "–"),
        ("at the start", "2", "–"),
        ("+ settings", "0.5", "–"),
        ("− damping", "0.25", "–"),
        ("= now", "2.26", "–"),
        ("residual", "0.1 %", "–"),
    ]


def test_nothing_is_said_to_be_measured_of_a_cloth_that_stands_still():
    going, stopped = meter(None, MEASURING), meter(None, MEASURING)
    stopped.add(Frame(refused="too heavy"))
    stopped.read()
    assert "measuring" in Tradeoff().svg(["a"], [going])
    assert "measuring" not in Tradeoff().svg(["a"], [stopped])
    assert "measuring" not in variant_table("", ["a"], [stopped])
