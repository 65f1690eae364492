"""The same cloth on a mesh twice as fine, or half: every vertex of the coarser one is one of the finer.

Grids get other rows and columns; of any other mesh each triangle is cut into four alike, at the middles of
its sides, which cannot be undone.

An edge spring of stiffness k has the constant k/l₀, and halving l₀ puts twice as many beside each other: for
the same stiffness per width, k is halved. A hinge's rest angle bends what is half as long, so it is halved
for the same curvature. Bending stiffness and density do not depend on the mesh; the damping ratio is that of
each spring, so what it damps of the whole does, a little.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec.structs import replace

from sim.mesh import build_mesh, edge_numbers, sides_of, triangles_at
from sim.scene import MAX_VERTICES, Arrays, Grid, Scene
from sim.settings import Settings


def nested(scene: Scene, settings: Settings, level: int) -> tuple[Scene, dict[str, Any]] | None:
    """The scene with its cloth 2^level times as fine, and the settings that make it the same cloth.

    Args:
        scene: Its cloth must be grids, or for level 1 triangle meshes without links or masses of their own.
        settings: In force.
        level: −1 for half as fine, 1 for twice.

    Returns:
        None where the cloth has no such mesh.
    """
    part = 2.0**level
    cloth, total = [], 0
    for piece in scene.cloth:
        finer = None
        if isinstance(piece, Grid):
            finer = _grid(piece, part)
        elif level == 1:
            finer = _quartered(scene, piece)
        if finer is None:
            return None
        cloth.append(finer)
        total += finer.resolution[0] * finer.resolution[1] if isinstance(finer, Grid) else len(finer.vertices)
    if total > MAX_VERTICES:
        return None
    changes = {name: getattr(settings, name) / part for name in ("stretch", "altitude", "rest_angle")}
    if abs(changes["rest_angle"]) > math.pi:
        return None
    return replace(scene, cloth=cloth), changes


def _quartered(scene: Scene, cloth: Any) -> Arrays | None:
    """A piece with each triangle cut into four; sides that are pinned by name are pinned all along."""
    alone = replace(scene, cloth=[cloth], obstacle=[])
    mesh = build_mesh(alone)
    n, sides = len(mesh.vertices), sides_of(mesh.triangles, len(mesh.vertices))
    if len(sides) < len(mesh.edges) or not np.isnan(mesh.given_masses).all():
        return None
    named = replace(cloth, pins=[pin for pin in cloth.pins if isinstance(pin, str)])
    held = build_mesh(replace(alone, cloth=[named])).pinned
    border = triangles_at(sides, mesh.triangles, n) == 1
    along = np.flatnonzero(border & np.isin(sides, held).all(axis=1))
    numbers = edge_numbers(sides, n)

    def middles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return n + np.searchsorted(numbers, edge_numbers(np.stack([a, b], axis=1), n))

    a, b, c = mesh.triangles.T
    ab, bc, ca = middles(a, b), middles(b, c), middles(c, a)
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return Arrays(
        name=cloth.name,
        density=cloth.density,
        vertices=_with_middles(mesh.vertices, sides),
        rest_vertices=_with_middles(mesh.rest_vertices, sides),
        triangles=np.concatenate([np.stack(corners, axis=1) for corners in quarters]),
        pins=[*mesh.pinned.tolist(), *(n + along).tolist()],
    )


def _with_middles(points: np.ndarray, sides: np.ndarray) -> np.ndarray:
    return np.concatenate([points, points[sides].mean(axis=1)])


def _grid(cloth: Grid, part: float) -> Grid | None:
    nx, ny = cloth.resolution
    intervals = part * (nx - 1), part * (ny - 1)
    if min(intervals) < 2.0 or any(count % 1.0 for count in intervals):
        return None
    resolution = int(intervals[0]) + 1, int(intervals[1]) + 1
    pins: list[int | str] = []
    for pin in cloth.pins:
        if isinstance(pin, str):
            pins.append(pin)
            continue
        row, column = divmod(pin, nx)
        if (part * row) % 1.0 or (part * column) % 1.0:
            return None
        pins.append(int(part * row) * resolution[0] + int(part * column))
    return replace(cloth, resolution=resolution, pins=pins)
