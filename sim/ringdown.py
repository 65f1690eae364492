"""The damping a mode of the cloth really has: set, to be expected, added by the integrator, and measured.

Cloth at rest is deflected a little in the shape of one of its modes and let go. The deflection y of that mode
then follows y_{k+2} = a y_{k+1} + b y_k, whose roots ρ give the decay and the frequency (Prony 1795), also
where it creeps back without ringing. An integrator that looks back two steps has two roots more, which fade.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh

from sim.damping import apparent
from sim.integrators import INTEGRATORS
from sim.scene import Scene, load_scene
from sim.simulation import Simulation
from sim.solve.stability import system_matrices
from sim.statics import equilibrium

DEFLECTION = 1e-4
"""Largest deflection as part of the cloth's size: small, so that its springs stay linear."""

DIGITS = 1e-6
"""Position error that a solve may leave, as part of the deflection."""

PERIODS, FEWEST, MOST = 0.6, 12, 4000
"""How long the motion is followed, and bounds on its steps."""

APART = 0.3
"""Phase ω t from one sample of the fit to the next, at least: closer ones differ by little but rounding."""

MISFIT = 1e-3
"""Part of the motion by which samples may miss a recurrence that they are said to follow."""

OFF = 0.05
"""Part by which the frequency of a ring-down may differ from that of the mode it is taken for."""

RIGID = 1e-12
"""Modes this much slower than the fastest (ω²) are motions of a whole piece, seen through rounding."""

DENSE = 400
"""Vertices up to which all modes are computed at once."""


@dataclass(frozen=True)
class ModalDamping:
    """Damping of one mode.

    Attributes:
        frequency: ω of the mode, undamped [rad/s].
        gamma: The damping ratio set for every spring.
        modal: What the springs' dampers make of it for this mode.
        stepped: That, and what the integrator adds at its time step.
        measured: From the ring-down.
        measured_frequency: Undamped, from the ring-down [rad/s].
    """

    frequency: float
    gamma: float
    modal: float
    stepped: float
    measured: float
    measured_frequency: float

    @property
    def integrator_share(self) -> float:
        """What the integrator adds by itself."""
        return self.stepped - self.modal


def modal_damping(
    scene: Scene | str | Path | dict[str, Any],
    mode: int = 0,
    longest: float = math.inf,
    **overrides: Any,
) -> ModalDamping:
    """Measure the damping ratio of a mode of `scene` about its equilibrium, contact left out.

    Cloth that nothing but an obstacle holds is measured as it floats, without gravity.

    Args:
        scene: As for Simulation.
        mode: 0 is the slowest that deforms the cloth; −1 the fastest.
        longest: Leave out modes with a longer period [s], which take as long to measure.
        overrides: Settings that differ from the scene's.

    Raises:
        StepError: where the motion cannot be followed.
        SceneError, ValueError, EquilibriumError: As `equilibrium`; ValueError also where no such mode is.
    """
    scene, overrides = load_scene(scene), {**overrides, "contact": "none"}
    if not all(cloth.pins for cloth in scene.cloth):
        overrides["gravity"] = (0.0, 0.0, 0.0)
    world = equilibrium(scene, **overrides)
    frequency, shape = cloth_mode(world, mode, longest)
    _, damping = system_matrices(world.model, world.positions)
    moving = shape.ravel()
    modal = float(moving @ (damping @ moving)) / (2.0 * frequency)
    s = world.settings
    stepped = float(apparent(s.integrator, frequency * s.dt, modal)[0])
    roots = 4 if INTEGRATORS[s.integrator].looks_back else 2
    every = max(1, round(APART / (frequency * s.dt)))
    samples = _let_go(world, shape, frequency)[::every]
    measured, rate = fit_ring_down(samples, every * s.dt, roots)
    expected = frequency * float(apparent(s.integrator, frequency * s.dt, modal)[1])
    if not abs(rate - expected) <= OFF * expected:
        raise ValueError(
            f"mode {mode}: expected a ring-down at {expected:.4g} rad/s, got {rate:.4g}; the cloth is too "
            "stiff, or its rest too delicate, to tell the mode from rounding"
        )
    return ModalDamping(frequency, s.gamma, modal, stepped, measured, rate)


