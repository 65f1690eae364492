"""Arrays that a scene made in code gives, checked; what is wrong with one is a SceneError of one line."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from sim.scene import SceneError

FARTHEST = 1e4
"""Coordinates beyond this [m] are refused: at that size a millimetre is lost in rounding."""

SMALLEST = 1e-4
"""Meshes smaller than this [m] are refused."""

LIGHTEST, HEAVIEST = 1e-18, 1e18
"""Masses [kg] beyond which squares and inverses are no numbers to reckon with."""


def points(value: Any, where: str) -> np.ndarray:
    """(n, 3) float64 points [m], at least one."""
    array = numbers(value, 3, where)
    if len(array) == 0:
        raise SceneError(f"{where}: expected at least one vertex, got none")
    far = np.abs(array).max(axis=1)
    if far.max() > FARTHEST:
        row = int(np.argmax(far))
        raise SceneError(f"{where}[{row}]: expected coordinates within ±1e4 m, got {far[row]:g}")
    return array


def numbers(value: Any, width: int, where: str) -> np.ndarray:
    """Finite float64 numbers (n, width), or (n,) for a width of zero."""
    return _rows(value, width, where).astype(float)


def masses(value: Any, n: int, where: str) -> np.ndarray:
    """(n,) float64 masses [kg]."""
    array = numbers(value, 0, where)
    if len(array) != n:
        raise SceneError(f"{where}: expected {n} masses, got {len(array)}")
    wrong = ~((array >= LIGHTEST) & (array <= HEAVIEST))
    if wrong.any():
        row = int(np.argmax(wrong))
        allowed = f"≥ {LIGHTEST:g} and ≤ {HEAVIEST:g} kg"
        raise SceneError(f"{where}[{row}]: expected {allowed}, got {array[row]:g}")
    return array


def check_size(vertices: np.ndarray, where: str) -> None:
    """Refuse a shape that is likely in other units: springs on it would be beyond all bounds.

    All vertices in one place are a collapsed cloth, which is something else.
    """
    if 0.0 < (size := float(np.ptp(vertices, axis=0).max())) < SMALLEST:
        raise SceneError(f"{where}: expected a size of at least {SMALLEST:g} m, got {size:g}")


def indices(value: Any, width: int, n: int, where: str) -> np.ndarray:
    """(m, width) int64 indices of n vertices, distinct in each row; none for what was left out."""
    if value is None:
        return np.zeros((0, width), dtype=np.int64)
    array = _rows(value, width, where)
    wrong = (array != np.floor(array)) | (array < 0) | (array >= n)
    ordered = np.sort(array, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    for bad, reason in (
        (wrong.any(axis=1), f"vertex indices from 0 to {n - 1}"),
        (repeated, "distinct vertices"),
    ):
        if bad.any():
            row = int(np.argmax(bad))
            raise SceneError(f"{where}[{row}]: expected {reason}, got {array[row].tolist()}")
    return array.astype(np.int64)


def _rows(value: Any, width: int, where: str) -> np.ndarray:
    """Finite numbers of any type (n, width), or (n,) for a width of zero; nothing else is taken for one."""
    shape, expected = (width,) if width else (), f"{width or 'a'} finite number{'s' if width else ''}"
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.zeros(0, dtype=object)
    if array.size == 0 and array.dtype != object:
        return np.zeros((0, *shape))
    if array.ndim and array.shape[1:] == shape and array.dtype.kind in "iuf" and np.isfinite(array).all():
        return array
    for row, each in enumerate(value if isinstance(value, list | tuple | np.ndarray) else ()):
        if not _is_row(each, shape):
            raise SceneError(f"{where}[{row}]: expected {expected}, got {reprlib.repr(each)}")
    raise SceneError(f"{where}: expected rows of {expected}, got {reprlib.repr(value)}")


def _is_row(value: Any, shape: tuple[int, ...]) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:
        return False
    return array.shape == shape and array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
