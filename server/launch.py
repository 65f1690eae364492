"""Running the lab from the command line, until somebody ends it."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator

from server.access import is_loopback
from server.lab import Lab

EVERYWHERE = "0.0.0.0"
"""Where a server listens that is told to listen at no address in particular."""

WARNING = (
    "muslin: --host {host} lets other computers in. Whoever has an address with its token may come, and what "
    "goes over the network is not encrypted: use it among people you trust.\n"
)
"""What is said where others can reach the page."""


def run_lab(
    scene: str = "drape",
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = True,
    view_only: bool = False,
) -> None:
    """Run the lab until Ctrl-C or SIGTERM.

    Args:
        scene: Name or path of the scene to open.
        host: Address to listen on; anything but a loopback address lets others in who have the token that
            the printed address carries.
        port: Port to listen on; the next free one is taken, and printed, where it is not free.
        open_browser: Open the page in the default browser.
        view_only: Let guests watch only.

    Raises:
        SceneError: if the scene cannot be used.
        ValueError: if nothing can listen at that address.
    """
    done, host = threading.Event(), host or EVERYWHERE
    lab = Lab(scene, host, port, view_only=view_only)
    if not is_loopback(host):
        sys.stderr.write(WARNING.format(host=host))
    with _on_signal(signal.SIGTERM, done.set):
        try:
            lab.start()
            sys.stdout.write(f"Muslin is at {lab.url}   (Ctrl-C ends it)\n")
            if lab.guest_url != lab.url:
                sys.stdout.write(f"Others watch at {lab.guest_url}\n")
            sys.stdout.flush()
            if open_browser:
                webbrowser.open(lab.url)
            while not done.wait(0.5):  # in short waits, since Windows delivers no Ctrl-C within one
                pass
        except KeyboardInterrupt:
            sys.stdout.write("\n")
        finally:
            lab.stop()


@contextlib.contextmanager
def _on_signal(number: int, action: Callable[[], None]) -> Iterator[None]:
    """While in force, a signal does `action`; only the main thread can have it so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, lambda *_: action())
    try:
        yield
    finally:
        signal.signal(number, before)
