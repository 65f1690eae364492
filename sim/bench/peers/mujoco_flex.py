"""MuJoCo's flex: finite elements of a shell on a grid, with the options of its shipped drape example."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from sim.bench.peers import Knobs
from sim.bench.sheet import DENSITY, DROP, FRAME, GRAVITY, RADIUS, SPRING, THICKNESS, WIDTH, Sheet

mujoco: Any = import_module("mujoco")

OWN: Knobs = {"substeps": 8, "iterations": 400, "solver": "CG"}
FRAMES: tuple[Knobs, ...] = (OWN, {**OWN, "substeps": 1})
LADDER: tuple[Knobs, ...] = tuple({**OWN, "substeps": 2**k} for k in range(1, 9))
OTHERS: tuple[Knobs, ...] = (
    *({"substeps": n, "iterations": 400, "solver": "CG"} for n in (1,)),
    *({"substeps": n, "iterations": 100, "solver": "CG"} for n in (2, 4, 8)),
    *({"substeps": n, "iterations": 100, "solver": "Newton"} for n in (2, 4)),
)

SHELL = 1e-3
"""Thickness that scales the elasticity [m]; with 1000 N/m along the threads, it bends like the sheet."""

POISSON, DAMPING, TOLERANCE = 0.2, 1e-4, 1e-6
"""Poisson's ratio, damping [s] and the solver's tolerance of MuJoCo's example."""


class FlexRun:
    """A sheet in MuJoCo."""

    def __init__(self, sheet: Sheet, knobs: Knobs, threads: int) -> None:
        self.substeps = int(knobs["substeps"])
        self.model = mujoco.MjModel.from_xml_string(_xml(sheet, knobs))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.order = _order(self._all(), sheet.mesh.vertices)

    def frame(self) -> None:
        """Go on by one frame."""
        mujoco.mj_step(self.model, self.data, self.substeps)

    def positions(self) -> np.ndarray:
        """(n, 3) [m]."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)
        return self._all()[self.order]

    def _all(self) -> np.ndarray:
        return np.array(self.data.flexvert_xpos).reshape(-1, 3)


start = FlexRun


def _order(theirs: np.ndarray, ours: np.ndarray) -> np.ndarray:
    """For each of our vertices (n, 3), the index of the vertex of theirs (n, 3) at the same place."""
    mine, other = (np.lexsort(np.round(p, 6).T) for p in (ours, theirs))
    order = np.empty(len(ours), dtype=int)
    order[mine] = other
    return order


def _xml(sheet: Sheet, knobs: Knobs) -> str:
    grid = f"{sheet.side} {sheet.side} 1"
    corners = sheet.mesh.vertices[sheet.mesh.pinned]
    last = sheet.side - 1
    pinned = " ".join(
        f"{round((x / WIDTH + 0.5) * last)} {round((y / WIDTH + 0.5) * last)}" for x, y, _ in corners
    )
    pins = f'<pin grid="{pinned}"/>' if sheet.hangs else ""
    center = " ".join(map(str, sheet.center))
    ball = "" if sheet.hangs else f'<geom type="sphere" size="{RADIUS}" pos="{center}"/>'
    options = f'solver="{knobs["solver"]}" tolerance="{TOLERANCE}" iterations="{knobs["iterations"]}"'
    return f"""
<mujoco>
  <option timestep="{FRAME / int(knobs["substeps"])}" integrator="discrete" gravity="0 0 {-GRAVITY}"
          {options}/>
  <size memory="2G"/>
  <worldbody>
    {ball}
    <flexcomp name="sheet" type="grid" dim="2" count="{grid}" spacing="{sheet.spacing} {sheet.spacing} 1"
              pos="0 0 {0.0 if sheet.hangs else DROP}" radius="{THICKNESS}" mass="{DENSITY * WIDTH**2}">
      {pins}
      <contact selfcollide="none" passive="true" solref="0.01 1" solimp=".95 .99 .0001"/>
      <elasticity young="{SPRING / SHELL}" poisson="{POISSON}" thickness="{SHELL}" elastic2d="both"
                  damping="{DAMPING}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
