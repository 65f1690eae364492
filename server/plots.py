"""Plots of what was measured over simulated time, made once and then kept to the last minute."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import viser

from server import style
from server.digits import power_of_ten
from server.meter import Meter
from server.palette import VARIANTS, Rgb, shades
from server.tables import caption, update

HISTORY = 300
"""Points kept of each line: a minute at five a second."""

COST_HEIGHT, PAIR_HEIGHT = 92, 125
"""Of the plots [CSS px]."""

FINEST = 0.01
"""Below this, a scale counts in a smaller unit: the numbers beside it have three decimals."""

AXIS: Any = {"size": 40, "font": "10px sans-serif", "labelGap": 0, "gap": 2}
X_AXIS: Any = {**AXIS, "size": 20}

SCALES: Any = {"x": {"time": False}}
"""Simulated seconds, not the time of day."""

UNSEEN: Any = {"label": "", "stroke": "transparent", "width": 0, "points": {"show": False}}


class Plot:
    """A plot over simulated time, hidden until there is a line to draw."""

    def __init__(self, server: viser.ViserServer, height: int):
        self._server = server
        self._lines: list[Any] = [{"label": ""}]
        self._handle = server.gui.add_uplot(
            (np.zeros(1), np.zeros(1)),
            ({"label": "time"}, *self._lines),
            scales=SCALES,
            axes=(X_AXIS, AXIS),
            legend={"show": False},
            height=height,
            padding=(6, 8, 0, 0),
            visible=False,
        )

    def hide(self) -> None:
        """Until there is something to be seen again."""
        self._handle.visible = False

    def draw(self, columns: Any, lines: list[Any]) -> None:
        """Draw times and one column per line; lines that have not changed are not sent again."""
        if len(columns[0]) < 2:
            return
        with self._server.atomic():
            if lines != self._lines:
                self._handle.series = ({"label": "time"}, *lines)
                self._lines = lines
            self._handle.data = tuple(np.ascontiguousarray(column, dtype=float) for column in columns)
            if not self._handle.visible:
                self._handle.visible = True


class CostPlot:
    """One variant's milliseconds per step over time, phases stacked, as dark to light tones of its colour."""

    def __init__(self, server: viser.ViserServer, color: Rgb):
        self._color = color
        self._plot = Plot(server, COST_HEIGHT)
        self._key = server.gui.add_html("")
        self.clear()

    def clear(self) -> None:
        """Forget the past."""
        self._times: deque[float] = deque(maxlen=HISTORY)
        self._values: deque[dict[str, float]] = deque(maxlen=HISTORY)
        self._plot.hide()
        update(self._key, "")

    def add(self, time: float, meter: Meter) -> float:
        """Take in a point; gives the total [ms] that a good scale reaches.

        A rare peak may stick out of it: one hiccup of the machine would flatten a minute of steps.
        """
        self._times.append(time)
        self._values.append(dict(meter.ms or {}))
        totals = [values["total"] for values in self._values if values]
        return 1.3 * float(np.quantile(totals, 0.95)) if totals else 0.0

    def draw(self, ceiling: float) -> None:
        """Draw the points, cut off at `ceiling` [ms], on the same scale as the other variants'.

        Lines that are not seen, at zero and at the ceiling, hold the scale: a scale that is set anew makes
        the client build the whole plot again, and lose its place in time.
        """
        phases = list(dict.fromkeys(p for values in self._values for p in values if p != "total"))
        gap = dict.fromkeys(phases, np.nan)  # where the variant stood still
        table = np.array([[(values or gap).get(p, 0.0) for p in phases] for values in self._values])
        sums = np.cumsum(table, axis=1).T[::-1]  # the largest first, so that each is painted over the last
        tones = shades(self._color, len(phases))
        painted = reversed(list(zip(phases, tones, strict=True)))
        lines = [{"label": p, "stroke": t.css, "fill": t.css, "width": 1} for p, t in painted]
        times = np.array(self._times)
        ends = [np.full(len(times), level) for level in (0.0, ceiling)]
        self._plot.draw((times, *np.minimum(sums, ceiling), *ends), [*lines, UNSEEN, UNSEEN])
        last = self._values[-1]
        parts = (
            f"{style.chip(t)}{escape(p)} {last.get(p, 0.0):.1f}" for p, t in zip(phases, tones, strict=True)
        )
        update(
            self._key, f'<div class="muslin key">{" ".join(f"<span>{part}</span>" for part in parts)}</div>'
        )


class PairPlot:
    """Two numbers of every variant over time, in its colour: the first solid, the second dashed.

    Args:
        server: Where the page is.
        title: What is plotted.
        unit: Its unit; the caption says which power of ten of it the scale counts in.
        labels: Of the two numbers.
        least: What is smaller than this is drawn as nothing: rounding would fill the plot.
        visible: Whether to show it before `show` says so.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        title: str,
        unit: str,
        labels: tuple[str, str],
        least: float,
        visible: bool = True,
    ):
        self._title, self._unit, self._labels, self._least = title, unit, labels, least
        self._caption = server.gui.add_html("", visible=visible)
        self._plot = Plot(server, PAIR_HEIGHT)
        self._rows: deque[list[float]] = deque(maxlen=HISTORY)
        self.clear()

    @property
    def visible(self) -> bool:
        """Whether points are taken in and seen."""
        return self._caption.visible

    def show(self, visible: bool) -> None:
        """Show it, beginning with what comes from now on, or hide it."""
        if visible != self.visible:
            self._caption.visible = visible
            self.clear()

    def clear(self) -> None:
        """Forget the past."""
        self._rows.clear()
        self._plot.hide()
        self._say(0)

    def add(self, time: float, pairs: Sequence[tuple[float, float]]) -> None:
        """Take in both numbers of every variant, nan for none, and draw."""
        solid, dashed = zip(*pairs, strict=True)
        self._rows.append([time, *solid, *dashed])
        times, *values = np.array(self._rows).T
        largest = max(self._least, np.nanmax(np.abs(values), initial=0.0))
        power = 0 if largest >= FINEST else 3 * math.floor(math.log10(largest) / 3)
        ends = [np.full(len(times), level) for level in (0.0, self._least)]
        styles = {"width": 2}, {"width": 1.3, "dash": [5, 4]}
        lines = [
            {"label": label, "stroke": color.css, **look}
            for label, look in zip(self._labels, styles, strict=True)
            for color in VARIANTS[: len(pairs)]
        ]
        self._plot.draw((times, *(np.array([*values, *ends]) / 10.0**power)), [*lines, UNSEEN, UNSEEN])
        self._say(power)

    def _say(self, power: int) -> None:
        unit = f"{power_of_ten(power)} {self._unit}" if power else self._unit
        update(
            self._caption,
            caption(f"{self._title}, {unit} · {self._labels[0]} and (dashed) {self._labels[1]}"),
        )
