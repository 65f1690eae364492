"""What Newton's solvers share: a sheet as its model, and the loop over substeps of its examples."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from sim.bench.sheet import DENSITY, FRAME, GRAVITY, RADIUS, THICKNESS, Sheet

newton: Any = import_module("newton")
wp: Any = import_module("warp")

CONTACT = {"soft_contact_ke": 1e2, "soft_contact_kd": 1.0, "soft_contact_mu": 0.3}
"""Stiffness [N/m], damping and friction of contact with the sphere."""


class NewtonRun:
    """A sheet in Newton, on the CPU.

    Args:
        sheet: Which one.
        substeps: Of a frame.
        add_cloth: Adds the cloth, as (builder, arguments).
        make_solver: The solver of a model.
        contact: What differs from `CONTACT`.
        record: Whether the launches of a frame are recorded once and played from then on, as its examples do.
    """

    def __init__(
        self,
        sheet: Sheet,
        substeps: int,
        add_cloth: Callable[[Any, dict[str, Any]], None],
        make_solver: Callable[[Any], Any],
        contact: dict[str, float],
        record: bool = True,
    ) -> None:
        wp.config.quiet = True
        wp.set_device("cpu")
        self.substeps, self.h = substeps, FRAME / substeps
        self.model = _model(sheet, add_cloth, contact)
        self.solver = make_solver(self.model)
        self.states = [self.model.state(), self.model.state()]
        self.control = self.model.control()
        self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.hangs = sheet.hangs
        self.record, self.graph = record and substeps % 2 == 0, None

    def frame(self) -> None:
        """Go on by one frame."""
        if not self.record:
            self._substeps()
            return
        if self.graph is None:
            with wp.ScopedCapture(device="cpu") as capture:
                self._substeps()
            self.graph = capture.graph
        wp.capture_launch(self.graph)

    def positions(self) -> np.ndarray:
        """(n, 3) [m]."""
        return self.states[0].particle_q.numpy().astype(float)

    def _substeps(self) -> None:
        for _ in range(self.substeps):
            here, there = self.states
            here.clear_forces()
            if not self.hangs:
                self.pipeline.collide(here, self.contacts)
            self.solver.step(here, there, self.control, self.contacts, self.h)
            self.states.reverse()


def _model(sheet: Sheet, add_cloth: Callable[[Any, dict[str, Any]], None], contact: dict[str, float]) -> Any:
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -GRAVITY))
    mesh = sheet.mesh
    arguments = {
        "pos": wp.vec3(0.0, 0.0, 0.0),
        "rot": wp.quat_identity(),
        "scale": 1.0,
        "vel": wp.vec3(0.0, 0.0, 0.0),
        "vertices": [wp.vec3(*map(float, p)) for p in mesh.vertices],
        "indices": mesh.triangles.ravel().tolist(),
        "density": DENSITY,
        "particle_radius": THICKNESS,
    }
    add_cloth(builder, arguments)
    for pinned in mesh.pinned.tolist():
        builder.particle_mass[pinned] = 0.0
        builder.particle_flags[pinned] &= ~int(newton.ParticleFlags.ACTIVE)
    if not sheet.hangs:
        builder.add_shape_sphere(
            body=-1, xform=wp.transform(wp.vec3(*sheet.center), wp.quat_identity()), radius=RADIUS
        )
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    for name, value in {**CONTACT, **contact}.items():
        setattr(model, name, value)
    return model
