"""Numbers as people read them, and round numbers for scales."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.effects import Cost

SLIGHT = 0.1
"""Percent of a step below which a clock tells little."""

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number_text(value: float, digits: int = 4) -> str:
    """So many digits, without an exponent where that is short enough: 10000, 0.0001, 1e-06."""
    return f"{value:.0f}" if min(1e3, 10.0**digits) <= abs(value) < 1e7 else f"{value:.{digits}g}"


def written(value: float, digits: int = 4) -> str:
    """The same for reading only: 10⁻⁶, 2.5·10⁻⁷."""
    factor, e, power = number_text(value, digits).partition("e")
    if not e:
        return factor
    ten = power_of_ten(int(power))
    return {"1": ten, "-1": f"-{ten}"}.get(factor, f"{factor}·{ten}")


def power_of_ten(power: int) -> str:
    """As 10⁻⁶."""
    return f"10{str(power).translate(SUPERSCRIPT)}"


def short(value: float) -> str:
    """For the end of a small scale: 10k, 0.02, 10⁻⁶."""
    if value >= 1000:
        return f"{value / 1000:.3g}k"
    power = math.log10(value)
    if power < -2.5 and abs(power - round(power)) < 1e-9:
        return power_of_ten(round(power))
    return f"{value:.2g}"


def round_below(value: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten that is not above a positive number."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (5, 2, 1) if m * power <= value * (1 + 1e-9))


def round_above(value: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten that is not below a positive number."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= value * (1 - 1e-9))


def share_text(cost: Cost, total: float) -> str:
    """A cost as part of a step of `total` milliseconds; where it has no figure, whose it is in."""
    if cost.ms is None:
        return "in contact"
    if not (cost.ms and total > 0.0):
        return "0"
    part = 100.0 * cost.ms / total
    if part < SLIGHT:
        return f"< {SLIGHT} %"
    return f"{'< ' * cost.most}{written(part, 1 if part < 1.0 else 2)} %"
