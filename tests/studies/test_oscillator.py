"""The oscillator study: closed form, orders, mistakes, and measured γ."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from sim.integrators import INTEGRATORS
from sim.studies import oscillator

VECTORS = Path(__file__).parent.parent / "vectors" / "methods.json"

KNOWN = json.loads(VECTORS.read_text(encoding="utf-8"))["oscillator"]
"""Motions that another program found: x0 [m], ω [rad/s], γ, and (t, x) pairs."""


@pytest.fixture(scope="module")
def result():
    return oscillator.run()


@pytest.mark.parametrize("known", KNOWN, ids=lambda known: f"γ = {known['gamma']}")
def test_closed_form_is_that_of_the_vectors(known):
    assert known["v0"] == 0.0
    for t, x in known["exact"]:
        found = known["x0"] * oscillator.released(t, *oscillator.roots(known["gamma"], known["omega"]))
        assert found == pytest.approx(x, abs=1e-15)


@pytest.mark.parametrize("gamma", oscillator.GAMMAS)
def test_closed_form_starts_at_rest_and_obeys_its_equation(gamma):
    """By differences: x'' + 2 γ ω x' + ω² x = 0; truncation is 1e-6 of ω²."""
    step, omega = 1e-4, 20.0
    roots = oscillator.roots(gamma, omega)
    before, now, after = (oscillator.released(0.05 + k * step, *roots) for k in (-1, 0, 1))
    second, first = (after - 2 * now + before) / step**2, (after - before) / (2 * step)
    assert second + 2 * gamma * omega * first + omega**2 * now == pytest.approx(0.0, abs=1e-5 * omega**2)
    assert oscillator.released(0.0, *roots) == 1.0
    assert oscillator.released(1e-6, *roots) == pytest.approx(1.0, abs=1e-9)


def test_every_integrator_shows_its_order(result):
    table = result.tables[0]
    assert len(table.rows) == 3 * len(INTEGRATORS)
    for name, order in zip(table.column("integrator"), table.column("order"), strict=True):
        assert order == pytest.approx(INTEGRATORS[name].order, abs=0.1)


def test_backward_euler_errs_by_what_its_own_recurrence_says(result):
    """X_{k+1} (1 + 2 γ h ω + h² ω²) = x_k (2 + 2 γ h ω) − x_{k−1}, from two equal values."""
    gamma, h = 0.2, oscillator.STEPS[0]
    hw = h * oscillator.OMEGA
    before = now = oscillator.STRETCHED
    for _ in range(round(oscillator.END / h)):
        before, now = now, (now * (2 + 2 * gamma * hw) - before) / (1 + 2 * gamma * hw + hw**2)
    row = next(row for row in result.tables[0].rows if row[:2] == (gamma, "backward_euler"))
    assert row[2] + row[3] == pytest.approx(1e3 * now, abs=1e-9)


def test_the_mistakes_are_far_off(result):
    table = result.tables[1]
    assert table.column("γ") == (0.2, 2.0, 2.0)
    assert min(abs(off) for off in table.column("off by [% of the start]")) > 2.0
    b = 2 * 0.2 * math.sqrt(0.5 * 200.0)
    damped = oscillator.OMEGA * math.sqrt(1 - 0.2**2)
    t = oscillator.END
    noted = math.exp(-b * t / 2) * (math.cos(damped * t) + b / (2 * damped) * math.sin(damped * t))
    assert table.rows[0][3] == pytest.approx(1e3 * oscillator.STRETCHED * noted, rel=1e-12)


def test_measured_damping_is_what_is_expected_and_the_node_mass_makes_it_too_large(result):
    table = result.tables[2]
    for gamma, spring, integrator, _, expected, measured in table.rows:
        assert measured == pytest.approx(expected, abs=1e-3)
        if integrator == "midpoint":
            true = gamma * math.sqrt(2.0) if "mass of one end" in spring else gamma
            assert measured == pytest.approx(true, abs=5e-3)
    euler = [row for row in table.rows if row[2] == "backward_euler"]
    assert np.array([row[5] - row[0] for row in euler]) == pytest.approx([0.047, 0.0, -0.124], abs=1e-3)
