"""A simulation without physics, and a browser without a screen, for tests of the page."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from types import SimpleNamespace
from typing import ClassVar

import msgspec
import numpy as np
import viser
import zstandard
from websockets.asyncio.client import connect

from sim.mesh import build_mesh
from sim.report import StepError

SCENE = {
    "name": "fake",
    "cloth": {"kind": "grid", "size": [1.0, 1.0], "resolution": [4, 4], "position": [0.0, 0.0, 1.0]},
    "obstacle": [{"kind": "sphere", "center": [0.0, 0.0, 0.4], "radius": 0.3}],
    "lesson": {"title": "A <b>fake</b>", "look_for": "nothing", "try": ["nothing"]},
}

REMEMBERED = 100
"""Updates: a soak makes a hundred a second, and all of them would look like a leak of the page."""


class FakeWorld:
    """Falls at 1 m/s; refuses to step while the density is above 100."""

    made: ClassVar[list[FakeWorld]] = []

    def __init__(self, scene, settings):
        self.scene, self.settings = scene, settings
        self.mesh = build_mesh(scene)
        self.positions = self.mesh.vertices.copy()
        self.time = 0.0
        self.steps = self.crossed = 0
        self.updates: deque[dict] = deque(maxlen=REMEMBERED)
        self.thread = threading.get_ident()
        self.gate = threading.Event()
        self.gate.set()
        FakeWorld.made.append(self)

    def update(self, **changes):
        assert threading.get_ident() == self.thread, "settings change between steps, in the lane's thread"
        if changes.get("gamma") == 13.0:
            raise ValueError("gamma: unlucky")
        self.updates.append(changes)
        self.settings = msgspec.structs.replace(self.settings, **changes)

    def step(self):
        assert threading.get_ident() == self.thread
        self.gate.wait()
        if self.settings.density > 100:
            raise StepError("load of vertex 3 is too heavy", "solve", "density")
        self.positions = self.positions - [0.0, 0.0, self.settings.dt]
        self.time += self.settings.dt
        self.steps += 1
        return SimpleNamespace(
            ms={"solve": 1.0, "total": 1.0},
            iterations=1,
            contacts=0,
            penetrations=0,
            effects={"gravity": "ran"},
            costs={"gravity": 0.0},
            costs_below={},
        )

    def crossings(self):
        return self.crossed

    def energy(self):
        return {"kinetic": 1.0, "gravity": float(self.positions[:, 2].sum())}

    def momentum(self):
        return np.array([3.0, 0.0, 4.0]), np.array([0.0, 2.5e-7, 0.0])

    def obstacle_poses(self):
        return [(np.array(o.reference), np.eye(3)) for o in self.scene.obstacle]


def nothing_to_compile(scene, progress):
    progress(0, 1, "nothing")
    progress(1, 1, "ready")


def wait_until(condition, seconds=60.0):
    """Wait for another thread to make `condition()` true; how long it takes is no matter of these tests."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came about"
        time.sleep(0.01)


class RawClient:
    """A websocket that speaks viser's protocol and says whatever a test wants it to."""

    def __init__(self, url: str, origin: str | None = None, **headers: str):
        self.controls: dict[str, dict] = {}
        self.values: dict[str, object] = {}
        self.messages: list[dict] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        headers |= {"Origin": origin} if origin else {}
        self._socket = self._do(self._connect(url.replace("http", "ws"), headers))
        self._reader = asyncio.run_coroutine_threadsafe(self._read(), self._loop)

    def _do(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(20)

    async def _connect(self, url, headers):
        protocol = f"viser-v{viser.__version__}"
        return await connect(
            url, subprotocols=[protocol], additional_headers=headers, compression=None, max_size=None
        )

    async def _read(self):
        async for frame in self._socket:
            length = int.from_bytes(frame[8:16], "little")
            inner = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + length])
            for message in msgspec.msgpack.decode(inner, strict=False)["messages"]:
                self.messages.append(message)
                if "container_uuid" in message:
                    self.controls[message["uuid"]] = message
                if message["type"] == "GuiUpdateMessage" and "value" in message["updates"]:
                    self.values[message["uuid"]] = message["updates"]["value"]

    def send(self, **message):
        """Send one message, with its type and fields."""
        self._do(self._socket.send(msgspec.msgpack.encode(message)))

    def send_bytes(self, data):
        """Send anything."""
        self._do(self._socket.send(data))

    def look(self, image_width=1280, image_height=720, position=(0.0, -3.0, 1.0), **more):
        """Say where the camera is; only then does viser count this as a client."""
        camera = {
            "wxyz": [1.0, 0.0, 0.0, 0.0],
            "position": list(position),
            "fov": 0.6,
            "near": 0.01,
            "far": 100.0,
            "image_height": image_height,
            "image_width": image_width,
            "look_at": [0.0, 0.0, 0.0],
            "up_direction": [0.0, 0.0, 1.0],
        }
        self.send(type="ViewerCameraMessage", **camera | more)

    def find(self, label: str, kind: str = "") -> str:
        """The id of the control with a label."""
        found = []

        def there():
            found[:] = [
                uuid
                for uuid, m in list(self.controls.items())
                if m["props"].get("label") == label and kind in m["type"]
            ]
            return found

        wait_until(there)
        return found[0]

    def shows(self, uuid: str) -> object:
        """The value of a control on this page."""
        return self.values.get(uuid, self.controls[uuid]["value"])

    def count(self, kind: str) -> int:
        """How many messages of a type have come."""
        return sum(message["type"] == kind for message in list(self.messages))

    def press(self, key: str):
        """Give the command that a key gives."""

        def there():
            return [
                m["uuid"]
                for m in list(self.messages)
                if m["type"] == "RegisterCommandMessage" and m["props"]["hotkey"] == key
            ]

        wait_until(there)
        self.send(type="CommandTriggerMessage", uuid=there()[0])

    def set(self, uuid: str, value, **others):
        """Claim that a control was moved to a value."""
        self.send(type="GuiUpdateMessage", uuid=uuid, updates={"value": value, **others})

    def drag(self, uuid: str, values):
        """Claim that a control was moved to one value after the other, as fast as can be."""

        async def drag():
            for value in values:
                update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
                await self._socket.send(msgspec.msgpack.encode(update))

        self._do(drag())

    def vanish(self):
        """Be gone without a word, once all that was sent has come to the server."""

        async def ping():
            await (await self._socket.ping())

        self._do(ping())
        self._loop.call_soon_threadsafe(self._socket.transport.abort)

    def close(self):
        """Hang up; once is enough."""
        if not self._thread.is_alive():
            return
        self._do(self._socket.close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)


def label_sizes(client: RawClient) -> dict[str, float]:
    """Of the labels that only this client has, by name."""
    sizes = {}
    for m in list(client.messages):
        if m["type"] == "LabelMessage" and m.get("owner"):
            sizes[m["name"]] = m["props"]["font_screen_scale"]
        elif m["type"] == "SceneNodeUpdateMessage" and m.get("owner") and m["name"] in sizes:
            sizes[m["name"]] = m["updates"].get("font_screen_scale", sizes[m["name"]])
        elif m["type"] == "RemoveSceneNodeMessage" and m.get("owner"):
            sizes.pop(m["name"], None)
    return sizes


def press_find(client: RawClient, kind: str, most: float) -> None:
    """Ask for settings that meet a budget."""
    client.set(client.find("budget"), kind)
    client.set(client.find("at most"), most)
    client.set(client.find("find"), "Find settings")
