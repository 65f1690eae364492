"""Obstacles, detection, the responses and friction, against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sim
from sim.compiled import Vec3
from sim.contact.detect import detect
from sim.contact.obstacles import Obstacles, shape_of, signed_distance
from sim.stress.contact import MU, SPEED, drift_on_incline, sliding_error, stopping_distance, stopping_error
from sim.stress.probe import Probe
from tests.jit import compiled
from tests.worlds import ball, chain, grid, scene

G = 9.81
SHAPES = {
    "sphere": ball((0, 0, 0), 0.3),
    "plane": {"kind": "plane"},
    "box": {"kind": "box", "center": [0, 0, 0], "size": [0.4, 0.6, 0.2]},
    "capsule": {"kind": "capsule", "start": [-0.2, 0.1, 0], "end": [0.2, 0.1, 0.3], "radius": 0.1},
}


@compiled
def distance_to_first(shapes, point):
    return signed_distance(shape_of(shapes, 0), point)


def obstacles_of(*parts):
    return Obstacles(sim.load_scene(scene(grid(), *parts)))


def distance(obstacles, point, time=0.0):
    """Signed distance of a world point to the only obstacle, and its direction in the world."""
    poses = obstacles.poses(time)
    local = poses.rotation[0].T @ (np.asarray(point) - poses.position[0])
    value, n = distance_to_first(obstacles.shapes, Vec3(*local))
    return value, poses.rotation[0] @ np.array(n)


def brute_distance(part, p):
    """The distance outside each shape, the obvious way."""
    p = np.asarray(p)
    if part["kind"] == "sphere":
        return np.linalg.norm(p - part["center"]) - part["radius"]
    if part["kind"] == "plane":
        return p[2]
    if part["kind"] == "box":
        return np.linalg.norm(np.maximum(np.abs(p) - np.array(part["size"]) / 2, 0))
    a, b = np.array(part["start"]), np.array(part["end"])
    samples = a + np.linspace(0, 1, 20_001)[:, None] * (b - a)
    return np.linalg.norm(samples - p, axis=1).min() - part["radius"]


@pytest.mark.parametrize("name", SHAPES)
def test_distance_outside_is_the_obvious_one_and_its_direction_is_its_slope(name):
    obstacles = obstacles_of(SHAPES[name])
    for p in np.random.default_rng(0).uniform(-1, 1, (300, 3)):
        value, n = distance(obstacles, p)
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-12)
        if value > 1e-3:
            assert value == pytest.approx(brute_distance(SHAPES[name], p), abs=2e-5)  # spacing of the samples
            slope = [
                (distance(obstacles, p + d)[0] - distance(obstacles, p - d)[0]) / 2e-6
                for d in 1e-6 * np.eye(3)
            ]
            np.testing.assert_allclose(n, slope, atol=1e-6)
        assert distance(obstacles, p - value * n)[0] == pytest.approx(
            0.0, abs=1e-12
        )  # the nearest surface point


@pytest.mark.parametrize("name", SHAPES)
def test_the_plane_through_the_nearest_point_keeps_the_whole_obstacle_on_one_side(name):
    obstacles, rng = obstacles_of(SHAPES[name]), np.random.default_rng(1)
    points = rng.uniform(-0.6, 0.6, (500, 3))
    inside = [p for p in points if distance(obstacles, p)[0] < 0]
    for p in points[:100]:
        value, n = distance(obstacles, p)
        if value > 0:
            assert all((q - p) @ n <= -value + 1e-9 for q in inside)


@pytest.mark.parametrize("motion", ["linear", "smooth"])
def test_a_keyed_path_passes_through_its_keys_and_repeats(motion):
    keys = [{"time": 1, "position": [0, 0, 0]}, {"time": 2, "position": [1, 0, 0], "rotation": [0, 0, 3]}]
    keys += [{"time": 4, "position": [0, 0, 2]}]
    obstacles = obstacles_of(ball(path=keys, motion=motion))
    for time, x in (
        (0, [0, 0, 0]),
        (1, [0, 0, 0]),
        (2, [1, 0, 0]),
        (3, [0.5, 0, 1]),
        (4, [0, 0, 2]),
        (9, [0, 0, 2]),
    ):
        np.testing.assert_allclose(obstacles.poses(time).position[0], x, atol=1e-12)
    turned = obstacles.poses(2.0).rotation[0]
    np.testing.assert_allclose(turned[:2, :2], [[np.cos(3), -np.sin(3)], [np.sin(3), np.cos(3)]], atol=1e-12)
    again = obstacles_of(ball(path=keys, motion=motion, repeat=True))
    np.testing.assert_allclose(again.poses(5.0).position[0], [1, 0, 0], atol=1e-12)


def sweep(part, start, end, thickness=0.01, continuous=True, h=0.02):
    obstacles = obstacles_of(part)
    start, end = np.array([start], float), np.array([end], float)
    return detect(
        obstacles.shapes,
        obstacles.poses(0.0),
        obstacles.poses(h),
        start,
        end,
        np.ones(1, bool),
        h,
        thickness,
        continuous,
    )


@pytest.mark.parametrize("name", SHAPES)
@given(seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=50)
def test_continuous_detection_misses_no_way_that_comes_too_near(name, seed):
    """Against a thousand samples of the way; near misses of a hundredth of the thickness are left open."""
    a, b = np.random.default_rng(seed).uniform(-1, 1, (2, 3))
    obstacles, thickness = obstacles_of(SHAPES[name]), 0.01
    nearest = min(distance(obstacles, a + t * (b - a))[0] for t in np.linspace(0, 1, 1001))
    found = len(sweep(SHAPES[name], a, b, thickness).key) > 0
    if nearest < thickness:
        assert found
    elif nearest > 1.01 * thickness + np.linalg.norm(b - a) / 1000:
        assert not found


@pytest.mark.parametrize("speed", [10.0, 1e3, 1e6])
def test_continuous_detection_catches_what_static_detection_lets_tunnel(speed):
    h = 0.02
    start, end = [0, 0, 0.5], [0, 0, 0.5 - speed * h]
    assert len(sweep(ball(), start, end, continuous=True).key) == 1
    assert len(sweep(ball(), start, end, continuous=False).key) == 0


def test_a_moving_obstacle_meets_a_vertex_that_stands_still():
    keys = [{"time": 0, "position": [-5, 0, 0]}, {"time": 0.02, "position": [5, 0, 0]}]
    found = sweep(ball(radius=0.1, path=keys, motion="linear"), [0, 0, 0], [0, 0, 0])
    np.testing.assert_allclose(found.normal, [[1, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(found.speed, [[500, 0, 0]], rtol=1e-9)


def drop(name, contact, steps=90, **more):
    world = sim.Simulation(
        scene(
            grid(resolution=(12, 12), position=[0.03, 0.02, 0.55]),
            SHAPES[name],
            gravity=[0, 0, -G],
            contact=contact,
            **more,
        )
    )
    reports = [world.step() for _ in range(steps)]
    return world, reports


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("detection", ["static", "continuous"])
def test_impulses_leave_no_vertex_inside(name, detection):
    _, reports = drop(name, "impulse", detection=detection)
    if detection == "continuous":
        assert all(r.penetrations == 0 for r in reports)
    assert max(r.contacts for r in reports) > 0
    assert reports[-1].penetrations == 0


def test_without_contact_cloth_falls_through():
    world, reports = drop("sphere", "none", steps=40)
    assert all(r.contacts == 0 for r in reports)
    assert any(r.penetrations > 0 for r in reports)
    assert world.positions[:, 2].max() < -0.3


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
def test_cloth_laid_on_a_plane_comes_to_rest_at_the_thickness(contact):
    thickness = 0.01
    world = sim.Simulation(
        scene(
            grid(position=[0, 0, 0.05]),
            {"kind": "plane"},
            gravity=[0, 0, -G],
            contact=contact,
            thickness=thickness,
        )
    )
    for _ in range(120):
        report = world.step()
    overlap = G * world.settings.dt**2 / 10.0  # a penalty of 10 m/h² holds a weight at this depth
    np.testing.assert_allclose(
        world.positions[:, 2], thickness, atol=1.05 * overlap if contact == "penalty" else 1e-9
    )
    assert np.abs(world.velocities).max() < 1e-6
    assert report.contacts == len(world.masses)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-7])
@pytest.mark.parametrize("newton", [1, 2, 3, 8])
def test_cloth_on_a_ball_comes_to_rest(newton, tolerance):
    """No piece breaks away that some of it holds: vertices would slide, and be put back, at every turn.

    Nor is cloth that hangs off the ball's side pulled to it at every turn.
    """
    sheet = grid((0.4, 0.4), (12, 12), position=[0, 0, 0.31])
    how = {"friction": 0.6, "newton": newton, "tolerance": tolerance}
    how["jitter"] = 1e-4  # without, it stays as even as it began until rounding has it buckle, seconds later
    world, fastest = sim.Simulation(scene(sheet, ball(), gravity=[0, 0, -G], **how)), 0.0
    while world.time < 4.0:
        world.step()
    for _ in range(30):
        world.step()
        fastest = max(fastest, np.abs(world.velocities).max())
    assert fastest < max(tolerance / world.settings.dt, 1e-4)  # as far as the solver may err in a step


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("contact", ["penalty", "impulse"])
def test_newton_converges_where_cloth_lands(contact, friction):
    """Whether a contact pushes follows from where it ends, damped or not, or it comes and goes."""
    cloth = grid(size=(0.3, 0.3), resolution=(5, 5), position=[0.0, 0.0, 0.22])
    how = {"contact": contact, "friction": friction, "newton": 30, "tolerance": 1e-6}
    world = sim.Simulation(scene(cloth, ball(radius=0.2), gravity=[0, 0, -G], stretch=5.0, **how))
    reports = [world.step() for _ in range(12)]
    assert sum(r.contacts > 0 for r in reports) > 8
    assert max(r.newton for r in reports) < 15  # it used all 30 in half of the steps
    assert all("below" in r.stopped for r in reports)


@pytest.mark.parametrize("speed", [5.0, 100.0])
def test_a_fast_sphere_passes_no_vertex_of_a_pinned_cloth(speed):
    """The sphere goes right through where the cloth hangs; every vertex stays outside at every step."""
    way = [{"time": 0, "position": [0, 0, -0.5]}, {"time": 1.0 / speed, "position": [0, 0, 0.5]}]
    cloth = grid(resolution=(15, 15), pins=["left", "right"])
    world = sim.Simulation(scene(cloth, ball(radius=0.05, path=way, motion="linear"), dt=1 / 60, gamma=0.5))
    while world.time < 1.0 / speed + 0.1:
        assert world.step().penetrations == 0


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
@pytest.mark.parametrize("floor", ["plane", "mesh"])
def test_cloth_rests_inside_the_friction_cone(floor, contact):
    assert drift_on_incline(Probe(0), contact, floor) < 1e-4  # of a metre in one second


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
@pytest.mark.parametrize("floor", ["plane", "mesh"])
@pytest.mark.parametrize("ratio", [1.05, 1.5, 3.0])
def test_cloth_slides_outside_the_friction_cone_as_coulomb_says(floor, contact, ratio):
    assert sliding_error(Probe(0), ratio, contact, floor) < 1e-3


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
@pytest.mark.parametrize("floor", ["plane", "mesh"])
def test_sliding_cloth_stops_after_the_distance_that_friction_allows(floor, contact):
    assert stopping_error(Probe(0), contact, floor) < 5e-3


@pytest.mark.parametrize("floor", ["plane", "mesh"])
def test_the_distance_that_cloth_slides_is_of_first_order_in_the_step(floor):
    """Short of v²/2μg by 5 % at 1/60 s, and by half of that at half the step, as backward Euler is."""
    exact = SPEED**2 / (2 * MU * G)
    whole, half = (stopping_distance(Probe(0), "impulse", floor, h) for h in (1 / 60, 1 / 120))
    order = np.log2((exact - whole) / (exact - half))
    assert order == pytest.approx(1.0, abs=0.1)
    assert 2.0 * half - whole == pytest.approx(exact, rel=2e-3)  # as h goes to zero


def test_a_vertex_that_lands_loses_its_normal_speed_and_no_more():
    world = sim.Simulation(
        scene(chain([[0, 0, 0.02]], [0.1]), {"kind": "plane"}, friction=0.0, thickness=5e-3, dt=0.01)
    )
    world._velocities[:] = [1.0, 0.0, -3.0]
    world.step()
    assert world.velocities[0, 0] == pytest.approx(1.0, abs=1e-12)
    assert world.positions[0, 2] == pytest.approx(5e-3, abs=1e-9)
    world.step()
    assert world.velocities[0, 2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("newton", [1, 2, 4])
@pytest.mark.parametrize("contact", ["penalty", "impulse"])
def test_a_belt_takes_cloth_along_with_all_that_friction_gives(contact, newton):
    """It gains μ g t, in steps that are searched along as well: friction is no descent of energy alone."""
    mu, h, steps = 0.5, 1 / 240, 12
    keys = [{"time": 0.0, "position": [0, 0, 0]}, {"time": 1.0, "position": [0.5, 0, 0]}]
    belt = {"kind": "plane", "motion": "linear", "path": keys}
    cloth = grid((0.2, 0.2), (4, 4), position=[0, 0, 5e-3])
    how = {"contact": contact, "newton": newton, "tolerance": 1e-8, "dt": h, "friction": mu}
    world = sim.Simulation(scene(cloth, belt, gravity=[0, 0, -G], **how))
    for _ in range(steps):
        world.step()
    # The first step presses by what it expects, and what rests on springs sinks in for another few.
    np.testing.assert_allclose(world.velocities[:, 0], mu * G * h * steps, rtol=0.1)
