"""The right dock: the variants' numbers, milliseconds per step by phase, energies, effects."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import viser

from server import style
from server.digits import round_above
from server.meter import Meter
from server.palette import VARIANTS, Rgb, shades
from server.tables import caption, effects_table, energy_table, update, variant_table

HISTORY = 300
"""Points kept of each line: a minute at five a second."""

COST_HEIGHT, ENERGY_HEIGHT = 92, 125
"""Of the plots [CSS px]."""

AXIS: Any = {"size": 40, "font": "10px sans-serif", "labelGap": 0, "gap": 2}
X_AXIS: Any = {**AXIS, "size": 20}


SCALES: Any = {"x": {"time": False}}
"""Simulated seconds, not the time of day."""

UNSEEN: Any = {"label": "", "stroke": "transparent", "width": 0}


class Charts:
    """Plots of the last minute, made once for as many variants as there can be; the rest are hidden.

    Nothing here is ever removed: a slow browser that meets an update and a removal of one element in the
    same batch reports an error.
    """

    def __init__(self, server: viser.ViserServer):
        gui = server.gui
        panel = gui.add_panel()
        with panel.add_tab("Measured"):
            self._table = gui.add_html("")
            gui.add_html(caption("milliseconds per step, by phase"))
            self._costs = [CostPlot(server, color) for color in VARIANTS]
            gui.add_html(caption("energy, J · total and (dashed) kinetic"))
            self._energies = EnergyPlot(server)
            self._energy_table = gui.add_html("")
        with panel.add_tab("Effects"):
            self._effects = gui.add_html("")
        panel.dock_right()
        panel.set_width(style.RIGHT_WIDTH)
        self._setting, self._names = "", [""]

    def name(self, setting: str, names: Sequence[str]) -> None:
        """Call the variants so, by their values of the setting that differs."""
        self._setting, self._names = setting, list(names)

    def clear(self) -> None:
        """Forget the past."""
        for plot in (*self._costs, self._energies):
            plot.clear()

    def add(self, time: float, meters: Sequence[Meter], moved: bool) -> None:
        """Write the present numbers; and where time has moved on, a point of every line."""
        update(self._table, variant_table(self._setting, self._names, meters))
        update(self._energy_table, energy_table(self._names, meters))
        update(self._effects, effects_table(self._names, meters))
        if moved and any(meter.ms for meter in meters):
            plots = self._costs[: len(meters)]
            highest = max(plot.add(time, meter) for plot, meter in zip(plots, meters, strict=True))
            for plot in plots:
                plot.draw(round_above(max(highest, 0.1)))
            self._energies.add(time, meters)


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


class EnergyPlot:
    """All variants' total and kinetic energy over time."""

    def __init__(self, server: viser.ViserServer):
        self._plot = Plot(server, ENERGY_HEIGHT)
        self._rows: deque[list[float]] = deque(maxlen=HISTORY)

    def clear(self) -> None:
        """Forget the past."""
        self._rows.clear()
        self._plot.hide()

    def add(self, time: float, meters: Sequence[Meter]) -> None:
        """Take in a point and draw."""
        energies = [{} if meter.latest.refused else meter.latest.energy for meter in meters]
        kinetic = [energy.get("kinetic", np.nan) for energy in energies]
        self._rows.append([time, *(total_energy(energy) for energy in energies), *kinetic])
        solid = [{"label": "total", "stroke": c.css, "width": 2} for c in VARIANTS[: len(meters)]]
        dashed = [
            {"label": "kinetic", "stroke": c.css, "width": 1.3, "dash": [5, 4]}
            for c in VARIANTS[: len(meters)]
        ]
        self._plot.draw(np.array(self._rows).T, [*solid, *dashed])


def total_energy(energy: Mapping[str, float]) -> float:
    """The sum over kinds [J]; nan if there are none, as in a gap."""
    return sum(energy.values()) if energy else np.nan
