"""The one kernel that every implicit integrator calls: backward Euler from (x̂, v̂) over h.

It finds v with x = x̂ + h v and M (v − v̂) = h f(x, v), which minimises the incremental potential
Φ(v) = ½ ‖v − v̂‖²_M + E(x̂ + h v) + ½ h Σ b q̇², where friction's drag counts like damping. One Newton iteration
is the linearised step of Baraff and Witkin (1998); more of them, with a line search that never lets Φ grow,
converge to the solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim.compiled import corner, dot, kernel, row
from sim.contact.gap import GapSprings
from sim.model import Model
from sim.settings import Settings
from sim.solve.cg import BROKEN, CONVERGED, EXHAUSTED, conjugate_gradients, multiply, rounding_error
from sim.solve.preconditioner import refresh

MOST_ITERATIONS = 5000
"""Iterations after which a linear solve gives up; what it has then is still a descent direction."""

LARGEST_DIRECT = 20_000
"""Vertices above which "auto" never factors: memory and time grow too fast."""

SUFFICIENT = 1e-4
"""Part of the predicted decrease of Φ that a step must achieve (Armijo 1966)."""

ROUNDING = 1e-14
"""Part of Φ that is lost in adding it up: a smaller increase is none."""

FILTERED = 2
"""Newton iterations that use the filtered Hessian; the exact one, for the last digits, comes after them."""

SHORTEST_STEP = 1e-6
"""Part of a Newton step below which the line search gives up and keeps what it has."""


class SolveError(ArithmeticError):
    """The linear system could not be solved; the message says which number went wrong."""


class Felt(NamedTuple):
    """What a solve felt, for a ledger.

    Attributes:
        impulse: (n, 3) of all forces, as its last linear model has them [N s].
        normal: (n, 3) forces of contacts along their normals, at the end of the step [N].
        friction: (n, 3) and across them [N].
        carried: Powers [W] that the other sides' motion puts in by both.
    """

    impulse: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    carried: tuple[float, float]


@dataclass(frozen=True)
class Solution:
    """The end of an implicit step.

    Attributes:
        positions: (n, 3) [m].
        velocities: (n, 3) [m/s].
        iterations: Of the linear solver, summed over Newton iterations.
        newton: Newton iterations done.
        residual: Estimated position error of the last linear solve at the worst vertex [m].
        converged: The linear solves reached the tolerance, and Newton did where it may iterate.
        solver: What the last linear system was solved with, "cg" or "direct".
        stopped: Why Newton's iteration ended.
        felt: What it felt, where a ledger is kept.
        rows: What a ledger's tally integrated along with it.
        limited: (n, 3) what strain limiting gave after it [N s]; None without.
    """

    positions: np.ndarray
    velocities: np.ndarray
    iterations: int
    newton: int
    residual: float
    converged: bool
    solver: str = ""
    stopped: str = ""
    felt: Felt | None = None
    rows: np.ndarray | None = None
    limited: np.ndarray | None = None


def backward_euler(
    model: Model,
    contacts: GapSprings,
    settings: Settings,
    x_hat: np.ndarray,
    v_hat: np.ndarray,
    h: float,
    start: np.ndarray,
    filtered: int = FILTERED,
    booked: bool = False,
    guess: np.ndarray | None = None,
) -> Solution:
    """Solve one backward-Euler step from (`x_hat`, `v_hat`) over `h` [s].

    Args:
        model: Springs, masses and the matrix to assemble into.
        contacts: Contact coordinates felt by the solve.
        settings: newton, tolerance and gravity are read.
        x_hat: (n, 3) [m], equal to `start` on fixed vertices.
        v_hat: (n, 3) [m/s], zero on fixed vertices.
        h: Length of the step [s].
        start: (n, 3) positions to linearise at first [m].
        filtered: Newton iterations before those with the exact Hessian.
        booked: Whether to say what the solve felt.
        guess: (n, 3) velocities near those that the first linear solve ends with; `v_hat` without [m/s].

    Raises:
        SolveError: where the matrix is not positive definite or a number is not finite.
    """
    velocities = (start - x_hat) / h
    fall = model.confined(np.broadcast_to(h * np.asarray(settings.gravity), start.shape))
    guess, shortcut = (v_hat if guess is None else guess) - velocities, fall
    iterations, newton = 0, 0
    while True:
        newton += 1
        at, change = x_hat + h * velocities, v_hat - velocities
        loose = model.loose(contacts.contacts)
        exact = newton > filtered
        lag = v_hat if newton == 1 else velocities  # the first iterate stands still, which air would not feel
        forces = model.linearise(at, velocities, contacts, h, exact, lag)
        linear = _solve(model, loose, settings, forces, change, guess, shortcut, h)
        if exact and linear.broken:
            exact, forces = False, model.linearise(at, velocities, contacts, h)
            linear = _solve(model, loose, settings, forces, change, guess, shortcut, h)
        iterations += linear.iterations
        end = velocities + linear.step
        if contacts.settle(velocities, x_hat + h * end, end, model, settings.friction, h, forces):
            go_on = linear.step, np.zeros_like(guess), h
            linear = _solve(model, loose, settings, forces, change, *go_on, anew=False)
            if exact and linear.broken:  # what the first solve did not come across, this one may
                forces = model.linearise(at, velocities, contacts, h, lag=lag)
                linear = _solve(model, loose, settings, forces, change, *go_on)
            iterations += linear.iterations
        if linear.broken:
            raise SolveError(_what_broke(forces))
        step = linear.step
        small = h * float(np.abs(step).max(initial=0.0)) <= settings.tolerance
        if settings.newton > 1 and model.conservative:
            descent = model.masses[:, None] * change + h * forces
            drift = _drift(model, loose, model.masses[:, None] * step)
            way = step - drift, descent
            step = drift + _line_search(model, contacts, x_hat, v_hat, velocities + drift, h, *way)
        velocities = velocities + step
        at, last = x_hat + h * velocities, newton == settings.newton or not step.any()
        shares = contacts.shares(at, velocities) if booked and (small or last) else None
        if settings.newton > 1:
            moved = h * float(np.abs(step).max(initial=0.0))
            small = not contacts.engage(at, settings.tolerance, moved, last) and small
        guess, shortcut = np.zeros_like(step), np.zeros_like(step)
        converged = linear.converged and (settings.newton == 1 or small)
        if converged or last:
            why = _why_stopped(settings, linear, small, bool(step.any()))
            felt = None
            if shares is not None:
                felt = Felt(_modelled(model, forces, linear.step, step, h), *shares)
            how = iterations, newton, linear.error, converged, linear.solver, why
            return Solution(at, velocities, *how, felt)


def _modelled(model: Model, forces: np.ndarray, full: np.ndarray, step: np.ndarray, h: float) -> np.ndarray:
    """(n, 3) impulse [N s] that the linear model has: h f − (A − M) step where the `full` step was made.

    Of a step that the line search shortened it also has what that left out, on purpose: A (full − step).
    """
    impulse = np.empty_like(full)
    multiply(model.matrix, model.coupling, model.free, full, impulse, model.work.partial)
    _add_impulse(h, forces, model.masses, step, impulse)
    return impulse


@kernel
def _add_impulse(h, forces, masses, step, product):
    """Turn the `product` A step into h f − A step + M step."""
    for i in range(len(step)):
        for c in range(3):
            product[i, c] = h * forces[i, c] - product[i, c] + masses[i] * step[i, c]


def _what_broke(forces: np.ndarray) -> str:
    wild = ~np.isfinite(forces).all(axis=1)
    if wild.any():
        return f"force on vertex {int(np.argmax(wild))} is not finite"
    return "matrix of the linear system is not positive definite or not finite"


def _why_stopped(settings: Settings, linear: _Linear, small: bool, moved: bool) -> str:
    """In words, the most telling reason first."""
    if not linear.converged:
        return f"the linear solver gave up at an error of {linear.error:.2g} m"
    if settings.newton == 1:
        return "linearised: one iteration is all that is asked for"
    if small:
        return f"the last change of velocity was below {settings.tolerance / settings.dt:.2g} m/s"
    return "all iterations used" if moved else "no shorter step lowers the potential"


@dataclass(frozen=True)
class _Linear:
    step: np.ndarray
    iterations: int
    error: float
    converged: bool
    broken: bool
    solver: str


def _solve(model, loose, settings, forces, change, guess, shortcut, h, anew=True) -> _Linear:
    """Solve A step = M `change` + h `forces`, to settings.tolerance in h · step.

    On `loose` pieces, which nothing holds from outside, A moves a translation like M alone does: what
    the residual has of one is taken out exactly, so that the tolerance costs no momentum. The preconditioner
    is computed `anew`, or the last one serves: where drag alone has changed, it costs more than it saves.
    """
    rest = model.masses[:, None] * change + h * forces
    if settings.solver == "direct":
        return _solve_directly(model, settings, rest, h, 0)
    auto, n = settings.solver == "auto", len(rest)
    most = _worth_a_factorisation(n) if auto and n <= LARGEST_DIRECT else MOST_ITERATIONS
    if anew:
        refresh(model.preconditioner, model.matrix)
    right, step, allowed = rest.copy(), guess.copy(), settings.tolerance / h
    system = model.matrix, model.coupling, model.preconditioner
    iterations, error, status = conjugate_gradients(*system, model.work, rest, step, shortcut, allowed, most)
    if status == CONVERGED and _may_be_rounding(model, step, allowed):
        error = max(error, rounding_error(*system, model.work, right, step))
        status = CONVERGED if error <= allowed else EXHAUSTED
    if status == EXHAUSTED and auto and n <= LARGEST_DIRECT:
        return _solve_directly(model, settings, right, h, iterations)
    step += _drift(model, loose, rest)
    broken = status == BROKEN or not np.isfinite(step).all()
    return _Linear(step, iterations, h * error, status == CONVERGED, broken, "cg")


def _may_be_rounding(model: Model, step: np.ndarray, allowed: float) -> bool:
    """Whether the rounding of A `step` may be an error above what is `allowed` [m/s]: A is at least M."""
    stiffest = model.matrix.diagonal.max(initial=0.0)  # no entry of a definite matrix is larger
    largest = float(stiffest * np.abs(step).max(initial=0.0))
    lightest = float(model.masses.min(initial=np.inf, where=model.free))
    return bool(np.finfo(float).eps * largest > allowed * lightest)


def _worth_a_factorisation(n: int) -> int:
    """Iterations that take about as long as factoring the matrix of n vertices; measured from 256 to 4,096.

    Who tries no more of them than that, and then factors, spends at most twice what the faster way takes; and
    it does not depend on the clock, so that the same run gives the same bits.
    """
    return max(30, math.ceil(n ** (2 / 3)))


def _solve_directly(model: Model, settings: Settings, right: np.ndarray, h: float, tried: int) -> _Linear:
    """By a factorisation, after `tried` iterations that were not enough."""
    from sim.solve.direct import solve_directly  # SciPy, which the usual solver does without

    step = np.empty_like(right)
    error, definite = solve_directly(model.matrix, model.coupling, model.free, right, step)
    broken = not (definite and np.isfinite(step).all())
    return _Linear(step, tried + 1, h * error, h * error <= settings.tolerance, broken, "direct")


Groups = tuple[np.ndarray, np.ndarray]
"""Pieces by group, and the groups' masses [kg], as `Model.loose` gives them."""


