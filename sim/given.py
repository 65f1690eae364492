"""Arrays that a scene made in code gives, checked; what is wrong with one is a SceneError of one line."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim.scene import SceneError

FARTHEST = 1e4
"""Coordinates beyond this [m] are refused: at that size a millimetre is lost in rounding."""


def points(value: Any, where: str) -> np.ndarray:
    """(n, 3) float64 points [m], at least one."""
    array = numbers(value, 3, where)
    if len(array) == 0:
        raise SceneError(f"{where}: expected at least one vertex, got none")
    if np.abs(array).max() > FARTHEST:
        raise SceneError(f"{where}: expected coordinates within ±1e4 m, got {np.abs(array).max():g}")
    return array


def numbers(value: Any, width: int, where: str) -> np.ndarray:
    """Finite float64 numbers (n, width), or (n,) for a width of zero."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{where}: expected numbers, got {error}") from None
    shape = f"(n, {width})" if width else "(n,)"
    if array.ndim != (2 if width else 1) or (width and array.shape[1] != width):
        raise SceneError(f"{where}: expected an array of shape {shape}, got {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        row = int(np.argwhere(~finite)[0][0])
        raise SceneError(f"{where}[{row}]: expected finite numbers, got {array[row].tolist()}")
    return array


def indices(value: Any, width: int, n: int, where: str) -> np.ndarray:
    """(m, width) int64 indices of n vertices, distinct in each row; none for what was left out."""
    if value is None or np.size(value) == 0:
        return np.zeros((0, width), dtype=np.int64)
    array = numbers(value, width, where)
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
