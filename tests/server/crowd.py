"""A classroom without chairs: scripted websockets, in a process of their own, that behave well and badly.

Run as `python crowd.py URL SECONDS '{"kind": count, …}' '{"label": uuid, …}'`; prints what it did as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import sys
from collections import Counter

import msgspec
import viser
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, -3.0, 1.0],
    "fov": 0.6,
    "near": 0.01,
    "far": 100.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}
LAST = 0.875
"""What the flood ends with."""


class Crowd:
    def __init__(self, url, seconds, controls):
        self.url, self.controls, self.did = url.replace("http", "ws"), controls, Counter()
        self.end = asyncio.get_running_loop().time() + seconds

    def going_on(self):
        return asyncio.get_running_loop().time() < self.end

    @contextlib.asynccontextmanager
    async def visit(self, **options):
        protocol = f"viser-v{viser.__version__}"
        address = connect(self.url, subprotocols=[protocol], compression=None, max_size=None, **options)
        async with address as socket:
            self.did["visits"] += 1
            await self.send(socket, **CAMERA)
            yield socket

    async def send(self, socket, **message):
        await socket.send(msgspec.msgpack.encode(message))
        self.did["messages"] += 1

    async def move(self, socket, label, value):
        await self.send(socket, type="GuiUpdateMessage", uuid=self.controls[label], updates={"value": value})

    async def read(self, socket, pause=0.0):
        async for frame in socket:
            self.did["frames"] += 1
            self.did["bytes"] += len(frame)
            await asyncio.sleep(pause)

    async def calm(self):
        """Looks on, and moves a slider now and then."""
        async with self.visit() as socket:
            reader = asyncio.create_task(self.read(socket))
            while self.going_on():
                await self.move(socket, "damping ratio γ", random.random())
                await asyncio.sleep(random.random())
            reader.cancel()

    async def slow(self):
        """Takes a fifth of a second over each frame."""
        async with self.visit(max_queue=1) as socket:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(self.end):
                    await self.read(socket, 0.2)

    async def deaf(self):
        """Reads nothing at all."""
        async with self.visit(max_queue=1, ping_interval=None, close_timeout=0.1) as socket:
            while self.going_on():
                await asyncio.sleep(0.2)
            socket.transport.abort()

    async def vanishing(self):
        """Is gone in the middle of a drag, without a word, and comes back."""
        while self.going_on():
            async with self.visit(close_timeout=0.1) as socket:
                reader = asyncio.create_task(self.read(socket))
                for i in range(10):
                    await self.move(socket, "rest angle θ₀ [rad]", i / 20)
                    await asyncio.sleep(0.05)
                socket.transport.abort()
                reader.cancel()

    async def flooding(self):
        """Moves a slider faster than it is listened to, now and then, and always to one place at last."""
        async with self.visit(ping_interval=None) as socket:
            reader = asyncio.create_task(self.read(socket))
            while self.going_on():
                await asyncio.sleep(1.0)
                for _ in range(1000):
                    await self.move(socket, "friction", random.random())
                    await asyncio.sleep(1 / 500)
                await self.move(socket, "friction", LAST)
                await (await socket.ping())  # all has come, though not all has been heard
            reader.cancel()

    async def rude(self):
        """Moves a slider as fast as it can be sent."""
        async with self.visit(close_timeout=0.1) as socket:
            while self.going_on():
                await self.move(socket, "rest angle θ₀ [rad]", random.random())
                await asyncio.sleep(0)
            socket.transport.abort()

    async def garbage(self):
        """Sends what is no message, and messages that are out of all bounds."""
        while self.going_on():
            async with self.visit(close_timeout=0.1) as socket:
                for value in (1e300, float("nan"), -1, "x", None, [], "9" * 10_000):
                    await self.move(socket, "damping ratio γ", value)
                await self.send(socket, type="GuiUpdateMessage", uuid="nobody", updates={"value": 1})
                await socket.send(random.randbytes(random.randrange(1, 5000)))
                await asyncio.sleep(0.2)

    async def fighting(self):
        """Wants one slider at one end, while another wants it at the other."""
        async with self.visit() as socket:
            reader, mine = asyncio.create_task(self.read(socket)), random.choice((-1.5, 1.5))
            while self.going_on():
                await self.move(socket, "rest angle θ₀ [rad]", mine)
                await asyncio.sleep(0.05)
            reader.cancel()

    async def member(self, kind):
        while self.going_on():
            try:
                await getattr(self, kind)()
            except (ConnectionClosed, InvalidStatus, OSError, TimeoutError) as error:
                self.did[f"{kind}: {type(error).__name__}"] += 1
                await asyncio.sleep(0.1)


async def main(url, seconds, counts, controls):
    crowd = Crowd(url, float(seconds), json.loads(controls))
    kinds = [kind for kind, count in json.loads(counts).items() for _ in range(count)]
    await asyncio.gather(*map(crowd.member, kinds))
    sys.stdout.write(json.dumps(crowd.did))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
