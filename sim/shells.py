"""Obstacles that are meshes: read and mended as cloth from a file is, in frames of their own.

A shell is a surface, and cloth feels both of its sides. Only what is inside a closed one can be told, and
nothing but the check of a scene asks for it. NumPy alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim import given
from sim.repair import PINS, repair_triangles, used_vertices
from sim.scene import MAX_VERTICES, Scene, SceneError, ShellArrays, ShellFile


class Shell(NamedTuple):
    """The triangles of an obstacle in its own frame.

    Attributes:
        vertices: (k, 3) float64 [m], each of them used.
        triangles: (m, 3) int32, wound alike within each connected part.
    """

    vertices: np.ndarray
    triangles: np.ndarray

    @property
    def open_edges(self) -> int:
        """How many edges belong to a single triangle; a shell without any is closed."""
        sides = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, count = np.unique(sides, axis=0, return_counts=True)
        return int(np.count_nonzero(count == 1))

    def encloses(self, point: np.ndarray) -> bool:
        """Whether a closed shell goes round `point` (3,) [m], in its own frame.

        It does where the triangles take up the whole sphere of directions seen from there (van Oosterom and
        Strackee 1983, eq. 8).
        """
        corners = self.vertices[self.triangles] - point
        a, b, c = np.moveaxis(corners, 1, 0)
        x, y, z = np.linalg.norm(corners, axis=2).T
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
        angle = np.arctan2(volume, x * y * z + ab * z + bc * x + ca * y).sum()
        return bool(abs(angle) > np.pi)  # half of ±2π, which it is inside; outside it is zero


def read_shells(scene: Scene) -> tuple[tuple[Shell | None, ...], tuple[str, ...]]:
    """The shell of each obstacle, None for those that are no meshes, and a line for each repair.

    Raises:
        SceneError: for arrays or a file that are no mesh, and for too many vertices.
    """
    shells: list[Shell | None] = []
    warnings: list[str] = []
    total = 0
    for i, part in enumerate(scene.obstacle):
        where = f"{scene.source}: obstacle[{i}]"
        shell, found = None, []
        if isinstance(part, ShellFile):
            shell, found = _from_file(part, where, scene.folder)
        elif isinstance(part, ShellArrays):
            shell, found = _from_arrays(part, where)
        shells.append(shell)
        total += 0 if shell is None else len(shell.vertices)
        if total > MAX_VERTICES:
            reason = f"expected meshes of at most {MAX_VERTICES:,} vertices, got {total:,}"
            raise SceneError(f"{scene.source}: obstacle: {reason}")
        warnings += [f"{where}: {line.removesuffix(PINS)}" for line in found]
        if shell is not None and (edges := shell.open_edges):
            warnings.append(f"{where}: {edges:,} open edges; the mesh has no inside")
    return tuple(shells), tuple(warnings)


def _from_file(part: ShellFile, where: str, folder: str) -> tuple[Shell, list[str]]:
    from sim.meshfile import read_mesh

    try:
        vertices, triangles, warnings = read_mesh(part.file, folder, part.scale)
    except ValueError as error:
        raise SceneError(f"{where}.file: {error}") from None
    return Shell(vertices, triangles), warnings


def _from_arrays(part: ShellArrays, where: str) -> tuple[Shell, list[str]]:
    vertices = given.points(part.vertices, f"{where}.vertices")
    triangles = given.indices(part.triangles, 3, len(vertices), f"{where}.triangles")
    triangles, warnings = repair_triangles(vertices, triangles)
    if len(triangles) == 0:
        raise SceneError(f"{where}.triangles: expected triangles, got none with an area")
    vertices, triangles, left_out = used_vertices(vertices, triangles)
    given.check_size(vertices, f"{where}.vertices")
    return Shell(vertices, triangles.astype(np.int32)), warnings + left_out
