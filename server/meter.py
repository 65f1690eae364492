"""What one variant's frames add up to between two looks at them, slow enough to be read."""

from __future__ import annotations

import numpy as np

from server.lane import Frame, mean_ms
from server.prober import NO_READING, Reading


class Meter:
    """Collects one variant's frames.

    Attributes:
        latest: The newest frame.
        ms: Mean milliseconds per step, by phase and "total", over the frames before the last `read`; None
            until a step was measured.
        dt: The time step [s] that these were made with.
        reading: What is known of its local error.
        inside: Most vertices inside an obstacle after any of those frames; None until a step was measured.
        crossings: Most edges through triangles in those frames in which they were counted; None before.
    """

    def __init__(self):
        self.latest = Frame()
        self.ms: dict[str, float] | None = None
        self.inside: int | None = None
        self.crossings: int | None = None
        self.dt: float | None = None
        self.reading: Reading = NO_READING
        self._frames: list[Frame] = []

    def is_off(self, read_out: str) -> bool:
        """Whether one of READ_OUTS is switched off, so that what was read holds no longer."""
        settings = self.latest.settings
        return settings is not None and getattr(settings, read_out) == "off"

    def add(self, frame: Frame) -> None:
        """Take in a frame; one that was taken in before is left out."""
        if frame is not self.latest:
            self.latest = frame
            self._frames.append(frame)

    def read(self) -> Meter:
        """Sum up what came since the last time.

        Without a step since then the numbers stay as they were; of a variant that was stopped none is left.
        """
        stepped = [f for f in self._frames if f.steps and f.ms]
        if stepped:
            self.ms = mean_ms([frame.ms for frame in stepped if frame.ms])
            self.dt = stepped[-1].settings.dt if stepped[-1].settings else None
            self.inside = max(frame.report.penetrations for frame in stepped)
        counted = [frame.crossings for frame in self._frames if frame.crossings is not None]
        if counted:
            self.crossings = max(counted)
        if self.is_off("crossings"):
            self.crossings = None
        if self.latest.refused:
            self.ms = self.inside = self.crossings = None
            self.reading = NO_READING
        self._frames = []
        return self

    def energies(self) -> tuple[float, float]:
        """Total and kinetic energy [J] of the newest frame; nan, a gap in a plot, while it stands still."""
        energy = self.latest.energy
        if self.latest.refused or not energy:
            return np.nan, np.nan
        return sum(energy.values()), energy.get("kinetic", np.nan)

    def momenta(self) -> tuple[float, float]:
        """Size of the linear [kg m/s] and the angular momentum [kg m²/s] of the newest frame, or nan."""
        if self.latest.refused or self.latest.momentum is None:
            return np.nan, np.nan
        linear, angular = map(np.linalg.norm, self.latest.momentum)
        return float(linear), float(angular)
