"""A strip clamped at one end under its own weight: how stiff is a bending spring, really?

Two measurements. Bent by force onto a cylinder of curvature κ, the strip's bending springs hold the
energy ½ D κ² per area, which gives the bending stiffness D; on equilateral triangles D = c/2 (Seung and
Nelson 1988). Let go under gravity, it must hang as the heavy elastica, θ'' = −Γ (1 − s) cos θ with
Γ = ρ g L³/D; the ratio of its drop to its reach depends on Γ alone (Romero et al. 2021).

The strip's rows of vertices lie across it, and two of them are held. The fold at the second one stands for
the bending of half a row to either side of it, so the free length begins half a row inside the clamp.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import sim
from sim.mesh import build_mesh
from sim.scene import load_scene
from sim.springs import BENDING
from sim.studies import Cell, Progress, Result, Table, watched

GAMMAS = (1.0, 5.0, 10.0, 50.0)
"""Γ, weight over bending stiffness."""

CURVATURES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""κ of the cylinders [1/m]; the strip is 1 m long."""

TREND = (4, 8, 16)
"""Rows of free vertices for the trend, and Γ and kind of spring that it is taken with."""
TREND_GAMMA, TREND_KIND = 10.0, "angle"

ROWS, WIDTH = 12, 0.46
"""Rows of free vertices, and the width of the strip [m]: wide, so that it does not curl across as well."""

DENSITY, GRAVITY, STRETCH = 0.1, 9.81, 3e4
"""[kg/m²], [m/s²], and k [N] so large that the weight does not stretch the strip visibly."""

FAR_FLOOR = {"kind": "plane", "point": (0.0, 0.0, -10.0)}
"""An obstacle that the strip never reaches."""

LARGEST_FOLD = math.pi / 2.0
"""Of θ at the elastica's free end [rad]: straight down."""


def run(progress: Progress | None = None, rows: int = ROWS, trend: tuple[int, ...] = TREND) -> Result:
    """Measure every right bending kind on a strip with `rows` rows, and one on the rows of `trend`."""
    kinds = [name for name, kind in BENDING.items() if not kind.wrong]
    strip = Strip(rows)
    cases = [(kind, gamma) for kind in kinds for gamma in GAMMAS]
    hung, start = [], None
    for kind, gamma in watched(cases, progress, lambda case: f"{case[0]}, Γ = {case[1]:g}"):
        start = start if gamma != GAMMAS[0] else None
        row, start = _hung_row(strip, kind, gamma, start)
        hung.append(row)
    return Result(
        "A cantilever strip",
        (
            Table(
                "Bending stiffness D on a cylinder, as part of c/2",
                ("κ [1/m]", *kinds),
                tuple((kappa, *(strip.stiffness(kind, kappa) for kind in kinds)) for kappa in CURVATURES),
            ),
            Table(
                "The strip under its weight; H is the drop of its end, W its reach, L its length",
                (
                    "kind",
                    "Γ",
                    "H/L",
                    "elastica H/L",
                    "W/L",
                    "elastica W/L",
                    "H/W",
                    "elastica H/W",
                    "error of H/W [%]",
                ),
                tuple(hung),
            ),
            Table(
                f"Error of H/W on finer strips, {TREND_KIND} springs, Γ = {TREND_GAMMA:g}",
                ("rows", "length from half a row inside the clamp [%]", "length from the clamped row [%]"),
                tuple(_trend_row(n) for n in trend),
            ),
        ),
        (
            "Angle and modified springs have the stiffness D = c/2 of the theory, and hang as the elastica "
            "does.",
            "Cross springs have no linear stiffness when flat: they are matched to the others at a fold of "
            "60°, and at the small folds of a bent strip resist almost nothing, the less the finer the mesh. "
            "Their strip falls until something else holds it, its weight in a trough or a few sharp folds, "
            "and where it ends depends on how it came there.",
            "Read from the clamped row itself, the length is half a row too short, and the error only of "
            "first order in the row's height.",
        ),
    )


def elastica(gamma: float) -> tuple[float, float]:
    """Drop and reach of the end of a heavy elastica of length 1, to 1e-10, for Γ up to 100.

    Found by shooting from the free end; beyond, a rod may hang in several ways, and this in the wrong one.
    """

    def from_end(angle: float) -> np.ndarray:
        """θ, θ', drop and reach at the clamp, of the rod whose free end has the angle θ."""

        def slope(s: float, y: np.ndarray) -> tuple[float, ...]:
            return y[1], -gamma * (1.0 - s) * math.cos(y[0]), -math.sin(y[0]), -math.cos(y[0])

        start = (angle, 0.0, 0.0, 0.0)
        return solve_ivp(slope, (1.0, 0.0), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]

    end = brentq(lambda angle: from_end(angle)[0], 0.0, LARGEST_FOLD, xtol=1e-13)
    _, _, drop, reach = from_end(float(end))  # pyright: ignore[reportArgumentType]
    return float(drop), float(reach)


