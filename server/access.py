"""Who may look at the page, and who may touch it: tokens that addresses carry, and what they open.

Everybody who connects shares one simulation. While only this computer can reach the page nobody is asked for
anything; a page that others can reach asks for a token. A browser sends the token of its address once, gets a
cookie for it, and is sent on to the same address without, so that a projector does not show it. Programs may
carry it in the address of their websocket.

With `view_only` guests watch: they look around freely, and all else that they send is dropped.
"""

from __future__ import annotations

import contextlib
import enum
import ipaddress
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

PARAMETER = "token"
"""What carries the token in an address."""

ASK = "this page needs an address that ends in ?token=…; ask whoever started Muslin for the whole of it"
"""Why a request without a token is refused."""


class Role(enum.Enum):
    """What somebody may do."""

    ACTS = "moves the controls"
    WATCHES = "looks on"


@dataclass(frozen=True)
class Access:
    """Whom the page lets in, and as what.

    Attributes:
        asks: Whether a token is needed at all.
        view_only: Whether guests only watch.
        host_token: Opens everything.
        guest_token: Opens what guests may do.
    """

    asks: bool = False
    view_only: bool = False
    host_token: str = field(default_factory=lambda: secrets.token_urlsafe(16), repr=False)
    guest_token: str = field(default_factory=lambda: secrets.token_urlsafe(16), repr=False)

    @classmethod
    def at(cls, host: str, view_only: bool = False) -> Access:
        """For a server that listens at `host`: one that only this computer can reach asks for no token."""
        return cls(asks=not is_loopback(host), view_only=view_only)

    @property
    def guest(self) -> Role:
        """What guests may do."""
        return Role.WATCHES if self.view_only else Role.ACTS

    def role(self, tokens: Iterable[str]) -> Role | None:
        """What somebody with these tokens may do; None where that is nothing at all."""
        held = [token.encode() for token in tokens]
        if any(secrets.compare_digest(token, self.host_token.encode()) for token in held):
            return Role.ACTS
        if not self.asks or any(secrets.compare_digest(token, self.guest_token.encode()) for token in held):
            return self.guest
        return None

    def host_address(self, url: str) -> str:
        """The address for whoever started it."""
        return f"{url}/?{PARAMETER}={self.host_token}" if self.asks or self.view_only else url

    def guest_address(self, url: str) -> str:
        """The address to hand out; the host's own where guests may do the same."""
        if not self.view_only:
            return self.host_address(url)
        return f"{url}/?{PARAMETER}={self.guest_token}" if self.asks else url


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach a server that listens at `host`."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def own_address() -> str:
    """The address at which other computers of the local network most likely find this one."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # an address that is nobody's (RFC 5737); this sends nothing
        return probe.getsockname()[0]
    return socket.gethostname()


def token_in(path: str) -> tuple[str, str]:
    """The token that a request's path carries, empty if none, and the path without it."""
    parts = urlsplit(path)
    pairs = parse_qsl(parts.query, keep_blank_values=True)
    token = next((value for name, value in pairs if name == PARAMETER), "")
    rest = urlencode([pair for pair in pairs if pair[0] != PARAMETER])
    return token, f"/{parts.path.lstrip('/')}{'?' * bool(rest)}{rest}"


def tokens_in(cookies: Iterable[str], name: str) -> list[str]:
    """The values of the cookie `name` in these headers."""
    found = []
    for text in cookies:
        with contextlib.suppress(CookieError):
            if morsel := SimpleCookie(text).get(name):
                found.append(morsel.value)
    return found


def cookie_name(port: int) -> str:
    """Of the cookie for one server: browsers tell servers on several ports of a computer not apart."""
    return f"muslin-{port}"


def cookie(port: int, token: str) -> str:
    """The header that has a browser keep a token until it is closed, from scripts and other sites."""
    return f"{cookie_name(port)}={token}; Path=/; HttpOnly; SameSite=Lax"
