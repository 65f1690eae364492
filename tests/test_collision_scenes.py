"""The scenes about collision: what impulses promise, at every step, and what each lesson says.

Each variant is stepped once; the tests look at the film.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import sim

ROUND_OFF = 1e-12
"""Distances that differ by less than this [m] are the same: positions are about 1 m in double precision."""

SECONDS = {"bullet": 1.2, "clap": 2.0, "clap2d": 2.0, "ring": 2.8, "fold": 3.2, "spin": 2.1}
"""How long a scene is watched [s], where its lesson takes other than 1.5 s."""

KEPT = [
    ("bullet", {"detection": "continuous"}),
    ("catch", {"cloth_collision": "auto"}),
    ("catch2d", {"cloth_collision": "auto"}),
    ("clap", {"self_collision": "auto"}),
    ("clap2d", {"self_collision": "auto"}),
    ("drape2d", {"contact": "impulse"}),
    ("fold", {"bending": 1e-4}),
    ("fold", {"bending": 2e-2}),
    ("response", {"contact": "impulse"}),
    ("ring", {"friction": 0.0}),
    ("ring", {"friction": 0.3}),
    ("spin", {"friction": 0.0}),
    ("spin", {"friction": 0.6}),
    ("stack", {"contact": "impulse"}),
]
"""The variants in which nothing may cross."""


@dataclass(frozen=True)
class Film:
    """A run: the simulation at its end, and of every step positions [m], crossings and the report."""

    world: sim.Simulation
    x: np.ndarray
    crossings: np.ndarray
    reports: list

    def piece(self, k):
        """Positions (steps, ·, 3) of one cloth of the scene."""
        return self.x[:, self.world.pieces == k]

    def speed(self):
        """Root mean square of the vertices' speeds at the end [m/s]."""
        return np.sqrt(np.mean(np.sum(self.world.velocities**2, axis=1)))

    def deepest(self):
        """How far a vertex was inside an obstacle at worst [m]."""
        return max(report.deepest for report in self.reports)

    def says(self, words):
        """(steps,) whether a step said `words` of contact."""
        return np.array([words in report.effects["contact"] for report in self.reports])


@cache
def _film(scene, settings):
    world, x, crossed, reports = sim.Simulation(scene, **dict(settings)), [], [], []
    assert crossings(world) == 0, "the scene starts tangled"
    while world.time < SECONDS.get(scene, 1.5) - ROUND_OFF:
        reports.append(world.step())
        x.append(world.positions.copy())
        crossed.append(crossings(world))
    return Film(world, np.array(x), np.array(crossed), reports)


def film(scene, **settings):
    return _film(scene, tuple(settings.items()))


def crossings(world):
    """Edges across triangles, of cloth and of mesh obstacles, and edges across edges in a plane."""
    obstacles, n = world.contact.obstacles, len(world.positions)
    x = np.concatenate([world.positions, obstacles.corners(obstacles.poses(world.time))])
    found = len(sim.intersections(x, np.concatenate([world.triangles, obstacles.solid.triangles + n])))
    return found + (crossings_in_plane(world) if world.scene.plane else 0)


def crossings_in_plane(world):
    """Pairs of edges that lie in one plane of constant y and cross there."""
    x, edges = world.positions, world.edges
    edges = edges[x[edges[:, 0], 1] == x[edges[:, 1], 1]]
    a, b = (x[edges[:, k]][:, [0, 2]] for k in (0, 1))
    y = x[edges[:, 0], 1]

    def side(p, q, r):
        return (q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]

    a1, b1, a2, b2 = a[:, None], b[:, None], a[None], b[None]
    across = (side(a1, b1, a2) * side(a1, b1, b2) < 0) & (side(a2, b2, a1) * side(a2, b2, b1) < 0)
    return int(np.count_nonzero(across & (y[:, None] == y[None]))) // 2


@pytest.mark.parametrize(("scene", "settings"), KEPT)
def test_impulses_let_nothing_cross_at_any_step(scene, settings):
    seen = film(scene, **settings)
    assert not seen.crossings.any()
    assert not any(report.penetrations for report in seen.reports)
    assert any(report.contacts for report in seen.reports)  # it was put to the test
    assert not seen.says("may tunnel").any()


@pytest.mark.parametrize("scene", ["catch2d", "clap2d", "drape2d"])
def test_scenes_in_a_plane_stay_in_it_to_the_bit(scene):
    """Strips and chains are in parallel planes, that of the start."""
    seen = film(scene, **dict(KEPT)[scene])
    assert (seen.x[..., 1] == seen.world.mesh.vertices[:, 1]).all()


# Drape, seen edge-on

SWING = 0.01
"""Ends that still swing lift by up to this [m]."""


