"""A picture of cloth and obstacles as SVG, for pages that nobody turns about."""

from __future__ import annotations

from html import escape

import numpy as np

from server.palette import GROUND, INK, STONE, VARIANTS, WHITE, Rgb
from server.shapes import capsule, obstacle_mesh
from sim.scene import Capsule, Obstacle, Sphere
from sim.shells import Shell
from sim.stress.probe import Picture

WIDTH, HEIGHT = 320, 240
"""Of a picture [CSS px]."""

EYE = np.array([1.0, -1.7, 0.9])
"""Where one looks from: a direction, as there is no perspective."""

LIGHT = np.array([0.3, -0.5, 0.8])
"""Where light comes from."""

MARGIN = 0.12
"""Part of a picture that is left about the cloth."""

PARTS = 12
"""Of an edge without triangles."""

ROUND = 9
"""Rings of a sphere."""

PIECES = 10
"""Obstacles are cut into triangles of at most the cloth's size over this, to hide what is behind them."""


def drawing(picture: Picture, title: str) -> str:
    """An SVG element of what the cloth covers, seen from aside; obstacles beyond that are cut off."""
    size = max(float(np.ptp(picture.positions, axis=0).max()), 1e-3)
    center = 0.5 * (picture.positions.min(axis=0) + picture.positions.max(axis=0))
    parts = [_cloth(picture)]
    parts += [_obstacle(*placed, center, size) for placed in picture.obstacles]
    corners = np.concatenate([part[0] for part in parts])
    colors = [color for part in parts for color in part[1]]
    view = _view()
    flat = (corners - center) @ view.T
    shown = (picture.positions - center) @ view.T
    scale, middle = _fitted(shown[:, :2])
    points = np.round((flat[:, :, :2] - middle) * [scale, -scale] + [WIDTH / 2, HEIGHT / 2], 1)
    shapes = [_shape(*about) for about in zip(points, colors, strict=True)]
    depths = flat[:, :, 2].mean(axis=1).tolist()
    for thread in _threads(picture):
        ends = shown[thread]
        a, b = (ends[:, :2] - middle) * [scale, -scale] + [WIDTH / 2, HEIGHT / 2]
        for k in range(PARTS):  # in parts, of which some may be hidden
            near, far = k / PARTS, (k + 1) / PARTS
            depths.append(float(ends[0, 2] + 0.5 * (near + far) * (ends[1, 2] - ends[0, 2])))
            shapes.append(_line(a + near * (b - a), a + far * (b - a)))
    shapes = [shapes[k] for k in np.argsort(depths, kind="stable")]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" stroke-linejoin="round" stroke-width=".5">'
        f"<title>{escape(title)}</title>{''.join(shapes)}</svg>"
    )


def _view() -> np.ndarray:
    """Rows that point to the right, up and to the eye."""
    toward = EYE / np.linalg.norm(EYE)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward])


def _fitted(points: np.ndarray) -> tuple[float, np.ndarray]:
    """Pixels per metre, and what is in the middle."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 1e-6)
    return float(((1.0 - 2.0 * MARGIN) * np.array([WIDTH, HEIGHT]) / extent).min()), 0.5 * (low + high)


def _cloth(picture: Picture) -> tuple[np.ndarray, list[str]]:
    corners = picture.positions[picture.triangles]
    facing = _normals(corners) @ EYE > 0.0
    tones = _shaded(corners, both=True)
    held = np.all(picture.held[picture.triangles], axis=1).tolist()
    sides = [
        STONE if fixed else VARIANTS[0 if front else 1] for front, fixed in zip(facing, held, strict=True)
    ]
    return corners, [_tone(side, tone) for side, tone in zip(sides, tones, strict=True)]


def _obstacle(
    obstacle: Obstacle,
    shell: Shell | None,
    position: np.ndarray,
    rotation: np.ndarray,
    center: np.ndarray,
    size: float,
) -> tuple[np.ndarray, list[str]]:
    """The sides that one sees, cut up, near the cloth."""
    from trimesh.remesh import subdivide_to_size

    if isinstance(obstacle, Sphere | Capsule):
        half = (
            0.5 * np.linalg.norm(np.subtract(obstacle.end, obstacle.start))
            if isinstance(obstacle, Capsule)
            else 0
        )
        vertices, triangles = capsule(np.array([0.0, 0.0, half]), obstacle.radius, ROUND)
    else:
        vertices, triangles = obstacle_mesh(obstacle, shell)
    longest = max(size, 0.1 * float(np.ptp(vertices, axis=0).max())) / PIECES
    vertices, triangles = subdivide_to_size(vertices.astype(float), triangles, longest, max_iter=12)[:2]
    corners = (vertices @ rotation.T + position)[triangles]
    near = np.abs(corners.mean(axis=1) - center).max(axis=1) < 1.5 * size
    corners = corners[near & (_normals(corners) @ EYE > 0.0)]
    return corners, [_tone(STONE, tone) for tone in _shaded(corners, both=False)]


def _normals(corners: np.ndarray) -> np.ndarray:
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]


def _shaded(corners: np.ndarray, both: bool) -> np.ndarray:
    """How light each triangle is, 0 to 1; `both` sides of cloth are lit."""
    lit = _normals(corners) @ (LIGHT / np.linalg.norm(LIGHT))
    return np.abs(lit) if both else 0.5 + 0.5 * lit


def _tone(color: Rgb, lit: float) -> str:
    return color.toward(INK, 0.45 * (1.0 - lit)).toward(WHITE, 0.3 * lit).css


def _shape(points: np.ndarray, color: str) -> str:
    corners = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polygon points="{corners}" fill="{color}" stroke="{color}"/>'


def _line(a: np.ndarray, b: np.ndarray) -> str:
    (x, y), (u, v) = np.round([a, b], 1).tolist()
    return f'<line x1="{x:g}" y1="{y:g}" x2="{u:g}" y2="{v:g}" stroke="{INK.css}" stroke-width="1.5"/>'


def _threads(picture: Picture) -> list[list[int]]:
    """Edges that belong to no triangle."""
    sides = np.sort(picture.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    known = {tuple(side) for side in sides.tolist()}
    return [edge for edge in np.sort(picture.edges, axis=1).tolist() if tuple(edge) not in known]


BACKGROUND = GROUND.toward(WHITE, 0.65).css
"""What is behind a picture."""