def _drift(model: Model, loose: Groups, momentum: np.ndarray) -> np.ndarray:
    """(n, 3) the velocity of loose groups of pieces as a whole, given each vertex's `momentum`; else zero."""
    if np.isinf(loose[1]).all():
        return np.zeros_like(momentum)
    groups = loose[0][model.mesh.pieces]
    whole = np.stack([np.bincount(groups, momentum[:, c], len(loose[1])) for c in range(3)], axis=1)
    return (whole / np.where(loose[1] > 0.0, loose[1], 1.0)[:, None])[groups]


def _line_search(model, contacts, x_hat, v_hat, velocities, h, step, descent) -> np.ndarray:
    """The longest of step, step/2, step/4 … that decreases Φ enough.

    `descent` is −∂Φ/∂v along every step without drift. Loose pieces have drifted in full before: Φ is exactly
    quadratic in that, and a shortened step would take their momentum away.
    """
    quadratic = contacts.drag_along(velocities, step)
    if model.wind is not None:
        quadratic = quadratic + model.wind.along(velocities, step)
    for springs in model.springs:
        quadratic = quadratic + damping_along(springs.elements, velocities, step)

    def potential(t: float) -> float:
        v = velocities + t * step
        inertia = 0.5 * float(np.sum(model.masses[:, None] * (v - v_hat) ** 2))
        viscous = 0.5 * h * float(quadratic @ (1.0, t, t * t))
        return inertia + viscous + model.potential(x_hat + h * v, contacts)

    before, slope, t = potential(0.0), float(np.sum(descent * step)), 1.0
    noise = ROUNDING * abs(before)
    while t > SHORTEST_STEP and not potential(t) <= before - SUFFICIENT * t * slope + noise:
        t *= 0.5
    return t * step if t > SHORTEST_STEP else np.zeros_like(step)


@kernel
def damping_along(elements, velocities, step):
    """Coefficients of 1, t and t² in Σ b q̇² at velocities + t step."""
    constant = linear = square = 0.0
    for e in range(len(elements.q)):
        rate, change = -elements.drift[e], 0.0
        for a in range(elements.nodes.shape[1]):
            g = corner(elements.gradient, e, a)
            rate += dot(g, row(velocities, elements.nodes[e, a]))
            change += dot(g, row(step, elements.nodes[e, a]))
        constant += elements.damping[e] * rate * rate
        linear += 2.0 * elements.damping[e] * rate * change
        square += elements.damping[e] * change * change
    return np.array([constant, linear, square])
