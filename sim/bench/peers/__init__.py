"""Other simulators of cloth, and Muslin itself, as the bench sees them.

A peer is a module here and one line in the registry below. The module has

    FRAMES: Sequence[Knobs]           settings to time; the first is what the peer's own examples recommend
    LADDER: Iterable[Knobs]           ever more accurate settings, each about twice as dear as the one before
    OTHERS: Sequence[Knobs]           further settings that may reach an accuracy for less
    start(sheet, knobs, threads)      a `Run` of a sheet, ready to step

and may import its package at its top: it is imported only where that is installed.

This module imports no numba and no peer: listing peers must be quick.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np

Knobs = Mapping[str, int | str]
"""Settings of a peer that decide its accuracy, by name: substeps of a frame, iterations, and methods."""

EXTRA = "peers"
"""The extra of Muslin's package that installs them all."""


class Run(Protocol):
    """A sheet in a peer."""

    def frame(self) -> None:
        """Go on by one frame."""
        ...

    def positions(self) -> np.ndarray:
        """(n, 3) [m], in the order of the sheet's mesh."""
        ...


@dataclass(frozen=True)
class Peer:
    """What there is to know of a peer before it runs.

    Attributes:
        module: Import path of its module.
        packages: What must be installed, by the names that are imported.
        note: What differs from Muslin's sheet, and how many cores it uses.
        settings: How many FRAMES its module has.
    """

    module: str
    packages: Sequence[str]
    note: str
    settings: int = 1

    def load(self) -> Any:
        """Its module, imported on first use."""
        return importlib.import_module(self.module)

    @property
    def missing(self) -> tuple[str, ...]:
        """What must be installed and is not."""
        return tuple(package for package in self.packages if find_spec(package) is None)


MUSLIN = "Muslin"
"""The name that the others are compared with."""

MUSLIN_AS_PEER = Peer(
    "sim.bench.peers.muslin",
    (),
    "Muslin: spring constants as above, one linearised backward-Euler step a frame, impulses.",
)

PEERS: dict[str, Peer] = {
    "MuJoCo flex": Peer(
        "sim.bench.peers.mujoco_flex",
        ("mujoco",),
        "MuJoCo: its flex grid with finite elements that stretch and bend (Young's modulus × thickness = "
        "the spring constant, Poisson's ratio 0.2), and the time step, solver, damping and contact of its "
        "shipped drape example; self-collision off; one core.",
        settings=2,
    ),
    "Taichi springs": Peer(
        "sim.bench.peers.taichi_springs",
        ("taichi",),
        "Taichi: it has no cloth library, so this is a mass-spring sheet written for this bench after the "
        "method of its implicit example: the same edges, no altitude or bending springs, one linearised step "
        "a frame with its sparse direct solver; the sphere pushes vertices out and takes their inward "
        "velocity after the step; one core in the solver.",
    ),
    "Newton VBD": Peer(
        "sim.bench.peers.newton_vbd",
        ("newton", "warp"),
        "Newton VBD: the same mesh with its triangle and hinge elements, substeps, iterations and damping as "
        "in its hanging-cloth example, self-contact off; single precision, on the CPU, which is not what it "
        "was made for; one core.",
    ),
    "Newton XPBD": Peer(
        "sim.bench.peers.newton_xpbd",
        ("newton", "warp"),
        "Newton XPBD: the same mesh with its springs on edges (the same constant, undamped). The 10 substeps "
        "of 10 iterations of its hanging-cloth example, whose particles are far heavier, diverge on this "
        "sheet; 160 of 1 hold at 1,024 vertices, but not at 4,096. Single precision, on the CPU; one core.",
    ),
    "Newton Style3D": Peer(
        "sim.bench.peers.newton_style3d",
        ("newton", "warp"),
        "Newton Style3D: the same mesh with its woven material (warp and weft 1000, shear 100 N/m), substeps "
        "and iterations as in its hanging-cloth example; single precision, on the CPU; one core.",
    ),
}


def version_of(package: str) -> str:
    """The installed version of what is imported as `package`; "" where there is none."""
    for name in (package, f"{package}-lang"):  # Warp's distribution is not named like its module
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""


def words(knobs: Knobs) -> str:
    """Settings as people read them: substeps × iterations, and what is not a number."""
    numbers = [str(value) for value in knobs.values() if isinstance(value, int)]
    return " ".join(["×".join(numbers), *(str(value) for value in knobs.values() if isinstance(value, str))])
