"""Compiling before the first step, with honest progress.

Kernels compile when they are first called, or are read from the cache on disk. A step of a handful of
vertices calls them all, in the time that the first step of the scene would have taken longer, and can be
watched. Where there is something to compile, a second process compiles what solves are made of, while this
one compiles what finds and answers contacts; then it reads the other's from the cache.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np
from numba.core import event
from numba.core.dispatcher import Dispatcher

from sim import ledger
from sim.compiled import KERNELS
from sim.contact import intersections, outspread
from sim.contact.gap import NO_GAP_SPRINGS, GapSprings
from sim.effects import feels_cloth, feels_obstacles
from sim.report import StepReport
from sim.scene import Scene, ShellArrays, ShellFile
from sim.settings import Settings
from sim.simulation import Simulation
from sim.solve.cg import conjugate_gradients
from sim.solve.implicit import FILTERED, Solution
from sim.springs.build import kernel_of, kinds_in_force
from sim.tangles import refuses

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
    meshes = any(isinstance(part, ShellFile | ShellArrays) for part in scene.obstacle)
    felt = feels_obstacles(s, scene.obstacle_labels)
    touches = s.contact != "none" and (feels_cloth(s, len(scene.cloth) > 1) or (felt and meshes))
    one_sheet = touches and len(scene.cloth) == 1 and not (felt and meshes) and s.self_collision != "off"
    looks = touches and (s.tangled == "untangle" or refuses(s))  # for what crosses at the start
    settings = {
        "bend": s.bend,
        "adhoc_rule": s.adhoc_rule,
        "altitudes": s.altitudes,
        "contact": "none" if s.contact == "none" else "impulse",
        "obstacles": "auto" if felt else "off",
        "self_collision": "auto" if touches else "off",
        "cloth_collision": "auto" if touches else "off",
        "edge_edge": s.edge_edge,
        "drag": s.drag,
        "strain_limit": s.strain_limit,
        "ledger": s.ledger,
        "solver": "cg",
        "tangled": s.tangled if looks else "keep",
    }
    for effect, value in OPTIONAL.items():
        if getattr(s, value) > 0.0:
            importlib.import_module(effect)  # so that its kernels are counted
    settings |= {"newton": min(s.newton, 2), "tolerance": 1e-12}  # so that a line search is needed, too
    under = {"vertices": [[0, 0, -1e-3], [0.1, 0, -1e-3], [0, 0.1, -1e-3]], "triangles": [[0, 1, 2]]}
    obstacles = [ball] * bool(scene.obstacle) + [under] * meshes
    small = {"cloth": [cloth, over], "obstacle": obstacles, "settings": settings}
    kinds = kinds_in_force(s).values()
    rules = {kernel_of(kind, s) for kind in kinds}
    exact = s.newton > FILTERED

    def needed(kernel: Dispatcher) -> bool:
        module, name = kernel.py_func.__module__, kernel.py_func.__name__
        if module in OPTIONAL:
            return getattr(s, OPTIONAL[module]) > 0.0
        if name.endswith("curvature"):
            return exact and module in {"sim.solve.system", *(kind.module for kind in kinds)}
        if module == intersections.__name__:
            return looks
        if module == outspread.__name__:
            return one_sheet
        if module == ledger.__name__:
            return s.ledger != "off"
        if module.startswith("sim.springs."):
            return kernel in rules
        if module in {"sim.contact.broad", "sim.contact.proximity", "sim.solve.coupling"}:
            return touches
        if module in {"sim.contact.detect", "sim.contact.faces"}:
            return felt
        return name != "project" and (felt or touches or not module.startswith("sim.contact"))

    alone = {**small, "obstacle": [], "settings": {**settings, "contact": "none"}}
    shared = s.contact != "none" and not conjugate_gradients.overloads  # else both would compile the same
    second = _SecondProcess(alone, shared)
    watch = _Watch([k for k in KERNELS if needed(k)], progress, second.start)
    with _rarely_collected(), second, event.install_listener("numba:compile", watch):
        world = Simulation(small)
        _touch(world, one_sheet)
        second.wait()  # or this one would begin with the same
        _solve(world)
        if exact:
            world.model.linearise(world.positions.copy(), world.velocities.copy(), NO_GAP_SPRINGS, 0.01, True)
    if progress is not None:
        progress(1, 1, "ready")


def _solve(world: Simulation) -> None:
    """Make a step, and keep its books."""
    world.keep_ledger()  # which has kernels of its own, and calls some that a linearised step does not
    world.step()


def _touch(world: Simulation, one_sheet: bool) -> None:
    """Call what finds contacts and answers them, on the way that a step would take without springs."""

    def fall(felt: GapSprings, s: Settings, x: np.ndarray, v: np.ndarray, __: object) -> Solution:
        v = v + s.dt * np.asarray(s.gravity)
        end, forces, model = x + s.dt * v, np.zeros_like(x), world.model
        felt.linearise(x, v, s.dt, model.matrix, forces)
        felt.settle(v, end, v, model, s.friction, s.dt, forces)
        felt.shares(end, v)
        return Solution(end, v, 0, 1, 0.0, True)

    s = world.settings
    if one_sheet:
        corners = np.arange(4, dtype=np.int32)
        outspread.clearance(corners[None, :3], corners, np.eye(4, 3), np.eye(4, 3), 0.0)
    if s.contact != "none":
        world.contact.through(s, 0.0, world.positions.copy(), world.velocities.copy(), fall, StepReport())
        world.contact.forget()


@contextlib.contextmanager
def _rarely_collected() -> Iterator[None]:
    """Look for garbage a hundred times less often: compilers make many objects, of which few are garbage."""
    usual = gc.get_threshold()
    gc.set_threshold(100 * usual[0], *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def solve_alone() -> None:
    """What the second process does: `_solve` the scene without contacts that it is handed."""
    gc.disable()
    _solve(Simulation(msgspec.json.decode(sys.stdin.read())))


class _SecondProcess(contextlib.AbstractContextManager):
    """A process that will `solve_alone`, which fills the cache; ended, if need be, with the context.

    There is none where none is `wanted`, or there is one core. What both compile at the same time is compiled
    twice and kept once, by whoever is later.
    """

    def __init__(self, scene: dict[str, Any], wanted: bool):
        self._scene = msgspec.json.encode(scene)
        self._wanted = wanted and (os.cpu_count() or 1) > 1
        self._process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start it, the first time."""
        if self._wanted and self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-c", "from sim.warmup import solve_alone; solve_alone()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            assert self._process.stdin is not None
            with contextlib.suppress(OSError), self._process.stdin as to:
                to.write(self._scene)

    def wait(self) -> None:
        """Wait until it is done, or has failed, if it was started."""
        if self._process is not None:
            self._process.wait()

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


class _Watch(event.Listener):
    """Reports each of `kernels` as its compilation starts, and calls `wake` then."""

    def __init__(
        self, kernels: list[Dispatcher], progress: Progress | None, wake: Callable[[], None]
    ) -> None:
        self.kernels, self.progress, self.wake = kernels, progress, wake

    def on_start(self, event: event.Event) -> None:
        dispatcher = (event.data or {})["dispatcher"]
        self.wake()
        if self.progress is not None and dispatcher in self.kernels:
            ready = sum(bool(k.overloads) for k in self.kernels)
            module, name = dispatcher.py_func.__module__, dispatcher.py_func.__name__
            self.progress(ready, len(self.kernels), f"{module.removeprefix('sim.')}.{name.lstrip('_')}")

    def on_end(self, event: event.Event) -> None:
        """Nothing to say: the next start reports how many are ready."""
