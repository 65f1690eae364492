"""The right dock: error against cost, the variants' numbers, energies, momentum, effects, damping, budget."""

from __future__ import annotations

from collections.abc import Sequence

import viser

from server import style
from server.budget import BudgetTab
from server.digits import round_above
from server.meter import Meter
from server.palette import VARIANTS
from server.plots import CostPlot, PairPlot
from server.ringdown import EXPLANATION, Results, damping_table
from server.tables import (
    NOTHING,
    caption,
    color_key,
    effects_table,
    sums_table,
    threads_line,
    update,
    variant_table,
)
from server.tradeoff import Tradeoff

TRADEOFF = caption("local error of a frame against its cost")
"""What stands above that chart."""

MEASURE = "Measure the damping"

NO_MOMENTUM = 1e-9
"""Momentum [kg m/s, kg m²/s] that may come from rounding alone."""


class Charts:
    """Plots of the last minute, made once for as many variants as there can be; the rest are hidden.

    Nothing here is ever removed: a slow browser that meets an update and a removal of one element in the
    same batch reports an error.
    """

    def __init__(self, server: viser.ViserServer):
        gui = server.gui
        panel = gui.add_panel()
        self._tradeoff = Tradeoff()
        with panel.add_tab("Cost"):
            gui.add_html(TRADEOFF)
            self._chart = gui.add_html("")
            self._table = gui.add_html("")
            gui.add_html(caption("milliseconds per step, by phase"))
            self._costs = [CostPlot(server, color) for color in VARIANTS]
            self._threads = gui.add_html("")
        with panel.add_tab("Energy"):
            self._energies = PairPlot(server, "energy", "J", ("total", "kinetic"), NOTHING)
            self._momenta = PairPlot(server, "momentum", "SI", ("|P|", "|L|"), NO_MOMENTUM, visible=False)
            self._sums = gui.add_html("")
        with panel.add_tab("Effects"):
            self._effects = gui.add_html("")
        with panel.add_tab("Damping"):
            gui.add_html(caption(EXPLANATION))
            self.measure = gui.add_button_group("ring-down", (MEASURE,))
            self._damping = gui.add_html("")
        with panel.add_tab("Budget"):
            self.budget = BudgetTab(gui)
        panel.dock_right()
        panel.set_width(style.RIGHT_WIDTH)
        self._setting, self._names = "", [""]
        self.picture = ""
        """The chart of error against cost, with its title and key, as HTML."""

    def name(self, setting: str, names: Sequence[str]) -> None:
        """Call the variants so, by their values of the setting that differs."""
        self._setting, self._names = setting, list(names)

    def show_damping(self, results: Results) -> None:
        """Write what was measured of each variant's damping; nothing where that is out of date."""
        update(self._damping, damping_table(self._names, results))

    def clear(self) -> None:
        """Forget the past."""
        self._tradeoff.clear(len(self._names))
        for plot in (*self._costs, self._energies, self._momenta):
            plot.clear()

    def show_momentum(self, kept: bool) -> None:
        """Plot momentum, or not: where something outside pulls or holds the cloth, it says nothing."""
        self._momenta.show(kept)

    def add(self, time: float, meters: Sequence[Meter], moved: bool) -> None:
        """Write the present numbers; and where time has moved on, a point of every line."""
        self._tradeoff.add(meters)
        chart = self._tradeoff.svg(self._names, meters)
        self.picture = TRADEOFF + chart + color_key(self._names, self._setting)
        update(self._chart, f'<div class="muslin">{chart}</div>')
        update(self._table, variant_table(self._setting, self._names, meters))
        update(self._threads, threads_line(meters))
        update(self._sums, sums_table(self._names, meters))
        update(self._effects, effects_table(self._names, meters))
        if moved and any(meter.ms for meter in meters):
            plots = self._costs[: len(meters)]
            highest = max(plot.add(time, meter) for plot, meter in zip(plots, meters, strict=True))
            for plot in plots:
                plot.draw(round_above(max(highest, 0.1)))
            self._energies.add(time, [meter.energies() for meter in meters])
            if self._momenta.visible:
                self._momenta.add(time, [meter.momenta() for meter in meters])
