"""One spring, stretched and let go: does what is stepped follow the closed form, and is γ the γ that was set?

With μ x'' + b x' + K x = 0, ω = √(K/μ) and b = γ · 2 √(μ K), the motion from x0 at rest is a sum of the
exponentials of r± = −γ ω ± ω √(γ² − 1): it rings for γ < 1, is critical at γ = 1, and creeps for γ > 1. Here
μ is the mass of one end where the other is held, and the reduced mass 1/(1/m1 + 1/m2) where none is.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import sim
from sim.integrators import INTEGRATORS
from sim.studies import Progress, Result, Table, watched

MASS, STIFFNESS, LENGTH = 0.5, 200.0, 1.0
"""m [kg], K [N/m] and the spring's rest length [m]."""

STRETCHED, END = 0.01, 0.12
"""How far the spring is stretched [m], and when its motion is looked at [s]."""

GAMMAS = (0.2, 1.0, 2.0)
STEPS = (0.005, 0.0025, 0.00125)
"""Time steps [s], each half of the one before."""

FINE, COARSE = 1e-3, 5e-3
"""Time steps [s] for measuring γ: so short that the integrator adds nothing, and long enough that it does."""

OMEGA = math.sqrt(STIFFNESS / MASS)


def run(progress: Progress | None = None) -> Result:
    """Compare stepped motion, printed formulas and measured γ with the closed form."""
    cases = [(gamma, name) for gamma in GAMMAS for name in INTEGRATORS]
    stepped = [_stepped_row(gamma, name) for gamma, name in watched(cases, progress, lambda case: case[1])]
    wrong = [row for gamma in GAMMAS for row in _wrong_rows(gamma)]
    measured = [row for gamma in GAMMAS for row in _measured_rows(gamma)]
    errors = tuple(f"error [mm], h = {1e3 * h:g} ms" for h in STEPS)
    return Result(
        "A damped spring",
        (
            Table(
                f"Stretch after {END:g} s of a spring of {STIFFNESS:g} N/m with {MASS:g} kg on it, let go at "
                f"{1e3 * STRETCHED:g} mm",
                ("γ", "integrator", "closed form [mm]", *errors, "order"),
                tuple(stepped),
            ),
            Table(
                "The same by formulas with the mistakes of the course notes",
                ("γ", "mistake", "right [mm]", "with the mistake [mm]", "off by [% of the start]"),
                tuple(wrong),
            ),
            Table(
                "γ as set, as it should show, and as measured from a ring-down",
                ("γ set", "spring", "integrator", "h [ms]", "γ expected", "γ measured"),
                tuple(measured),
            ),
        ),
        (
            "Half the step halves the error of a first-order method, and quarters that of a second-order "
            "one.",
            "The exponents need their 1/m, and the two of an overdamped spring differ: without, the spring "
            "moves as if it had another mass, or starts with a speed that nobody gave it.",
            "The mass in b is the reduced mass. With the mass of one end, two free ends are damped √2 too "
            "much: a spring that is set to γ = 1 no longer rings but creeps.",
            "Backward Euler adds about ½ h ω (1 − γ²) of its own to γ; a critical spring stays critical.",
        ),
    )


def released(t: float, first: complex, second: complex) -> float:
    """Motion from 1 at rest, of the exponentials with the roots `first` and `second` [1/s], at `t` [s]."""
    if first == second:
        return ((1.0 - first * t) * cmath.exp(first * t)).real
    return ((first * cmath.exp(second * t) - second * cmath.exp(first * t)) / (first - second)).real


def roots(gamma: float, omega: float) -> tuple[complex, complex]:
    """The slower and the faster root [1/s] of a spring's motion; a pair for γ < 1."""
    root = omega * cmath.sqrt(gamma * gamma - 1.0)
    return -gamma * omega + root, -gamma * omega - root


def spring(masses: tuple[float, float], held: bool, stretched: float) -> dict[str, Any]:
    """A scene of one spring along x; its first end is held, or free as the other one is."""
    rest = [[0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0]]
    return {
        "cloth": {
            "vertices": [rest[0], [LENGTH + stretched, 0.0, 0.0]],
            "rest_vertices": rest,
            "edges": [[0, 1]],
            "masses": masses,
            "pins": [0] if held else [],
        },
        "settings": {"gravity": (0.0, 0.0, 0.0), "stretch": STIFFNESS * LENGTH, "solver": "direct"},
    }


def _stepped_row(gamma: float, integrator: str) -> tuple:
    right = STRETCHED * released(END, *roots(gamma, OMEGA))
    errors = [_stretch(gamma, integrator, h) - right for h in STEPS]
    order = math.log2(abs(errors[-2] / errors[-1])) if errors[-1] else None
    return gamma, integrator, 1e3 * right, *(1e3 * error for error in errors), order


def _stretch(gamma: float, integrator: str, h: float) -> float:
    """How far the spring is stretched at `END` [m]."""
    world = sim.Simulation(
        spring((MASS, MASS), True, STRETCHED), gamma=gamma, integrator=integrator, dt=h, newton=3
    )
    for _ in range(round(END / h)):
        world.step()
    return float(world.positions[1, 0]) - LENGTH


def _wrong_rows(gamma: float) -> list[tuple]:
    """The mistakes that a spring with this γ shows; the critical formula has none."""
    slow, fast = roots(gamma, OMEGA)
    without = [complex(root.real * MASS, root.imag) for root in (slow, fast)]
    wrong = {"exponents without 1/m": released(END, *without)}
    if gamma > 1.0:
        wrong["both exponentials alike"] = math.exp(slow.real * END)
    right = released(END, slow, fast)
    return [
        (gamma, mistake, 1e3 * STRETCHED * right, 1e3 * STRETCHED * value, 100.0 * (value - right))
        for mistake, value in wrong.items()
        if gamma != 1.0
    ]


def _measured_rows(gamma: float) -> list[tuple]:
    """γ measured of springs whose b has the reduced mass, and of one whose b has the mass of one end."""
    held, pair, uneven = ((MASS, MASS), True), ((MASS, MASS), False), ((MASS, 1e3 * MASS), False)
    excess = math.sqrt(2.0)  # of b with m for μ = m/2: √(m K) / √(μ K)
    cases = (
        ("one end held", held, 1.0, "midpoint", FINE),
        ("both ends free, alike", pair, 1.0, "midpoint", FINE),
        ("both ends free, masses 1 : 1000", uneven, 1.0, "midpoint", FINE),
        ("both ends free, mass of one end in b", pair, excess, "midpoint", FINE),
        ("one end held", held, 1.0, "backward_euler", COARSE),
    )
    rows = []
    for name, (masses, is_held), factor, integrator, h in cases:
        scene = spring(masses, is_held, 0.0)
        found = sim.modal_damping(scene, gamma=factor * gamma, integrator=integrator, dt=h)
        rows.append((gamma, name, integrator, 1e3 * h, found.stepped, found.measured))
    return rows
