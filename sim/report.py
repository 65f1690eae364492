"""What one step did, and the error of a step that could not be done."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


class StepError(RuntimeError):
    """A step that could not be done; the state is as it was before.

    Attributes:
        reason: Which quantity went wrong.
        phase: Where it failed: "detect", "solve" or "respond".
        setting: The setting most likely to blame.
    """

    def __init__(self, reason: str, phase: str, setting: str) -> None:
        super().__init__(f"{phase}: {reason}; the likeliest setting to blame is {setting}")
        self.reason = reason
        self.phase = phase
        self.setting = setting


@dataclass
class StepReport:
    """What one step did.

    Attributes:
        ms: Milliseconds by phase, what is between phases as "rest", and all of the step as "total".
        iterations: Of the linear solver.
        newton: Newton iterations.
        residual: Estimated position error, at the worst vertex, that the last linear solve left [m].
        converged: Whether the solver reached the tolerance.
        solver: What the last linear system was solved with, "cg" or "direct".
        stopped: Why the solver's last Newton iteration was the last.
        contacts: Contacts that detection found.
        penetrations: Vertices inside an obstacle at the end of the step.
        deepest: How far the deepest of them is inside [m].
        moved: The longest way that a vertex or an obstacle went [m].
        candidates: Pairs of features of cloth that were looked at.
        looked: Of these, by effect, those that bounds could not show to be out of reach as a whole.
        near: Of these, those hardly farther than the thickness at the start.
        felt: Pairs of features that were near or would have met, by effect, summed over all looks.
        thickness: That cloth had against cloth [m]; no more than a part of a typical edge.
        hits: Pairs that continuous detection found to meet, summed over its rounds.
        zones: Groups of contacts that shared vertices and were settled at once, as sweeps did not.
        held_back: Vertices that had to be held back, as no impulse led them past what they would have met.
        failsafes: Parts of the step in which that happened.
        pinched: Vertices between obstacles that leave them less room than the thickness on both sides.
        overrun: Vertices that an obstacle has run over and not let go of before the step: they are pinned, or
            had nowhere to go.
        overrun_by: These obstacles, as effects name them.
        overruns: Parts of the step in which one did though they could move.
        substeps: Parts that the step was done in.
        cut_short: Whether vertices were held back as the step's budget of pairs and parts was spent.
        integrator: What took the step: the setting, or what stood in for it.
        effects: Each effect and whether it ran, or why not.
        energy_injected: By changes of settings since the step before [J].
        energy_jumps: Springs that began or ceased to act at the end of the step, as their kind chose.
        energy_jump: What these put in [J].
        strain: Largest strain of an edge that strain limiting left; contact may add to it.
        limited: Edges that it pulled at.
        wind_work: Work that the air did on the cloth [J], by its force and the velocities at the end.
        lists: Broad phases: lists of pairs that were made anew.
        looks: Times that the pairs on a list were looked at.
        sweeps: Times that it was looked whether they meet on the way.
        outspread: Whether cloth was shown not to meet itself, as seen from one side no part of it is behind
            another.
        near_obstacles: Those but meshes that could not be shown to be out of reach.
        sleeping: Parts of the cloth that sleep at the end of the step.
        asleep: Whether the step was left out, as all cloth sleeps: all else is of the last one that was not.
        discarded: Kinetic energy that cloth had when it fell asleep at the end of the step [J].
        costs: Milliseconds by effect, of the work that is done for it alone.
        costs_below: The same of work that it shares with others, so that it takes less than that.
    """

    ms: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    newton: int = 0
    residual: float = 0.0
    converged: bool = True
    solver: str = ""
    stopped: str = ""
    contacts: int = 0
    penetrations: int = 0
    deepest: float = 0.0
    moved: float = 0.0
    candidates: int = 0
    looked: dict[str, int] = field(default_factory=dict)
    near: int = 0
    felt: dict[str, int] = field(default_factory=dict)
    thickness: float = 0.0
    hits: int = 0
    zones: int = 0
    held_back: int = 0
    failsafes: int = 0
    pinched: int = 0
    overrun: int = 0
    overrun_by: list[str] = field(default_factory=list)
    overruns: int = 0
    substeps: int = 1
    cut_short: bool = False
    integrator: str = ""
    effects: dict[str, str] = field(default_factory=dict)
    energy_injected: float = 0.0
    energy_jumps: int = 0
    energy_jump: float = 0.0
    strain: float = 0.0
    limited: int = 0
    wind_work: float = 0.0
    lists: int = 0
    looks: int = 0
    sweeps: int = 0
    outspread: bool = False
    near_obstacles: set[str] = field(default_factory=set)
    sleeping: int = 0
    asleep: bool = False
    discarded: float = 0.0
    costs: dict[str, float] = field(default_factory=dict)
    costs_below: dict[str, float] = field(default_factory=dict)
    _within: float = field(default=0.0, repr=False)

    @contextmanager
    def spent(self, effect: str, alone: bool = False) -> Iterator[None]:
        """Add the time that the block takes to `costs[effect]`, beside what phases count.

        It is for this effect `alone` where what the block books for others does not count.
        """
        begin, booked = time.perf_counter(), (self.costs.copy(), self.costs_below.copy()) if alone else ()
        try:
            yield
        finally:
            for costs, before in zip((self.costs, self.costs_below), booked, strict=False):
                costs.clear()
                costs.update(before)
            self.costs[effect] = self.costs.get(effect, 0.0) + 1e3 * (time.perf_counter() - begin)

    def close(self, begin: float) -> None:
        """Have the total be all time since `begin` [s], and what no phase counts be the phase "rest"."""
        whole = 1e3 * (time.perf_counter() - begin)
        self.ms |= {"rest": whole - self.ms.get("total", 0.0), "total": whole}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time that the block takes to `ms[name]` and to the total; phases within it count apart."""
        begin, outer, self._within = time.perf_counter(), self._within, 0.0
        yield
        took = 1e3 * (time.perf_counter() - begin)
        self.ms[name] = self.ms.get(name, 0.0) + took - self._within
        self.ms["total"] = self.ms.get("total", 0.0) + took - self._within
        self._within = outer + took
