"""The energy ledger: where a simulation's energy went, entry by entry, and what does not add up.

A step takes (x₀, v₀) to (x₁, v₁). With v̄ = ½ (v₀ + v₁) its kinetic energy changes by exactly v̄·M (v₁ − v₀),
and what impulses do to it is v̄ times each. Impulses are integrated by the integrator itself, along with the
state, from forces that are evaluated anew at its stages: S of springs and gravity with the springs' damping;
N and F of contacts, normal and friction; L, the force that a solve took for granted, less what it turned out
to be.

- damping: Σ b q̇² at the stages, with the integrator's weights: never negative. The factor b is that of the
  last linearisation, as the step felt it.
- friction, contact: −v̄·F and −v̄·N, with what `rub` and `keep_apart` gave after the solve, and without the
  share of obstacles, which put in (impulse)·(their velocity). An inelastic impact loses ½ m v² so. In a step
  in which the slip turns about, friction may come out a little below zero.
- linearisation: −v̄·L. A step that is solved to the end has none.
- wind: the work of drag and lift, which S has, too.
- sleep: the kinetic energy of cloth that falls asleep (`sim.sleep`).
- strain limiting: −v̄ times what it gave after the solve.
- integrator: wind − ΔU − v̄·S − damping: what S took from the kinetic energy and no potential gained. For
  backward Euler without contact it is ½ ‖v₁ − v₀‖²_M + Σ [E(x₀) − E(x₁) − ∇E(x₁)·(x₀ − x₁)], the two squares
  that a step of it loses for every convex E, and for any other integrator what its own rule for x and v comes
  to. Where contact moves vertices after the solve, which asks no spring, what springs gain by it is in here.

What is left, the residual, is v̄·(M (v₁ − v₀) − S − N − F − L) in each step, the work of a force that no
entry knows: what the linear solver's tolerance left of the equation of motion; and any energy that changed
between steps without being booked. It is no part of any entry, and would show one that is wrong.

Source of the two squares: the dissipation of implicit Euler, e.g. Hairer, Lubich and Wanner (2006), VI.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.accounts import DISSIPATED, INJECTED
from sim.compiled import kernel
from sim.contact.contacts import Contacts, along
from sim.contact.friction import rub
from sim.contact.hold import slow
from sim.contact.response import project
from sim.contact.zones import keep_apart
from sim.solve.implicit import Felt, Solution

if TYPE_CHECKING:
    from sim.contact.gap import GapSprings
    from sim.integrators import State
    from sim.model import Model
    from sim.report import StepReport

Account = dict[str, float]

NOTHING = np.zeros((0, 3))
"""Vectors of vertices where there are none."""


@dataclass(frozen=True)
class Ledger:
    """What became of energy since the books were opened [J].

    Attributes:
        start: Energy, kinetic and potential, at the opening.
        energy: Now, by kind.
        dissipated: By what; an entry is negative where it put energy in.
        injected: By what; an entry is negative where it took energy out.
        turnover: Of all steps, what kinds of energy and entries changed by, without sign: the scale of
        errors.
    """

    start: float
    energy: Account
    dissipated: Account
    injected: Account
    turnover: float

    @property
    def residual(self) -> float:
        """What does not add up [J]: energy that is there, or went, and was not there or put in."""
        known = self.start + sum(self.injected.values()) - sum(self.dissipated.values())
        return sum(self.energy.values()) - known


@dataclass(frozen=True)
class Books:
    """The sums behind a ledger, as of the end of a step; never changed.

    Attributes:
        start: Energy at the opening [J].
        flows: By entry [J].
        turnover: As in Ledger.
        rows: Of the last step's tally, for integrators that look back.
    """

    start: float
    flows: Account = field(default_factory=lambda: dict.fromkeys((*DISSIPATED, *INJECTED), 0.0))
    turnover: float = 0.0
    rows: np.ndarray | None = None

    def ledger(self, energy: Account, pending: float) -> Ledger:
        """With the present `energy` by kind, and what settings put in that no step has reported yet."""
        injected = {name: self.flows[name] for name in INJECTED}
        injected["settings"] += pending
        return Ledger(
            self.start, energy, {name: self.flows[name] for name in DISSIPATED}, injected, self.turnover
        )

    def after(self, parts: list[Part], settings: float, switched: float, rows: np.ndarray | None) -> Books:
        """With a step made in `parts`, what settings put in before it, and switched springs after."""
        flows, turnover = dict(self.flows), self.turnover + abs(settings) + abs(switched)
        flows["settings"] += settings
        flows["switched springs"] += switched
        for part in parts:
            turnover += part.turnover
            for name, amount in part.flows.items():
                flows[name] += amount
        return Books(self.start, flows, turnover, rows)

    def asleep(self, energy: float) -> Books:
        """With the `energy` [J] that cloth had when it fell asleep, and no longer has."""
        flows = {**self.flows, "sleep": self.flows["sleep"] + energy}
        return replace(self, flows=flows, turnover=self.turnover + energy)


class Tally:
    """Impulses and work of a step's forces, integrated by the integrator along with the state.

    They are rows below the velocities: `n` each of S, L, N and F, then the powers of damping, of springs that
    are wrong on purpose and of the wind, and, of what contacts push and rub with, the parts of obstacles.
    Below positions are as many, which mean nothing.

    Args:
        model: Springs and masses.
        contacts: What the step feels.
        before: The rows of the step before, where the integrator looks back.
        report: Is told what all this takes, but for what an explicit stage needs anyway.
    """

    def __init__(
        self, model: Model, contacts: GapSprings, before: np.ndarray | None, report: StepReport
    ) -> None:
        self._model, self._contacts, self._before, self._report = model, contacts, before, report

    def state(self, x: np.ndarray, v: np.ndarray) -> State:
        """Positions and velocities (n, 3) with nothing integrated."""
        return self._below(x), self._below(v)

    def earlier(self, x: np.ndarray, v: np.ndarray, now: np.ndarray) -> State:
        """The same one step earlier; where no books were kept then, S alone made the velocities `now`."""
        n = len(v)
        rows = self._before
        if rows is None:
            rows = np.zeros((4 * n + 2, 3))
            rows[:n] = self._model.masses[:, None] * (now - v)
        return self._below(x), np.concatenate([v, -rows])

    @staticmethod
    def _below(array: np.ndarray) -> np.ndarray:
        whole = np.zeros((5 * len(array) + 2, 3))
        whole[: len(array)] = array
        return whole

    def after(self, stage: Solution, v_hat: np.ndarray, h: float) -> State:
        """The end of a stage of backward Euler over `h` [s] from velocities and rows `v_hat`."""
        felt = stage.felt
        assert felt is not None
        with self._report.spent("ledger", alone=True):
            rates = self._rates(stage.positions, stage.velocities, felt, anew=False)
            end = np.empty_like(v_hat)
            _integrate(stage.velocities, rates, felt.impulse, v_hat, h, end)
            return self._below(stage.positions), end

    def rates(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Accelerations (n, 3) [m/s²] of an explicit stage, and the rows' rates below them."""
        felt, n = Felt(np.zeros(0), *self._contacts.shares(x, v, pull=False)), len(x)
        rates = self._rates(x, v, felt, anew=True)
        return np.concatenate([self._model.inverse_masses[:, None] * (rates[:n] + felt.normal), rates])

    def _rates(self, x: np.ndarray, v: np.ndarray, felt: Felt, anew: bool) -> np.ndarray:
        n = len(x)
        rates = np.zeros((4 * n + 2, 3))
        taken, blown = self._model.felt(x, v, anew, rates[:n])
        rates[2 * n : 3 * n], rates[3 * n : 4 * n] = felt.normal, felt.friction
        rates[4 * n] = sum(taken.values()), self._wrong(v, taken), blown
        rates[4 * n + 1, :2] = felt.carried
        return rates

    def _wrong(self, v: np.ndarray, taken: Account) -> float:
        """What springs that are wrong on purpose give [W], their damping aside, which has `taken` its own."""
        given = 0.0
        for springs in self._model.springs:
            if springs.kind.wrong and springs.acts:
                e = springs.elements
                given -= float(e.tension @ np.einsum("eki,eki->e", e.gradient, v[e.nodes]))
                given += taken[springs.name]
        return given


