"""What the page accepts from a network: whom it knows, a few kinds of message, checked values, at a pace.

viser answers anyone who can reach its port: it takes websockets from foreign pages, opens a public tunnel
when a client sends the message for it, and stores whatever value (or property) of a control a client sends.
This is the only module that reaches into viser's private parts to stop that; it is written for the pinned
viser version, and tests/server/test_guard.py exercises every hook with real connections.

Policy:
    Host     must be an address literal, "localhost" or this machine's name, so that a foreign name that was
             made to point here (DNS rebinding) is refused.
    Origin   must be the page's own. A browser always sends one with a websocket; a request without one is a
             program on this machine or network, which could forge it anyway, and is let through.
    Token    must be right where other computers can reach the page (server/access.py).
    Path     PROJECTOR is another address of the page itself; its websocket has the same path.
    Message  only values of controls, commands and pointer events of the 3-D view are handled; of somebody who
             only watches, none but his camera and the commands that act on his own page alone.
    Value    a control's value passes its check before viser sees it: clamped, or refused and shown as it was.
    Camera   one that cannot be one is dropped.
    Pace     nobody is listened to faster than a hand can move. What comes faster waits in the sender's own
             computer, so that nothing is lost and nothing piles up here. What has come of somebody who left
             meanwhile is heard to its end.
    Backlog  what is sent to a page that does not keep up is bounded, so that it skips frames and does not lag
             behind; one that does not answer at all is hung up on by websockets' own pings.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http
import io
import ipaddress
import logging
import socket
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import viser
import websockets.asyncio.server
import websockets.exceptions
from viser import _messages as messages
from websockets.protocol import State

from server.access import ASK, Access, Role, cookie, cookie_name, token_in, tokens_in

Check = Callable[[Any], Any]
"""Gives the value that a control may take for the one a client sent; raises ValueError to refuse it."""

MAX_MESSAGE = 2**20
"""Largest message [bytes] taken from a client; a control's value needs a few hundred."""

MOST_CLIENTS = 100
"""Connections at a time; whoever comes after is asked to come later."""

PACE, BURST = 250.0, 250.0
"""Messages a second that one client is listened to, and how many at once after a rest.

A browser sends some 20 of each control that is dragged and 50 of its camera."""

BACKLOG = 2**18
"""Bytes that the system is asked to hold, at most, for a client that does not keep up."""

PORTS = 1000
"""How many ports are tried before giving up, as viser does."""

HANDLED = {
    messages.GuiUpdateMessage,
    messages.CommandTriggerMessage,
    messages.SceneNodeClickMessage,
    messages.SceneNodeDragMessage,
    messages.ScenePointerMessage,
}
"""The messages from clients that reach viser at all."""

OWN = {messages.ViewerCameraMessage}
"""What comes on top from each client for itself alone."""

SETTLE = 0.8
"""Seconds until a control whose value was clamped or refused is shown as it is: a hand may be typing."""

LOG_EVERY = 10.0
"""Seconds between two lines about clients' nonsense, which would fill a disk otherwise."""

NEAREST, FARTHEST = 1e-6, 1e6
"""Of what a camera looks at [m], and of all that it has: between them, rounding leaves it a direction."""

PROJECTOR = "/projector"
"""Path of the page in projector mode."""

_log = logging.getLogger(__name__)
_construction = threading.Lock()


def refusal(headers: Any) -> str | None:
    """Why a request with these headers is refused, or None if it may pass."""
    host = _authority(f"http://{headers.get('Host', '')}")
    if host is None or not _is_own_name(host[0]):
        return "this host name is not one of this machine's"
    origin = headers.get("Origin")
    if origin is not None and _authority(origin) != host:
        return "pages of other origins may not talk to this server"
    return None


def _authority(url: str) -> tuple[str, int] | None:
    """Host name and port of an http(s) URL, or None for anything else ("null", "file://…")."""
    try:
        parts = urlsplit(url)
        port = parts.port or {"http": 80, "https": 443}[parts.scheme]
    except (ValueError, KeyError):
        return None
    return (parts.hostname, port) if parts.hostname else None