def test_strip_and_chain_hang_from_the_bar_as_a_rope_does():
    """A quarter of the girth lies on each side, and the longer rest hangs straight down from the waist."""
    seen = film("drape2d", contact="impulse")
    world = seen.world
    bar, middle = world.scene.obstacle[0], world.scene.cloth[0].position[0]
    around = 0.5 * np.pi * (bar.radius + world.settings.thickness)
    lowest = bar.start[2] - (0.5 * world.scene.cloth[0].size[0] + middle - around)
    for k in (0, 1):
        assert seen.piece(k)[-1, :, 2].min() == pytest.approx(lowest, abs=SWING)


def test_penalty_lets_strip_and_chain_sink_into_the_bar():
    seen = film("drape2d", contact="penalty")
    assert 0.002 < seen.deepest() < 0.01 < film("drape2d", contact="penalty", dt=1 / 30).deepest()
    assert film("drape2d", contact="impulse").deepest() == 0.0


# Clap


def tips(seen, k=0):
    """(steps,) how far the tips of the left and the right half of a cloth reach to the right [m]."""
    start = seen.world.mesh.vertices[seen.world.pieces == k]
    left, right = (np.isclose(start[:, 0], sign * 0.5) for sign in (-1, 1))
    return seen.piece(k)[:, left, 0].max(axis=1), seen.piece(k)[:, right, 0].min(axis=1)


@pytest.mark.parametrize(("scene", "k"), [("clap", 0), ("clap2d", 0), ("clap2d", 1)])
def test_halves_that_feel_each_other_clap_and_others_swap_sides(scene, k):
    """Felt, they hang still, half a metre down; not felt, each swings on to where the other came from."""
    seen = film(scene, self_collision="auto")
    left, right = tips(seen, k)
    assert (left < right).all()
    assert seen.piece(k)[-1, :, 2].min() == pytest.approx(0.5, abs=5e-3)
    assert seen.speed() < 0.02
    left, right = tips(film(scene, self_collision="off"), k)
    assert (left - right).max() > 0.5


def test_halves_are_through_each_other_before_static_detection_sees_them():
    world = sim.Simulation("clap", self_collision="auto", detection="static")
    assert any(crossings(world) for _ in range(30) if world.step())


# Catch


@pytest.mark.parametrize(("scene", "pairs"), [("catch", [(0, 1)]), ("catch2d", [(0, 1), (2, 3)])])
def test_what_falls_is_caught_if_it_is_felt_and_else_lies_on_the_floor(scene, pairs):
    caught, fallen = (film(scene, cloth_collision=how) for how in ("auto", "off"))
    floor = fallen.world.settings.thickness
    for net, falling in pairs:
        assert fallen.piece(falling)[-1, :, 2].max() < floor + 0.01
        assert caught.piece(falling)[-1, :, 2].min() > caught.piece(net)[-1, :, 2].min()
    assert caught.speed() < 0.02


def test_the_net_hangs_deeper_by_what_it_caught():
    low = [film("catch", cloth_collision=how).piece(0)[-1, :, 2].min() for how in ("auto", "off")]
    assert low[0] < low[1] - 5e-3


# Fast ball


def ahead_of_ball(seen):
    """How far the cloth round the ball's path is ahead of the ball's middle at the end [m], at least."""
    ball = seen.world.obstacle_poses()[0][0]
    x = seen.x[-1]
    near = np.hypot(x[:, 0] - ball[0], x[:, 2] - ball[2]) < 0.5 * seen.world.scene.obstacle[0].radius
    assert near.any()
    return (x[near, 1] - ball[1]).min()


def test_a_fast_ball_is_through_before_static_detection_sees_it():
    """Nothing ever touches the sheet, and the steps in which the ball flew say so."""
    seen = film("bullet", detection="static")
    assert ahead_of_ball(seen) < -0.1
    assert not any(report.contacts for report in seen.reports)
    told = seen.says("may tunnel: moved 250 mm, thickness 5 mm, looked for once per step")
    assert np.count_nonzero(told) == 3


def test_a_fast_ball_is_met_along_the_way():
    seen = film("bullet", detection="continuous")
    ball = seen.world.scene.obstacle[0]
    assert ahead_of_ball(seen) >= ball.radius * 0.8
    assert seen.speed() < 0.1


def test_static_detection_sees_the_ball_in_steps_of_less_than_its_size():
    world = sim.Simulation("bullet", detection="static", dt=1 / 480)
    met = 0
    while world.time < 0.56:
        met += world.step().contacts
    assert met > 0
    assert world.positions[:, 1].max() > 0.05


# Spinning ball


STUCK = 1.3
"""When the ball turns fast [s], and the corners still hang: later they fly, and the top slips a little."""


def turning(seen, among):
    """Angular velocity [1/s] about the ball's axis of the vertices `among` in the step to STUCK."""
    k = round(STUCK / seen.world.settings.dt) - 1
    m, x, before = seen.world.masses[among], seen.x[k, among], seen.x[k - 1, among]
    v = (x - before) / seen.world.settings.dt
    return m @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]) / (m @ (x[:, 0] ** 2 + x[:, 1] ** 2))


