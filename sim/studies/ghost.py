"""A folded hinge that floats free: does its bending rule push it or turn it out of nothing?

Forces that are the gradient of an energy, which knows only where vertices are relative to each other, sum to
no force and no torque. Rules of thumb that turn the hinge's moment into forces do not, and the hinge flies
off, or spins, by itself: ghost forces (Bridson, Marino and Fedkiw 2003).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import sim
from sim.springs import BENDING
from sim.studies import Progress, Result, Table, watched

FLAT = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.3, 0.9, 0.0), (0.6, -0.4, 0.0)])
"""x1, x2 of the shared edge and the tips x3, x4 [m], at rest; the two triangles differ on purpose."""

FOLD, MASS = math.pi / 3.0, 0.1
"""How far x3 is folded up [rad], and the mass of each vertex [kg]."""

STRETCH, MOMENT = 500.0, 0.05
"""Stretch stiffness k [N], and c w [N·m], the moment of the hinge per radian."""

STEP, SECONDS = 1e-4, 1.0
"""Of symplectic Euler, and how long it runs [s]."""

REFERENCE = {"tips": (0.0683, 0.0121), "half": (0.0, 0.0152), "lever": (0.0, 0.0053)}
"""|P| [kg m/s] and |L| [kg m²/s] after 1 s that another program found, by ad-hoc rule."""


def run(progress: Progress | None = None, seconds: float = SECONDS) -> Result:
    """Let the hinge go with every bending rule there is, for `seconds` [s]."""
    rules: list[dict[str, str]] = [{"bend": name} for name, kind in BENDING.items() if not kind.wrong]
    rules += [{"bend": "adhoc", "adhoc_rule": rule} for rule in REFERENCE]
    rows = [_row(rule, seconds) for rule in watched(rules, progress, lambda rule: " ".join(rule.values()))]
    after = f"after {seconds:g} s"
    return Result(
        "Ghost forces",
        (
            Table(
                f"A hinge folded by {math.degrees(FOLD):.0f}°, let go at rest, without gravity or damping; "
                "L is about the centre of mass",
                (
                    "rule",
                    "net force [N]",
                    "net torque [N·m]",
                    "|P| at the start [kg m/s]",
                    "|L| at the start [kg m²/s]",
                    f"|P| {after} [kg m/s]",
                    f"|L| {after} [kg m²/s]",
                    "|P| elsewhere",
                    "|L| elsewhere",
                ),
                tuple(rows),
            ),
        ),
        (
            "Nothing touches the hinge, so momentum P and angular momentum L must stay zero: with true "
            "gradients they do, to rounding.",
            "Forces on the tips alone push the hinge away and turn it. With half of them given back on each "
            "end of the shared edge nothing pushes it any more, but it still turns; and so it does with the "
            "right force on each tip and these shares on the edge.",
            "The last two columns are those of another program, after 1 s.",
        ),
    )


def hinge() -> dict[str, Any]:
    """A scene of the folded hinge."""
    folded = FLAT.copy()
    folded[2] = FLAT[2, 0], FLAT[2, 1] * math.cos(FOLD), FLAT[2, 1] * math.sin(FOLD)
    length, heights = FLAT[1, 0], FLAT[2, 1] - FLAT[3, 1]
    return {
        "cloth": {
            "vertices": folded,
            "rest_vertices": FLAT,
            "triangles": [[0, 1, 2], [1, 0, 3]],
            "masses": [MASS] * 4,
        },
        "settings": {
            "gravity": (0.0, 0.0, 0.0),
            "gamma": 0.0,
            "stretch": STRETCH,
            "bending": MOMENT * heights / length,
            "integrator": "symplectic_euler",
            "dt": STEP,
        },
    }


def _row(rule: dict[str, Any], seconds: float) -> tuple:
    world = sim.Simulation(hinge(), **rule)
    forces = world.forces()
    arms = world.positions - world.positions.mean(axis=0)
    net = [_size(forces.sum(axis=0)), _size(np.cross(arms, forces).sum(axis=0))]
    before = _momenta(world)
    for _ in range(round(seconds / STEP)):
        world.step()
    name = rule.get("adhoc_rule", "")
    words = f"ad hoc: {name}" if name else rule["bend"]
    known = REFERENCE.get(name, (None, None)) if name else (0.0, 0.0)
    return words, *net, *before, *_momenta(world), *known


def _momenta(world: sim.Simulation) -> tuple[float, float]:
    """|P|, and |L| about the centre of mass."""
    linear, angular = world.momentum()
    centre = world.masses @ world.positions / world.masses.sum()
    return _size(linear), _size(angular - np.cross(centre, linear))


def _size(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))
