"""Compiling before the first step, with honest progress.

Kernels compile when they are first called, or are read from the cache on disk. A step of a handful of
vertices calls them all, in the time that the first step of the scene would have taken longer, and can be
watched.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from numba.core import event
from numba.core.dispatcher import Dispatcher

from sim.compiled import KERNELS
from sim.contact.gap import NO_GAP_SPRINGS
from sim.scene import Scene, ShellArrays, ShellFile
from sim.simulation import Simulation
from sim.solve.implicit import FILTERED
from sim.springs.build import kernel_of, kinds_in_force

Progress = Callable[[int, int, str], None]

OPTIONAL = {"sim.wind": "drag", "sim.strain": "strain_limit"}
"""Modules whose kernels only a scene needs that has a setting above zero."""


def warm_up(scene: Scene, progress: Progress | None = None) -> None:
    """Compile, or read from the cache, every kernel that `scene` needs.

    Args:
        scene: Its spring kinds, Newton iterations, and whether it has obstacles, decide what is compiled.
        progress: Called as progress(ready, total, name) when a kernel begins to compile, and once at the end.
    """
    cloth = {"kind": "grid", "size": [0.2, 0.2], "resolution": [3, 3], "pins": ["corner00"]}
    over = {**cloth, "position": [0.0, 0.0, 1e-3], "pins": []}  # so near that the two are felt
    ball = {"kind": "sphere", "center": [0.1, 0.1, -0.05], "radius": 0.05}
    s = scene.settings
    settings = {
        "bend": s.bend,
        "adhoc_rule": s.adhoc_rule,
        "altitudes": s.altitudes,
        "contact": "none" if s.contact == "none" else "impulse",
        "obstacles": s.obstacles,
        "self_collision": s.self_collision,
        "drag": s.drag,
        "strain_limit": s.strain_limit,
        "solver": "cg",
    }
    for effect, value in OPTIONAL.items():
        if getattr(s, value) > 0.0:
            importlib.import_module(effect)  # so that its kernels are counted
    settings |= {"newton": min(s.newton, 2), "tolerance": 1e-12}  # so that a line search is needed, too
    meshes = any(isinstance(part, ShellFile | ShellArrays) for part in scene.obstacle)
    under = {"vertices": [[0, 0, -1e-3], [0.1, 0, -1e-3], [0, 0.1, -1e-3]], "triangles": [[0, 1, 2]]}
    obstacles = [ball] * bool(scene.obstacle) + [under] * meshes
    small = {"cloth": [cloth, over], "obstacle": obstacles, "settings": settings}
    kinds = kinds_in_force(s).values()
    rules = {kernel_of(kind, s) for kind in kinds}
    exact = s.newton > FILTERED
    felt = bool(scene.obstacle) and s.obstacles != "off"
    touches = s.contact != "none" and (s.self_collision != "off" or meshes)

    def needed(kernel: Dispatcher) -> bool:
        module, name = kernel.py_func.__module__, kernel.py_func.__name__
        if module in OPTIONAL:
            return getattr(s, OPTIONAL[module]) > 0.0
        if name.endswith("curvature"):
            return exact and module in {"sim.solve.system", *(kind.module for kind in kinds)}
        if module.startswith("sim.springs."):
            return kernel in rules
        if module in {"sim.contact.broad", "sim.contact.proximity", "sim.solve.coupling"}:
            return touches
        if module in {"sim.contact.detect", "sim.contact.faces"}:
            return felt
        return name != "project" and (felt or touches or not module.startswith("sim.contact"))

    with event.install_listener("numba:compile", _Watch([k for k in KERNELS if needed(k)], progress)):
        world = Simulation(small)
        world.keep_ledger()  # which has no kernels of its own, but calls some that a linearised step does not
        world.step()
        if exact:
            world.model.linearise(world.positions.copy(), world.velocities.copy(), NO_GAP_SPRINGS, 0.01, True)
    if progress is not None:
        progress(1, 1, "ready")


class _Watch(event.Listener):
    """Reports each of `kernels` as its compilation starts."""

    def __init__(self, kernels: list[Dispatcher], progress: Progress | None) -> None:
        self.kernels = kernels
        self.progress = progress

    def on_start(self, event: event.Event) -> None:
        dispatcher = (event.data or {})["dispatcher"]
        if self.progress is not None and dispatcher in self.kernels:
            ready = sum(bool(k.overloads) for k in self.kernels)
            module, name = dispatcher.py_func.__module__, dispatcher.py_func.__name__
            self.progress(ready, len(self.kernels), f"{module.removeprefix('sim.')}.{name.lstrip('_')}")

    def on_end(self, event: event.Event) -> None:
        """Nothing to say: the next start reports how many are ready."""
