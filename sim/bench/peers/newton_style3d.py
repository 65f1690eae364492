"""Newton's Style3D solver (projective dynamics), as its hanging-cloth example has it."""

from __future__ import annotations

from typing import Any

from sim.bench.peers import Knobs
from sim.bench.peers.newton_model import NewtonRun, newton, wp
from sim.bench.sheet import BENDING, SPRING, Sheet

OWN: Knobs = {"substeps": 2, "iterations": 10}
FRAMES: tuple[Knobs, ...] = (OWN,)
LADDER: tuple[Knobs, ...] = tuple({"substeps": 2**k, "iterations": 10} for k in range(1, 9))
OTHERS: tuple[Knobs, ...] = (
    *({"substeps": n, "iterations": 4} for n in (2, 4, 10)),
    *({"substeps": n, "iterations": 20} for n in (1, 2, 4)),
)

SHEAR = 0.1
"""Stiffness against shear over that along the threads, as in the example."""


def start(sheet: Sheet, knobs: Knobs, threads: int) -> NewtonRun:
    """A sheet of woven cloth."""

    def add_cloth(builder: Any, arguments: dict[str, Any]) -> None:
        newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        newton.solvers.style3d.add_cloth_mesh(
            builder,
            **arguments,
            panel_verts=[wp.vec2(p[0], p[1]) for p in arguments["vertices"]],
            panel_indices=arguments["indices"],
            tri_aniso_ke=wp.vec3(SPRING, SPRING, SHEAR * SPRING),
            edge_aniso_ke=wp.vec3(BENDING, BENDING, BENDING),
        )

    def make_solver(model: Any) -> Any:
        config = newton.solvers.SolverStyle3D.Config(iterations=int(knobs["iterations"]))
        return newton.solvers.SolverStyle3D(model=model, config=config)

    contact = {"soft_contact_kd": 1e2}
    return NewtonRun(sheet, int(knobs["substeps"]), add_cloth, make_solver, contact, record=False)
