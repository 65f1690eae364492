"""The page's looks outside the 3-D view: style rules and the small pieces of HTML in the docks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from server.guard import handle_id
from server.palette import GROUND, INK, WHITE, Rgb

LEFT_WIDTH, RIGHT_WIDTH = 300, 300
"""Of the docks [CSS px]."""

LABEL, BOX, ROW = 7.7, 3.6, 1.90625
"""Of a setting's row [em]: width of its label, width of the box beside a slider, height."""

PHONE, SHEET_PART = 576, 0.4
"""Pages up to this width [CSS px] have a sheet of controls at the bottom, of this part of the height."""

SHEET = (
    f"@media(max-width:{PHONE}px){{"
    '.mantine-Paper-root[style*="position: fixed"]'
    f"{{width:100%!important;max-height:{100 * SHEET_PART:g}%!important}}"
    '.mantine-Paper-root[style*="position: fixed"] [style*="width: 20em"]{width:100%!important}}'
)
"""Rules for that sheet: of viser's own, 60 % and 20 em beside the right border would cover the cloths."""

LOW = 440
"""Pages up to this height [CSS px], phones on their side, have no room for a second dock."""

SIDEWAYS = (
    f"@media(max-height:{LOW}px) and (max-width:960px){{"
    '[data-dock-region=right],[data-dock-root]>div[style*="right: 0px"][style*=shadow]'
    "{visibility:hidden!important}[data-dock-root]>div:first-child{right:0!important}}"
)
"""Rules for these: between two docks the cloths would have a quarter of the width."""

CHART_WIDTH, CHART_PART = 32, 0.42
"""Of the chart on a projector: part of the page's width [%]; of its height, where it stands before cloths."""

PROJECTOR = (
    "[data-dock-region],[data-dock-root]>div[style*=shadow],[data-floating-window],"
    '.mantine-Paper-root[style*="position: fixed"]{visibility:hidden!important}'
    "[data-dock-root]>div:first-child{left:0!important;right:0!important}"
    ".muslin.projector{visibility:visible;position:fixed;z-index:9;right:0;bottom:0;box-sizing:border-box;"
    f"width:{CHART_WIDTH}vw;padding:.8rem;background:#ffffffb0;font-size:1.25rem}}"
    ".muslin.projector svg{font-size:12px;overflow:visible}"
    f".muslin.projector .key span{{display:inline-block;margin-right:1em;color:{INK.css}}}"
    ".muslin.way-out{visibility:visible;position:fixed;z-index:9;left:0;bottom:0;padding:.8rem}"
    f".muslin.way-out a{{color:{INK.css}}}"
)
"""Rules that hide docks, windows and the phone's sheet, and give the cloths their room.

What is in a dock is not displayed without it, but may be visible though it is hidden."""

MOST_BESIDE = 3
"""Variants that may stand beside the chart on a projector; more take the page's whole width."""

BESIDE = (
    f"@media(min-aspect-ratio:5/4){{[data-dock-root]>div:first-child{{right:{CHART_WIDTH}vw!important}}"
    ".muslin.projector{top:0;display:flex;flex-direction:column;justify-content:center}}"
)
"""Rules for a chart that takes a side of a page that is wide enough."""

UNKNOWN = "–"
"""Stands for a number that has not been measured."""


def page(control_rules: str, *rows: Any) -> str:
    """The style element of the whole page; `rows` are inputs that take the full width, without label."""
    bare = "".join(f'div:has(>p>label[for="{handle_id(row)}"]){{display:none}}' for row in rows)
    sky = GROUND.toward(WHITE, 0.65).css
    return (
        "<style>"
        f"canvas[data-engine]{{background:linear-gradient({sky},{GROUND.css})}}"
        f".muslin{{padding:0 .75em .4em;color:{INK.css};line-height:1.35;font-size:.875em}}"
        ".muslin h1{font-size:1.1em;margin:.1em 0 .15em;font-weight:650}"
        ".muslin p{margin:0 0 .3em}.muslin ul{margin:.1em 0 .2em;padding-left:1.1em}"
        ".muslin table{width:100%;border-collapse:collapse;font-variant-numeric:tabular-nums}"
        ".muslin a{color:inherit}"
        ".muslin td,.muslin th{text-align:right;padding:.1em .2em;font-weight:400}"
        ".muslin th{color:#6f675f;font-size:.88em}"
        ".muslin.many{font-size:.74em;white-space:nowrap;padding-right:1.6em}"
        ".muslin.many .small,.muslin.many .bad{white-space:normal}"
        ".muslin.many td,.muslin.many th{padding:.1em 0 .1em .3em}"
        ".muslin td:first-child,.muslin th:first-child{text-align:left}"
        ".muslin.key{font-size:.74em;color:#6f675f}.muslin.key span{display:inline-block;margin-right:.8em}"
        ".muslin .small{font-size:.88em;line-height:1.25;color:#5d564f}.muslin li::marker{content:'▸ '}"
        ".muslin.left{font-size:.77em}.muslin.left td{text-align:left}"
        ".muslin.left td:first-child{white-space:nowrap;padding-right:.8em}"
        ".muslin.effects{font-size:.77em;padding-right:1.6em}"
        ".muslin.effects table{margin-bottom:.8em;table-layout:fixed}"
        ".muslin.effects td{text-align:left;vertical-align:top}.muslin.effects td:first-child{width:31%}"
        ".muslin.effects td:nth-child(2){white-space:nowrap;text-align:right;width:31%}"
        ".muslin.export{font-size:.8em}.muslin.export pre{white-space:pre-wrap;overflow-wrap:anywhere;"
        "user-select:all;margin:0 0 .6em;padding:.4em .5em;border:1px solid #d8d2c9;border-radius:.3em}"
        ".muslin .rule>td{border-top:1px solid #d8d2c9}"
        "[role=tab]{padding:.7em .3em!important}[role=tab],[role=tab] *{font-size:12px!important}"
        ".muslin.alarm{border-left:4px solid #34302c;padding-left:.5em;margin:0 .5em .2em}"
        ".mantine-Notification-description{white-space:pre-line}"
        ".mantine-Notifications-notification"
        "{max-height:90vh!important;overflow:auto!important;align-items:flex-start}"
        ".muslin .dim{color:#6f675f}.muslin .bad{font-weight:800}"
        ".muslin i.chip{display:inline-block;width:.7em;height:.7em;border-radius:2px;margin-right:.35em}"
        f"div:has(>p>label){{width:{LABEL}em!important;padding-right:.25em}}"
        "p:has(>label){font-size:.8em!important}p>label{white-space:nowrap}"
        f".mantine-Slider-root~.mantine-NumberInput-root{{width:{BOX}em!important}}"
        ".mantine-Slider-root:is([data-disabled],:has([data-disabled]))~.mantine-NumberInput-root"
        "{pointer-events:none}"
        ".mantine-Slider-root:is([data-disabled],:has([data-disabled]))~.mantine-NumberInput-root input"
        "{background:#f1f3f5;color:#6f6f6f}"
        f"{SHEET}{SIDEWAYS}{bare}{control_rules}</style>"
    )