class Unbooked:
    """A part of a step whose energy nobody asks after."""

    keep_apart = staticmethod(keep_apart)
    rub = staticmethod(rub)
    slow = staticmethod(slow)

    def respond_anew(self) -> None:
        """Nothing is known of an earlier try."""

    @staticmethod
    def project(*about: Any) -> None:
        """Put right what a step led into."""
        project(*about, np.zeros_like(about[-1]))


UNBOOKED = Unbooked()


class Part:
    """Books of one step of the integrator, which may be a part of a step, while it is made.

    Args:
        model: Springs and masses.
        x: (n, 3) positions at its start [m].
        v: (n, 3) velocities at its start [m/s].

    Attributes:
        flows: What it came to, by entry.
        turnover: And without signs.
    """

    def __init__(self, model: Model, x: np.ndarray, v: np.ndarray) -> None:
        self._model, self._x, self._v = model, x, v
        self._potential = model.energies(x)
        self.flows: Account = {}
        self.turnover = 0.0
        self.respond_anew()

    def respond_anew(self) -> None:
        """Forget what an earlier try at a response gave."""
        self._given: dict[str, np.ndarray] = {}
        self._carried = dict.fromkeys(("contact", "friction"), 0.0)

    def keep_apart(self, contacts: Contacts, targets, masses, inverse, h, x, v, given, report) -> None:
        """As `sim.contact.zones.keep_apart`."""
        if not len(given):
            return
        before, was = given.copy(), v.copy()
        keep_apart(contacts, targets, masses, inverse, h, x, v, given, report)
        if np.array_equal(given, before):
            return
        self._give("contact", v - was)
        self._carried["contact"] += float((given - before) @ along(contacts.normal, contacts.speed))

    def rub(self, contacts: Contacts, masses, inverse, h, x, v, allowed) -> None:
        """As `sim.contact.friction.rub`."""
        if not len(allowed):
            return
        with self._giving("friction", v):
            carried = rub(contacts, masses, inverse, h, x, v, allowed)
        self._carried["friction"] += carried

    def slow(self, v, which, most) -> None:
        """As `sim.contact.hold.slow`."""
        if not len(which):
            return
        with self._giving("contact", v):
            slow(v, which, most)

    def project(self, contacts: Contacts, friction, masses, inverse, x, v) -> None:
        """As `sim.contact.response.project`."""
        rubbed = np.zeros_like(v)
        with self._giving("contact", v):
            pushed, dragged = project(contacts, friction, masses, inverse, x, v, rubbed)
        self._give("contact", -rubbed)
        self._give("friction", rubbed)
        self._carried["contact"] += pushed
        self._carried["friction"] += dragged

    @contextmanager
    def _giving(self, name: str, v: np.ndarray) -> Iterator[None]:
        """Book what the block does to velocities `v` (n, 3) as given by `name`."""
        before = v.copy()
        yield
        self._give(name, v - before)

    def _give(self, name: str, change: np.ndarray) -> None:
        """Book a `change` (n, 3) of velocities [m/s]."""
        self._given[name] = self._given[name] + change if name in self._given else change

    def close(self, solution: Solution) -> None:
        """Make the entries, at the end of it: the `solution` has the rows of a Tally."""
        assert solution.rows is not None
        (damping, wrong, wind), (pushed, rubbed, _) = solution.rows[-2:].tolist()
        pushed, rubbed = pushed + self._carried["contact"], rubbed + self._carried["friction"]
        given = (self._given.get(name, NOTHING) for name in ("contact", "friction"))
        limited = NOTHING if solution.limited is None else solution.limited
        about = self._v, solution.velocities, self._model.masses, solution.rows, *given, limited
        kinetic, springs, linear, normal, friction, shortened = _works(*about).tolist()
        potential = self._model.energies(solution.positions)
        changes = {name: energy - self._potential[name] for name, energy in potential.items()}
        wrong += sum(changes[s.name] for s in self._model.springs if s.kind.wrong)
        self.flows = {
            "damping": damping,
            "friction": rubbed - friction,
            "contact": pushed - normal,
            "strain limiting": -shortened,
            "linearisation": -linear,
            "integrator": wrong + wind - sum(changes.values()) - springs - damping,
            "wind": wind,
            "obstacles": pushed + rubbed,
            "wrong springs": wrong,
        }
        self.turnover = 0.5 * sum(map(abs, (kinetic, *changes.values(), *self.flows.values())))


