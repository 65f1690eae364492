"""Rotation vectors: axis times angle [rad]."""

import numpy as np


def rotation_matrix(vector: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """The (3, 3) matrix that turns about `vector` by its length [rad] (Rodrigues 1840)."""
    vector = np.asarray(vector, dtype=float)
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
