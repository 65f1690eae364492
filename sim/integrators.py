"""The time integrators. One is a function here and one line in the registry below.

Every implicit one is one or two calls of the same kernel, backward Euler from (x̂, v̂) over a part of the step
(`sim.solve.implicit`); so they share springs, Newton iterations, linear solver and all that is reported.

A step that feels a contact is a backward Euler step, whatever the integrator: a contact force acts as an
impulse, which leaves no method more than first order, and the methods that damp nothing would bounce.

This module imports no numba: choosing, checking and documenting integrators must be quick.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

CALM = "backward_euler"
"""The one that holds at any step, as it damps whatever a step is too long for (L-stable)."""

State = tuple[Any, Any]
"""Positions (n, 3) [m] and velocities (n, 3) [m/s]."""


@dataclass(frozen=True)
class Step:
    """What an integrator has to go on.

    Attributes:
        x: (n, 3) positions at the start [m].
        v: (n, 3) velocities at the start [m/s].
        h: Length of the step [s].
        previous: State one step of h before, or None after a restart.
        solve: solve(x̂, v̂, h) gives the state that backward Euler reaches from there.
        acceleration: acceleration(x, v) gives forces over masses, (n, 3) [m/s²], zero where pinned.
    """

    x: Any
    v: Any
    h: float
    previous: State | None
    solve: Callable[[Any, Any, float], State]
    acceleration: Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Integrator:
    """What there is to know of an integrator.

    Attributes:
        summary: One line for menus, tooltips and docs.
        order: Of its global error.
        advance: Takes a step.
        growth: growth(h ω, γ) gives the two factors, complex, by which one step multiplies the motion of a
            spring with damping ratio γ, that is of x'' = −2 γ ω x' − ω² x.
        implicit: False for one that is only stable up to a step that the stiffest spring sets.
        looks_back: Whether it uses the state before the last, and must restart where that means nothing.
    """

    summary: str
    order: int
    advance: Callable[[Step], State]
    growth: Callable[[Any, Any], tuple[Any, Any]]
    implicit: bool = True
    looks_back: bool = False

    @property
    def calms(self) -> bool:
        """Whether it damps what is too fast for it, so that it has no reason to raise the energy.

        The explicit one does not, nor do midpoint and trapezoid, for which springs that change put energy in.
        """
        return self.implicit and max(abs(factor) for factor in self.growth(1e6, 0.0)) < 0.5


SIGMA = 1.0 - 0.5**0.5
"""σ of SDIRK2, for which it damps infinitely stiff springs in one step (Alexander 1977)."""

TRAPEZOID_PART = 2.0 - 2.0**0.5
"""Part of a TR-BDF2 step that the trapezoid takes (Bank et al. 1985); its two solves then share h_e = σ h."""


def backward_euler(s: Step) -> State:
    """First order; damps what the step cannot resolve, and much that it can."""
    return s.solve(s.x, s.v, s.h)


def midpoint(s: Step) -> State:
    """Backward Euler over half the step, and as far again."""
    x, v = s.solve(s.x, s.v, 0.5 * s.h)
    return 2.0 * x - s.x, 2.0 * v - s.v


def trapezoid(s: Step) -> State:
    """Forward Euler over half the step, backward Euler over the other; Newmark's with β = ¼, γ = ½ (1959)."""
    return _trapezoid(s, s.h)


def _trapezoid(s: Step, h: float) -> State:
    half = 0.5 * h
    return s.solve(s.x + half * s.v, s.v + half * s.acceleration(s.x, s.v), half)


def bdf2(s: Step) -> State:
    """Backward differences over two steps (Gear 1971), SDIRK2 where there is no step before."""
    if s.previous is None:
        return sdirk2(s)
    x, v = s.previous
    return s.solve((4.0 * s.x - x) / 3.0, (4.0 * s.v - v) / 3.0, 2.0 * s.h / 3.0)


def sdirk2(s: Step) -> State:
    """Two stages that each are backward Euler over σ h (Alexander 1977)."""
    part, rest = SIGMA * s.h, (1.0 - SIGMA) * s.h
    _, v = s.solve(s.x, s.v, part)
    return s.solve(s.x + rest * v, s.v + (rest / part) * (v - s.v), part)


