"""Everything that can be said of a scene before it runs: what was repaired, and what is likely a mistake.

Needs neither numba nor scipy, so that `muslin check` answers at once.
"""

from __future__ import annotations

import numpy as np

from sim.clearance import clearance_warnings, crossing_warnings
from sim.mesh import Mesh, build_mesh
from sim.placement import pose
from sim.refusal import counted, listed
from sim.scene import Scene
from sim.settings import Settings

SLIVER = np.radians(1.0)
"""Triangles with an angle below this [rad] are counted: springs on them are stiff, and their hinges jumpy."""

TURN = 1e-3
"""Angle [rad] of a jump that is rounding: four digits of a whole turn leave a fifth of it."""

MEGABYTES, KILOBYTES_OF_VERTEX = 200.0, 12.0
"""Memory that a process with kernels takes, and what each vertex adds where cloth drapes, as measured for
docs/benchmarks.md."""


def memory(mesh: Mesh) -> float:
    """Megabytes, about, that a simulation of `mesh` takes, as known before it is built."""
    return MEGABYTES + 1e-3 * KILOBYTES_OF_VERTEX * len(mesh.vertices)


def check_scene(scene: Scene) -> tuple[Mesh, list[str]]:
    """The mesh of a scene and one line for each thing that its author may want to know.

    Raises:
        SceneError: for cloth that cannot be simulated, or starts across itself where that is refused.
    """
    mesh = build_mesh(scene)
    prefix = f"{scene.source}: "
    warnings = [w.removeprefix(prefix) for w in mesh.warnings]
    warnings += _part_warnings(mesh) + _sliver_warnings(mesh) + _thickness_warnings(mesh, scene.settings)
    warnings += _path_warnings(scene)
    return mesh, warnings + crossing_warnings(mesh, scene) + clearance_warnings(mesh, scene)


def _part_warnings(mesh: Mesh) -> list[str]:
    """Where a piece of cloth is in parts that nothing joins, which is often a seam that was not welded."""
    warnings = []
    for piece in range(int(mesh.pieces.max(initial=-1)) + 1):
        count = len(np.unique(mesh.parts[mesh.pieces == piece]))
        if count > 1:
            warnings.append(f"cloth[{piece}] is in {count:,} parts that nothing joins")
    return warnings


def _path_warnings(scene: Scene) -> list[str]:
    """Where a path that is repeated jumps: what is in its way is thrown off without bound."""
    warnings = []
    for i, obstacle in enumerate(scene.obstacle):
        if not (obstacle.repeat and obstacle.path):
            continue
        (start, begun), (end, ended) = (pose(obstacle, obstacle.path[k].time) for k in (0, -1))
        jumps = f"obstacle[{i}] jumps as its path is repeated: the last key is not"
        if not np.allclose(start, end, rtol=0.0, atol=1e-6):
            warnings.append(f"{jumps} where the first is")
        if not np.allclose(begun, ended, rtol=0.0, atol=TURN):
            warnings.append(f"{jumps} turned as the first is")
    return warnings


def _thickness_warnings(mesh: Mesh, settings: Settings) -> list[str]:
    """Where cloth is to be thicker than half of its shortest edge: it would touch itself where it is flat."""
    ends = mesh.rest_vertices[mesh.edges]
    shortest = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).min(initial=np.inf))
    if settings.contact == "none" or settings.thickness <= 0.5 * shortest:
        return []
    expected = f"expected at most half of the shortest edge of {shortest:.2g} m"
    return [f"thickness: {expected}, got {settings.thickness:g} m; cloth may keep less from itself"]


def _sliver_warnings(mesh: Mesh) -> list[str]:
    corners = mesh.rest_vertices[mesh.triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest_two = np.sort(lengths, axis=1)[:, 1:].prod(axis=1)
    slivers = np.flatnonzero(twice_area < np.sin(SLIVER) * longest_two)
    if not len(slivers):
        return []
    what = counted(len(slivers), "triangle has", "triangles have")
    return [f"{what} an angle below 1°: {listed(slivers)}"]