@kernel
def _integrate(velocities, rates, impulse, before, h, end):
    """Fill `end` (5n + 2, 3): `velocities` (n, 3), and the rows `before` with their `rates` for h [s] more.

    L is what of a solve's `impulse` (n, 3) [N s] the other forces are not.
    """
    n = len(velocities)
    for i in range(n):
        for c in range(3):
            known = rates[i, c] + rates[2 * n + i, c] + rates[3 * n + i, c]
            end[i, c] = velocities[i, c]
            end[n + i, c] = before[n + i, c] + h * rates[i, c]
            end[2 * n + i, c] = before[2 * n + i, c] + impulse[i, c] - h * known
    for k in range(2 * n, 4 * n + 2):
        for c in range(3):
            end[n + k, c] = before[n + k, c] + h * rates[k, c]


@kernel
def _works(before, after, masses, rows, pushed, rubbed, limited):
    """Works [J] along the mean of the velocities `before` and `after` (n, 3).

    Of what changes these, and, as the first of the `rows` have them, of S, L, N and F; the last two with what
    contacts `pushed` and `rubbed` velocities by after the solve, (n, 3) [m/s]; and of what strain limiting
    gave, (n, 3) [N s]. Of these three NOTHING is none.
    """
    n, works = len(masses), np.zeros(6)
    for i in range(n):
        for c in range(3):
            mean = 0.5 * (before[i, c] + after[i, c])
            works[0] += mean * masses[i] * (after[i, c] - before[i, c])
            for k in range(4):
                works[1 + k] += mean * rows[k * n + i, c]
            if len(pushed):
                works[3] += mean * masses[i] * pushed[i, c]
            if len(rubbed):
                works[4] += mean * masses[i] * rubbed[i, c]
            if len(limited):
                works[5] += mean * limited[i, c]
    return works
