"""Where steps are known to do well, and which setting is the likeliest to blame where one cannot be done.

The range of a setting's slider is what `muslin stress` sweeps, any two ends of any two settings together, on
several meshes: there nothing explodes. The command line and the boxes of the page allow far more.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from sim.integrators import CALM, INTEGRATORS
from sim.settings import FIELDS, Settings

STRONG = 100.0
"""Gravity beyond this in any component [m/s²], ten times the earth's, is not swept."""

DOUBTFUL: dict[str, str] = {
    "integrator": "explicit steps blow up where they are longer than the stiffest spring allows",
    "gravity": "cloth falls many edges far in a step and meets everything at once",
    "dt": "cloth goes many edges far in a step, which is linear about where it no longer is then",
    "stretch": "digits are lost where springs of h² k outweigh the mass",
    "altitude": "the same, along the heights of triangles",
    "bending": "the same, and curvature that a mesh cannot show any more",
    "density": "light cloth is stiff cloth to a step, heavy cloth outweighs what holds it",
    "gamma": "damping far beyond critical is as stiff as a spring of the same h b",
    "thickness": "contacts that reach over several edges hold everything with everything",
    "friction": "what sticks at any slope may have no way out that obeys all contacts",
}
"""Settings that make a step fail where they are out of the ordinary, the likeliest first, and why."""

START = "tangled"
"""The setting that decides about a start that crosses itself."""

LESS_STRICT = {"refuse": "untangle", "untangle": "keep"}
"""What to set it to where the start is refused."""


def out_of_range(settings: Settings) -> list[str]:
    """Names of the settings that are where steps are not known to do well, the likeliest to blame first."""
    return [name for name in DOUBTFUL if _acts(name, settings) and _moderated(name, settings) is not None]


def suspect(settings: Settings) -> str:
    """The setting most likely to blame for a step that cannot be done; the time step if none stands out."""
    return next(iter(out_of_range(settings)), "dt")


def safe_changes(settings: Settings, blamed: str = "") -> dict[str, Any]:
    """What to change so that steps can be done again: by name, everything that is out of the ordinary.

    Where nothing is, it is half the time step, down to the end of its slider; empty there. A start that is
    refused for a tangle, which the setting that is `blamed` tells, is untangled, or kept if that has failed.
    """
    if blamed == START:
        return {START: LESS_STRICT.get(settings.tangled, settings.tangled)}
    changes = {name: _moderated(name, settings) for name in out_of_range(settings)}
    low, _ = FIELDS["dt"].slider or (settings.dt, settings.dt)
    if not changes and settings.dt > low:
        changes["dt"] = max(low, 0.5 * settings.dt)
    return changes


def safe(settings: Settings) -> Settings:
    """The same with `safe_changes` made."""
    return msgspec.structs.replace(settings, **safe_changes(settings))


def _acts(name: str, settings: Settings) -> bool:
    switch = {"altitude": settings.altitudes, "bending": settings.bend}.get(name)
    if name in ("thickness", "friction"):
        switch = settings.contact
    return switch != "none"


def _moderated(name: str, settings: Settings) -> Any:
    """A moderate value for a setting in place of the one that it has; None where that is moderate."""
    field, value = FIELDS[name], getattr(settings, name)
    if name == "integrator":
        return None if INTEGRATORS[value].implicit else CALM
    if field.slider is None:
        return field.default if np.abs(value).max() > STRONG else None
    low, high = field.slider
    if value == 0.0:  # where it is allowed there is none of it, which no step minds
        return None
    return None if low <= value <= high else min(max(value, low), high)
