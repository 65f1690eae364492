"""Muslin's core: scenes, springs, contact and implicit stepping, headless.

    import sim

    world = sim.Simulation(sim.load_scene("static_scenes/drape.toml"), gamma=0.5)
    report = world.step()

Numba and everything that needs it is imported when `Simulation` is first used, so that checking and listing
scenes stays quick.
"""

import importlib
from importlib.metadata import PackageNotFoundError, version

from sim.scene import Scene, SceneError, load_scene
from sim.settings import Settings

try:
    __version__ = version("muslin")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

_LATER = {
    "Simulation": "sim.simulation",
    "StepError": "sim.report",
    "StepReport": "sim.report",
    "EquilibriumError": "sim.equilibrium",
    "equilibrium": "sim.equilibrium",
    "modal_damping": "sim.ringdown",
}
"""Where to find what needs numba."""

__all__ = ["Scene", "SceneError", "Settings", "__version__", "load_scene", *_LATER]  # pyright: ignore


def __getattr__(name: str):
    if name not in _LATER:
        raise AttributeError(f"module 'sim' has no attribute {name!r}")
    found = getattr(importlib.import_module(_LATER[name]), name)
    globals()[name] = found  # the module sim.equilibrium would take its function's place otherwise
    return found
