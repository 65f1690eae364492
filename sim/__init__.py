"""Muslin's core: scenes, springs, contact and implicit stepping, headless.

    import sim

    world = sim.Simulation(sim.load_scene("static_scenes/drape.toml"), gamma=0.5)
    report = world.step()

Numba and everything that needs it is imported when `Simulation` is first used, so that checking and listing
scenes stays quick.
"""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from sim.scene import Scene, SceneError, load_scene
from sim.settings import Settings

if TYPE_CHECKING:
    from sim.budget import choose_settings
    from sim.contact.intersections import intersections
    from sim.contact.time_of_impact import time_of_impact
    from sim.ledger import Ledger
    from sim.probe import LocalError, Probe
    from sim.report import StepError, StepReport
    from sim.ringdown import modal_damping
    from sim.simulation import Simulation
    from sim.statics import EquilibriumError, equilibrium

try:
    __version__ = version("muslin")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

__all__ = [
    "EquilibriumError",
    "Ledger",
    "LocalError",
    "Probe",
    "Scene",
    "SceneError",
    "Settings",
    "Simulation",
    "StepError",
    "StepReport",
    "choose_settings",
    "equilibrium",
    "intersections",
    "load_scene",
    "modal_damping",
    "time_of_impact",
]

_LATER = {
    "EquilibriumError": "sim.statics",
    "Ledger": "sim.ledger",
    "LocalError": "sim.probe",
    "Probe": "sim.probe",
    "Simulation": "sim.simulation",
    "StepError": "sim.report",
    "StepReport": "sim.report",
    "choose_settings": "sim.budget",
    "equilibrium": "sim.statics",
    "intersections": "sim.contact.intersections",
    "modal_damping": "sim.ringdown",
    "time_of_impact": "sim.contact.time_of_impact",
}
"""Where to find what needs numba; imported when it is first used."""


def __getattr__(name: str):
    if name not in _LATER:
        raise AttributeError(f"module 'sim' has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)
