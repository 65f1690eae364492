"""What a run leaves behind: a recording in NumPy's .npz, read back by `numpy.load` with nothing of Muslin.

A file is written beside its place and moved there in one go, so it is either whole or not there.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import msgspec
import numpy as np

import sim

if TYPE_CHECKING:
    from sim.simulation import Simulation

MOST_BYTES = 2_000_000_000
"""Recordings larger than this are refused before the run rather than during it."""


class Recording:
    """Positions of a simulation, one frame at a time.

    Args:
        world: The simulation; its present state is the first frame.
        frame_time: Time from frame to frame [s]; each step is a frame where steps are longer.
    """

    def __init__(self, world: Simulation, frame_time: float = 1 / 60) -> None:
        self.world = world
        self.frame_time = frame_time
        self._positions: list[np.ndarray] = []
        self._times: list[float] = []
        self.add()

    def __len__(self) -> int:
        return len(self._times)

    @property
    def due(self) -> bool:
        """Whether the present state is closer to the time of the next frame than the next state will be."""
        return self.world.time >= len(self) * self.frame_time - 0.5 * self.world.settings.dt

    def add(self) -> None:
        """Keep the present state as a frame."""
        self._positions.append(self.world.positions.copy())
        self._times.append(self.world.time)

    def arrays(self) -> dict[str, np.ndarray]:
        """What `save` writes.

        positions (frames, n, 3) [m], times (frames,) [s], triangles (m, 3) and edges (e, 2), settings as JSON
        text and the version that made it. No entry needs pickle.
        """
        settings = msgspec.json.encode(self.world.settings).decode()
        return {
            "positions": np.stack(self._positions),
            "times": np.array(self._times),
            "triangles": np.array(self.world.triangles),
            "edges": np.array(self.world.edges),
            "settings": np.array(settings),
            "scene": np.array(self.world.scene.name),
            "version": np.array(sim.__version__),
        }

    def save(self, path: str | Path) -> None:
        """Write all frames to an .npz file; OSError leaves what was there before."""
        write_whole(path, lambda stream: np.savez(stream, **self.arrays()))  # pyright: ignore[reportArgumentType]


def save_json(path: str | Path, content: dict[str, Any]) -> None:
    """Write `content` as JSON; OSError leaves what was there before."""
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    write_whole(path, lambda stream: stream.write(text.encode()))


def write_whole(path: str | Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Let `write` fill a file that appears at `path` only when it is complete."""
    path = Path(path).resolve()
    handle, beside = tempfile.mkstemp(prefix=f".{path.name[:100]}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            write(stream)
        os.chmod(beside, 0o666 & ~_umask())  # mkstemp's are the owner's alone
        os.replace(beside, path)
    except BaseException:
        os.unlink(beside)
        raise


def check_writable(path: str | Path) -> None:
    """Raise OSError, with a reason and the path, where a file cannot be written."""
    place = Path(path).resolve()
    if place.exists() and not place.is_file():  # a folder, or a device that a file must not replace
        raise OSError(f"{path}: cannot be written: it is not a file")
    try:
        handle, beside = tempfile.mkstemp(dir=place.parent)
    except OSError as error:
        raise OSError(f"{path}: cannot be written: {error.strerror}") from None
    os.close(handle)
    os.unlink(beside)


def check_outputs(**files: str | Path | None) -> None:
    """Refuse what a command cannot write: options by name, with the file that each one asks for, or None.

    Raises:
        ValueError: for an empty name, and for a file that two options ask for.
        OSError: as `check_writable`.
    """
    asked: dict[str, str] = {}
    for option, path in files.items():
        if path == "":
            raise ValueError(f"--{option}: expected a file, got an empty name")
        if path is not None:
            check_writable(path)
            if (other := asked.setdefault(str(path), option)) != option:
                raise ValueError(f"--{option}: expected another file than --{other}, got {path}")


def check_size(vertices: int, frames: int) -> None:
    """Raise ValueError for a recording that would not fit."""
    size = 24 * vertices * frames
    if size > MOST_BYTES:
        raise ValueError(
            f"{frames:,} frames would take {size / 1e9:.0f} GB, more than {MOST_BYTES / 1e9:.0f} GB"
        )


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