def _is_own_name(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name in {"localhost", own, own.partition(".")[0], own.partition(".")[0] + ".local"}
    return True


def open_server(host: str, port: int, access: Access | None = None) -> tuple[viser.ViserServer, Guard]:
    """Start a viser server behind a guard, without viser's own greeting on the terminal.

    Args:
        host: Address to listen at.
        port: Port to listen on.
        access: Whom to let in; everybody who can reach it if left out.

    Returns:
        The server, already listening (on another port than asked for where that one was taken: see
        `server.get_port()`), and the guard that its controls must be registered with.

    Raises:
        ValueError: if nothing can listen there; viser itself would wait for ever.
    """
    port, roles = free_port(host, port), weakref.WeakKeyDictionary()
    door = Door(access or Access(), roles)
    # A client may leave between being asked after and being sent its camera; nobody needs to hear of it.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
    # Of each value of a wrong type that a client sends, which would be printed, and kept, for ever.
    warnings.filterwarnings("ignore", r"(?s)\[viser\] .* does not match annotation", UserWarning)
    with _construction, _behind(door), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="Muslin", verbose=False)
    return server, Guard(server, roles)


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that a server can listen on at `host`; ValueError if there is none."""
    with ThreadPoolExecutor(1) as pool:  # the calling thread may have an event loop of its own
        for candidate in range(port, min(port + PORTS, 65536)):
            try:
                pool.submit(asyncio.run, _listen_once(host, candidate)).result()
            except (OSError, UnicodeError) as error:
                if isinstance(error, OSError) and error.errno in (errno.EADDRINUSE, errno.EACCES):
                    continue
                why = getattr(error, "strerror", None) or str(error)
                raise ValueError(f"--host {host}: cannot listen there: {why}") from None
            return candidate
    raise ValueError(f"--port {port}: neither this nor any of the next ports is free at {host}")


async def _listen_once(host: str, port: int) -> None:
    server = await asyncio.get_running_loop().create_server(asyncio.Protocol, host, port)
    server.close()


class Door:
    """Decides on each request, and on what terms a connection is served.

    Args:
        access: Whom to let in.
        roles: Where to note what each connection may do.
    """

    def __init__(self, access: Access, roles: weakref.WeakKeyDictionary[Any, Role]):
        self._access, self._roles = access, roles
        self._inside = 0

    def answer(self, connection: Any, request: Any, serve: Callable) -> Any:
        """The response to a request; None lets a websocket in."""
        headers = request.headers
        try:
            reason = refusal(headers)
        except LookupError:  # some header twice
            reason = "a header is there twice"
        if reason is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
        port = (_authority(f"http://{headers['Host']}") or ("", 80))[1]
        token, path = token_in(request.path)
        role = self._access.role([token, *tokens_in(headers.get_all("Cookie"), cookie_name(port))])
        if role is None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {ASK}.\n")
        if headers.get("Upgrade", "").lower() == "websocket":
            if self._inside >= MOST_CLIENTS:
                return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are open.\n")
            self._roles[connection] = role
        elif token and self._access.role([token]) is not None:
            response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
            response.headers["Location"] = path
            response.headers["Set-Cookie"] = cookie(port, token)
            return response
        elif urlsplit(path).path == PROJECTOR:  # viser looks for a file of that name
            request = replace(request, path="/")
        return serve(connection, request)

    async def serve(self, connection: Any, handler: Callable) -> None:
        """Let viser handle a connection, at a pace and with a bounded backlog, whatever a client sends."""
        self._inside += 1
        try:
            connection.recv, connection.send = _paced(connection), _surviving(connection.send)
            connection.transport.get_extra_info("socket").setsockopt(
                socket.SOL_SOCKET, socket.SO_SNDBUF, BACKLOG
            )
            await handler(connection)
        except Exception as error:  # what a client sent; websockets would print a traceback
            _report(error)
            await connection.close(1007)
        finally:
            self._inside -= 1


def _paced(connection: Any) -> Callable:
    """Its `recv`, but for no more than PACE messages a second after the first BURST (a token bucket).

    Of a connection that is closed, no more can come than is here: that is given as fast as it is asked for.
    """
    receive, left, last = connection.recv, BURST, time.monotonic()

    async def paced(*args: Any, **options: Any) -> Any:
        nonlocal left, last
        now = time.monotonic()
        left, last = min(BURST, left + PACE * (now - last)), now
        if left < 1.0:
            await asyncio.sleep((1.0 - left) / PACE if connection.state is State.OPEN else 0.0)
        left -= 1.0
        return await receive(*args, **options)

    return paced


def _surviving(send: Callable) -> Callable:
    """The same, but once the connection is closed it waits to be cancelled.

    Viser stops to listen where it cannot send, and would not hear the last of what a page said before it
    left. So it ends where nothing more is to be heard.
    """

    async def surviving(*args: Any, **options: Any) -> None:
        try:
            await send(*args, **options)
        except websockets.exceptions.ConnectionClosed:
            await asyncio.get_running_loop().create_future()

    return surviving


@contextlib.contextmanager
def _behind(door: Door) -> Iterator[None]:
    """While in force, servers that are started stand behind a door.

    A connection that sends garbage is closed with one line in the log.
    """
    serve = websockets.asyncio.server.serve

    def guarded(handler: Callable, *args: Any, process_request: Callable, **options: Any):
        return serve(
            lambda connection: door.serve(connection, handler),
            *args,
            process_request=lambda connection, request: door.answer(connection, request, process_request),
            **{**options, "max_size": MAX_MESSAGE},
        )

    websockets.asyncio.server.serve = guarded
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve


class _Nonsense:
    """Logs what clients send as one line, now and then; with its traceback for whoever asks for those."""

    def __init__(self) -> None:
        self._silent_until, self._unsaid = 0.0, 0

    def report(self, error: object) -> None:
        """Log it, or count it where another was logged lately."""
        if time.monotonic() < self._silent_until:
            self._unsaid += 1
            return
        more = f", and {self._unsaid} before it" if self._unsaid else ""
        self._silent_until, self._unsaid = time.monotonic() + LOG_EVERY, 0
        trace = error if isinstance(error, Exception) and _log.isEnabledFor(logging.DEBUG) else None
        what = " ".join(repr(error).split())[:100]
        _log.warning("a message from a page was dropped: %s%s", what, more, exc_info=trace)


_report = _Nonsense().report


def handle_id(handle: Any) -> str:
    """The id under which a control is known on the wire and in the page's HTML."""
    return handle._impl.uuid


