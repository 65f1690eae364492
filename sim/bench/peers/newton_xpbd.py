"""Newton's extended position-based dynamics.

The 10 substeps of 10 iterations of its hanging-cloth example are for particles of 100 g; on this sheet, with
particles of a gram or less, they diverge. One iteration in each of 160 substeps holds at 1,024 vertices.
"""

from __future__ import annotations

from typing import Any

from sim.bench.peers import Knobs
from sim.bench.peers.newton_model import NewtonRun, newton
from sim.bench.sheet import BENDING, SPRING, Sheet

OWN: Knobs = {"substeps": 160, "iterations": 1}
FRAMES: tuple[Knobs, ...] = (OWN,)
LADDER: tuple[Knobs, ...] = tuple({"substeps": 160 * 2**k, "iterations": 1} for k in range(6))
OTHERS: tuple[Knobs, ...] = ({"substeps": 80, "iterations": 1}, {"substeps": 120, "iterations": 1})


def start(sheet: Sheet, knobs: Knobs, threads: int) -> NewtonRun:
    """A sheet of springs on edges, and hinges."""

    def add_cloth(builder: Any, arguments: dict[str, Any]) -> None:
        springs = {"add_springs": True, "spring_ke": SPRING, "spring_kd": 0.0}
        triangles = {"tri_ke": 0.0, "tri_ka": 0.0, "tri_kd": 0.0}
        builder.add_cloth_mesh(**arguments, **springs, **triangles, edge_ke=BENDING, edge_kd=0.0)

    def make_solver(model: Any) -> Any:
        return newton.solvers.SolverXPBD(model, iterations=int(knobs["iterations"]))

    return NewtonRun(sheet, int(knobs["substeps"]), add_cloth, make_solver, {})