def cloth_mode(world: Simulation, mode: int = 0, longest: float = math.inf) -> tuple[float, np.ndarray]:
    """Frequency ω [rad/s] and shape (n, 3), of unit mass-weighted norm, of a mode about the present state.

    Arguments and errors are those of `modal_damping`.
    """
    if isinstance(mode, bool) or not isinstance(mode, int):
        raise ValueError(f"mode: expected a whole number, got {mode!r}")
    if not longest > 0.0:
        raise ValueError(f"longest: expected > 0 s, got {longest:g}")
    if not world.model.free.any():
        raise ValueError("cloth: expected vertices that can move, got none")
    stiffness, _ = system_matrices(world.model, world.positions, exact=True)
    kept = np.flatnonzero(np.repeat(world.model.free, 3))
    scale = np.repeat(np.sqrt(world.masses), 3)[kept]
    scaled = diags_array(1.0 / scale) @ stiffness[kept][:, kept] @ diags_array(1.0 / scale)
    fastest = float(abs(scaled).sum(axis=1).max())  # no ω² exceeds it
    slowest = max(RIGID * fastest, (2.0 * math.pi / longest) ** 2)
    if len(kept) <= 3 * DENSE or not -len(kept) // 4 < mode < len(kept) // 4:
        squares, shapes = eigh(scaled.toarray())
    elif mode < 0:
        squares, shapes = eigsh(scaled, k=-mode, which="LA", v0=np.ones(len(kept)))
    else:
        squares, shapes = eigsh(scaled, k=mode + 1, sigma=slowest, which="LA", v0=np.ones(len(kept)))
    order = np.argsort(squares)
    squares, shapes = squares[order], shapes[:, order]
    real = np.flatnonzero(squares > slowest)
    if not len(real):
        raise ValueError(f"longest: there is no mode with a period up to {longest:g} s")
    if not -len(real) <= mode < len(real):
        raise ValueError(f"mode: expected {-len(real)} to {len(real) - 1}, got {mode}")
    chosen = real[mode]
    shape = np.zeros(3 * len(world.masses))
    shape[kept] = shapes[:, chosen] / scale
    return math.sqrt(squares[chosen]), shape.reshape(-1, 3)


def fit_ring_down(samples: np.ndarray, dt: float, roots: int = 2) -> tuple[float, float]:
    """Damping ratio and undamped frequency [rad/s] of a decaying motion sampled every `dt` [s].

    Args:
        samples: (k,) of the motion.
        dt: Time from one to the next [s].
        roots: Of the recurrence that the samples follow; the two that fade last are the motion.

    Raises:
        ValueError: for samples that do not decay like a damped oscillator.
    """
    y = np.asarray(samples, dtype=float)
    other = ValueError("samples: expected the motion of a damped oscillator, got something else")
    if len(y) < 2 * roots + 1 or not np.isfinite(y).all():
        raise other
    past = np.lib.stride_tricks.sliding_window_view(y[:-1], roots)[:, ::-1]
    recurrence, _, rank, _ = np.linalg.lstsq(past, y[roots:], rcond=1e-12)
    off = np.abs(past @ recurrence - y[roots:]).max()
    if rank < roots or off > MISFIT * np.abs(y).max():
        raise other
    found = np.roots([1.0, *-recurrence]).astype(complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.log(found[np.argsort(-np.abs(found))][:2]) / dt
        frequency = np.sqrt(rates[0] * rates[1])
        ratio = -(rates[0] + rates[1]) / (2.0 * frequency)
    grows = np.abs(found).max() > 1.0 + MISFIT
    if grows or not (np.isfinite(ratio) and np.isfinite(frequency) and frequency.real > 0.0):
        raise other
    return float(ratio.real), float(frequency.real)


def _let_go(world: Simulation, shape: np.ndarray, frequency: float) -> np.ndarray:
    """Deflections of the mode `shape` in time, from a small one on."""
    size = float(np.ptp(world.positions, axis=0).max()) or 1.0
    deflection = DEFLECTION * size / float(np.abs(shape).max())
    rest, weights = world.positions.copy(), world.masses[:, None] * shape
    exact = {"newton": 20, "tolerance": DIGITS * DEFLECTION * size, "solver": "direct"}
    world.update(**{k: v for k, v in exact.items() if k != "tolerance" or v < world.settings.tolerance})
    world.place(rest + deflection * shape)
    steps = math.ceil(PERIODS * 2.0 * math.pi / (frequency * world.settings.dt))
    samples = [deflection]
    for _ in range(min(max(steps, FEWEST), MOST)):
        world.step()
        samples.append(float(np.sum(weights * (world.positions - rest))))
    return np.array(samples)
