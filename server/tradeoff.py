"""The chart of error against cost: every variant a point with its recent trail, both axes logarithmic."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from html import escape

from server.digits import short
from server.meter import Meter
from server.palette import VARIANTS, WHITE

WIDTH, HEIGHT = 280, 168
"""Of the chart [CSS px]."""

LEFT, RIGHT, TOP, BOTTOM = 48, 10, 8, 34
"""What is about the plot [CSS px]."""

TRAIL = 12
"""Points that a trail has."""

APART = 0.02
"""How far two points of a trail are apart at least, in decades."""

LEAST = 1e-9
"""Errors below this are drawn at it: there is no zero on a logarithmic axis."""

FRAME_MS = 1e3 / 60
"""Milliseconds of a frame: who takes longer does not keep up with real time."""

Point = tuple[float, float]
"""Milliseconds per frame of 1/60 s, and local error."""


def point(meter: Meter) -> Point | None:
    """Where a variant is now; None while cost or error is not known."""
    found = meter.reading.found
    if meter.ms is None or meter.dt is None or found is None:
        return None
    return meter.ms["total"] / (60.0 * meter.dt), max(found.error, LEAST)


class Tradeoff:
    """Collects the points of all variants and draws them."""

    def __init__(self) -> None:
        self.clear(0)

    def clear(self, count: int) -> None:
        """Forget the past of all variants."""
        self.trails: list[deque[Point]] = [deque(maxlen=TRAIL) for _ in range(count)]

    def add(self, meters: Sequence[Meter]) -> None:
        """Take in where the variants are now."""
        if len(self.trails) != len(meters):
            self.clear(len(meters))
        for trail, meter in zip(self.trails, meters, strict=True):
            if meter.reading.off:
                trail.clear()
            if (now := point(meter)) is None:
                continue
            if len(trail) > 1 and _apart(trail[-2], now) < APART:
                trail[-1] = now
            elif not trail or trail[-1] != now:
                trail.append(now)

    def svg(self, names: Sequence[str], meters: Sequence[Meter]) -> str:
        """The chart: filled points are up to date; what is being measured is hollow."""
        known = [p for trail in self.trails for p in trail]
        costs = _decades([p[0] for p in known] or [1.0, 10.0])
        errors = _decades([p[1] for p in known] or [1e-4, 1e-2])
        parts = [_axes(costs, errors)]
        for i, (trail, name) in enumerate(zip(self.trails, names, strict=False)):
            if trail:
                fresh = point(meters[i]) is not None
                parts.append(_trail([_place(p, costs, errors) for p in trail], i, name, fresh))
        readings = [meter.reading for meter in meters]
        measuring, off = (any(getattr(r, state) for r in readings) for state in ("measuring", "off"))
        if not known and (measuring or off):
            middle = f'x="{LEFT + _wide() / 2:g}" y="{TOP + _high() / 2:g}" text-anchor="middle"'
            parts.append(f"<text {middle}>{'measuring …' if measuring else 'local error: off'}</text>")
        return (
            f'<svg class="tradeoff" viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" font-size="10" '
            f'fill="#6f675f"><title>local error against cost</title>{"".join(parts)}</svg>'
        )


def _apart(a: Point, b: Point) -> float:
    return math.dist([math.log10(max(v, LEAST)) for v in a], [math.log10(max(v, LEAST)) for v in b])


def _wide() -> int:
    return WIDTH - LEFT - RIGHT


def _high() -> int:
    return HEIGHT - TOP - BOTTOM


def _decades(values: Sequence[float]) -> tuple[int, int]:
    """The powers of ten that an axis begins and ends with: whole ones, so that it seldom changes."""
    low, high = (math.log10(max(v, LEAST)) for v in (min(values), max(values)))
    return math.floor(low - 0.1), max(math.ceil(high + 0.1), math.floor(low - 0.1) + 1)


def _place(p: Point, costs: tuple[int, int], errors: tuple[int, int]) -> Point:
    """Where a point is on the page [CSS px]."""
    along, up = (
        (math.log10(max(value, LEAST)) - low) / (high - low)
        for value, (low, high) in zip(p, (costs, errors), strict=True)
    )
    return round(LEFT + along * _wide(), 1), round(TOP + (1.0 - up) * _high(), 1)


def _axes(costs: tuple[int, int], errors: tuple[int, int]) -> str:
    """Lines at the powers of ten, faint ones at their multiples, and the line of real time."""
    bottom, right, parts = TOP + _high(), LEFT + _wide(), []
    for power in range(costs[0], costs[1] + 1):
        for times in range(1, 10 if power < costs[1] else 2):
            x, _ = _place((times * 10.0**power, 1.0), costs, errors)
            parts.append(_line(x, TOP, x, bottom, times == 1))
        x, _ = _place((10.0**power, 1.0), costs, errors)
        parts.append(f'<text x="{x:g}" y="{bottom + 14}" text-anchor="middle">{_tick(power)}</text>')
    stride = max(1, math.ceil((errors[1] - errors[0]) / 6))
    for power in range(errors[0], errors[1] + 1):
        _, y = _place((1.0, 10.0**power), costs, errors)
        parts.append(_line(LEFT, y, right, y, True))
        if (power - errors[0]) % stride == 0:
            words = f"{_tick(power + 2)} %"
            parts.append(f'<text x="{LEFT - 4}" y="{y + 3.5:g}" text-anchor="end">{words}</text>')
    middle = f'x="{LEFT + _wide() / 2:g}" y="{HEIGHT - 4}" text-anchor="middle"'
    parts.append(f"<text {middle}>ms per frame of 1/60 s</text>")
    if costs[0] < math.log10(FRAME_MS) < costs[1]:
        x, _ = _place((FRAME_MS, 1.0), costs, errors)
        parts.append(f'<path d="M{x:g} {TOP}V{bottom}" stroke="#6f675f" stroke-dasharray="2 3" fill="none"/>')
        side = ("end", -3) if x > LEFT + _wide() / 2 else ("start", 3)
        parts.append(f'<text x="{x + side[1]:g}" y="{TOP + 9}" text-anchor="{side[0]}">real time</text>')
    return "".join(parts)


def _tick(power: int) -> str:
    """A power of ten beside an axis: 0.001, 10, 100, 1k."""
    return f"{10.0**power:g}" if -3 <= power < 3 else short(10.0**power)


def _line(x: float, y: float, u: float, v: float, strong: bool) -> str:
    shade = "#d8d2c9" if strong else "#eeeae4"
    return f'<path d="M{x:g} {y:g}L{u:g} {v:g}" stroke="{shade}" stroke-width=".7"/>'


def _trail(places: Sequence[Point], index: int, name: str, fresh: bool) -> str:
    """A fading line to the present point, which says its name when it is pointed at."""
    color, parts = VARIANTS[index], []
    for k, ((x, y), (u, v)) in enumerate(itertools.pairwise(places)):
        tone = color.toward(WHITE, 0.75 * (1.0 - (k + 1) / len(places))).css
        parts.append(f'<path d="M{x:g} {y:g}L{u:g} {v:g}" stroke="{tone}" stroke-width="2"/>')
    x, y = places[-1]
    inside = color.css if fresh else WHITE.css
    parts.append(
        f'<circle class="variant{index}" cx="{x:g}" cy="{y:g}" r="5" fill="{inside}" stroke="{color.css}" '
        f'stroke-width="2"><title>{escape(name)}</title></circle>'
    )
    return "".join(parts)