LAG = 0.02
"""Share by which cloth that sticks is behind a ball that gets faster."""


def test_the_cloth_turns_with_the_ball_only_by_friction():
    rough, smooth = (film("spin", friction=mu) for mu in (0.6, 0.0))
    ball, h = rough.world.scene.obstacle[0], rough.world.settings.dt
    now, before = (rough.world.contact.obstacles.poses(t).rotation[0] for t in (STUCK, STUCK - h))
    step = now @ before.T
    spin = np.arctan2(step[1, 0], step[0, 0]) / h
    assert spin > 4.0
    top = rough.x[round(STUCK / h) - 1, :, 2] > ball.center[2] + 0.8 * ball.radius
    assert turning(rough, top) == pytest.approx(spin, rel=LAG)
    assert abs(turning(smooth, slice(None))) < 0.01 * spin


def test_the_corners_are_thrown_outwards_by_the_turn():
    low = {mu: film("spin", friction=mu).x[-1, :, 2].min() for mu in (0.0, 0.6)}
    assert low[0.6] > low[0.0] + 0.05


# Stack


def test_three_cloths_keep_their_order_on_the_ball():
    """Along every ray through the top of the ball the lowest cloth comes first, then the middle one."""
    seen = film("stack", contact="impulse")
    ball = seen.world.scene.obstacle[0]
    for x in seen.x:
        layers = [x[seen.world.pieces == k] - ball.center for k in range(3)]
        top = [layer[np.hypot(layer[:, 0], layer[:, 1]) < 0.1] for layer in layers]
        radii = [np.linalg.norm(layer, axis=1) for layer in top]
        assert radii[0].min() > ball.radius
        assert radii[0].max() < radii[1].max() < radii[2].max()
    assert seen.speed() < 0.05


def test_penalty_lets_the_stack_through_itself_and_into_the_ball():
    seen = film("stack", contact="penalty")
    assert seen.crossings.max() > 8
    assert seen.deepest() > 0.005
    assert seen.says("may tunnel").any()


# Response


def jumps(seen):
    """Root mean square [m] of how far vertices go in the last quarter of a second, step by step."""
    return np.sqrt(np.mean(np.sum(np.diff(seen.x[-15:], axis=0) ** 2, axis=2)))


def stretched(seen):
    """Largest relative change of an edge's length at the end."""
    ends, rest = (p[seen.world.edges] for p in (seen.x[-1], seen.world.mesh.rest_vertices))
    now, was = (np.linalg.norm(p[:, 1] - p[:, 0], axis=1) for p in (ends, rest))
    return np.abs(now / was - 1.0).max()


def test_penalty_sinks_in_and_impulses_do_not():
    assert film("response", contact="penalty").deepest() > 0.005
    assert film("response", contact="impulse").deepest() == 0.0
    assert film("response", contact="penalty").says("springs give way").any()


def test_what_is_put_right_afterwards_is_stretched_and_crosses_itself():
    post, impulse = (film("response", contact=how) for how in ("postprocess", "impulse"))
    assert stretched(post) > 0.15 > 0.06 > stretched(impulse)
    assert post.crossings.max() > 0
    assert post.says("put right once").any()


# Ring


def test_the_cloth_is_pulled_through_the_ring():
    """While the ring passes its widest place all of it is within; at the end the ring is below all of it."""
    seen = film("ring", friction=0.0)
    world = seen.world
    inside = np.hypot(*world.mesh.shells[0].vertices[:, :2].T).min()
    times = world.settings.dt * np.arange(1, len(seen.x) + 1)
    heights = [world.contact.obstacles.poses(time).position[0, 2] for time in times]
    passing = 0
    for x, height in zip(seen.x, heights, strict=True):
        level = np.abs(x[:, 2] - height) < 2e-3
        passing += np.count_nonzero(level)
        assert (np.hypot(x[level, 0], x[level, 1]) < inside).all()
    assert passing > 20
    assert np.ptp(world.mesh.vertices[:, 0]) > 3 * 2 * inside
    assert seen.x[-1, :, 2].min() > heights[-1]


# Fold


def half_that_was_turned(seen):
    """Where the outer edge of the half on the plate is at the end, and where the other one is."""
    start = seen.world.mesh.vertices[:, 0]
    return seen.x[-1, start == start.max()].mean(axis=0), seen.x[-1, start == start.min()].mean(axis=0)


def test_limp_cloth_stays_folded():
    turned, other = half_that_was_turned(film("fold", bending=1e-4))
    assert turned[0] < -0.2
    assert turned[2] > other[2]


def test_stiff_cloth_springs_open():
    turned, other = half_that_was_turned(film("fold", bending=2e-2))
    assert turned[0] - other[0] == pytest.approx(0.7, abs=0.01)
    assert turned[2] == pytest.approx(other[2], abs=5e-3)
