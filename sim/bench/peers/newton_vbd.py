"""Newton's vertex block descent, as its hanging-cloth example has it."""

from __future__ import annotations

from typing import Any

from sim.bench.peers import Knobs
from sim.bench.peers.newton_model import NewtonRun, newton
from sim.bench.sheet import BENDING, SPRING, Sheet

OWN: Knobs = {"substeps": 10, "iterations": 10}
FRAMES: tuple[Knobs, ...] = (OWN,)
LADDER: tuple[Knobs, ...] = tuple({"substeps": 5 * 2**k, "iterations": 10 * 2**k} for k in range(7))
OTHERS: tuple[Knobs, ...] = (
    *({"substeps": n, "iterations": 5} for n in (10, 20, 40, 80)),
    *({"substeps": n, "iterations": 10} for n in (20, 40)),
)

DAMPING = 0.1
"""Of a triangle over its stiffness [s], as in the example."""


def start(sheet: Sheet, knobs: Knobs, threads: int) -> NewtonRun:
    """A sheet of triangle and hinge elements."""

    def add_cloth(builder: Any, arguments: dict[str, Any]) -> None:
        stiffness = {"tri_ke": SPRING, "tri_ka": SPRING, "tri_kd": DAMPING * SPRING}
        builder.add_cloth_mesh(**arguments, **stiffness, edge_ke=BENDING, edge_kd=0.0)

    def make_solver(model: Any) -> Any:
        return newton.solvers.SolverVBD(model, iterations=int(knobs["iterations"]))

    return NewtonRun(sheet, int(knobs["substeps"]), add_cloth, make_solver, {"soft_contact_kd": 1e2})
