"""One variant's simulation in a thread of its own: a queue of commands, drained between steps."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from sim.settings import Settings, change

_log = logging.getLogger(__name__)

ROUNDING = 1e-9
"""Simulated time [s] that adding up time steps may be off by."""


PATIENCE = 0.7
"""Wall time [s] after which it is said that something takes long."""

FIGURES_EVERY = 0.1
"""Wall time [s] for which energies and momenta are good while time runs: nobody reads them more often."""

SHARE = 0.0025
"""Of wall time, that counting what crosses may take while time runs."""


@dataclass(frozen=True)
class Advance:
    """Command: step until this much more simulated time [s] has passed.

    Attributes:
        seconds: How much.
        counted: Count what crosses in the frame after it, whatever that takes, and have its energies and
            momenta be of its very time: it may be the last for long.
    """

    seconds: float
    counted: bool = False


@dataclass(frozen=True)
class Change:
    """Command: change settings while the simulation runs."""

    values: Mapping[str, Any]


@dataclass(frozen=True)
class Reset:
    """Command: start again from the beginning, with these settings."""

    settings: Settings


@dataclass(frozen=True)
class Ask:
    """Command: hand a snapshot of the state to `reply`, in the lane's thread; None where there is none."""

    reply: Callable[[Any], None]


@dataclass(frozen=True)
class Frame:
    """What one variant looks like and cost, at one time. Never changed once made.

    Attributes:
        positions: (n, 3) float32 [m]; None before there is a simulation.
        poses: Position [m] and rotation matrix of each obstacle.
        time: Simulated time [s].
        steps: How many steps were made since the frame before.
        ms: Mean milliseconds per step of those, by phase and "total"; None when there were none.
        report: The last step's report, None before the first.
        crossings: How many edges go through triangles now; None where that was not counted.
        counting: What counting took of the time of steps so far, as a part; None where nothing is counted.
        energy: Energies [J] by kind; these, ledger and momentum may be FIGURES_EVERY old.
        ledger: Where energy went, None where no books are kept.
        momentum: Linear [kg m/s] and angular momentum about the origin [kg m²/s], each (3,).
        settings: In force when the frame was made.
        refused: Why the last step was refused; empty while all is well.
        blamed: The setting that is likeliest to blame for that; empty where none is.
        note: Why the last change of settings was refused, or what was done to the start; else empty.
    """

    positions: np.ndarray | None = None
    poses: list = field(default_factory=list)
    time: float = 0.0
    steps: int = 0
    ms: Mapping[str, float] | None = None
    report: Any = None
    crossings: int | None = None
    counting: float | None = None
    energy: Mapping[str, float] = field(default_factory=dict)
    ledger: Any = None
    momentum: tuple[np.ndarray, np.ndarray] | None = None
    settings: Settings | None = None
    refused: str = ""
    blamed: str = ""
    note: str = ""