def tr_bdf2(s: Step) -> State:
    """The trapezoid over a part of the step, backward differences over the rest (Bank et al. 1985)."""
    part = TRAPEZOID_PART
    x, v = _trapezoid(s, part * s.h)
    before, over = (1.0 - part) ** 2, part * (2.0 - part)
    return s.solve((x - before * s.x) / over, (v - before * s.v) / over, (1.0 - part) * s.h / (2.0 - part))


def symplectic_euler(s: Step) -> State:
    """Velocities from the forces at the start, positions from the new velocities; nothing is solved."""
    v = s.v + s.h * s.acceleration(s.x, s.v)
    return s.x + s.h * v, v


def _of_modes(factor: Callable[[Any], Any]) -> Callable[[Any, Any], tuple[Any, Any]]:
    """`growth` of a method that multiplies x' = λ x by factor(h λ)."""

    def growth(hw: Any, gamma: Any) -> tuple[Any, Any]:
        root = (gamma * gamma - 1.0 + 0j) ** 0.5
        return factor(hw * (root - gamma)), factor(-hw * (root + gamma))

    return growth


def _bdf2_growth(hw: Any, gamma: Any) -> tuple[Any, Any]:
    """Of the four roots of (3 − 2 z) ρ² − 4 ρ + 1 the two that fade last: one for each z = h λ, or a pair."""
    root = (gamma * gamma - 1.0 + 0j) ** 0.5
    first, second = hw * (root - gamma), -hw * (root + gamma)
    above, below = (1.0 + 2.0 * first) ** 0.5, (1.0 + 2.0 * second) ** 0.5
    paired = (abs(above.real) < 1e-9) & (abs(below.real) < 1e-9)
    return (2.0 + above) / (3.0 - 2.0 * first), (2.0 + (1 - 2 * paired) * below) / (3.0 - 2.0 * second)


def _explicit_growth(hw: Any, gamma: Any) -> tuple[Any, Any]:
    """The roots of ρ² − (2 − 2 γ h ω − h² ω²) ρ + 1 − 2 γ h ω."""
    half = 1.0 - gamma * hw - 0.5 * hw * hw
    root = (half * half - 1.0 + 2.0 * gamma * hw + 0j) ** 0.5
    return half + root, half - root


_trapezoid_growth = _of_modes(lambda z: (1.0 + 0.5 * z) / (1.0 - 0.5 * z))
_two_stage_growth = _of_modes(lambda z: (1.0 + (1.0 - 2.0 * SIGMA) * z) / (1.0 - SIGMA * z) ** 2)

INTEGRATORS: dict[str, Integrator] = {
    "backward_euler": Integrator(
        "first order, one solve; holds at any step, and damps more the longer it is",
        1,
        backward_euler,
        _of_modes(lambda z: 1.0 / (1.0 - z)),
    ),
    "bdf2": Integrator(
        "second order, one solve; damps far less than backward Euler",
        2,
        bdf2,
        _bdf2_growth,
        looks_back=True,
    ),
    "midpoint": Integrator(
        "second order, one solve; damps nothing by itself, so stiff springs ring",
        2,
        midpoint,
        _trapezoid_growth,
    ),
    "trapezoid": Integrator(
        "second order, one solve; damps nothing by itself, so stiff springs ring",
        2,
        trapezoid,
        _trapezoid_growth,
    ),
    "sdirk2": Integrator(
        "second order, two solves; the most accurate at a given step, damps only what is too stiff for it",
        2,
        sdirk2,
        _two_stage_growth,
    ),
    "tr_bdf2": Integrator("second order, two solves; damps as SDIRK2 does", 2, tr_bdf2, _two_stage_growth),
    "symplectic_euler": Integrator(
        "explicit, first order, no solve; blows up beyond the step that the stiffest spring allows",
        1,
        symplectic_euler,
        _explicit_growth,
        implicit=False,
    ),
}
