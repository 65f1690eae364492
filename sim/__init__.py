"""Muslin's core: scenes, springs, contact and implicit stepping, headless.

    import sim

    world = sim.Simulation(sim.load_scene("static_scenes/drape.toml"), gamma=0.5)
    report = world.step()

Numba and everything that needs it is imported when `Simulation` is first used, so that checking and listing
scenes stays quick.
"""

from importlib.metadata import PackageNotFoundError, version

from sim.scene import Scene, SceneError, load_scene
from sim.settings import Settings

try:
    __version__ = version("muslin")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0+unknown"

__all__ = ["Scene", "SceneError", "Settings", "Simulation", "StepError", "StepReport", "load_scene"]


def __getattr__(name: str):
    if name in ("Simulation", "StepError", "StepReport"):
        from sim import simulation

        return getattr(simulation, name)
    raise AttributeError(f"module 'sim' has no attribute {name!r}")
