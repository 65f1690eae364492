"""What damping a time integrator adds of its own, and how to take it off again.

A spring with damping ratio γ and frequency ω, stepped by h, moves as one with other ratio and frequency: for
backward Euler the ratio is γ + ½ h ω (1 − γ²) + O(h²). Both follow from the factor by which one step
multiplies its motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.integrators import INTEGRATORS
from sim.settings import Settings

FREQUENCIES = np.logspace(-3.0, 3.0, 400)
"""h ω at which compensation is worked out; linear between them is good to 1e-4 in γ."""

HALVINGS = 40
"""Of the interval in which the ratio that compensates is sought: to 1e-12."""


def apparent(integrator: str, hw: Any, gamma: Any) -> tuple[Any, Any]:
    """Damping ratio, and frequency relative to the true one, that a spring shows when stepped.

    Args:
        integrator: Its name.
        hw: h ω > 0, number or array.
        gamma: The spring's damping ratio, number or array.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = INTEGRATORS[integrator].growth(np.asarray(hw, dtype=float), np.asarray(gamma, dtype=float))
        first, second = (np.log(factor) for factor in factors)
        frequency = np.sqrt(first * second)
        ratio = -(first + second) / (2.0 * frequency)
    return ratio.real, frequency.real / hw


def damping_ratios(settings: Settings) -> np.ndarray:
    """The γ to give springs, over their frequency [rad/s], (k, 2), as `sim.elements.set_damping` reads it.

    It is settings.gamma; less, where the integrator's own share is to be compensated for. Compensation never
    goes below zero, so that it never drives a spring, and leaves springs alone that do not ring.
    """
    gamma = settings.gamma
    if settings.compensate == "off" or not 0.0 < gamma < 1.0:
        return np.array([[1.0, gamma]])
    low, high = np.zeros_like(FREQUENCIES), np.full_like(FREQUENCIES, gamma)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        above = apparent(settings.integrator, FREQUENCIES, middle)[0] > gamma
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.stack([FREQUENCIES / settings.dt, high], axis=1)
