"""How figures look: for slides, told apart without colour, legible from the back row; and their files.

Colours are Okabe and Ito's; markers and line styles say the same again for a greyscale print.
"""

from __future__ import annotations

import io
import re
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from server.palette import INK, VARIANTS, Rgb

BLUE, VERMILION = Rgb(0, 114, 178), Rgb(213, 94, 0)
COLORS = (VERMILION, BLUE, VARIANTS[2], VARIANTS[0], VARIANTS[3], VARIANTS[1], INK)
MARKERS, DASHES = "osD^vPX", ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1, 1, 1)), (0, (1, 1)))
HATCHES = ("", "///", "...", "xxx", "\\\\\\", "+++", "ooo")

LOOKS: dict[Any, Any] = {
    "font.size": 15,
    "axes.titlesize": 17,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK.css,
    "axes.labelcolor": INK.css,
    "text.color": INK.css,
    "xtick.color": INK.css,
    "ytick.color": INK.css,
    "legend.frameon": False,
    "legend.fontsize": 13,
    "lines.linewidth": 2.2,
    "lines.markersize": 9,
    "svg.hashsalt": "muslin",
    "svg.fonttype": "path",
    "hatch.linewidth": 0.8,
}
WIDE, TALL = (12.0, 6.75), (12.0, 7.5)
"""Inches, as a slide has it."""

Figures = dict[str, tuple[str, Figure]]
"""By file name: a caption, and the figure."""


def svg(figure: Figure) -> bytes:
    """The figure as a file."""
    return _saved(figure, "svg")


def png(figure: Figure) -> bytes:
    """The figure as pixels."""
    return _saved(figure, "png")


def inline_svg(figure: Figure, label: str) -> str:
    """The figure as an element of a page, which refers to nothing outside."""
    text = svg(figure).decode()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)


def _saved(figure: Figure, kind: str) -> bytes:
    stream = io.BytesIO()
    with rc_context(LOOKS):
        about: dict[str, Any] = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": 160}
        figure.savefig(stream, format=kind, bbox_inches="tight", **about)
    return stream.getvalue()


def axes_for(size: tuple[float, float] = WIDE) -> tuple[Figure, Axes]:
    """A figure of this size [inches] and its axes, with a quiet grid."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(True, which="major", color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    return figure, axes
