"""Every case of the battery that takes no more than some seconds, once."""

import pytest

from sim.stress import Task, cases, sweep
from sim.stress.contact import blind_to_edges
from sim.stress.probe import run_task

FAST = 2.0
"""A case that takes longer [s] is left to `muslin stress`."""


def fast():
    return [name for name, case in cases().items() if case.seconds <= FAST and case.theme != "sweep"]


@pytest.mark.parametrize("name", fast())
def test_a_hard_case_is_within_its_marks(name):
    outcome = run_task(Task(name, 0))
    assert not outcome.trouble
    assert outcome.figures
    wrong = [figure for figure in outcome.figures if not figure.passed]
    assert not wrong


@pytest.mark.parametrize("mesh", ["grid", "irregular", "slivers", "pieces"])
def test_a_row_of_all_settings_is_within_its_marks(mesh):
    outcome = run_task(Task(f"sweep-{mesh}", SWEPT))
    assert outcome.passed, (outcome.trouble, outcome.figures)


SWEPT = 5
"""A row of the array that is quick."""


STIFF_AND_DAMPED = {
    "gravity": (0.0, 0.0, -9.81),
    "gamma": 2.0,
    "rest_angle": -1.5,
    "stretch": 1.0,
    "altitudes": "all",
    "altitude": 1e4,
    "bend": "adhoc",
    "adhoc_rule": "tips",
    "bending": 1e-6,
    "density": 2.0,
    "contact": "penalty",
    "detection": "static",
    "self_collision": "off",
    "thickness": 0.05,
    "friction": 0.0,
    "integrator": "tr_bdf2",
    "dt": 1 / 30,
    "newton": 10,
    "solver": "direct",
    "tolerance": 1e-7,
    "jitter": 1e-8,
}


def test_tr_bdf2_holds_stiff_and_damped_cloth(monkeypatch):
    monkeypatch.setattr(sweep, "rows", lambda: [STIFF_AND_DAMPED])
    outcome = run_task(Task("sweep-grid", 31))
    assert outcome.passed, (outcome.trouble, outcome.figures)


def test_the_wire_goes_through_where_pairs_of_edges_are_not_looked_at():
    """What C2-wire is worth: the same case fails with edges against edges switched off."""
    with blind_to_edges():
        assert not run_task(Task("C2-wire", 0)).passed
