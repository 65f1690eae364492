"""What an implicit step promises however large it is: descent, a quadratic tail, honesty, constant memory.

A step of backward Euler minimises the incremental potential Φ(v) = ½ ‖v − vⁿ‖²_M + E(xⁿ + h v) + ½ h Σ b q̇²
(Ortiz and Stainier 1999; Martin et al. 2011). Its search begins at v = 0, where Φ = E(xⁿ) + ½ ‖vⁿ‖²_M, and a
line search lets no iteration raise it. So whatever the stiffness and however badly the step was solved,

    E(xⁿ⁺¹) + ½ ‖vⁿ⁺¹ − vⁿ‖²_M  ≤  E(xⁿ) + ½ ‖vⁿ‖²_M

with gravity's potential in E. `sim.solve.implicit` searches along lines only with newton ≥ 2 and springs that
have an energy; the one iteration of newton = 1 is taken as it is, and promises nothing. Where γ > 0, each
iteration has b and ∇q of where it begins, and so a Φ of its own: for γ = 0 the bound is proved, else found.
"""

import gc
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

import sim
from sim.solve import implicit
from sim.stress.measures import potential_parts, rise
from tests.worlds import ball, grid, irregular, scene

KINDS = ("none", "cross", "modified", "angle")
DT = (1 / 60, 0.1, 1.0)
STIFFNESS = (1e1, 1e3, 1e6)

ITERATIONS = 20
"""Newton iterations of the steps that must descend."""

ROUNDING = 10 * ITERATIONS * implicit.ROUNDING
"""Of the sum of all parts of Φ: each search lets go so much, and ten for the sums of some hundred terms."""

BADLY = 1
"""Linear iterations of a badly solved step: its error is from half of the solution to twenty times it."""


def crumpled(bend, dt, stiffness, held, size=1.0, **settings):
    """Crumpled cloth of `size` [m] that all of its vertices leave in different directions, at 1 m/s."""
    cloth = irregular(3, noise=0.05) | ({"pins": [0, 1]} if held else {})
    for shape in ("vertices", "rest_vertices"):
        cloth[shape] = (size * np.array(cloth[shape])).tolist()
    settings = {"gamma": 0.0, "newton": ITERATIONS, "tolerance": 1e-8, "altitudes": "all", **settings}
    world = sim.Simulation(
        scene(
            cloth,
            gravity=[0.3, 0, -9.81],
            bend=bend,
            dt=dt,
            stretch=stiffness,
            altitude=stiffness,
            bending=1e-5 * stiffness,
            contact="none",
            **settings,
        )
    )
    rng = np.random.default_rng(0)
    world.place(world.positions, rng.standard_normal(world.positions.shape))
    return world


@pytest.mark.parametrize("gamma", [0.0, 0.2])
@pytest.mark.parametrize("bend", KINDS)
def test_no_step_raises_its_incremental_potential(bend, gamma):
    """Steps up to 1 s and stiffness up to 1e6 N, of cloth that hangs and that falls."""
    for dt, stiffness, held in product(DT, STIFFNESS, (True, False)):
        world = crumpled(bend, dt, stiffness, held, gamma=gamma)
        for _ in range(3):
            assert rise(world)[0] <= ROUNDING, (dt, stiffness, held)


@pytest.mark.parametrize("newton", [3, ITERATIONS])
@pytest.mark.parametrize("bend", KINDS)
def test_badly_solved_steps_descend_too(bend, newton, monkeypatch):
    """Directions of conjugate gradients that were stopped far from the solution."""
    monkeypatch.setattr(implicit, "MOST_ITERATIONS", BADLY)
    for dt, stiffness, held in product(DT, STIFFNESS, (True, False)):
        world = crumpled(bend, dt, stiffness, held, newton=newton, solver="cg", tolerance=1e-10)
        for _ in range(2):
            found, report = rise(world)
            assert not report.converged
            assert found <= ROUNDING, (dt, stiffness, held)


def test_a_loose_tolerance_does_not_let_a_step_rise():
    """A centimetre, the largest there may be, of cloth three centimetres wide."""
    for bend, stiffness, held in product(KINDS, (1e1, 1e3), (True, False)):
        world = crumpled(bend, 1 / 60, stiffness, held, size=0.03, tolerance=1e-2)
        for _ in range(5):
            assert rise(world)[0] <= ROUNDING, (bend, stiffness, held)


def test_a_step_without_line_search_can_raise_it():
    """What the tests above are worth: a linearised step from such states does what they rule out."""
    worlds = [
        crumpled(bend, *case, newton=1) for bend in KINDS for case in product(DT, STIFFNESS, (True, False))
    ]
    for world in worlds:
        world.step()
    assert sum(rise(world)[0] > ROUNDING for world in worlds) > len(worlds) / 4


