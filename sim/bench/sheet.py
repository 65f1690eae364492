"""The two sheets that are measured, alike for every solver: one hangs, one falls on a sphere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from sim.mesh import Mesh

WIDTH = 1.0
"""Of the square sheet [m]."""

DENSITY = 0.2
"""[kg/m²]."""

SPRING = 1000.0
"""Constant of an edge spring along the grid [N/m], which is the sheet's stiffness per width at any size."""

BENDING = 1e-4
"""[N m]."""

GRAVITY = 9.81
"""[m/s²], downwards along z."""

FRAME = 1.0 / 60.0
"""[s]."""

RADIUS = 0.3
"""Of the sphere [m]; its top is at the origin."""

THICKNESS = 5e-3
"""Distance that cloth keeps from the sphere, and from itself up to 0.4 of an edge [m]."""

DROP = 0.01
"""Height of the falling sheet above the top of the sphere [m]."""

KINDS = {"hang": "pinned at two corners, swings down from flat", "drape": "falls on a sphere"}
"""What sheets do, in words."""


@dataclass(frozen=True)
class Sheet:
    """A square grid.

    Attributes:
        kind: One of `KINDS`.
        side: Vertices along either side.
    """

    kind: str
    side: int

    @property
    def count(self) -> int:
        """Vertices."""
        return self.side**2

    @property
    def spacing(self) -> float:
        """Between neighbours along the grid [m]."""
        return WIDTH / (self.side - 1)

    @property
    def hangs(self) -> bool:
        """Pinned rather than dropped."""
        return self.kind == "hang"

    @property
    def center(self) -> tuple[float, float, float]:
        """Of the sphere [m]."""
        return (0.0, 0.0, -RADIUS)

    def scene(self) -> dict[str, Any]:
        """The sheet as a scene of Muslin."""
        cloth = {
            "kind": "grid",
            "size": [WIDTH, WIDTH],
            "resolution": [self.side, self.side],
            "position": [0.0, 0.0, 0.0 if self.hangs else DROP],
            "pins": ["corner01", "corner11"] if self.hangs else [],
        }
        stiffness = SPRING * self.spacing
        settings = {
            "density": DENSITY,
            "gravity": [0.0, 0.0, -GRAVITY],
            "stretch": stiffness,
            "altitudes": "all",
            "altitude": stiffness,
            "bend": "cross",
            "bending": BENDING,
            "contact": "impulse",
            "self_collision": "off" if self.hangs else "auto",
            "thickness": THICKNESS,
            "dt": FRAME,
            "newton": 1,
            "tolerance": 1e-4,
        }
        ball = {"kind": "sphere", "center": list(self.center), "radius": RADIUS}
        return {"cloth": cloth, "obstacle": [] if self.hangs else [ball], "settings": settings}

    @cached_property
    def mesh(self) -> Mesh:
        """Vertices [m], triangles, edges and pinned vertices, as Muslin numbers them: x varies fastest."""
        from sim.mesh import build_mesh
        from sim.scene import load_scene

        return build_mesh(load_scene(self.scene()))

    def strain(self, positions: np.ndarray) -> float:
        """The largest strain of an edge, of a sheet at `positions` (n, 3) [m]."""
        return float((self._lengths(positions) / self._lengths(self.mesh.vertices)).max() - 1.0)

    def _lengths(self, positions: np.ndarray) -> np.ndarray:
        import numpy as np

        a, b = self.mesh.edges.T
        return np.linalg.norm(positions[a] - positions[b], axis=1)
