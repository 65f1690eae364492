"""One variant's cloth as the 3-D view shows it: sheets of triangles, and strands where there are none."""

from __future__ import annotations

import numpy as np
import viser

from server.palette import INK, STONE, WHITE, Rgb
from server.shapes import capsule
from sim.mesh import Mesh, bare_edges

THREAD, BALL = 0.012, 0.018
"""Thickness of a strand and radius of the balls on it, as shares of the scene's scale."""

CLOSE = 0.3
"""Largest radius of a ball as a share of the median edge: on a fine chain they stay apart."""

BALL_DETAIL = 8
"""How finely a ball is drawn: there may be thousands."""

PIN = 0.012
"""Size [m] of the dots on pinned vertices of a sheet."""


def bare_vertices(mesh: Mesh) -> np.ndarray:
    """(k,) vertices that end such an edge, or belong to no triangle; sorted."""
    loose = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.triangles)
    return np.union1d(bare_edges(mesh), loose).astype(int)


TINT, DARKEST = 0.22, 0.5
"""How much darker each piece is than the one before it, and the last one at most: layers are told apart."""


class Sheets:
    """The triangles of one piece: each side in its own tone, and, if wanted, their edges as fine lines."""

    def __init__(self, api: viser.SceneApi, root: str, mesh: Mesh, color: Rgb, piece: int = 0):
        own = np.flatnonzero(mesh.pieces == piece)
        self._own = slice(own[0], own[-1] + 1)
        number, vertices = piece or "", mesh.vertices[self._own]
        faces = mesh.triangles[mesh.pieces[mesh.triangles[:, 0]] == piece] - own[0]
        # Two meshes, one per side, since viser's have one colour: the reverse is paler, as in printed cloth.
        # Neither receives shadows: cloth this thin only shows the map's resolution, as stripes.
        side = {"receive_shadow": False, "faces": faces, "vertices": vertices}
        self._face = api.add_mesh_simple(f"{root}/cloth{number}", color=color, side="front", **side)
        self._reverse = api.add_mesh_simple(
            f"{root}/reverse{number}",
            color=color.toward(WHITE, 0.5).toward(STONE, 0.2),
            side="back",
            cast_shadow=False,
            **side,
        )
        self._lines = api.add_mesh_simple(
            f"{root}/lines{number}",
            color=color.toward(INK, 0.6),
            wireframe=True,
            opacity=0.35,
            cast_shadow=False,
            visible=False,
            **side,
        )
        pins = mesh.vertices[np.intersect1d(mesh.pinned, faces + own[0])].astype(np.float32)
        if len(pins):
            api.add_point_cloud(
                f"{root}/pins{number}", pins, INK, point_size=PIN, point_shape="circle", precision="float32"
            )

    def move(self, positions: np.ndarray) -> None:
        """Show the cloth with all vertices of the scene at positions (n, 3) [m]."""
        self._face.vertices = self._reverse.vertices = positions[self._own]
        if self._lines.visible:
            self._lines.vertices = positions[self._own]

    def show_lines(self, visible: bool) -> None:
        """Draw the edges, or not."""
        self._lines.visible = visible


class Strands:
    """What has no triangle: edges as thick lines, with a ball at every vertex; pinned ones are dark."""

    def __init__(self, api: viser.SceneApi, root: str, mesh: Mesh, color: Rgb, scale: float):
        self._edges, self._vertices = bare_edges(mesh), bare_vertices(mesh)
        ends = mesh.vertices[self._edges]
        if len(ends):
            self._lines = api.add_line_segments(f"{root}/strands", ends, color, thickness=THREAD * scale)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        room = CLOSE * float(np.median(lengths)) if len(lengths) else np.inf
        radius = max(min(BALL * scale, room), 0.5 * THREAD * scale)
        ball, triangles = capsule(np.zeros(3), radius, BALL_DETAIL)
        pinned = np.isin(self._vertices, mesh.pinned)[:, None]
        self._balls = api.add_batched_meshes_simple(
            f"{root}/balls",
            ball,
            triangles,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(self._vertices), 1)),
            batched_positions=mesh.vertices[self._vertices],
            batched_colors=np.where(pinned, INK, color).astype(np.uint8),
            lod="off",
            receive_shadow=False,
        )

    def move(self, positions: np.ndarray) -> None:
        """Show vertices at positions (n, 3) [m]."""
        if len(self._edges):
            self._lines.points = positions[self._edges]
        self._balls.batched_positions = positions[self._vertices]

    def show_lines(self, visible: bool) -> None:
        """Strands are lines already."""


def draw_cloth(
    api: viser.SceneApi, root: str, mesh: Mesh, color: Rgb, scale: float
) -> list[Sheets | Strands]:
    """Add what a cloth consists of to the scene, under the node `root`.

    Args:
        api: The scene.
        root: Name of the node.
        mesh: The cloth, where it starts.
        color: The variant's.
        scale: By which thickness is measured [m].
    """
    parts: list[Sheets | Strands] = []
    sheets = np.unique(mesh.pieces[mesh.triangles[:, 0]])
    for k, piece in enumerate(sheets):
        tint = color.toward(INK, min(TINT, DARKEST / max(len(sheets) - 1, 1)) * k)
        parts.append(Sheets(api, root, mesh, tint, int(piece)))
    if len(bare_vertices(mesh)):
        parts.append(Strands(api, root, mesh, color, scale))
    return parts
