"""The same cloth on a mesh twice as fine, or half: every vertex of the coarser one is one of the finer.

An edge spring of stiffness k has the constant k/l₀, and halving l₀ puts twice as many beside each other: for
the same stiffness per width, k is halved. Bending stiffness and density do not depend on the mesh; the
damping ratio is that of each spring, so what it damps of the whole does, a little.
"""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from sim.scene import MAX_VERTICES, Grid, Scene
from sim.settings import Settings


def nested(scene: Scene, settings: Settings, level: int) -> tuple[Scene, dict[str, Any]] | None:
    """The scene with its grids 2^level times as fine, and the stiffnesses that make it the same cloth.

    Args:
        scene: Its cloth must be grids.
        settings: In force.
        level: −1 for half as fine, 1 for twice.

    Returns:
        None where the cloth is no grid, or has no such mesh.
    """
    if not all(isinstance(cloth, Grid) for cloth in scene.cloth):
        return None
    part = 2.0**level
    cloth = [_grid(piece, part) for piece in scene.cloth if isinstance(piece, Grid)]
    if None in cloth or sum(c.resolution[0] * c.resolution[1] for c in cloth if c) > MAX_VERTICES:
        return None
    stiffness = {"stretch": settings.stretch / part, "altitude": settings.altitude / part}
    return replace(scene, cloth=cloth), stiffness


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
