"""A sweep of all settings: any two values of any two settings meet in some run, on each of several meshes.

The values are those of every enumerated setting and both ends of every slider. Each run takes hundreds of
steps, and between them moves sliders and changes choices at random, as somebody would who tries everything.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Any

import numpy as np

from sim.integrators import CALM, INTEGRATORS
from sim.report import StepError, StepReport
from sim.settings import FIELDS
from sim.simulation import Simulation, Snapshot
from sim.stress import Figure, at_most, case, reported
from sim.stress.judge import Judge
from sim.stress.measures import EARTH, potential_parts, relative_rise
from sim.stress.numerics import DESCENT, slivers
from sim.stress.probe import Probe, Trial
from sim.stress.worlds import ball, grid, irregular

Row = dict[str, Any]
"""A value for each setting that is swept."""

STEPS, EVERY = 200, 20
"""Steps of a run, and steps between two moves of a slider."""

AGAIN = 20
"""Steps of a run that are taken a second time, which must give the same bits."""

TRIED = 40
"""Values of a row that are drawn, of which the one that meets most new pairs is kept."""


def levels() -> dict[str, list[Any]]:
    """What each setting is swept over; gravity acts or not, and so does wind. A run has one thread."""
    found: dict[str, list[Any]] = {"gravity": [tuple(EARTH), (0.0, 0.0, 0.0)]}
    found["wind"] = [(0.0, 0.0, 0.0), (3.0, -5.0, 4.0)]
    for name, field in FIELDS.items():
        if field.choices is not None and name != "tangled":  # which acts before the first step alone
            found[name] = list(field.choices())
        elif field.slider is not None and name != "threads":
            found[name] = [field.clamp(end) for end in field.slider]
    return found


@functools.cache
def rows() -> list[Row]:
    """A pairwise-covering array of `levels`: the best of some random rows at a time (Cohen et al. 1997)."""
    known, random = levels(), np.random.default_rng(0)
    names = list(known)
    left = {
        (a, i, b, j)
        for a, b in combinations(range(len(names)), 2)
        for i in range(len(known[names[a]]))
        for j in range(len(known[names[b]]))
    }
    array: list[Row] = []
    while left:
        listed = sorted(left)
        drawn = (_drawn(known, listed, random) for _ in range(TRIED))
        row = max(drawn, key=lambda row: len(_met(row) & left))
        left -= _met(row)
        array.append({name: known[name][i] for name, i in zip(names, row, strict=True)})
    return array


Pair = tuple[int, int, int, int]
"""A setting, the number of its value, another setting, and the number of its value."""


def _drawn(known: dict[str, list[Any]], left: list[Pair], random: np.random.Generator) -> tuple[int, ...]:
    """Numbers of random values, two of which are of a pair that is left."""
    row = [int(random.integers(len(values))) for values in known.values()]
    a, i, b, j = left[random.integers(len(left))]
    row[a], row[b] = i, j
    return tuple(row)


def _met(row: tuple[int, ...]) -> set[Pair]:
    return {(a, row[a], b, row[b]) for a, b in combinations(range(len(row)), 2)}


# Meshes


def on_a_grid(gravity: bool) -> dict[str, Any]:
    """A sheet that hangs from two corners beside a ball, or floats."""
    cloth = grid((0.6, 0.6), (9, 9), position=[0, 0, 0.35], pins=["corner00", "corner10"] if gravity else [])
    return {"cloth": cloth, "obstacle": [ball((0.05, 0.1, 0.0), 0.25)] if gravity else []}


def on_irregular_triangles(gravity: bool) -> dict[str, Any]:
    """A crumpled mesh that falls on a box, or floats."""
    cloth = {**irregular(11, 70, 0.01), "position": [0.0, 0.0, 0.3]}
    box = {"kind": "box", "center": [0, 0, 0], "size": [0.4, 0.3, 0.2]}
    return {"cloth": cloth, "obstacle": [box] if gravity else []}


def on_slivers(gravity: bool) -> dict[str, Any]:
    """A mesh with a band of triangles 1000 times as long as high, over a capsule."""
    cloth = {**slivers(9, 1e-4), "position": [-0.5, -0.3, 0.25]}
    cloth["pins"] = cloth["pins"] if gravity else []
    capsule = {"kind": "capsule", "start": [-0.3, 0, 0], "end": [0.3, 0.1, 0], "radius": 0.1}
    return {"cloth": cloth, "obstacle": [capsule] if gravity else []}


def of_pieces(gravity: bool) -> dict[str, Any]:
    """Three sheets, one above the other, over the floor, or flying at each other."""
    cloth = [
        grid(
            (0.4, 0.4),
            (6, 6),
            position=[0.01 * k, 0.02 * k, 0.05 + 0.04 * k],
            rotation=[0.1 * k, 0.05, 0.3 * k],
        )
        for k in range(3)
    ]
    return {"cloth": cloth, "obstacle": [{"kind": "plane"}] if gravity else []}


MESHES: dict[str, Callable[[bool], dict[str, Any]]] = {
    "grid": on_a_grid,
    "irregular": on_irregular_triangles,
    "slivers": on_slivers,
    "pieces": of_pieces,
}


# Runs


class Watch:
    """What a run of the sweep must hold at every step, as far as its settings promise it.

    Attributes:
        tangled: Steps that started untangled and did not end so, of the `judged` ones with impulses.
        inside: Vertices inside obstacles after such steps that started with none.
        descent: The largest rise of the incremental potential in a step that must not raise it, relative.
        bounded: How many steps were of that sort.
        drift: The most that a step of free cloth lost of its momentum, over what rounding may take.
    """

    def __init__(self, trial: Trial) -> None:
        self.trial, self.judge = trial, Judge(trial.world)
        self.tangled = self.judged = self.inside = self.bounded = 0
        self.descent, self.drift = -math.inf, 0.0
        self.look()

    def look(self) -> None:
        """Take the state as it is for the one to go on from."""
        world = self.trial.world
        self._clean = not self.judge.crossings(world.positions)
        self._outside = not world.contact.depths(world.time, world.positions).any()

    def step(self) -> None:
        """Take one step, and see."""
        world = self.trial.world
        x, v, momentum = world.positions.copy(), world.velocities.copy(), world.momentum()[0]
        parts, pull = potential_parts(world, 0.0), float(np.abs(world.forces()).sum())
        report = self.trial.step()
        if self._free() and not report.held_back:
            scale = float(world.masses @ np.linalg.norm(world.velocities, axis=1)) + world.settings.dt * pull
            lost = float(np.abs(world.momentum()[0] - momentum).max())
            self.drift = max(self.drift, lost / max(scale * self._rounding(), 1e-300))
        if self._descends(report):
            self.bounded += 1
            self.descent = max(self.descent, relative_rise(parts, potential_parts(world, v)))
        self._contact(x, report)

    def _free(self) -> bool:
        """Whether nothing acts on the cloth from outside."""
        world = self.trial.world
        held = any(world.settings.gravity) or world.scene.obstacle or len(world.pinned) or world.model.wind
        return not held and world.model.conservative

    def _rounding(self) -> float:
        """Part of Σ m|v| + h Σ|f| that rounding may take in a step.

        Springs of constant K move a translation of the mass m by their own rounding, K h²/m times that of it.
        """
        world = self.trial.world
        stiffest = max(float(springs.elements.stiffness.max(initial=0.0)) for springs in world.model.springs)
        ratio = stiffest * world.settings.dt**2 / float(world.masses.min())
        return max(FREE, SUMS * float(np.finfo(float).eps) * ratio)

    def _descends(self, report: StepReport) -> bool:
        """Whether the last step was searched along, with nothing in it that has no potential."""
        s = self.trial.world.settings
        quiet = report.contacts == 0 and report.energy_injected == 0.0 and report.energy_jumps == 0
        model = self.trial.world.model
        searched = s.integrator == "backward_euler" and s.newton > 1 and model.conservative
        return quiet and searched and model.wind is None and report.limited == 0

    def _contact(self, before: np.ndarray, report: StepReport) -> None:
        world, s = self.trial.world, self.trial.world.settings
        promised = s.contact == "impulse" and s.detection == "continuous"
        crossings = self.judge.crossings(world.positions)
        if promised and "off" not in (s.self_collision, s.cloth_collision, s.edge_edge) and self._clean:
            self.judged += 1
            way = self.judge.each_meeting(before, world.positions) if report.substeps == 1 else iter(())
            self.tangled += bool(crossings) or next(way, None) is not None
        if promised and self._outside:
            self.inside += report.penetrations
        self._clean, self._outside = not crossings, report.penetrations == 0


BLOWN_UP = 100.0
"""Speed [m/s] at which a run has blown up; where it may, it begins anew."""


def calming(world: Simulation) -> bool:
    """Whether no step may be refused: the integrator damps, and no spring puts in energy for ever."""
    name = world.settings.integrator
    return name == CALM or (INTEGRATORS[name].calms and world.model.conservative)


def sweep(probe: Probe, made: Callable[[bool], dict[str, Any]]) -> Iterator[Figure]:
    """Two hundred steps with one row of settings, the start of them twice; sliders move every twenty."""
    row = rows()[probe.seed % len(rows())]
    scene = {**made(any(row["gravity"])), "settings": {**row, "seed": probe.seed, "tangled": "keep"}}
    twin, first = started(probe, scene), started(probe, scene)  # the last is kept of a failure
    watch, changed, differs, together = Watch(first), 0, 0, True
    world, rest = first.world, first.world.positions.copy()
    for k in range(STEPS):
        if k and k % EVERY == 0:
            world.update(**move(probe.random))
            watch.look()
        calms, before = calming(world), world.snapshot()
        try:
            watch.step()
            stopped = False
        except StepError:
            stopped = True
            changed += not alike(before, world.snapshot())
            if calms:
                raise
        together = together and k < AGAIN
        if together:
            with contextlib.suppress(StepError):
                twin.step()
            differs += not alike(world.snapshot(), twin.world.snapshot())
        if stopped or (not calms and np.abs(world.velocities).max() > BLOWN_UP):
            world.place(rest)
            world.update(dt=1e-3, integrator="backward_euler")
            watch.look()
            together = False
    yield at_most("numbers that are none", 0.0, 0.0)
    yield at_most("refused steps that changed the state", changed, 0.0)
    yield at_most("steps with impulses that tangled cloth", watch.tangled, 0.0)
    yield at_most("vertices that got inside obstacles with impulses, summed over steps", watch.inside, 0.0)
    yield at_most("rise of the potential in steps that descend, relative", max(watch.descent, -1.0), DESCENT)
    yield at_most("momentum lost in a step of free cloth, over what rounding may take", watch.drift, 1.0)
    yield at_most("first steps that differ in some bit when taken again", differs, 0.0)
    yield reported("steps judged for tangles", watch.judged)
    yield reported("steps judged for descent", watch.bounded)


SUMS = 100.0
"""Roundings that add up in a solve: of as many iterations, or of the two stages and ten Newton iterations."""

FREE = 1e-10
"""Part of Σ m|v| + h Σ|f| that free cloth may lose of its momentum in a step, if it is of a common sort."""


def started(probe: Probe, scene: dict[str, Any]) -> Trial:
    """The simulation that a run begins with, all of whose vertices move."""
    trial = probe.start(scene)
    random = np.random.default_rng(probe.seed)
    trial.world.place(trial.world.positions, random.uniform(-0.5, 0.5, trial.world.positions.shape))
    return trial


def alike(a: Snapshot, b: Snapshot) -> bool:
    """Whether two states are the same to the bit."""
    return bool((a.positions == b.positions).all() and (a.velocities == b.velocities).all())


def move(random: np.random.Generator) -> dict[str, Any]:
    """A setting at random and another value of it; sliders go anywhere between their ends."""
    known = levels()
    name = list(known)[random.integers(len(known))]
    field, values = FIELDS[name], known[name]
    if field.slider is None or field.choices is not None:
        return {name: values[random.integers(len(values))]}
    low, high = field.slider
    part = random.random()
    value = low * (high / low) ** part if field.scale == "log" else low + part * (high - low)
    return {name: field.clamp(value)}


def register(name: str, made: Callable[[bool], dict[str, Any]]) -> None:
    """A case for one of the meshes."""
    what = " ".join((made.__doc__ or "").rstrip(".\n ").split())

    def run(probe: Probe) -> Iterator[Figure]:
        """One run for each row of a pairwise-covering array: 200 steps, with a slider moved every 20."""
        yield from sweep(probe, made)

    run.__module__ = __name__
    title = what[:1].lower() + what[1:]
    case(f"sweep-{name}", f"all settings: {title}", seconds=2.0, runs=len(rows()), short=SHORT)(run)


SHORT = 6
"""Rows of the array that the short battery takes."""

for _name, _made in MESHES.items():
    register(_name, _made)
