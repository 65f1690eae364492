"""What is kept of a failure: the scene and its settings as JSON, the state before the step as arrays.

world = load("stress/C3-spheres-4.json")    # the .npz is beside it
world.step()                                # the step that failed, to the bit
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from sim.contact.contacts import Touch
from sim.ramp import Ramp
from sim.scene import load_scene
from sim.settings import Settings
from sim.simulation import Simulation, Snapshot

SCENE, STATE = ".json", ".npz"
"""How the names of the two files end."""


def pack(world: Simulation, state: Snapshot) -> dict[str, bytes]:
    """The contents of both files, by the end of their names."""
    ramp = {"start": state.ramp.start, "target": state.ramp.target, "elapsed": state.ramp.elapsed}
    about = {"scene": world.scene, "settings": world.settings, "ramp": ramp}
    stream = io.BytesIO()
    np.savez_compressed(stream, **_arrays(state))  # pyright: ignore[reportArgumentType]
    return {SCENE: msgspec.json.format(msgspec.json.encode(about), indent=1), STATE: stream.getvalue()}


def save(packed: dict[str, bytes], path: Path) -> list[Path]:
    """Write both files to `path`, to which the ends of their names are added; returns where they are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    files = [path.with_name(path.name + end) for end in packed]
    for file, content in zip(files, packed.values(), strict=True):
        file.write_bytes(content)
    return files


def load(path: str | Path) -> Simulation:
    """The simulation whose JSON is at `path`, in the state that is beside it."""
    path = Path(path)
    about = msgspec.json.decode(path.read_bytes())
    ramp = about["ramp"]
    start, target = (msgspec.convert(ramp[name], Settings) for name in ("start", "target"))
    world = Simulation(load_scene(about["scene"]), **about["settings"])
    with np.load(path.with_suffix(STATE)) as arrays:
        world.restore(_snapshot(Ramp(start, target, ramp["elapsed"]), dict(arrays)))
    return world


def _arrays(state: Snapshot) -> dict[str, Any]:
    previous = {} if state.previous is None else dict(zip("xv", state.previous, strict=True))
    return {
        "time": state.time,
        "injected": state.injected,
        "positions": state.positions,
        "velocities": state.velocities,
        **{f"previous.{name}": array for name, array in previous.items()},
        **{f"touched.{name}": array for name, array in state.touched._asdict().items()},
        **{f"memory.{name}": array for name, array in state.memory.items()},
    }


def _snapshot(ramp: Ramp, arrays: dict[str, np.ndarray]) -> Snapshot:
    def part(name: str) -> dict[str, np.ndarray]:
        return {k.partition(".")[2]: v for k, v in arrays.items() if k.startswith(f"{name}.")}

    previous = part("previous")
    return Snapshot(
        ramp=ramp,
        time=float(arrays["time"]),
        positions=arrays["positions"],
        velocities=arrays["velocities"],
        previous=(previous["x"], previous["v"]) if previous else None,
        touched=Touch(**part("touched")),
        memory=part("memory"),
        injected=float(arrays["injected"]),
    )