@pytest.mark.parametrize("bend", KINDS)
def test_each_further_iteration_descends(bend):
    """Steps that are alike up to the last iteration: the one with more of them ends no higher."""
    heights = []
    for newton in range(2, 10):
        world = crumpled(bend, 0.1, 1e3, held=True, newton=newton)
        start = world.velocities.copy()
        world.step()
        heights.append(potential_parts(world, start))
    for higher, lower in pairwise(heights):
        assert lower.sum() - higher.sum() <= ROUNDING * np.abs([higher, lower]).sum()
    assert heights[-1].sum() < heights[0].sum()


SPREAD = 4.0
"""C holds Φ''' in the direction of the error, which changes: seen are a fifth of the first C to twice."""

EXACT = 1e-14
"""Positions of about 1 m are not more alike than this [m]."""

TAIL = 7
"""Iterations to the last digit: the filtered ones, three or four that square 1e-3, and one to see that."""


@pytest.mark.parametrize("bend", KINDS)
def test_newton_squares_its_error_once_its_hessian_is_exact(bend):
    """Error k + 1 is at most C times the square of error k, from noisy cloth stretched by a fifth.

    Without damping, whose b and ∇q the Hessian takes as constant, and near enough for steps of full length.
    """

    def end(newton):
        cloth = grid(resolution=(7, 6), pins=["left"])
        stiff = {"stretch": 10.0, "altitude": 10.0, "altitudes": "all", "bend": bend, "bending": 1e-2}
        solver = {"solver": "direct", "tolerance": 1e-12, "newton": newton, "gamma": 0.0}
        world = sim.Simulation(scene(cloth, gravity=[0, 0, -9.81], **stiff, **solver))
        rng = np.random.default_rng(0)
        noise, speeds = rng.standard_normal((2, *world.positions.shape))
        world.place(1.2 * world.positions + 0.02 * noise, 0.5 * speeds)
        return world.step(), world.positions.copy()

    report, solution = end(60)
    assert report.converged
    assert report.newton <= TAIL
    exact = range(implicit.FILTERED, TAIL)
    errors = [float(np.linalg.norm(end(k)[1] - solution, axis=1).max()) for k in exact]
    assert errors[0] > 1e-4  # of cloth 1 m wide: there is something left for exact iterations to do
    factor = SPREAD * errors[1] / errors[0] ** 2
    for before, after in pairwise(errors):
        assert after <= max(factor * before**2, EXACT)
    assert errors[-1] <= EXACT


def test_a_step_that_does_not_converge_says_so_and_loses_nothing():
    """Not finite state, past or determinism: it can be gone back on, and goes on, to the same bits."""
    world = crumpled("angle", 1.0, 1e6, held=True, newton=2)
    world.step()
    start, ends = world.snapshot(), []
    for _ in range(2):
        reports = [world.step() for _ in range(3)]
        assert not any(report.converged for report in reports)
        assert all("all iterations used" in report.stopped for report in reports)
        ends.append((world.time, world.positions.copy(), world.velocities.copy()))
        assert np.isfinite(ends[-1][1]).all()
        assert np.isfinite(ends[-1][2]).all()
        assert not np.array_equal(ends[-1][1], start.positions)
        world.restore(start)
        np.testing.assert_array_equal(world.positions, start.positions)
    assert ends[0][0] == ends[1][0]
    np.testing.assert_array_equal(ends[0][1], ends[1][1])
    np.testing.assert_array_equal(ends[0][2], ends[1][2])


GROWTH = 2e6
"""Bytes that memory may grow by: to keep one vector of the cloth per step would take 5.4 MB."""

STATM = Path("/proc/self/statm")


def resident():
    """Memory that this process holds now [bytes]."""
    import resource

    gc.collect()
    return int(STATM.read_text().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(not STATM.exists(), reason="the system does not say how much memory a process holds")
def test_memory_does_not_grow_with_steps():
    """Ten thousand steps on a sphere, with stiffnesses and kinds of springs that change now and then."""
    cloth = grid(resolution=(5, 5), position=[0, 0, 0.31])
    world = sim.Simulation(scene(cloth, ball(), gravity=[0, 0, -9.81], contact="impulse", friction=1.0))
    contacts, held = 0, 0
    for step in range(10_000):
        contacts += world.step().contacts
        if step % 500 == 250:
            late = step // 500 % 2
            world.update(stretch=50.0 + 25.0 * late, bend=("angle", "cross")[late], newton=1 + late)
        if step == 999:
            held = resident()
    assert contacts > 10_000
    assert resident() - held <= GROWTH
