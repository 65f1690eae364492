"""Hard cases of springs, integrators and solvers, held against closed forms, published numbers and bounds.

Numbers N1 to N18 are those of the list of hard cases; N17 needs torsion that springs do not have.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.spatial import Delaunay
from scipy.special import ellipe, ellipk

from sim.check import check_scene
from sim.contact.gap import NO_GAP_SPRINGS
from sim.contact.intersections import intersections
from sim.elements import Elements, make_elements
from sim.scene import SceneError, load_scene
from sim.simulation import Simulation
from sim.springs import BENDING, STRETCH, SpringKind
from sim.statics import equilibrium
from sim.stress import Figure, at_least, at_most, case, reported
from sim.stress.measures import EARTH, G, dense, elements_at, period_ratio, rise, root, sag, swept
from sim.stress.probe import Probe, Trial
from sim.stress.worlds import chain, grid, irregular, scene
from sim.studies import cantilever, oscillator

RIGHT = [name for name, kind in BENDING.items() if not kind.wrong]
"""Bending springs that are not wrong on purpose."""

ROUNDING = 1e-10
"""Part of what is summed up that rounding may take, amply."""


# N1: compression


def compressed(part: float, seed: int) -> dict[str, Any]:
    """A crumpled irregular mesh at `part` of its size."""
    cloth = irregular(seed, noise=0.05)
    return cloth | {"vertices": (part * np.array(cloth["vertices"])).tolist()}


@case("N1", "springs in compression, whose Hessian is indefinite", seconds=2.5)
def compression(probe: Probe) -> Iterator[Figure]:
    """Crumpled and half-size meshes, each kind of bending spring, stiff, in long steps (Choi and Ko 2002)."""
    least, broken, slope = math.inf, 0, 0.0
    for bend, part, stretch in product(["none", *RIGHT], (0.5, 0.9), (1e2, 1e6)):
        springs = {"bend": bend, "stretch": stretch, "altitude": stretch, "bending": 1e-4 * stretch}
        made = scene(compressed(part, probe.seed), altitudes="all", dt=0.1, gamma=0.0, solver="cg", **springs)
        trial = probe.start(made, newton=3)
        world = trial.world
        slope = max(slope, slope_error(world, probe.random))
        world.model.linearise(world.positions.copy(), world.velocities.copy(), NO_GAP_SPRINGS, 0.1)
        values = np.linalg.eigvalsh(dense(world.model.matrix))
        # Of eigenvalues up to 1e8, the least is known to a part of the largest.
        least = min(least, (values[0] + 1e-14 * values[-1]) / world.masses.min())
        broken += sum("gave up" in trial.step().stopped for _ in range(3))
    yield at_least("least eigenvalue over the least mass", least, 1.0 - 1e-6)
    yield at_most("linear solves that gave up", broken, 0.0)
    yield at_most("forces against the slope of the energy, relative", slope, 1e-6)


def slope_error(world: Simulation, random: np.random.Generator) -> float:
    """Difference of the forces' power along a random direction from the energy's central difference."""
    direction, step = random.standard_normal(world.positions.shape), 1e-6
    up, down = (sum(world.model.energies(world.positions + s * step * direction).values()) for s in (1, -1))
    forces = world.forces()
    world.model.measure(world.positions)
    return abs((up - down) / (2.0 * step) + np.sum(forces * direction)) / float(
        np.abs(forces * direction).sum()
    )


# N2: buckling


@case("N2", "a strip shortened by a fifth buckles", seconds=1.0)
def buckling(probe: Probe) -> Iterator[Figure]:
    """Flat but for 1e-6 m, it may neither blow up nor stay flat, and ends as an elastica between hinges."""
    length, shortened = 0.5, 0.8
    cloth = grid((length, 0.05), (41, 5), pins=["left", "right"])
    made = scene(cloth, stretch=500.0, bending=1e-3, bend="angle", gamma=0.5, newton=5, dt=1 / 60)
    trial = probe.start(made)
    world = trial.world
    noise = 1e-6 * probe.random.standard_normal(world.positions.shape)
    noise[world.pinned] = 0.0
    world.place(world.positions * [shortened, 1.0, 1.0] + noise)
    start, fastest = sum(world.energy().values()), 0.0
    for _ in trial.until(4.0):
        fastest = max(fastest, float(np.linalg.norm(world.velocities, axis=1).max()))
    modulus = root(lambda m: 2.0 * ellipe(m) / ellipk(m) - 1.0 - shortened, 1e-9, 1.0 - 1e-9)
    height = length * math.sqrt(modulus) / ellipk(modulus)
    yield at_most("kinetic energy at the end over that of the start", world.energy()["kinetic"] / start, 1e-6)
    yield at_most("fastest vertex", fastest, math.sqrt(2.0 * start / world.masses.min()), "m/s")
    yield at_most("error of the height of its arch", abs(np.ptp(world.positions[:, 2]) / height - 1.0), 0.1)


# N3: stiff springs and long steps


def oscillating(h: float, stiffness: float, **settings: Any) -> dict[str, Any]:
    """One spring of k h²/m = `stiffness`, held at one end and stretched by a tenth."""
    cloth = chain([[0, 0, 0], [1.1, 0, 0]], [1.0, LIGHT], pins=[0])
    cloth["rest_vertices"] = [[0, 0, 0], [1, 0, 0]]
    how = {"newton": 50, "tolerance": 1e-12, "solver": "direct", "gamma": 0.0}
    return scene(cloth, stretch=stiffness * LIGHT / h**2, dt=h, **how, **settings)


LIGHT = 1e-4
"""Mass of what oscillates [kg]: so light that k h²/m can be 1e8 with a stiffness that is allowed."""


@case("N3", "k h²/m from 1e-2 to 1e8", seconds=0.3)
def stiff(probe: Probe) -> Iterator[Figure]:
    """A step of backward Euler damps a spring by exactly 1/√(1 + h²ω²), however stiff; it gains nothing."""
    h, off, gained = 0.01, 0.0, -math.inf
    for stiffness in 10.0 ** np.arange(-2.0, 8.5, 0.5):
        trial = probe.start(oscillating(h, float(stiffness)))
        world, omega, sizes = trial.world, math.sqrt(stiffness) / h, []
        for _ in range(3):
            sizes.append(math.hypot(world.velocities[1, 0], omega * (world.positions[1, 0] - 1.0)))
            trial.step()
        factor = 1.0 / math.sqrt(1.0 + stiffness)
        off = max(off, abs(sizes[1] / sizes[0] - factor))
        gained = max(gained, *(after / before - 1.0 for before, after in pairwise(sizes)))
    yield at_most("error of the factor by which a step multiplies", off, 1e-10)
    yield at_most("growth of the motion in a step", gained, 0.0)
    yield at_most("free fall off by", fall_error(probe), 1e-12, "m")


def fall_error(probe: Probe) -> float:
    """How far stiff, damped cloth of its rest shape falls off what backward Euler gives a point [m]."""
    trial = probe.start(scene(grid(), gravity=EARTH, gamma=5.0, stretch=1e8, bend="angle"))
    start, h = trial.world.positions.copy(), trial.world.settings.dt
    trial.step(30)
    fallen = np.array([0.0, 0.0, EARTH[2] * h * h * 30 * 31 / 2])
    return float(np.abs(trial.world.positions - start - fallen).max())


STEPS, STIFFNESS = (1e-6, 1e-3, 1 / 60, 1.0), (1e-4, 1e0, 1e4, 1e8)
"""All the time steps that a setting allows [s], and stiffness over twelve decades [N]."""


@case("N3-cloth", "crumpled cloth in steps of 1e-6 to 1 s, with stiffness over twelve decades", seconds=4.0)
def twelve_decades(probe: Probe) -> Iterator[Figure]:
    """No step raises its incremental potential, so that energy and change of velocity stay bounded."""
    worst = -math.inf
    for bend, dt, stretch, held in product(RIGHT, STEPS, STIFFNESS, (True, False)):
        worst = max(
            worst, *(rise(shaken(probe, bend, dt, stretch, held, newton=20).world)[0] for _ in range(2))
        )
    yield at_most("rise of the incremental potential in a step, relative", worst, DESCENT)


DESCENT = 2e-12
"""Part of Φ's terms that a step may seem to raise it by: 20 searches let go 1e-14 each, and sums as much."""


