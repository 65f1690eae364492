"""`muslin` and `muslin lab`: the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from sim.scene import load_scene


@dataclass(kw_only=True)
class Lab:
    """Open the lab in a browser; this is what `muslin` without a command does."""

    scene: Annotated[str, arg(metavar="SCENE")] = "drape"
    """Scene to begin with: a file, or one of `muslin scenes`."""
    port: int = 8080
    """Where to serve the page; the next free port if this one is taken."""
    host: str = "127.0.0.1"
    """Address to listen on; beyond this computer, whoever has the printed address and its token."""
    view_only: bool = False
    """Others watch: only the first printed address moves the controls."""
    no_browser: bool = False
    """Only serve the page."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        if not 0 <= self.port <= 65535:
            raise ValueError(f"--port: expected 0 to 65535, got {self.port}")
        load_scene(self.scene)
        from server.launch import run_lab

        run_lab(self.scene, self.host, self.port, not self.no_browser, self.view_only)
        return 0
