"""Going over to new settings in several steps: a stiff spring that changes at once would jerk the cloth."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from sim.settings import FIELDS, Settings

DURATION = 0.1
"""Simulated time [s] that a change takes: six frames at 60 Hz."""

RAMPED = tuple(name for name, field in FIELDS.items() if field.ramps)
"""Settings that go over."""


@dataclass(frozen=True)
class Ramp:
    """The way from some settings to others. Immutable: time that passes makes a new one.

    Attributes:
        start: Settings at the beginning; only those that ramp are read.
        target: Settings at the end.
        elapsed: Time since the beginning [s].
    """

    start: Settings
    target: Settings
    elapsed: float = 0.0

    @classmethod
    def done(cls, settings: Settings) -> Ramp:
        """Nothing to go over to."""
        return cls(settings, settings, DURATION)

    @property
    def over(self) -> bool:
        """Whether the target is reached."""
        return self.elapsed >= DURATION * (1.0 - 1e-9)

    @property
    def settings(self) -> Settings:
        """The settings in force now."""
        if self.over:
            return self.target
        part = self.elapsed / DURATION
        between = {name: self._between(name, part) for name in RAMPED}
        return msgspec.structs.replace(self.target, **between)

    def toward(self, target: Settings) -> Ramp:
        """The way to another target, from where this one is."""
        if _alike(target, self.target):
            return Ramp(self.start, target, self.elapsed)
        return Ramp.done(target) if _alike(target, self.settings) else Ramp(self.settings, target)

    def after(self, h: float) -> Ramp:
        """The same way, h [s] later."""
        return Ramp(self.start, self.target, self.elapsed + h)

    def _between(self, name: str, part: float) -> float:
        first, last = getattr(self.start, name), getattr(self.target, name)
        if FIELDS[name].scale == "log" and first > 0.0 and last > 0.0:
            return first * (last / first) ** part
        return first + part * (last - first)


def _alike(a: Settings, b: Settings) -> bool:
    """Whether two settings differ in none that goes over."""
    return all(getattr(a, name) == getattr(b, name) for name in RAMPED)