class Strip:
    """A strip along y, clamped at its lower end, whose free length is 1 m.

    Args:
        rows: Of free vertices.
        width: About how wide it is [m]; triangles stay equilateral.
    """

    def __init__(self, rows: int, width: float = WIDTH) -> None:
        self.height = 1.0 / (rows + 0.5)
        side = self.height * 2.0 / math.sqrt(3.0)
        columns = 1 + max(2, round(width / side))
        size = [side * (columns - 1), self.height * (rows + 1)]
        cloth = {"kind": "equilateral", "size": size, "resolution": [columns, rows + 2]}
        self.mesh = build_mesh(load_scene({"cloth": cloth}))
        self.clamped = list(range(2 * columns + 1))

    def scene(self, start: np.ndarray | None = None, **settings: Any) -> dict[str, Any]:
        """The strip as a scene; it starts flat, or at `start` (n, 3) [m]."""
        rest = self.mesh.vertices
        return {
            "cloth": {
                "vertices": rest if start is None else start,
                "rest_vertices": rest,
                "triangles": self.mesh.triangles,
                "pins": self.clamped,
            },
            "settings": {
                "density": DENSITY,
                "stretch": STRETCH,
                "gravity": (0.0, 0.0, -GRAVITY),
                **settings,
            },
        }

    def stiffness(self, kind: str, kappa: float) -> float:
        """D over c/2 on a cylinder of curvature `kappa` [1/m], across which the rows lie."""
        world = sim.Simulation(self.scene(bend=kind, bending=1.0))
        x, y, _ = self.mesh.vertices.T
        world.place(np.column_stack([x, np.sin(kappa * y) / kappa, (1.0 - np.cos(kappa * y)) / kappa]))
        area = np.ptp(x) * (np.ptp(y) - self.height)  # half a row at either end has no hinge
        return 2.0 * world.energy()[kind] / (float(area) * kappa**2) / 0.5

    def hang(self, kind: str, gamma: float, start: np.ndarray | None = None) -> np.ndarray:
        """(n, 3) positions [m] at rest under the weight that Γ says; EquilibriumError where there is none."""
        scene = self.scene(start, bend=kind, bending=2.0 * DENSITY * GRAVITY / gamma)
        if BENDING[kind].match_fold:  # limp: with an obstacle about, rest is sought by falling, not by Newton
            scene = {**scene, "obstacle": [FAR_FLOOR]}
            scene["settings"] = {**scene["settings"], "gamma": 1.0, "newton": 4}
        return sim.equilibrium(scene).positions.copy()

    def drop_and_reach(self, positions: np.ndarray) -> tuple[float, float]:
        """Of the strip's end from where its free length begins [m]."""
        y = self.mesh.vertices[:, 1]
        end = positions[y > y.max() - 0.5 * self.height].mean(axis=0)
        return -float(end[2]), float(end[1] - (y.max() - 1.0))


def _hung_row(
    strip: Strip, kind: str, gamma: float, start: np.ndarray | None
) -> tuple[tuple[Cell, ...], np.ndarray | None]:
    """A row of the table, and where the strip hangs, to start the next one from."""
    drop, reach = elastica(gamma)
    try:
        positions = strip.hang(kind, gamma, start)
    except sim.EquilibriumError:
        return (kind, gamma, None, drop, None, reach, None, drop / reach, None), start
    h, w = strip.drop_and_reach(positions)
    error = 100.0 * (h / w / (drop / reach) - 1.0)
    return (kind, gamma, h, drop, w, reach, h / w, drop / reach, error), positions


def _trend_row(rows: int) -> tuple[Cell, ...]:
    """Errors of H/W [%] with the free length read in two ways; Γ goes with its third power."""
    strip = Strip(rows)
    h, w = strip.drop_and_reach(strip.hang(TREND_KIND, TREND_GAMMA))
    inside = 0.5 * strip.height
    drop, reach = elastica(TREND_GAMMA)
    short_drop, short_reach = elastica(TREND_GAMMA * (1.0 - inside) ** 3)
    short = h / (w - inside) / (short_drop / short_reach)
    return rows, 100.0 * (h / w / (drop / reach) - 1.0), 100.0 * (short - 1.0)
