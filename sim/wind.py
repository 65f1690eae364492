"""Wind: drag and lift of the air on every triangle, with gusts that travel along with it.

The air passes corner i of a triangle at u = w − v_i. With A its area, n its unit normal on the lee side
(n·u ≥ 0) and ρ the density of air, the corner is pushed by a third of

    F = ½ ρ A (n·u) C [ u + lift (|u| n − (n·u) u / |u|) ]

that is by drag, ½ ρ C |u|² times the area that the triangle shows the air, and square to it by lift, which is
greatest at 45°. Triangles know nothing of each other: none is in another's lee, and the air is not moved.

In an implicit step drag is a coefficient g = Σ ½ ρ A (n·u) C / 3 per vertex times w − v at the end of the
step, with g and lift of the velocity before, or of the Newton iteration before. However long the step h is,
|v − w| of a vertex that nothing else acts on does not grow: it is multiplied by no more than
√(1 + (lift h g/m)²) / (1 + h g/m), and lift ≤ 1.

Gusts have the spectrum of turbulence, f^(−5/3) (Kolmogorov 1941), of a few frequencies with seeded phases,
alike in all directions, and are carried by the mean wind unchanged (Taylor 1938). They hold for a step.
"""

from __future__ import annotations

import math

import numpy as np

from sim.compiled import add, cross, dot, kernel, norm, put, row, scale, sub
from sim.mesh import Mesh
from sim.settings import Settings
from sim.solve.system import Matrix

DENSITY = 1.2
"""Of air at 20 °C and sea level [kg/m³]."""

FREQUENCIES = 0.25 * 2.0 ** np.arange(0.0, 5.0, 1.0 / 6.0).reshape(10, 3).T
"""Of gusts [Hz], for each direction: from 4 s down to what a step of 1/60 s still resolves."""

SLOWEST = 1e-3
"""Mean wind [m/s] below which gusts do not travel."""


class Wind:
    """What the air does to the triangles of a mesh.

    Attributes:
        air: (n, 3) velocity w of the air at each vertex [m/s], as `blow` left it.
        drag: (n,) g [kg/s], where it was last measured.
        lift: (n, 3) [N], there.
    """

    def __init__(self, mesh: Mesh) -> None:
        n = len(mesh.vertices)
        self._triangles = mesh.triangles
        self.air, self.lift, self.drag = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
        self._strength = self._part = 0.0

    def blow(self, settings: Settings, time: float, positions: np.ndarray) -> None:
        """Set the air to that of `time` [s] at `positions` (n, 3) [m]."""
        mean = np.asarray(settings.wind)
        self._strength, self._part = DENSITY * settings.drag / 6.0, settings.lift
        self.air[:] = mean
        speed = float(np.linalg.norm(mean))
        if settings.gust > 0.0 and speed > 0.0:
            along = positions @ mean / speed**2 if speed > SLOWEST else np.zeros(len(positions))
            self.air += settings.gust * speed * _gusts(settings.seed, time - along)

    def measure(self, positions: np.ndarray, velocities: np.ndarray) -> None:
        """Set drag and lift to those of a state, (n, 3) [m] and [m/s]."""
        about = self._triangles, positions, self.air - velocities, self._strength, self._part
        _measure(*about, self.drag, self.lift)

    def push(self, velocities: np.ndarray, forces: np.ndarray) -> float:
        """Add g (w − v) and the lift to `forces` (n, 3) [N]; gives their power [W]."""
        return _push(self.air, self.drag, self.lift, velocities, forces)

    def linearise(self, velocities: np.ndarray, h: float, matrix: Matrix, forces: np.ndarray) -> None:
        """`push`, and add h g to the diagonal of the matrix of an implicit step of h [s]."""
        self.push(velocities, forces)
        for c in range(3):
            matrix.diagonal[:, c, c] += h * self.drag

    def along(self, velocities: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Coefficients of 1, t and t² in Σ g |v − w|² − 2 lift·(v − w) at velocities + t step."""
        passing = velocities - self.air
        pull = self.drag[:, None] * passing - self.lift
        constant = float(np.sum((pull - self.lift) * passing))
        return np.array(
            [constant, 2.0 * float(np.sum(pull * step)), float(self.drag @ (step**2).sum(axis=1))]
        )

    def power(self, velocities: np.ndarray) -> float:
        """What the air gives to vertices with these `velocities` (n, 3) [W]; negative where it brakes."""
        return float(np.sum((self.drag[:, None] * (self.air - velocities) + self.lift) * velocities))


def _gusts(seed: int, times: np.ndarray) -> np.ndarray:
    """(n, 3) part of the mean speed at each of the (n,) `times` [s], of mean square 1 in each direction."""
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, FREQUENCIES.shape)
    gusts = np.zeros((len(times), 3))
    for c, (frequencies, phase) in enumerate(zip(FREQUENCIES, phases, strict=True)):
        # Equal steps of the logarithm of the frequency: a step holds f · f^(−5/3) of the mean square.
        square = frequencies ** (-2.0 / 3.0)
        size = np.sqrt(2.0 * square / square.sum())
        gusts[:, c] = np.sin(2.0 * math.pi * np.outer(times, frequencies) + phase) @ size
    return gusts


@kernel
def _measure(triangles, positions, passing, strength, part, drag, lift):
    """Fill `drag` (n,) and `lift` (n, 3) where the air is `passing` (n, 3) the vertices [m/s].

    `strength` is ρ C / 6, `part` the lift's of the drag.
    """
    drag[:] = 0.0
    lift[:] = 0.0
    for t in range(len(triangles)):
        a = row(positions, triangles[t, 0])
        n = cross(sub(row(positions, triangles[t, 1]), a), sub(row(positions, triangles[t, 2]), a))
        twice = norm(n)
        if not twice > 0.0:
            continue
        n = scale(1.0 / twice, n)
        for k in range(3):
            i = triangles[t, k]
            u = row(passing, i)
            across, speed = dot(n, u), norm(u)
            g = 0.5 * twice * strength * abs(across)
            drag[i] += g
            if speed > 0.0:
                lee = scale(math.copysign(speed, across), n)
                up = sub(lee, scale(abs(across) / speed, u))
                put(lift, i, add(row(lift, i), scale(part * g, up)))


@kernel
def _push(air, drag, lift, velocities, forces):
    """Add drag (air − v) and lift to `forces`; returns their power."""
    power = 0.0
    for i in range(len(forces)):
        for c in range(3):
            force = drag[i] * (air[i, c] - velocities[i, c]) + lift[i, c]
            forces[i, c] += force
            power += force * velocities[i, c]
    return power
