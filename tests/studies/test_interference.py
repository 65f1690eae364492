"""The study of interference: moduli of lattices and the pull of a rhombus, against closed forms."""

import numpy as np
import pytest

import sim
from sim.springs import BENDING
from sim.studies import interference

EXACT = 1e-6
"""Relative; what is not quadratic in the strain is 1e-8."""


@pytest.fixture(scope="module")
def result():
    return interference.run()


def row(table, *start):
    return next(r for r in table.rows if r[: len(start)] == start)


def test_equilateral_edges_have_equal_moduli_and_cross_springs_add_their_share(result):
    moduli = result.tables[0]
    edges = 3**0.5 / 4
    assert row(moduli, "edges")[3:5] == pytest.approx([edges, edges], rel=EXACT)
    for part in (1.0, 0.1):
        assert row(moduli, "cross", part)[3:5] == pytest.approx([0.75 * part] * 2, rel=EXACT)
        assert row(moduli, "cross", part)[6] == pytest.approx(3**0.5 * part, rel=EXACT)
        for kind in ("modified", "angle"):
            assert np.abs(row(moduli, kind, part)[3:5]).max() < 1e-12


def test_the_rhombus_is_as_stiff_as_the_closed_form_says(result):
    rhombi = result.tables[1]
    known = {
        ("edges",): 0.600,
        ("edges and cross", 1.0): 1.177,
        ("edges and cross", 0.1): 0.658,
        ("edges and modified", 1.0): 0.600,
        ("edges and angle", 1.0): 0.600,
    }
    for start, stiffness in known.items():
        assert row(rhombi, *start)[2] == pytest.approx(stiffness, rel=1e-3)  # three digits are known
    for _, _, measured, closed in rhombi.rows:
        assert measured == pytest.approx(closed, rel=EXACT)


def test_pulling_the_rhombus_apart_needs_the_force_that_its_stiffness_says():
    """Tips held 1 mm farther apart, the rest relaxed: the force on them over that millimetre."""
    cloth = interference.rhombus()
    apart = np.array(cloth["vertices"])
    apart[2, 1] += 0.5e-3
    apart[3, 1] -= 0.5e-3
    held = {**cloth, "vertices": apart, "rest_vertices": cloth["vertices"], "pins": [2, 3]}
    settings = {"gravity": [0, 0, 0], "stretch": 1.0, "bend": "none"}
    world = sim.equilibrium({"cloth": held, "settings": settings})
    assert -world.forces()[2, 1] / 1e-3 == pytest.approx(0.6, rel=1e-3)  # of second order in the strain


def test_right_angled_lattice_has_its_known_moduli(result):
    lattice = result.tables[2]
    assert row(lattice, "edges")[2::2] == pytest.approx([1.354, 0.354], rel=1e-2)
    assert row(lattice, "cross", "k_b = k")[2::2] == pytest.approx([1.874, 1.069], rel=1e-3)
    for _, _, *pairs in lattice.rows:
        for measured, closed in (pairs[:2], pairs[2:]):
            assert closed is None or measured == pytest.approx(closed, rel=EXACT, abs=1e-12)


def test_interference_grows_with_the_bending_stiffness(result):
    usual = result.tables[3]
    factor = (
        16 / 3 * 3**0.5 / (interference.USUAL_SIDE * interference.USUAL_STRETCH)
    )  # √3 k_b/k, k_b = 16 c/3 a
    assert usual.column("cross") == pytest.approx(
        [100 * factor * c for c in interference.BENDINGS], rel=EXACT
    )
    assert usual.column("modified") == pytest.approx([0.0] * 4, abs=1e-9)


def test_a_kind_from_outside_has_rows_and_no_closed_form(outside_kind):
    found = interference.run()
    moduli = [r for r in found.tables[0].rows if r[0] == outside_kind]
    assert [r[1] for r in moduli] == [1.0, 0.1]
    assert all(r[5] is None and abs(r[3]) < 1e-12 for r in moduli)
    assert row(found.tables[1], f"edges and {outside_kind}", 1.0)[2] == pytest.approx(0.6, rel=EXACT)
    assert outside_kind in found.tables[2].column("springs")
    assert outside_kind in found.tables[3].columns


def test_kinds_that_are_wrong_on_purpose_are_left_out(result):
    wrong = {name for name, kind in BENDING.items() if kind.wrong}
    assert wrong
    assert not wrong & set(result.tables[0].column("springs"))