def shaken(probe: Probe, bend: str, dt: float, stretch: float, held: bool, **settings: Any) -> Trial:
    """Crumpled cloth that all of its vertices leave in different directions, at 1 m/s."""
    cloth = irregular(3, noise=0.05) | ({"pins": [0, 1]} if held else {})
    springs = {"bend": bend, "stretch": stretch, "altitude": stretch, "bending": 1e-5 * stretch}
    how = {"gamma": 0.0, "tolerance": 1e-8, "altitudes": "all", "contact": "none", "dt": dt, **settings}
    trial = probe.start(scene(cloth, gravity=[0.3, 0, -9.81], **springs, **how))
    trial.world.place(trial.world.positions, probe.random.standard_normal(trial.world.positions.shape))
    return trial


@case("N3-damping", "γ from 0 to 1000, and rest angles up to ±π", seconds=3.0)
def damping_and_angles(probe: Probe) -> Iterator[Figure]:
    """Crumpled cloth with every kind of bending spring, in common steps: it only ever calms down."""
    fastest, worst = 0.0, -math.inf
    for bend, gamma, angle in product(RIGHT, (0.0, 1.0, 1000.0), (-math.pi, 0.0, math.pi)):
        more = {"newton": 10, "rest_angle": angle, "gravity": [0, 0, 0]}
        trial = shaken(probe, bend, 1 / 60, 50.0, False)
        trial.world.update(gamma=gamma, **more)
        energy = sum(trial.world.energy().values())
        bound = math.sqrt(2.0 * energy / trial.world.masses.min())
        for _ in range(20):
            trial.step()
            fastest = max(fastest, float(np.linalg.norm(trial.world.velocities, axis=1).max()) / bound)
        worst = max(worst, sum(trial.world.energy().values()) / energy - 1.0)
    yield at_most("fastest vertex over what all energy could give it", fastest, 1.0)
    yield at_most("energy gained in 20 steps, relative", worst, 0.0)


