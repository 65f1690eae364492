"""Small scenes as dicts, for cases of the battery and for tests."""

from __future__ import annotations

from typing import Any

import numpy as np


def grid(size=(1.0, 1.0), resolution=(8, 8), **more) -> dict[str, Any]:
    """A grid cloth."""
    return {"kind": "grid", "size": list(size), "resolution": list(resolution), **more}


def scene(cloth, *obstacles, **settings) -> dict[str, Any]:
    """A scene without gravity; cloth is not felt by cloth, unless the settings say so of all of it."""
    own = settings.get("self_collision", "off")
    usual = {"gravity": [0, 0, 0], "self_collision": own, "cloth_collision": own}
    return {"cloth": cloth, "obstacle": list(obstacles), "settings": {**usual, **settings}}


def ball(center=(0.0, 0.0, 0.0), radius=0.3, **more) -> dict[str, Any]:
    """A sphere."""
    return {"kind": "sphere", "center": list(center), "radius": radius, **more}


def chain(points, masses, **more) -> dict[str, Any]:
    """Vertices joined by edges one after another."""
    n = len(points)
    edges = [[i, i + 1] for i in range(n - 1)]
    return {"vertices": np.asarray(points, float).tolist(), "edges": edges, "masses": list(masses), **more}


def irregular(seed=0, count=60, noise=0.03) -> dict[str, Any]:
    """A crumpled irregular mesh: Delaunay of random points, moved out of its plane; its rest is flat."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    flat = rng.uniform(-0.5, 0.5, (count, 2))
    triangles = Delaunay(flat).simplices
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    turned = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0
    triangles[turned] = triangles[turned][:, ::-1]
    rest = np.column_stack([flat, np.zeros(count)])
    crumpled = rest * 0.9 + noise * rng.standard_normal((count, 3))
    return {"vertices": crumpled.tolist(), "rest_vertices": rest.tolist(), "triangles": triangles.tolist()}
