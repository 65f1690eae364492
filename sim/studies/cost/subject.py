"""What all runs of a study share: scene, chosen settings, times of looks, masses and size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import asdict

from sim.scene import Scene
from sim.settings import Settings
from sim.simulation import Simulation
from sim.studies.cost.measures import distances, size
from sim.studies.cost.trace import Case, Trace


@dataclass(frozen=True)
class Subject:
    """What a study is about.

    Attributes:
        scene: What is simulated.
        chosen: The settings that the study is about.
        every: Time from look to look [s].
        masses: (n,) [kg].
        length: L, of the cloth [m].
    """

    scene: Scene
    chosen: Settings
    every: float
    masses: np.ndarray
    length: float

    @classmethod
    def of(cls, scene: Scene, chosen: Settings, every: float) -> Subject:
        """Build the cloth once, for its masses and its size."""
        world = Simulation(scene, **asdict(chosen))
        return cls(scene, chosen, every, world.masses.copy(), size(world))

    def case(
        self, settings: dict[str, Any], looks: int, *nudges: tuple[float, int], limit: float = math.inf
    ) -> Case:
        """A run whose settings differ from the chosen ones."""
        return Case(self.scene, {**asdict(self.chosen), **settings}, self.every, looks, nudges, limit)

    def apart(self, one: Trace, other: Trace, look: int) -> np.ndarray:
        """(look + 1,) distances e_x of two runs."""
        until = slice(look + 1)
        return distances(one.positions[until], other.positions[until], self.masses, self.length)


def differences(trace: Trace, truth: Trace, look: int) -> dict[str, float]:
    """By how much observables differ at a look, in their own units."""
    return {
        name: float(values[look] - truth.observables[name][look])
        for name, values in trace.observables.items()
    }