# N4, N5: closed forms

ORDERS = {"backward_euler": 1, "trapezoid": 2, "bdf2": 2, "midpoint": 2, "sdirk2": 2, "tr_bdf2": 2}


@case("N4", "a damped oscillator over four halvings of the step", seconds=3.0)
def order(probe: Probe) -> Iterator[Figure]:
    """Under-, critically and overdamped, against the closed form: the error falls as the order says."""
    omega, end = 20.0, 0.13  # at ω t = 2 the leading error of critical damping would vanish
    for name, wanted in ORDERS.items():
        off = 0.0
        for gamma in (0.2, 1.0, 2.0):
            exact = 0.1 * oscillator.released(end, *oscillator.roots(gamma, omega))
            errors = []
            for steps in (80, 160, 320, 640, 1280):  # BDF2 has left its start behind by then
                h = end / steps
                trial = probe.start(oscillating(h, (omega * h) ** 2), integrator=name, gamma=gamma)
                trial.step(steps)
                errors.append(abs(trial.world.positions[1, 0] - 1.0 - exact))
            off = max(off, *(abs(math.log2(a / b) - wanted) for a, b in pairwise(errors)))
        yield at_most(f"observed order off {wanted}, {name}", off, 0.1)


@case("N5", "a pendulum with large swings on a stiff rod", seconds=1.0)
def pendulum(probe: Probe) -> Iterator[Figure]:
    """Its period over that of small swings is 2 K(sin² θ/2)/π."""
    for degrees in (30, 90, 150):
        exact = 2.0 * ellipk(math.sin(math.radians(0.5 * degrees)) ** 2) / math.pi
        off = max(abs(period_ratio(degrees, name) / exact - 1.0) for name in ("sdirk2", "midpoint", "bdf2"))
        yield at_most(f"error of the period from {degrees}°", off, 5e-3)


# N6: momentum


