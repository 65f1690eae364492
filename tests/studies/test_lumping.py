"""The study of mass lumping: iterations, condition numbers, and what the masses do to a panel."""

import numpy as np
import pytest

from sim.studies import lumping

COUNT = 12


@pytest.fixture(scope="module")
def result():
    return lumping.run(count=COUNT, gradings=(1.0, 2.0))


def cell(table, heading, *start):
    row = next(r for r in table.rows if r[: len(start)] == start)
    return row[table.columns.index(heading)]


@pytest.mark.parametrize(("mass", "plain", "jacobi"), [("constant", 222, 246), ("area", 438, 246)])
def test_a_uniform_sheet_takes_the_iterations_that_are_known(mass, plain, jacobi):
    """Another program's counts, for another random right-hand side and point Jacobi: to 5 % and 25 %."""
    system = lumping.System.of(lumping.graded(30, 1.0), mass, "random")
    assert lumping.textbook_cg(system, np.copy).to_residual == pytest.approx(plain, rel=0.05)
    blocks = lumping.textbook_cg(system, lumping.block_jacobi(system))
    assert blocks.to_residual == pytest.approx(jacobi, rel=0.25)


def test_constant_mass_helps_without_a_preconditioner_only(result):
    table = result.tables[0]
    for g in (1.0, 2.0):
        plain, jacobi, own = (
            [cell(table, name, g, "random", mass) for mass in ("constant", "area")]
            for name in lumping.PRECONDITIONERS
        )
        assert plain[1] == lumping.BEYOND or plain[1] > 1.5 * plain[0]
        assert jacobi[1] == pytest.approx(jacobi[0], rel=0.25)
        assert own[1] == pytest.approx(own[0], rel=0.25)
        assert max(own) < min(jacobi)


def test_for_the_weight_of_a_hanging_sheet_the_masses_hardly_matter(result):
    for name in lumping.PRECONDITIONERS:
        counts = [cell(result.tables[0], name, 2.0, "weight", mass) for mass in ("constant", "area")]
        assert abs(counts[1] - counts[0]) <= max(0.15 * counts[0], 1)  # of few, one more means nothing


@pytest.mark.parametrize("name", lumping.PRECONDITIONERS)
def test_condition_numbers_are_those_of_the_whole_matrix(name):
    """From all eigenvalues of P⁻¹A; the Lanczos iteration ends a little inside of them."""
    system = lumping.System.of(lumping.graded(6, 1.5), "area", "random")
    apply = lumping.PRECONDITIONERS[name](system)
    product = np.column_stack([apply(column).copy() for column in system.matrix.toarray().T])
    eigenvalues = np.linalg.eigvals(product).real
    assert lumping.textbook_cg(system, apply).condition == pytest.approx(
        eigenvalues.max() / eigenvalues.min(), rel=0.02
    )


def test_muslins_solver_stops_a_little_after_the_error_is_small_enough(result):
    table = result.tables[1]
    for row in table.rows:
        reached, stopped = row[-2:]
        assert reached <= stopped < 2.5 * reached


def test_the_error_is_measured_against_the_solution():
    system = lumping.System.of(lumping.graded(6, 1.0), "area", "weight")
    assert system.error(system.solution) == 0.0
    assert system.error(np.zeros_like(system.solution)) == pytest.approx(1.0)
    assert np.abs(system.matrix @ system.solution - system.right).max() < 1e-12 * np.abs(system.right).max()


def test_constant_mass_hangs_a_graded_panel_askew_and_swings_it_slower(result):
    table = result.tables[2]
    for g in (1.0, 2.0):
        assert abs(cell(table, "hangs askew by [°]", g, "area")) < 1e-9
        assert abs(cell(table, "off by [%]", g, "area")) < 1.0
    assert cell(table, "hangs askew by [°]", 2.0, "constant") < -10.0
    assert cell(table, "off by [%]", 2.0, "constant") < -5.0


def test_the_lightest_vertex_shortens_explicit_steps(result):
    table = result.tables[2]
    steps = [cell(table, "longest explicit step [ms]", 2.0, mass) for mass in ("constant", "area")]
    assert steps[1] < 0.1 * steps[0]
    assert cell(table, "lightest over mean vertex", 2.0, "constant") == pytest.approx(1.0)


def test_a_uniform_plate_is_a_known_pendulum():
    """By many small strips: ω² = 3 g/2 L, and level."""
    z = (np.arange(10_000) + 0.5) / 10_000
    askew, swing = lumping.rigid_panel(np.column_stack([0.5 + 0 * z, 0 * z, z]), np.ones_like(z))
    assert askew == 0.0
    assert swing == pytest.approx(lumping.PLATE_SWING, rel=1e-6)
