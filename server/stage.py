"""The 3-D view: every variant's cloth and obstacles side by side, in one scene under one camera."""

from __future__ import annotations

import weakref
from collections.abc import Callable

import numpy as np
import viser

from server.cloth import draw_cloth
from server.framing import ASPECT, FIELD_OF_VIEW, LABEL_PART, Framing, is_floor
from server.lane import Frame
from server.palette import BLACK, GROUND, STONE, VARIANTS, WHITE
from server.shapes import capsule, obstacle_mesh, quaternion, standing
from server.style import CHART_PART, MOST_BESIDE, PHONE, SHEET_PART
from sim.mesh import Mesh
from sim.scene import Plane, Scene

LABEL, ALARM, MANY = 1.45, 1.7, 0.8
"""Size of labels, as a multiple of viser's: to be read from the back row; smaller for more than two."""

LINE, LINES, MOST_LABELS = 21.0, 5, 0.3
"""Height of a label's line [CSS px], how many to have room for, and the most of a view's height for them."""

LABEL_WIDTH, LEAST = 180.0, 0.5
"""Width of a label [CSS px]; and how many times smaller it may become where a view is narrow."""

FINE = 2.5
"""Pixels of a phone's screen in a CSS pixel: two to three and a half, and it does not say."""

ENLARGED = 1.5
"""Times that labels are larger on a projector: some 27 px at 1280 × 720, a twenty-fifth of the height."""

RESHAPED, MOVED = 0.01, 1e-3
"""Relative change of a view's shape that is one, as sizes are whole pixels; and how far, as part of the
scene's size, a camera is away from where it was put when somebody has moved it."""


def view_of(client: viser.ClientHandle) -> tuple[float, float]:
    """Width and height of a client's view [its screen's px]; its own word, which may be any whole number."""
    return float(client.camera.image_width), float(client.camera.image_height)


def aspect_of(client: viser.ClientHandle) -> float:
    """Width over height of a client's view, within what can be framed."""
    width, height = view_of(client)
    return min(max(width / height, 0.3), 4.0) if height > 0 else ASPECT


def label_size(count: int) -> float:
    """Times that labels are smaller where there are so many variants."""
    return 1.0 if count <= 2 else MANY


