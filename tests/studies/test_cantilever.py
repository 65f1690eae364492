"""The cantilever study: stiffness on a cylinder, the elastica, and a strip that must hang as it does."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim.springs import BENDING
from sim.studies import cantilever

REFERENCE = Path(__file__).parent.parent / "vectors" / "reference.json"

ROWS = 8
"""Of the strip: fewer than the study has, for speed."""

SHARE = 5.0
"""Allowed error of H/W [%]."""


@pytest.fixture(scope="module")
def result():
    return cantilever.run(rows=ROWS, trend=(4, 8))


def hung(result, kind):
    return [row for row in result.tables[1].rows if row[0] == kind]


def chords(result, rows):
    """Chord over arc of a row on each cylinder of the first table, a list of floats."""
    half = 0.5 * np.array(result.tables[0].column("κ [1/m]")) * cantilever.Strip(rows).height
    return np.sin(half) / half


def test_the_elastica_is_that_of_the_reference():
    table = json.loads(REFERENCE.read_text(encoding="utf-8"))["heavy_elastica_cantilever"]["table"]
    for row in (row for row in table if row["Gamma"] <= 100):
        drop, reach = cantilever.elastica(row["Gamma"])
        assert drop == pytest.approx(row["drop_over_L"], abs=1e-6)  # the reference has six digits
        assert reach == pytest.approx(row["reach_over_L"], abs=1e-6)


def test_angle_springs_have_the_stiffness_of_theory_and_modified_ones_nearly(result):
    table = result.tables[0]
    assert table.columns[1:] == ("cross", "modified", "angle")
    assert table.column("angle") == pytest.approx([1.0] * len(table.rows), rel=1e-10)
    assert table.column("modified") == pytest.approx([1.0] * len(table.rows), rel=0.04)


def test_modified_springs_soften_as_the_half_sine_of_their_fold(result):
    """δ = h sin(θ/2), where on a cylinder θ = κ h₀, and h is the chord h₀ sin(θ/2)/(θ/2)."""
    expected = chords(result, ROWS) ** 4
    assert list(result.tables[0].column("modified")) == pytest.approx(expected, rel=1e-9)


def test_cross_springs_stiffen_with_the_square_of_the_curvature(result):
    """Their energy goes with the fourth power of the fold; at the smallest, they have almost none."""
    kappa, stiffness = np.array(result.tables[0].column("κ [1/m]")), result.tables[0].column("cross")
    assert np.polyfit(np.log(kappa), np.log(stiffness), 1)[0] == pytest.approx(2.0, abs=0.01)
    assert stiffness[0] < 1e-3


@pytest.mark.parametrize("kind", ["modified", "angle"])
def test_right_springs_hang_as_the_elastica_does(result, kind):
    rows = hung(result, kind)
    assert [row[1] for row in rows] == [1.0, 5.0, 10.0, 50.0]
    assert max(abs(row[-1]) for row in rows) < SHARE


@pytest.mark.parametrize("kind", ["modified", "angle"])
def test_stiffer_strips_drop_less_and_reach_farther(result, kind):
    rows = hung(result, kind)
    assert np.all(np.diff([row[2] for row in rows]) > 0.0)
    assert np.all(np.diff([row[4] for row in rows]) < 0.0)


def test_cross_springs_fail_the_cantilever(result):
    assert all(row[-1] is None or row[-1] > 10.0 for row in hung(result, "cross"))


def test_the_clamp_read_half_a_row_inside_errs_by_second_order_in_the_row(result):
    table = result.tables[2]
    inside, at_row = (np.abs(np.array(table.column(c))) for c in table.columns[1:])
    rows = np.array(table.column("rows"))
    assert np.polyfit(np.log(rows), np.log(at_row), 1)[0] == pytest.approx(-1.0, abs=0.2)
    assert np.polyfit(np.log(rows), np.log(inside), 1)[0] < -1.7
    assert np.all(inside < 0.1 * at_row)


def test_a_kind_from_outside_is_measured_like_the_others(outside_kind, monkeypatch):
    others = {
        name: kind for name, kind in BENDING.items() if name != "cross"
    }  # which is slow to come to rest
    monkeypatch.setattr(cantilever, "BENDING", others)
    found = cantilever.run(rows=4, trend=())
    assert found.tables[0].columns[1:] == ("modified", "angle", outside_kind)
    expected = chords(found, 4) ** 2  # q = 2 sin(θ/2)
    assert list(found.tables[0].column(outside_kind)) == pytest.approx(expected, rel=1e-9)
    assert max(abs(row[-1]) for row in hung(found, outside_kind)) < 10.0


def test_a_strip_that_comes_to_no_rest_leaves_its_cells_empty(monkeypatch):
    def nowhere(*_):
        raise cantilever.sim.EquilibriumError("never")

    monkeypatch.setattr(cantilever.Strip, "hang", nowhere)
    rows = cantilever.run(rows=4, trend=()).tables[1].rows
    assert all(row[2] is row[4] is row[-1] is None and row[3] > 0.0 for row in rows)