def _keep_only(wire: Any, kinds: set[type]) -> None:
    """Have one side of viser hear of no other kinds of message."""
    for kind in [kind for kind in wire._incoming_handlers if kind not in kinds]:
        del wire._incoming_handlers[kind]


def _admit(client: Any) -> None:
    """Have viser hear of a client's own messages alone, and of its camera where that can be one."""
    _keep_only(client, HANDLED | OWN)
    cameras = client._incoming_handlers.get(messages.ViewerCameraMessage, [])
    cameras[:] = [_of_cameras(handler) for handler in cameras]


def _of_cameras(handler: Callable) -> Callable:
    """The same, but called of cameras only that look from one place to another.

    Viser keeps others as they are and raises when one of them is moved, which would end whatever moves the
    cameras of all.
    """

    async def checked(client_id: Any, message: messages.ViewerCameraMessage) -> None:
        if _looks(message):
            await handler(client_id, message)
        else:
            _report("a camera that cannot be one")

    return checked


def _looks(camera: messages.ViewerCameraMessage) -> bool:
    """Whether a camera has a place, a direction and a way up, within FARTHEST."""
    try:
        pose = np.array([camera.position, camera.look_at, camera.up_direction], dtype=float)
        wxyz = np.array(camera.wxyz, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return False
    if pose.shape != (3, 3) or wxyz.shape != (4,) or not np.isfinite(wxyz).all():
        return False
    if not (np.abs(pose) <= FARTHEST).all():  # also where it is no number
        return False
    position, look_at, up = pose
    return bool(np.linalg.norm(look_at - position) > NEAREST and np.linalg.norm(up) > NEAREST)


class Guard:
    """Checks what clients send before viser acts on it.

    Args:
        server: What to guard.
        roles: What each connection may do.

    Attributes:
        on_refusal: Called with one line whenever a value was refused.
    """

    def __init__(self, server: viser.ViserServer, roles: weakref.WeakKeyDictionary[Any, Role]):
        self._roles, self._clients = roles, server._connected_clients
        self.on_refusal: Callable[[str], None] = lambda line: None
        self._wire = server._websock_server
        self._viser_update = server.gui._handle_gui_updates
        self._watched: dict[str, tuple[Any, Check]] = {}
        self._for_all: set[str] = set()
        self._corrections: dict[str, asyncio.TimerHandle] = {}
        _keep_only(self._wire, HANDLED)
        self._wire._incoming_handlers[messages.GuiUpdateMessage] = [self._update]  # type: ignore[list-item]
        self._viser_handle = self._wire._handle_incoming_message
        self._wire._handle_incoming_message = self._handle  # type: ignore[method-assign]
        self._wire.on_client_connect(_admit)
        server.request_share_url = self._no_tunnel  # type: ignore[method-assign]
        loop = self._wire._background_event_loop
        assert loop is not None, "viser has started its loop by the time its server exists"
        loop.call_soon_threadsafe(
            loop.set_exception_handler,
            lambda _, context: _report(context.get("exception") or context.get("message")),
        )

    def may_act(self, client_id: int) -> bool:
        """Whether a client may do more than watch."""
        connection = self._wire._live_connections.get(client_id)
        return connection is not None and self._roles.get(connection) is Role.ACTS

    def _request(self, client_id: int) -> Any:
        """What a client's websocket began with: path and headers; None of one that has left."""
        return getattr(self._wire._live_connections.get(client_id), "request", None)

    def came_to(self, client_id: int) -> str:
        """The path of the address at which a client opened the page; empty of one that has left."""
        request = self._request(client_id)
        return urlsplit(request.path).path if request is not None else ""

    def on_phone(self, client_id: int) -> bool:
        """Whether a client's browser says that it is a phone's: "Mobi" is part of the names of these."""
        request = self._request(client_id)
        return request is not None and "Mobi" in " ".join(request.headers.get_all("User-Agent"))

    def open_to_all(self, command: Any) -> None:
        """Let those who only watch give a command, too: it acts on the page of whoever gives it alone."""
        self._for_all.add(handle_id(command))

    async def _handle(self, client_id: Any, message: Any) -> None:
        # Somebody whose camera viser does not know yet, or no more, is nobody to its callbacks: it would show
        # the new value on all pages and tell no one of it.
        own = isinstance(message, messages.CommandTriggerMessage) and message.uuid in self._for_all
        if (own or self.may_act(client_id)) and client_id in self._clients:
            await self._viser_handle(client_id, message)
        elif isinstance(message, messages.GuiUpdateMessage) and message.uuid in self._watched:
            self._correct(self._watched[message.uuid][0])

    def watch(self, handle: Any, check: Check) -> None:
        """Let clients set `handle` to what `check` makes of their value; without it they cannot at all."""
        self._watched[handle_id(handle)] = (handle, check)

    async def _update(self, client_id: Any, message: messages.GuiUpdateMessage) -> None:
        handle, check = self._watched.get(message.uuid, (None, None))
        updates = message.updates
        if handle is None or check is None or not isinstance(updates, dict) or set(updates) != {"value"}:
            return
        if pending := self._corrections.pop(message.uuid, None):
            pending.cancel()
        try:
            if handle.disabled:
                raise ValueError("this control cannot act now")
            value = check(updates["value"])
        except (ValueError, TypeError, OverflowError) as error:
            self._correct(handle, str(error)[:200])
            return
        await self._viser_update(client_id, messages.GuiUpdateMessage(message.uuid, {"value": value}))
        if (list(value) if isinstance(value, tuple) else value) != updates["value"]:
            self._correct(handle)

    def _correct(self, handle: Any, why: str = "") -> None:
        """Soon send everyone the value that the control really has; the sender's page shows what it sent."""
        if handle_id(handle) in self._corrections:
            return

        def correct() -> None:
            self._corrections.pop(handle_id(handle), None)
            if why:
                self.on_refusal(why)
            if not handle._impl.is_button and not handle._impl.removed:
                update = messages.GuiUpdateMessage(handle_id(handle), {"value": handle.value})
                self._wire.queue_message(update)

        self._corrections[handle_id(handle)] = asyncio.get_running_loop().call_later(SETTLE, correct)

    @staticmethod
    def _no_tunnel(*_: Any, **__: Any) -> None:
        _log.warning("a public share link was asked for and refused")
