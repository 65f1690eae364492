"""Triangle meshes from files: which file, what it holds (sim/meshparse.py), and whether that can be cloth.

A file is data from somebody else's program, or from somebody else: it must lie in the scene's own folder, be
of a modest size, and name no other file. Vertices keep the order of the file, so that pins can name them.
"""

from __future__ import annotations

import numpy as np

from sim.given import FARTHEST, SMALLEST
from sim.meshclaims import declared_counts, mesh_bytes, mesh_path
from sim.meshparse import Arrays, parse
from sim.refusal import counted
from sim.repair import repair_triangles, used_vertices

HUGE = 100.0
"""Cloth larger than this [m] is possible, but most likely measured in millimetres."""

MILLIMETRES = "looks like millimetres: scale = 0.001?"


def read_mesh(file: str, folder: str, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Read and repair a mesh.

    Args:
        file: Path of the file, relative to `folder` and inside it.
        folder: The scene's folder.
        scale: Metres per unit of the file.

    Returns:
        (n, 3) float64 vertices [m], (m, 3) int32 triangles wound alike, and a line for each repair.

    Raises:
        ValueError: one line that says what is wrong with the file.
    """
    path = mesh_path(file, folder)
    data = mesh_bytes(path, file)
    suffix = path.suffix.lower()
    try:
        declared_counts(data, suffix)
        vertices, triangles, polygons = parse(data, suffix)
        _check_indices(vertices, triangles)
        with np.errstate(over="ignore"):  # what is too far away is refused below
            vertices = vertices * scale
        _check_reach(vertices, triangles)
        if suffix == ".stl":
            vertices, triangles = _welded(vertices, triangles)
        triangles, warnings = repair_triangles(vertices, triangles)
        if len(triangles) == 0:
            raise ValueError("expected triangles, got none with an area")
        vertices, triangles, left_out = used_vertices(vertices, triangles)
        if polygons:
            warnings.insert(0, f"cut {counted(polygons, 'polygon')} into triangles")
        return vertices, triangles.astype(np.int32), _size_warnings(vertices) + warnings + left_out
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


# Checks


def _check_indices(vertices: np.ndarray, triangles: np.ndarray) -> None:
    if len(triangles) == 0:
        raise ValueError("expected triangles, got none")
    if len(vertices) == 0:
        raise ValueError("expected vertices, got none")
    wrong = ((triangles < 0) | (triangles >= len(vertices))).any(axis=1)
    if wrong.any():
        face = int(np.argmax(wrong))
        raise ValueError(
            f"triangle {face}: expected vertices 0 to {len(vertices) - 1}, got {triangles[face].tolist()}"
        )
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        vertex = int(np.argmin(finite))
        raise ValueError(f"vertex {vertex}: expected finite numbers, got {vertices[vertex].tolist()}")


def _welded(vertices: np.ndarray, triangles: np.ndarray) -> Arrays:
    """One vertex for all corners at exactly the same place, numbered as they first appear.

    An .stl repeats each vertex in every triangle, to the same bits.
    """
    places, first, which = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    number = np.empty(len(places), dtype=np.int64)
    number[order] = np.arange(len(places))
    return places[order], number[which.ravel()][triangles]


def _check_reach(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Refuse what is so far away that no area could be told; vertices that no triangle uses are left out."""
    farthest = np.abs(vertices[triangles]).max(axis=2, initial=0.0)
    if (worst := float(farthest.max())) > FARTHEST:
        vertex = int(triangles.ravel()[np.argmax(farthest)])
        expected = f"vertex {vertex}: expected coordinates within ±{FARTHEST:g} m"
        raise ValueError(f"{expected}, got {worst:g} ({MILLIMETRES})")


def _size_warnings(vertices: np.ndarray) -> list[str]:
    """Refuse a size that cannot be meant; warn of one that is likely a matter of units."""
    size = float(np.ptp(vertices, axis=0).max())
    if size < SMALLEST:
        raise ValueError(f"expected a size of at least {SMALLEST:g} m, got {size:g} (scale = 1000?)")
    return [f"{size:,.0f} m across ({MILLIMETRES})"] if size > HUGE else []
