"""What the page accepts from a network: same-origin browsers, a few kinds of message, checked values.

viser answers anyone who can reach its port: it takes websockets from foreign pages, opens a public tunnel
when a client sends the message for it, and stores whatever value (or property) of a control a client sends.
This is the only module that reaches into viser's private parts to stop that; it is written for the pinned
viser version, and tests/server/test_guard.py exercises every hook with real connections.

Policy:
    Host     must be an address literal, "localhost" or this machine's name, so that a foreign name that was
             made to point here (DNS rebinding) is refused.
    Origin   must be the page's own. A browser always sends one with a websocket; a request without one is a
             program on this machine or network, which could forge it anyway, and is let through.
    Message  only values of controls, commands and pointer events of the 3-D view are handled.
    Value    a control's value passes its check before viser sees it: clamped, or refused and shown as it was.
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
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from viser import _messages as messages

Check = Callable[[Any], Any]
"""Gives the value that a control may take for the one a client sent; raises ValueError to refuse it."""

MAX_MESSAGE = 2**20
"""Largest message [bytes] taken from a client; a control's value needs a few hundred."""

PORTS = 1000
"""How many ports are tried before giving up, as viser does."""

HANDLED = {
    messages.GuiUpdateMessage,
    messages.CommandTriggerMessage,
    messages.SceneNodeClickMessage,
    messages.SceneNodeDragMessage,
    messages.ScenePointerMessage,
}
"""The messages from clients that reach viser at all; each client's own camera comes on top."""

SETTLE = 0.8
"""Seconds until a control whose value was clamped or refused is shown as it is: a hand may be typing."""

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


def open_server(host: str, port: int) -> tuple[viser.ViserServer, Guard]:
    """Start a viser server behind a guard, without viser's own greeting on the terminal.

    Returns:
        The server, already listening (on another port than asked for where that one was taken: see
        `server.get_port()`), and the guard that its controls must be registered with.

    Raises:
        ValueError: if nothing can listen there; viser itself would wait for ever.
    """
    port = free_port(host, port)
    # A client may leave between being asked after and being sent its camera; nobody needs to hear of it.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
    with _construction, _checked_handshakes(), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="Muslin", verbose=False)
    return server, Guard(server)


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


@contextlib.contextmanager
def _checked_handshakes() -> Iterator[None]:
    """While in force, servers that are started ask `refusal` before they answer a request.

    A connection that sends garbage is closed with one line in the log.
    """
    serve = websockets.asyncio.server.serve

    def checked_serve(handler: Callable, *args: Any, process_request: Callable, **options: Any):
        async def handle(connection: Any) -> None:
            try:
                await handler(connection)
            except Exception as error:  # what a client sent; websockets would print a traceback
                _report(error)
                await connection.close(1007)

        def check_first(connection: Any, request: Any):
            reason = refusal(request.headers)
            if reason is None:
                return process_request(connection, request)
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")

        return serve(handle, *args, process_request=check_first, **{**options, "max_size": MAX_MESSAGE})

    websockets.asyncio.server.serve = checked_serve
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve


def _report(error: object) -> None:
    """Log a client's nonsense as one line; with its traceback for whoever asks for debug messages."""
    trace = error if isinstance(error, Exception) and _log.isEnabledFor(logging.DEBUG) else None
    _log.warning("a message from a page was dropped: %s", " ".join(repr(error).split())[:100], exc_info=trace)


def handle_id(handle: Any) -> str:
    """The id under which a control is known on the wire and in the page's HTML."""
    return handle._impl.uuid


class Guard:
    """Checks what clients send before viser acts on it.

    Attributes:
        on_refusal: Called with one line whenever a value was refused.
    """

    def __init__(self, server: viser.ViserServer):
        self.on_refusal: Callable[[str], None] = lambda line: None
        self._wire = server._websock_server
        self._viser_update = server.gui._handle_gui_updates
        self._watched: dict[str, tuple[Any, Check]] = {}
        self._corrections: dict[str, asyncio.TimerHandle] = {}
        handlers = self._wire._incoming_handlers
        for kind in [kind for kind in handlers if kind not in HANDLED]:
            del handlers[kind]
        handlers[messages.GuiUpdateMessage] = [self._update]  # type: ignore[list-item]
        server.request_share_url = self._no_tunnel  # type: ignore[method-assign]
        loop = self._wire._background_event_loop
        assert loop is not None, "viser has started its loop by the time its server exists"
        loop.call_soon_threadsafe(
            loop.set_exception_handler,
            lambda _, context: _report(context.get("exception") or context.get("message")),
        )

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
