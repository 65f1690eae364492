"""Compiling before the first step, with honest progress.

Kernels compile when they are first called, or are read from the cache on disk. A step of a handful of
vertices calls them all, in the time that the first step of the scene would have taken longer, and can be
watched.
"""

from __future__ import annotations

from collections.abc import Callable

from numba.core import event

from sim.compiled import KERNELS
from sim.scene import Scene
from sim.simulation import Simulation
from sim.springs.build import kinds_in_force

Progress = Callable[[int, int, str], None]


def warm_up(scene: Scene, progress: Progress | None = None) -> None:
    """Compile, or read from the cache, every kernel that `scene` needs.

    Args:
        scene: Its spring kind, and whether it has obstacles, decide what is compiled.
        progress: Called as progress(ready, total, name) when a kernel begins to compile, and once at the end.
    """
    cloth = {"kind": "grid", "size": [0.2, 0.2], "resolution": [3, 3], "pins": ["corner00"]}
    ball = {"kind": "sphere", "center": [0.1, 0.1, -0.05], "radius": 0.05}
    settings = {"bend": scene.settings.bend, "contact": "impulse", "friction": 0.5}
    small = {"cloth": cloth, "obstacle": [ball] if scene.obstacle else [], "settings": settings}
    for kind in kinds_in_force(scene.settings).values():
        kind.load()
    with event.install_listener("numba:compile", _Watch(bool(scene.obstacle), progress)):
        Simulation(small).step()
    if progress is not None:
        progress(1, 1, "ready")


class _Watch(event.Listener):
    """Reports each kernel as its compilation starts."""

    def __init__(self, contact: bool, progress: Progress | None) -> None:
        self.kernels = [k for k in KERNELS if contact or not k.py_func.__module__.startswith("sim.contact")]
        self.progress = progress

    def on_start(self, event: event.Event) -> None:
        dispatcher = (event.data or {})["dispatcher"]
        if self.progress is not None and dispatcher in self.kernels:
            ready = sum(bool(k.overloads) for k in self.kernels)
            module, name = dispatcher.py_func.__module__, dispatcher.py_func.__name__
            self.progress(ready, len(self.kernels), f"{module.removeprefix('sim.')}.{name.lstrip('_')}")

    def on_end(self, event: event.Event) -> None:
        """Nothing to say: the next start reports how many are ready."""