@case("N6", "free cloth with nothing that acts on it from outside", seconds=0.3)
def momentum(probe: Probe) -> Iterator[Figure]:
    """Inner forces of every kind push and turn nothing, resist no rigid motion, and steps keep momentum."""
    push = turn = rigid = drift = spun = 0.0
    for bend, altitudes in product(RIGHT, ("none", "shortest", "all")):
        springs = {"bend": bend, "altitudes": altitudes, "stretch": 5.0, "altitude": 5.0, "bending": 1e-5}
        trial = probe.start(scene(irregular(7), rest_angle=0.2, gamma=0.5, dt=0.01, **springs))
        world = trial.world
        world.place(world.positions, probe.random.standard_normal(world.positions.shape))
        found = balance(world)
        push, turn = max(push, found[0]), max(turn, found[1])
        rigid = max(rigid, resisted(world))
        world.place(world.positions, probe.random.standard_normal(world.positions.shape))
        first, scale = world.momentum()[1], 0.0
        for _ in range(10):
            before = world.momentum()[0]
            trial.step()
            scale = world.masses @ np.linalg.norm(world.velocities, axis=1)
            drift = max(drift, float(np.abs(world.momentum()[0] - before).max() / scale))
        arms = np.linalg.norm(world.positions, axis=1).max()
        spun = max(spun, float(np.abs(world.momentum()[1] - first).max() / (scale * arms)))
    yield at_most("net force over Σ|f|", push, ROUNDING)
    yield at_most("net torque over Σ|f||x|", turn, ROUNDING)
    yield at_most("force that resists a rigid motion, over Σ|f| of stretching", rigid, ROUNDING)
    yield at_most("momentum lost in a step over Σ m|v|", drift, ROUNDING)
    yield reported("angular momentum lost in 10 steps over Σ m|v||x|, by backward Euler", spun)


def balance(world: Simulation) -> tuple[float, float]:
    """Net force and net torque over the sums of their sizes."""
    forces, x = world.forces(), world.positions
    sizes = np.linalg.norm(forces, axis=1)
    torque = np.cross(x, forces).sum(axis=0)
    arms = sizes @ np.linalg.norm(x, axis=1)
    return float(np.abs(forces.sum(axis=0)).max() / sizes.sum()), float(np.abs(torque).max() / arms)


def resisted(world: Simulation) -> float:
    """Damping force of a rigid motion, over that of stretching at the same speeds."""
    x = world.positions.copy()
    world.place(x, np.zeros_like(x))
    elastic = world.forces()
    world.place(x, np.cross([0.3, -2.0, 1.1], x) + np.array([1.0, -0.5, 0.3]))
    turning = np.abs(world.forces() - elastic).max()
    world.place(x, 2.0 * x)
    return float(turning / np.abs(world.forces() - elastic).sum())


# N7 to N11: degenerate shapes


def slivers(count: int = 12, thin: float = 1e-6) -> dict[str, Any]:
    """A band of triangles 1 m long and `thin` times that high between two of a common shape."""
    x = np.linspace(0.0, 1.0, count)
    rows = [0.0, 0.3, 0.3 + thin, 0.6]
    vertices = np.concatenate([np.column_stack([x, np.full(count, y), 0.0 * x]) for y in rows])
    a = (count * np.arange(len(rows) - 1)[:, None] + np.arange(count - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([a, a + 1, a + count], 1), np.stack([a + 1, a + count + 1, a + count], 1)]
    )
    return {"vertices": vertices.tolist(), "triangles": triangles.tolist(), "pins": [0, count - 1]}


@case("N7", "slivers of 1e-6, and cloth that has collapsed to a line and to a point", seconds=0.6)
def degenerate(probe: Probe) -> Iterator[Figure]:
    """Bending angles are undefined there: forces stay finite, and below stiffness times size."""
    largest, unsolved = 0.0, 0
    for bend, shape in product(RIGHT, ("slivers", "line", "point", "repeated")):
        cloth = slivers() if shape == "slivers" else grid((1.0, 0.6), (9, 7), pins=["corner00"])
        springs = {"bend": bend, "altitudes": "all", "newton": 3}
        trial = probe.start(scene(cloth, gravity=EARTH, **springs))
        world = trial.world
        if shape != "slivers":
            squeezed = {"line": [1.0, 0.0, 0.0], "point": [0.0, 0.0, 0.0], "repeated": [1.0, 1.0, 1.0]}[shape]
            x = world.positions * squeezed
            if shape == "repeated":
                x[1::2] = x[:-1:2][: len(x[1::2])]
            world.place(x)
        inner = world.forces() - world.masses[:, None] * EARTH
        largest = max(largest, float(np.linalg.norm(inner, axis=1).max() / force_cap(world)))
        for _ in range(20):
            unsolved += not np.isfinite(trial.step().residual)
    yield at_most("largest force over what stiffness times size gives", largest, 1.0)
    yield at_most("solves that left no number", unsolved, 0.0)


