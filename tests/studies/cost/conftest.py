"""A small smooth scene, and what a study and a comparison of it find; measured once."""

import math

import pytest
from small import EARTH, FEW, WASTEFUL, wasteful

from sim.integrators import INTEGRATORS, Integrator
from sim.studies.audit import audit
from sim.studies.cost.compare import compare
from sim.studies.cost.plan import Effort
from sim.studies.cost.study import cost
from tests.worlds import ball, grid, scene


@pytest.fixture(scope="session")
def swing():
    """A soft small sheet that swings from one side: smooth, and touching nothing."""
    cloth = grid(size=(0.3, 0.3), resolution=(3, 3), pins=["left"])
    return scene(cloth, gravity=EARTH, stretch=2.0, gamma=0.05, bend="none", dt=1 / 60, contact="none")


@pytest.fixture(scope="session")
def landing():
    """The same sheet, free, falling on a ball."""
    cloth = grid(size=(0.3, 0.3), resolution=(5, 5), position=[0.0, 0.0, 0.22])
    return scene(cloth, ball(radius=0.2), gravity=EARTH, stretch=5.0, thickness=1e-3, dt=1 / 60, newton=3)


@pytest.fixture(scope="session")
def report(swing):
    """The study of the sheet that swings, with an integrator made deliberately worse among its own."""
    good = INTEGRATORS["sdirk2"]
    worse = Integrator("does more than it must", good.order, wasteful, good.growth)
    INTEGRATORS[WASTEFUL] = worse
    try:
        effort = Effort(2, 0, (*FEW.integrators, WASTEFUL), 2, 2, 2, 0, math.inf)
        return cost(swing, seconds=0.3, effort=effort, target=1e-3, jobs=1)
    finally:
        del INTEGRATORS[WASTEFUL]


@pytest.fixture(scope="session")
def compared(landing):
    """The sheet that falls on a ball, by response."""
    return compare(landing, "contact", ["penalty", "impulse"], seconds=0.2, repeats=1, jobs=1)


@pytest.fixture(scope="session")
def audited():
    """A sheet that falls on a ball, with bending made so weak that it does next to nothing."""
    cloth = grid(size=(0.4, 0.4), resolution=(9, 9), position=[0.0, 0.0, 0.215])
    void = {"bending": 1e-13, "self_collision": "auto"}
    return audit(scene(cloth, ball(radius=0.2), gravity=EARTH, stretch=20.0, newton=3, **void), seconds=0.15)