class Stage:
    """Draws variants. Clears and redraws everything when another scene or number of variants is `set_up`.

    Args:
        server: Where the page is.
        on_phone: Whether a client is a phone, whose pixels are finer than those that style rules count in.
    """

    def __init__(self, server: viser.ViserServer, on_phone: Callable[[viser.ClientHandle], bool]):
        self._server, self._on_phone = server, on_phone
        self._places: list[Place] = []
        # Each set-up draws under names of its own: a node that is removed and added again under its old name
        # in one batch of messages keeps its old place in the browser.
        self._take: viser.FrameHandle | None = None
        self._takes = 0
        self._framing: Framing | None = None
        self._framed: weakref.WeakKeyDictionary[viser.ClientHandle, tuple[np.ndarray, float]]
        self._framed = weakref.WeakKeyDictionary()  # where each camera was put, for which width over height
        self._projecting: weakref.WeakSet[viser.ClientHandle] = weakref.WeakSet()
        self.show_mesh_lines = False
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map("apartment", environment_intensity=0.55)
        self._shadows = False
        server.scene.configure_default_lights(enabled=True, cast_shadow=False)

    def set_up(self, scene: Scene, mesh: Mesh, names: list[str]) -> None:
        """Show the still of a scene: each variant's cloth where it starts."""
        self._framing = Framing(scene, mesh, len(names))
        with self._server.atomic():
            for place in self._places:
                place.forget_clients()
            if self._take is not None:
                self._take.remove()
            self._takes += 1
            root = f"/take{self._takes}"
            self._take = self._server.scene.add_frame(root, show_axes=False)
            self._ground(root, self._framing.floor)
            self._places = [
                Place(self._server.scene, root, i, scene, mesh, self._framing) for i in range(len(names))
            ]
        self.show_lines(self.show_mesh_lines)
        for i, name in enumerate(names):
            self.label(i, name)
        first = self._server.initial_camera
        first.position, first.look_at = self._framing.camera()
        first.fov = FIELD_OF_VIEW
        for client in self._server.get_clients().values():
            self.frame_view(client)

    def cast_shadows(self) -> None:
        """Have shadows from now on; before, a browser that draws in software would hold up compilers."""
        if not self._shadows:
            self._shadows = True
            self._server.scene.configure_default_lights(enabled=True, cast_shadow=True)

    def _ground(self, root: str, floor: float) -> None:
        self._server.scene.add_grid(
            f"{root}/ground",
            infinite_grid=True,
            fade_distance=14.0,
            fade_strength=2.0,
            cell_color=GROUND.toward(BLACK, 0.03),
            section_color=GROUND.toward(BLACK, 0.07),
            cell_size=0.1,
            section_size=0.5,
            cell_thickness=0.6,
            section_thickness=0.8,
            shadow_opacity=0.4,
            plane_color=GROUND,
            plane_opacity=1.0,
            position=(0.0, 0.0, floor - 2e-3),  # a hair below, or cloth lying on it would flicker
        )

    def frame_view(self, client: viser.ClientHandle) -> None:
        """Put one client's camera where it sees all variants."""
        if self._framing is None or client.client_id not in self._server.get_clients():
            return
        camera, aspect = client.camera, aspect_of(client)
        covered, size = self._covered(client, aspect), self._fit_labels(client)
        labels = LINES * LINE * size * label_size(len(self._places)) / max(1.0, self._css_size(client)[1])
        labels = min(MOST_LABELS, max(LABEL_PART, labels))
        position, target = self._framing.camera(aspect, FIELD_OF_VIEW, covered, labels)
        self._framed[client] = position, aspect
        with client.atomic():
            camera.fov = FIELD_OF_VIEW
            camera.position = position
            camera.look_at = target  # after the position, which takes what is looked at along
            camera.up_direction = (0.0, 0.0, 1.0)

    def is_outgrown(self, client: viser.ClientHandle) -> bool:
        """Whether a client's view has another shape than it was framed for, and nobody has moved its camera.

        Docks that come or go, windows and phones that are turned do that; and a browser that is slow to begin
        may go to where all begin after it was told where to. May be asked by any thread.
        """
        position, aspect = self._framed.get(client, (None, 0.0))
        if self._framing is None or position is None or abs(aspect_of(client) / aspect - 1.0) < RESHAPED:
            return False
        here, near = client.camera.position, MOVED * self._framing.size
        own = (position, self._server.initial_camera.position)
        return any(np.allclose(here, place, rtol=0.0, atol=near) for place in own)

    def project(self, client: viser.ClientHandle, projecting: bool) -> None:
        """Write the labels that one client sees larger, or as large as for all again."""
        (self._projecting.add if projecting else self._projecting.discard)(client)
        self._fit_labels(client)

    def _covered(self, client: viser.ClientHandle, aspect: float) -> float:
        """Which part of a client's view is covered from below."""
        if client in self._projecting:
            return CHART_PART if len(self._places) > MOST_BESIDE else 0.0
        upright = self._on_phone(client) and aspect < 1.0
        return SHEET_PART if upright or view_of(client)[0] <= PHONE else 0.0

    def _css_size(self, client: viser.ClientHandle) -> tuple[float, float]:
        """Width and height of a client's view [CSS px], as near as that is known."""
        fine = FINE if self._on_phone(client) else 1.0
        width, height = view_of(client)
        return width / fine, height / fine

    def _fit_labels(self, client: viser.ClientHandle) -> float:
        """Have one client's labels larger on a projector, smaller in a narrow view; says how many times."""
        count, (width, _) = len(self._places), self._css_size(client)
        most = ENLARGED if client in self._projecting else 1.0
        room = width / max(count, 1) / (LABEL_WIDTH * label_size(count))
        size = max(min(most, room), LEAST) if room > 0.0 else most
        for place in self._places:
            place.resize_label(client, size)
        return size

    def show(self, frames: list[Frame]) -> None:
        """Show each variant's frame, all at once."""
        with self._server.atomic():
            for place, frame in zip(self._places, frames, strict=True):
                place.show(frame)

    def label(self, index: int, text: str, alarm: bool = False) -> None:
        """Write above a variant's cloth; an alarm is written larger."""
        self._places[index].write(text, alarm)

    def show_lines(self, visible: bool) -> None:
        """Draw the cloth's triangles as fine lines, or not."""
        self.show_mesh_lines = visible
        for place in self._places:
            place.show_lines(visible)


