"""The study of ghost forces: the table that another program found, to 1 %."""

import pytest

from sim.springs import BENDING
from sim.studies import ghost

SHARE = 0.01
"""Allowed difference to the other program, whose numbers have three digits; of zeros, to rounding."""

ROUND_OFF = 1e-14


@pytest.fixture(scope="module")
def rows():
    (table,) = ghost.run().tables
    return {row[0]: row[1:] for row in table.rows}


def test_every_kind_and_every_ad_hoc_rule_has_its_row(rows):
    right = {name for name, kind in BENDING.items() if not kind.wrong}
    assert set(rows) == right | {"ad hoc: tips", "ad hoc: half", "ad hoc: lever"}


@pytest.mark.parametrize("kind", ["cross", "modified", "angle"])
def test_true_gradients_keep_both_momenta(rows, kind):
    assert max(rows[kind][:6]) < ROUND_OFF


@pytest.mark.parametrize(
    ("rule", "linear", "angular"), [("tips", 0.0683, 0.0121), ("half", 0, 0.0152), ("lever", 0, 0.0053)]
)
def test_ad_hoc_rules_make_momentum_as_the_table_says(rows, rule, linear, angular):
    _, _, *before, p, l, p_elsewhere, l_elsewhere = rows[f"ad hoc: {rule}"]  # noqa: E741
    assert before == [0.0, 0.0]
    assert p == pytest.approx(linear, rel=SHARE, abs=ROUND_OFF)
    assert l == pytest.approx(angular, rel=SHARE)
    assert (p_elsewhere, l_elsewhere) == (linear, angular)


@pytest.mark.parametrize(
    ("rule", "force", "torque"),
    [
        ("tips", (0, 0.0453, -0.0785), (-0.0164, 0.0020, -0.0079)),
        ("half", (0, 0, 0), (-0.0262, 0, -0.0091)),
        ("lever", (0, 0, 0), (0, 0.0073, -0.0101)),
    ],
)
def test_net_forces_and_torques_at_the_start(rows, rule, force, torque):
    for found, known in zip(rows[f"ad hoc: {rule}"][:2], (force, torque), strict=True):
        assert found == pytest.approx(sum(x * x for x in known) ** 0.5, rel=SHARE, abs=ROUND_OFF)
