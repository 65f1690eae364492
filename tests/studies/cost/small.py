"""What small studies of cost are made with."""

import math

from sim.integrators import sdirk2
from sim.studies.cost.plan import Effort

FEW = Effort(2, 0, ("backward_euler", "bdf2", "sdirk2"), 1, 1, 0, 0, math.inf)
"""Three steps and no more runs than it takes."""

EARTH = [0.0, 0.0, -9.81]

WASTEFUL = "wasteful"


def wasteful(s):
    """SDIRK2 that does its first stage for nothing, and again."""
    s.solve(s.x, s.v, 0.3 * s.h)
    return sdirk2(s)