def force_cap(world: Simulation) -> float:
    """Force [N] that springs could have on a vertex, at stiffness times what they move; and a weight."""
    caps = np.zeros(len(world.masses))
    size = float(np.ptp(world.mesh.rest_vertices, axis=0).max())
    for springs in world.model.springs:
        e = springs.elements
        reach = (
            np.maximum(np.abs(e.q - e.rest), size)
            * e.stiffness
            * np.abs(e.gradient).max(axis=(1, 2), initial=0.0)
        )
        np.add.at(caps, e.nodes.ravel(), np.repeat(2.0 * reach, e.nodes.shape[1]))
    return float(caps.max() + world.masses.max() * G)


@case("N8", "altitude springs of 10,000 triangles, some as obtuse as 179.9°", seconds=0.2)
def obtuse(probe: Probe) -> Iterator[Figure]:
    """The foot may be far outside the base: the gradient is exact all the same, and pushes nothing."""
    count, kind, step = 10_000, STRETCH["altitude"], 1e-7
    x = probe.random.standard_normal((count, 3, 3))
    open_by = np.radians(180.0 - 10.0 ** probe.random.uniform(-1.0, 2.0, count // 2))
    turned = np.stack([np.cos(open_by), np.sin(open_by), 0.0 * open_by], axis=1)
    x[: count // 2, 2] = x[: count // 2, 1] + turned
    x[: count // 2, 0] = x[: count // 2, 1] + [1.0, 0.0, 0.0]

    def measured(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e = elements_many(kind, points)
        return e.q.copy(), e.gradient.copy()

    _, gradient = measured(x)
    slopes = np.zeros_like(gradient)
    for a, c in product(range(3), range(3)):
        shift = np.zeros((1, 3, 3))
        shift[0, a, c] = step
        slopes[:, a, c] = (np.abs(measured(x + shift)[0]) - np.abs(measured(x - shift)[0])) / (2.0 * step)
    sign = np.sign(np.einsum("nij,nij->n", slopes, gradient))[:, None, None]
    sharp = np.linalg.norm(slopes - sign * gradient, axis=(1, 2)) / np.linalg.norm(gradient, axis=(1, 2))
    sizes = np.abs(gradient).sum(axis=(1, 2))
    arms = sizes * np.abs(x).max(axis=(1, 2))
    torque = np.abs(np.cross(x, gradient).sum(axis=1)).max(axis=1)
    yield at_most("gradients that are no numbers", np.count_nonzero(~np.isfinite(gradient)), 0.0)
    yield at_most(
        "gradient against central differences, 99.9 % of triangles", np.quantile(sharp, 0.999), 1e-5
    )
    yield at_most("net force over Σ|f|", (np.abs(gradient.sum(axis=1)).max(axis=1) / sizes).max(), ROUNDING)
    yield at_most("net torque over Σ|f||x|", (torque / arms).max(), ROUNDING)


def elements_many(kind: SpringKind, points: np.ndarray) -> Elements:
    """Elements of many stencils, (n, k, 3), measured at once."""
    n, k = points.shape[:2]
    e = make_elements(np.arange(n * k).reshape(n, k), kind.memory)
    kind.load().coordinate(points.reshape(-1, 3), e.nodes, e.memory, e.q, e.gradient, e.new_memory)
    return e


@case("N9", "modified bending springs whose two lines are parallel to 1e-15", seconds=0.1)
def parallel(probe: Probe) -> Iterator[Figure]:
    """Folded shut, their common normal is undefined: force stays finite, of common size, without a jump."""
    largest, jump, wrong = 0.0, 0.0, 0
    short_of = 10.0 ** -np.arange(5.0, 15.5, 0.5)
    shut = np.concatenate([np.pi - short_of, [np.pi], np.pi + short_of[::-1]])
    for tips in ((0.5, 0.5), (0.8, 0.8 + 1e-9), (0.02, 0.02)):
        _, _, gradient = swept("modified", tips, np.concatenate([np.linspace(0.0, 3.1, 50), shut]))
        near = gradient[50:]
        wrong += int(np.count_nonzero(~np.isfinite(gradient)))
        largest = max(largest, float(np.abs(near).max()))
        jump = max(jump, float(np.abs(np.diff(near, axis=0)).max() / np.abs(near).max()))
    yield at_most("components that are no numbers", wrong, 0.0)
    yield at_most("largest component of the gradient", largest, 2.0)
    yield at_least("largest component of the gradient, at least", largest, 1e-3)
    yield at_most("jump of the gradient between folds, relative", jump, 1e-3)


@case("N10", "hinges folded over three half turns to either side", seconds=2.0)
def folded_over(probe: Probe) -> Iterator[Figure]:
    """Past a half turn the angle goes on rather than jump; force per step of fold must not either."""
    step = 2e-3
    for name in ("modified", "angle"):
        jump, back = 0.0, 0
        for way, tips in product((1.0, -1.0), ((0.8, 0.7), (0.5, 0.5), (0.9, 0.2))):
            q, turn, _ = swept(name, tips, way * np.arange(0.0, 3.0 * np.pi, step))
            tension = q * turn
            jump = max(jump, float(np.abs(np.diff(tension)).max() / np.abs(tension).max()))
            back += int(np.count_nonzero(way * np.diff(q) <= 0.0))
        yield at_most(f"largest jump of the force over the largest force, {name}", jump, 0.01)
        yield at_most(f"steps that unfold resistance, {name}", back, 0.0)
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.5, -1, 0]])
    gradient = elements_at(BENDING["angle"], flat).gradient
    yield at_most("force of a hinge with a triangle without area", np.abs(gradient).max(), 0.0)


@case("N11", "springs without length, and vertices at the same place", seconds=0.3)
def no_length(probe: Probe) -> Iterator[Figure]:
    """A seam of springs that want to have no length pulls two halves together, and they are at peace then."""
    half = 6
    x = np.linspace(0.0, 0.5, half)
    left = np.array([[s, y, 0.0] for y in x for s in x])
    right = left + np.array([0.6, 0.0, 0.1])
    count = len(left)
    seam = [[half * k + half - 1, count + half * k] for k in range(half)]
    rows = [[k, k + 1] for k in range(2 * count - 1) if (k + 1) % half]
    columns = [[k, k + half] for k in range(2 * count - half) if k % count < count - half]
    rest = np.concatenate([left, left + np.array([0.5, 0.0, 0.0])])
    cloth = {
        "vertices": np.concatenate([left, right]).tolist(),
        "rest_vertices": rest.tolist(),
        "edges": rows + columns + seam,
        "masses": [0.01] * (2 * count),
    }
    try:
        trial = probe.start(scene(cloth, gamma=1.0, newton=3))
    except SceneError:
        yield at_most("scenes with springs of no length that were refused", 1.0, 0.0)
        return
    linear = trial.world.momentum()[0]
    trial.step(200)
    gap = np.linalg.norm(np.diff(trial.world.positions[np.array(seam)], axis=1)[:, 0], axis=1).max()
    yield at_most("seam left open", gap, 1e-3, "m")
    drift = np.abs(trial.world.momentum()[0] - linear).max()
    yield at_most("momentum that it gained over that of a mm/s", drift / (0.01 * 2 * count * 1e-3), 1e-6)


# N12: masses


@case("N12", "masses of 1 to 1e3 and of 1 to 1e6, and pins", seconds=0.5)
def mass_ratio(probe: Probe) -> Iterator[Figure]:
    """A sheet on two pins of which every tenth vertex is heavy; conjugate gradients alone solve it."""
    for ratio in (1e3, 1e6):
        side = 24
        flat = Simulation(scene(grid(resolution=(side, side))))
        masses = np.full(side**2, 4e-4)
        masses[probe.random.permutation(side**2)[: side**2 // 10]] *= ratio
        cloth = {
            "vertices": flat.positions,
            "triangles": flat.triangles,
            "masses": masses,
            "pins": [side**2 - side, side**2 - 1],
        }
        made = scene(
            cloth, gravity=EARTH, altitudes="all", stretch=1e3 * ratio**0.5, solver="cg", contact="none"
        )
        trial = probe.start(made)
        pinned = trial.world.positions[trial.world.pinned].copy()
        trial.step(30)
        moved = np.abs(trial.world.positions[trial.world.pinned] - pinned).max()
        most = max(r.iterations for r in trial.reports)
        left = max(r.residual for r in trial.reports) / trial.world.settings.tolerance
        yield at_most(f"iterations over √n, 1 : {ratio:g}", most / side, 10.0)
        yield at_most(f"error left over the tolerance, 1 : {ratio:g}", left, 1.0)
        yield at_most(f"pins moved, 1 : {ratio:g}", moved, 0.0, "m")


# N13: a start that crosses itself


@case("N13", "two sheets that start across each other, with impulses", seconds=0.5)
def tangled(probe: Probe) -> Iterator[Figure]:
    """Refused with the pairs listed; or kept, with no more crossings than at first, and no explosion."""
    across = grid((0.4, 0.4), (9, 9), rotation=[0.0, 1.2, 0.3], position=[0.01, 0.02, 0.03])
    made = scene(
        [grid((0.4, 0.4), (10, 10)), across], self_collision="auto", contact="impulse", gravity=EARTH
    )
    for start in (Simulation, lambda made: check_scene(load_scene(made))):
        try:
            start(made)
            listed = 0
        except SceneError as error:
            listed = sum(word.strip(",").isdigit() for word in str(error).split())
        yield at_least("numbers in the refusal, of pairs and of triangles", listed, 3.0)
    world = probe.start(made, tangled="keep").world
    first, most, fastest = len(intersections(world.positions, world.triangles)), 0, 0.0
    for _ in range(60):
        world.step()
        relative = world.velocities - world.momentum()[0] / world.masses.sum()
        fastest = max(fastest, float(np.linalg.norm(relative, axis=1).max()))
        most = max(most, len(intersections(world.positions, world.triangles)))
    yield at_most("crossings, most over those at first", most / first, 1.0)
    yield at_most("fastest vertex beside the fall", fastest, 20.0, "m/s")


@case("N13-untangled", "two layers that poke through each other, untangled at the start", seconds=3.0)
def untangled(probe: Probe) -> Iterator[Figure]:
    """From then on nothing crosses, and nothing went far for it."""
    flat = Simulation(scene(grid((0.4, 0.4), (14, 14))))
    upper, lower = (flat.positions + np.array([0.003, 0.002, z]) for z in (0.005, 0.0))
    for x, y in probe.random.uniform(-0.15, 0.15, (4, 2)):
        upper[:, 2] -= 0.015 * np.exp(-((upper[:, 0] - x) ** 2 + (upper[:, 1] - y) ** 2) / 2e-3)
    lower[:, :2] -= [0.006, 0.004]
    layers = [{"vertices": x, "triangles": flat.triangles} for x in (upper, lower)]
    made = scene(layers, self_collision="auto", contact="impulse", gravity=EARTH)
    before = Simulation(made, tangled="keep")
    trial = probe.start(made, tangled="untangle", judged=True)
    moved = np.linalg.norm(trial.world.positions - before.positions, axis=1).max()
    yield at_least("crossings before", len(intersections(before.positions, before.triangles)), 10.0)
    yield at_most("crossings after", len(intersections(trial.world.positions, trial.world.triangles)), 0.0)
    yield at_most("longest way of a vertex", moved, 0.03, "m")
    trial.step(5)


# N14 to N18: rest against closed forms


@case("N14", "a hanging chain", seconds=0.9)
def catenary(probe: Probe) -> Iterator[Figure]:
    """A chain of unit length over half of it sags by that of a chain of links, and these by a catenary's."""
    half = root(lambda a: 2.0 * a * math.sinh(0.25 / a) - 1.0, 0.05, 1.0)
    exact = half * (math.cosh(0.25 / half) - 1.0)
    errors = [sag(links) - exact for links in (8, 16, 32)]
    off = max(abs(math.log2(a / b) - 2.0) for a, b in pairwise(errors))
    yield at_most("error of the sag of 20 links", abs(sag(20) / 0.39913655445781987 - 1.0), 2e-3)
    yield at_most("order of the error off 2", off, 0.1)


@case("N15", "a row of springs that hangs", seconds=0.1)
def hanging_row(probe: Probe) -> Iterator[Figure]:
    """With the end masses halved it lengthens by W L/2K, whatever the number of springs."""
    weight, stiffness, off = 2.0, 100.0, 0.0
    for links in (1, 4, 16, 64):
        masses = np.full(links + 1, weight / (-EARTH[2] * links))
        masses[[0, -1]] /= 2.0
        row = chain([[0, 0, -k / links] for k in range(links + 1)], masses, pins=[0])
        world = equilibrium(scene(row, gravity=EARTH, stretch=stiffness))
        off = max(off, abs((-world.positions[-1, 2] - 1.0) / (weight / (2.0 * stiffness)) - 1.0))
    probe.watch(world)
    yield at_most("error of the elongation", off, 1e-6)


@case("N16", "a clamped strip under its weight", seconds=4.0)
def cantilever_strip(probe: Probe) -> Iterator[Figure]:
    """Drop over reach against the heavy elastica, Γ from 1 to 100, with D measured on a cylinder."""
    strip = cantilever.Strip(cantilever.ROWS)
    for kind in ("angle", "modified"):
        start, ratios, off = None, [], 0.0
        stiffness = strip.stiffness(kind, 0.5)
        for gamma in (1.0, 5.0, 10.0, 50.0, 100.0):
            start = strip.hang(kind, gamma, start)
            drop, reach = strip.drop_and_reach(start)
            exact = cantilever.elastica(gamma / stiffness)
            ratios.append(drop / reach)
            off = max(off, abs(drop / reach / (exact[0] / exact[1]) - 1.0))
        yield at_most(f"error of drop over reach, {kind}", off, 0.05)
        fallen = sum(after <= before for before, after in pairwise(ratios))
        yield at_most(f"heavier strips that drop less, {kind}", fallen, 0.0)
    probe.watch(Simulation(strip.scene(start, bend=kind)))


def disc(radius: float, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) of a disc, ring by ring, and its triangles (m, 3)."""
    points = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        turn = 2.0 * np.pi * (np.arange(6 * k) + 0.5 * (k % 2)) / (6 * k)
        points.append(radius * k / rings * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    flat = np.concatenate(points)
    return np.column_stack([flat, np.zeros(len(flat))]), Delaunay(flat).simplices


@case("N18", "Cusick's drape: a disc of 30 cm on a support of 18 cm", seconds=3.0)
def drape(probe: Probe) -> Iterator[Figure]:
    """The part of its overhang that it still covers lies within 0 and 100 %, and grows with stiffness."""
    covered, rings = [], 10
    vertices, triangles = disc(0.15, rings)
    inside = np.flatnonzero(np.linalg.norm(vertices, axis=1) <= 0.09 + 1e-9).tolist()
    cloth = {"vertices": vertices, "triangles": triangles, "pins": inside}
    for bending in (1e-5, 1e-4, 1e-3, 1e-2):
        made = scene(cloth, gravity=EARTH, stretch=100.0, bending=bending, gamma=0.1, jitter=1e-3, newton=2)
        trial = probe.start(made)
        for _ in trial.until(2.0):
            pass
        rim = trial.world.positions[-6 * rings :, :2]
        after = np.roll(rim, -1, axis=0)
        area = 0.5 * abs(float(np.sum(rim[:, 0] * after[:, 1] - rim[:, 1] * after[:, 0])))
        covered.append(100.0 * (area - math.pi * 0.09**2) / (math.pi * (0.15**2 - 0.09**2)))
    yield at_least("least drape coefficient", min(covered), 0.0, "%")
    yield at_most("largest drape coefficient", max(covered), 100.0, "%")
    yield at_least("least growth from one bending stiffness to the next", min(np.diff(covered)), 0.0, "%")
