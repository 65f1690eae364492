"""Muslin, judged like its peers."""

from __future__ import annotations

import numpy as np

from sim.bench.peers import Knobs
from sim.bench.sheet import FRAME, Sheet
from sim.simulation import Simulation

OWN: Knobs = {"substeps": 1, "newton": 1, "integrator": "backward_euler"}
FRAMES: tuple[Knobs, ...] = (OWN,)
LADDER: tuple[Knobs, ...] = tuple({**OWN, "substeps": 2**k} for k in range(9))
OTHERS: tuple[Knobs, ...] = (
    {"substeps": 1, "newton": 2, "integrator": "backward_euler"},
    *({"substeps": n, "newton": 1, "integrator": "bdf2"} for n in (2, 4, 8, 16)),
    *({"substeps": n, "newton": 2, "integrator": "bdf2"} for n in (2, 4, 8)),
    *({"substeps": n, "newton": 2, "integrator": "tr_bdf2"} for n in (1, 2)),
)

TOLERANCE = 1e-4
"""Of a linear solve of a whole frame [m]; a substep's is smaller by the square of their number, so that the
errors of all velocities add up to no more."""


class MuslinRun:
    """A sheet in Muslin."""

    def __init__(self, sheet: Sheet, knobs: Knobs, threads: int) -> None:
        substeps = int(knobs["substeps"])
        self.world = Simulation(
            sheet.scene(),
            dt=FRAME / substeps,
            newton=knobs["newton"],
            integrator=knobs["integrator"],
            tolerance=TOLERANCE / substeps**2,
            threads=threads,
        )
        self.substeps = substeps

    def frame(self) -> None:
        """Go on by one frame."""
        for _ in range(self.substeps):
            self.world.step()

    def positions(self) -> np.ndarray:
        """(n, 3) [m]."""
        return self.world.positions.copy()


start = MuslinRun