def lesson(title: str, look_for: str, tries: Sequence[str]) -> str:
    """What a scene shows, what to look for, and what to try."""
    items = "".join(f"<li>{escape(item)}</li>" for item in tries)
    tried = f'<ul class="small">{items}</ul>' if items else ""
    return f'<div class="muslin"><p><b>{escape(title)}.</b> {escape(look_for)}</p>{tried}</div>'


def projector(chart: str, beside: bool) -> str:
    """What a page in projector mode has on top: its rules, the chart, and how to leave; all of it HTML."""
    return (
        f"<style>{PROJECTOR}{BESIDE * beside}</style>"
        f'<div class="muslin projector">{chart}</div>'
        '<div class="muslin way-out"><a href="/">P: the controls again</a></div>'
    )


HELP = (
    "Above each cloth: milliseconds per step, and the local error of one frame, beside a finer run. "
    "≈ is measured quickly, ≥ and < are all that is known; “% as of” says when, where that is long ago. "
    "Below: what is in obstacles, and what crosses.",
    "Point at a setting, an effect or a number to be told what it is.",
    "Keys act unless a box was clicked last, which takes them as text: click on the cloths first.",
)
"""How to read the page."""

MOUSE = {"drag": "Turn the view", "right drag": "Move it", "wheel": "Zoom"}
"""What the mouse does, as viser has it."""


def keys(commands: Mapping[str, str]) -> str:
    """What keys do, by key, after what the mouse does."""
    rows = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(what)}</td></tr>"
        for key, what in (MOUSE | {**commands}).items()
    )
    other = '<a href="/projector" target="_blank">Open a page for the projector</a>'
    return f'<div class="muslin left"><table>{rows}</table><p>{other}</p></div>'


def help_text(commands: Mapping[str, str]) -> str:
    """How to read the page, and what keys do."""
    return "\n\n".join([*HELP, "\n".join(f"{key}: {what}" for key, what in commands.items())])


SHARED = "Everyone who connects shares this simulation: all see the same cloths, and each looks around alone."
"""What it means that several are here."""

WATCHING = (
    f'<div class="muslin watching" title="{SHARED}"><p><b>You are watching.</b> Look around freely; '
    "the controls are the host's.</p></div><style>"
    ".mantine-Slider-root,.mantine-Input-wrapper,.mantine-Button-root,.mantine-Checkbox-root"
    "{pointer-events:none;opacity:.55}</style>"
)
"""Tops the page of somebody who may only watch, and greys its controls."""


def status(playing: bool, time: float | None, factor: float | None, note: str, crowd: int = 1) -> str:
    """How time runs, and how many look on; `note` is HTML."""
    clock = UNKNOWN if time is None else f"{time:.2f} s"
    rate = f"{factor:.2f} × real time" if factor is not None else ("measuring" if playing else "paused")
    rate = rate if time is not None else UNKNOWN
    here = f' &nbsp;·&nbsp; <span title="{SHARED}">{crowd} pages</span>' if crowd > 1 else ""
    line = f'<p style="margin:0" class="dim">time <b>{clock}</b> &nbsp;·&nbsp; {rate}{here}</p>'
    return f'<div class="muslin">{line}{f"<p><b>{note}</b></p>" if note else ""}</div>'


def chip(color: Rgb) -> str:
    """A small square of a colour."""
    return f'<i class="chip" style="background:{color.css}"></i>'