class Lane(threading.Thread):
    """Steps one simulation. Other threads only `send` commands and read `frame`.

    Args:
        build: Makes the simulation for some settings; called in this thread.
        settings: The settings to begin with.
        on_frame: Called in this thread after each new frame; must return at once.
        counting: Whether to count what crosses, which would have to compile something when first done.
    """

    def __init__(
        self,
        build: Callable[[Settings], Any],
        settings: Settings,
        on_frame: Callable[[], None],
        counting: bool = True,
    ):
        super().__init__(name="muslin lane", daemon=True)
        self.frame = Frame()
        self.step_length = settings.dt
        """The present time step [s]."""
        self.counting = counting
        self._build = build
        self._settings = settings
        self._on_frame = on_frame
        self._commands: queue.SimpleQueue = queue.SimpleQueue()
        self._unfinished = 1
        self._count_lock = threading.Lock()
        self._stopping = threading.Event()
        self._world: Any = None
        self._report: Any = None
        self._doing = ("", 0.0)
        self._owed = 0.0
        self._refused = self._blamed = self._note = ""
        self._spent: list[Mapping[str, float]] = []
        self._count_next, self._count_due = False, 0.0
        self._counted = self._stepped = 0.0
        self._figures, self._figures_due = {}, 0.0

    def send(self, command: Advance | Change | Reset | Ask) -> None:
        """Queue a command; it takes effect between two steps. One that only asks leads to no new frame."""
        with self._count_lock:
            self._unfinished += not isinstance(command, Ask)
        self._commands.put(command)

    def stop(self) -> None:
        """Ask the thread to end after the step it is in."""
        self._stopping.set()
        self._commands.put(None)

    @property
    def busy(self) -> bool:
        """Whether some command has not been carried out to its end."""
        return self._unfinished > 0

    @property
    def waiting(self) -> str:
        """What it has been doing for longer than a step should take; empty most of the time."""
        what, since = self._doing
        return f"{what} …" if what and perf_counter() > since + PATIENCE else ""

    @property
    def ready(self) -> bool:
        """Whether there is a simulation to be stepped."""
        return self._world is not None

    def run(self) -> None:
        """Build, then carry out commands until told to stop."""
        self._start(self._settings)
        self._finish(1)
        while not self._stopping.is_set():
            carried_out = self._drain()
            while self._owed >= self.step_length - ROUNDING and not self._stopping.is_set():
                self._step()
                carried_out += self._drain(wait=False)
            if carried_out:
                self._finish(carried_out)

    def _finish(self, commands: int) -> None:
        self._doing = ("", 0.0)
        self._show()
        with self._count_lock:
            self._unfinished -= commands
        self._on_frame()

    def _drain(self, wait: bool = True) -> int:
        """Carry out all queued commands, changes that come in a row as one; how many there were.

        What comes before a reset is not done any more: it has all the settings.
        """
        commands = [self._commands.get()] if wait else []
        while not self._commands.empty():
            commands.append(self._commands.get())
        reset = max((k for k, command in enumerate(commands) if isinstance(command, Reset)), default=0)
        changes: dict[str, Any] = {}
        for k, command in enumerate(commands):
            if k < reset and not isinstance(command, Ask):
                continue
            if isinstance(command, Change):
                changes.update(command.values)
                continue
            self._change(changes)
            changes = {}
            if isinstance(command, Advance) and not self._refused:
                self._owed += command.seconds
                if command.counted:
                    self._count_next, self._figures_due = True, 0.0
            elif isinstance(command, Reset):
                self._start(command.settings)
            elif isinstance(command, Ask):
                snapshot = getattr(self._world, "snapshot", None)
                command.reply(snapshot() if snapshot else None)
        self._change(changes)
        return sum(not isinstance(command, Ask | None) for command in commands)

    def _start(self, settings: Settings) -> None:
        self._settings, self._owed, self._spent, self._count_next = settings, 0.0, [], True
        self._figures_due = self._counted = self._stepped = 0.0
        self._refused = self._blamed = self._note = ""
        self._doing = ("starting", perf_counter())
        self._world = self._report = None
        self.step_length = settings.dt
        try:
            self._world = self._build(settings)
        except Exception as error:
            self._refuse("cannot start", error)
            return
        self._note = getattr(self._world, "note", "")

    def _change(self, values: Mapping[str, Any]) -> None:
        if not values:
            return
        if self._world is None:  # what could not start may now
            self._start(change(self._settings, **values))
            return
        self._doing = ("changing settings", perf_counter())
        try:
            self._world.update(**values)
        except ValueError as error:
            self._note = str(error)
            return
        except Exception as error:
            self._refuse("change failed", error)
            return
        self.step_length, self._figures_due = self._world.settings.dt, 0.0
        self._count_next |= "crossings" in values
        self._refused = self._blamed = self._note = ""

    def _step(self) -> None:
        self._doing = ("stepping", perf_counter())
        try:
            report = self._world.step()
        except Exception as error:
            self._refuse("", error)
            return
        self._owed -= self.step_length
        self._spent.append(report.ms)
        self._stepped += 1e-3 * report.ms["total"]
        self._report = report

    def _refuse(self, what: str, error: Exception) -> None:
        """Stand still and say why; errors that are no verdict of the simulation also go to the log."""
        self._owed = self._figures_due = 0.0
        self._refused = f"{what}: {getattr(error, 'reason', error)}".removeprefix(": ")
        self._blamed = getattr(error, "setting", "")
        if type(error).__name__ not in ("StepError", "SceneError"):
            _log.exception("variant stopped: %s", what or "no step")

    def _show(self) -> None:
        """Make the frame that others see."""
        world = self._world
        if world is None:
            self.frame = Frame(refused=self._refused, blamed=self._blamed)
            return
        figures, crossings = self._energies(), self._crossings()
        self.frame = Frame(
            positions=world.positions.astype(np.float32),
            poses=world.obstacle_poses(),
            time=float(world.time),
            steps=len(self._spent),
            ms=mean_ms(self._spent),
            report=self._report,
            crossings=crossings,
            counting=self._counted / max(self._stepped, ROUNDING) if self._counts else None,
            **figures,
            settings=world.settings,
            refused=self._refused,
            blamed=self._blamed,
            note=self._note,
        )
        self._spent = []

    def _energies(self) -> dict[str, Any]:
        """Energies, ledger and momentum for a frame, as they were not long ago or, where that is due, are."""
        now = perf_counter()
        if now >= self._figures_due:
            world, self._figures_due = self._world, now + FIGURES_EVERY
            ledger = getattr(world, "ledger", None)
            energy = dict(ledger.energy if ledger else world.energy())
            self._figures = {"energy": energy, "ledger": ledger, "momentum": world.momentum()}
        return self._figures

    @property
    def _counts(self) -> bool:
        """Whether what crosses is counted at all."""
        return self.counting and self._world.settings.crossings != "off"

    def _crossings(self) -> int | None:
        """How many edges go through triangles, where that is asked for or takes no more than its share."""
        begin, asked = perf_counter(), self._count_next or self._world.settings.crossings == "on"
        if not self._counts or (not asked and begin < self._count_due):
            return None
        count, end = self._world.crossings(), perf_counter()
        if self._report is not None:
            self._counted += end - begin
        if not self._count_next:  # at the start, kernels may have had to be loaded first
            self._count_due = end + (end - begin) / SHARE
        self._count_next = False
        return count


def mean_ms(reports: list[Mapping[str, float]]) -> dict[str, float] | None:
    """The mean of reports' milliseconds, phase by phase; None of none."""
    if not reports:
        return None
    phases = dict.fromkeys(phase for report in reports for phase in report)
    return {phase: sum(report.get(phase, 0.0) for report in reports) / len(reports) for phase in phases}