class Place:
    """One variant's cloth, obstacles and label, offset from the scene's own coordinates."""

    def __init__(
        self, api: viser.SceneApi, take: str, index: int, scene: Scene, mesh: Mesh, framing: Framing
    ):
        root = f"{take}/variant{index}"
        api.add_frame(root, show_axes=False, position=framing.offsets[index])
        color = VARIANTS[index]
        self._label_size = label_size(len(framing.offsets))
        length = float(np.linalg.norm(framing.bar))
        vertices, triangles = capsule(framing.bar / 2, 0.012 * length)
        api.add_mesh_simple(
            f"{root}/bar",
            vertices,
            triangles,
            color=color,
            position=framing.label_place,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._label_node = f"{root}/label", framing.label_place + np.array([0.0, 0.0, 0.05 * length])
        self._text, self._alarm = "", False
        self._label = self._add_label(api)
        self._own_labels: weakref.WeakKeyDictionary[viser.ClientHandle, tuple[viser.LabelHandle, float]]
        self._own_labels = weakref.WeakKeyDictionary()
        self._cloth = draw_cloth(api, root, mesh, color, framing.scale)
        self._moving = {}
        for k, (obstacle, shell) in enumerate(zip(scene.obstacle, mesh.shells, strict=True)):
            if is_floor(obstacle):
                continue
            vertices, triangles = obstacle_mesh(obstacle, shell)
            flat = isinstance(obstacle, Plane) or (shell is not None and shell.open_edges > 0)
            solid = api.add_mesh_simple(
                f"{root}/obstacle{k}",
                vertices,
                triangles,
                color=STONE.toward(WHITE, 0.35),
                side="double" if flat else "front",
                position=obstacle.reference,
                wxyz=quaternion(standing(obstacle)),
                flat_shading=shell is not None,
                receive_shadow=False,
            )
            if obstacle.path:
                self._moving[k] = solid

    def show(self, frame: Frame) -> None:
        """Move cloth and obstacles to where a frame has them."""
        if frame.positions is None:
            return
        for part in self._cloth:
            part.move(frame.positions)
        for k, solid in self._moving.items():
            position, rotation = frame.poses[k]
            solid.position = position
            solid.wxyz = quaternion(rotation)

    def show_lines(self, visible: bool) -> None:
        """Draw the cloth's triangles as fine lines, or not."""
        for part in self._cloth:
            part.show_lines(visible)

    def _add_label(self, api: viser.SceneApi) -> viser.LabelHandle:
        name, position = self._label_node
        return api.add_label(name, self._text, position=position, anchor="bottom-center")

    def resize_label(self, client: viser.ClientHandle, size: float) -> None:
        """Give one client a label so many times larger, which takes the place of everybody's there."""
        own, now = self._own_labels.get(client, (None, 1.0))
        if size == now:
            return
        if size == 1.0 and own is not None:
            own.remove()
            del self._own_labels[client]
        else:
            self._own_labels[client] = own or self._add_label(client.scene), size
            self.write(self._text, self._alarm)

    def forget_clients(self) -> None:
        """Take back what only one client has: it does not go with what all have."""
        for own, _ in self._own_labels.values():
            own.remove()
        self._own_labels.clear()

    def write(self, text: str, alarm: bool) -> None:
        """Set the label, without touching what is the same already."""
        self._text, self._alarm = text, alarm
        scale = (ALARM if alarm else LABEL) * self._label_size
        self._write(self._label, scale)
        for own, size in self._own_labels.values():
            self._write(own, size * scale)

    def _write(self, label: viser.LabelHandle, scale: float) -> None:
        if label.font_screen_scale != scale:
            label.font_screen_scale = scale
        if label.text != self._text:
            label.text = self._text
