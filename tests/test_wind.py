"""Wind: forces in closed form, steps of any length that only brake, energy, gusts."""

import numpy as np
import pytest

import sim
from sim.integrators import INTEGRATORS
from sim.wind import DENSITY, _gusts
from tests.worlds import grid, scene

BARE = {"gravity": [0, 0, 0], "stretch": 0.0, "bend": "none", "gamma": 0.0, "contact": "none"}
"""Nothing but the air acts."""

FREE = {"bend": "none", "contact": "none", "solver": "direct"}


def triangle(velocity, **settings):
    """The force of the air on one triangle in the x–y plane, of 0.5 m², that moves with `velocity`."""
    cloth = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}
    world = sim.Simulation(scene(cloth, **{**BARE, "drag": 1.2, **settings}))
    world.place(world.positions.copy(), np.tile(velocity, (3, 1)))
    return world.forces().sum(axis=0)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.0, 1.5])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_drag_and_lift_of_a_plate_at_an_angle(angle, side):
    u = 3.0 * np.array([np.sin(angle), 0.0, side * np.cos(angle)])
    force = triangle([0, 0, 0], wind=u.tolist(), lift=0.5)
    pressure = 0.5 * DENSITY * 1.2 * 9.0 * 0.5
    up = np.array([-np.cos(angle), 0.0, side * np.sin(angle)])
    assert force @ u / 3.0 == pytest.approx(pressure * np.cos(angle), rel=1e-12)
    assert force @ up == pytest.approx(0.5 * pressure * np.cos(angle) * np.sin(angle), rel=1e-9, abs=1e-12)
    assert force[1] == pytest.approx(0.0, abs=1e-12)


def test_only_the_motion_past_each_other_counts():
    blown, moved = triangle([0, 0, 0], wind=[1, 2, 3], lift=1.0), triangle([-1, -2, -3], lift=1.0)
    assert np.allclose(blown, moved, rtol=1e-13)
    assert not triangle([1, 2, 3], wind=[1, 2, 3], lift=1.0).any()


@pytest.mark.parametrize("dt", [1e-3, 1 / 60, 1.0])
def test_a_flat_sheet_falls_at_its_terminal_velocity_whatever_the_step(dt):
    world = sim.Simulation(scene(grid(), **FREE, gravity=[0, 0, -9.81], drag=1.2, density=0.2, dt=dt))
    for _ in range(round(1.5 / dt) if dt < 0.1 else 200):
        world.step()
    final = np.sqrt(2.0 * 0.2 * 9.81 / (DENSITY * 1.2))
    assert np.allclose(world.velocities, [0, 0, -final], atol=1e-6 * final)


@pytest.mark.parametrize("dt", [1e-3, 1 / 60, 1.0])
def test_air_alone_never_speeds_up_what_passes_it(dt):
    """Also with as much lift as there is, and in steps in which drag would turn the motion round."""
    world = sim.Simulation(scene(grid(), **BARE, wind=[3, -2, 1], drag=2.0, lift=1.0, density=0.01, dt=dt))
    random = np.random.default_rng(1)
    bumps, motion = random.normal(0, 0.02, world.positions.shape), random.normal(0, 5, world.positions.shape)
    world.place(world.positions + bumps, motion)
    for _ in range(20):
        before = np.linalg.norm(world.velocities - [3, -2, 1], axis=1)
        world.step()
        assert (np.linalg.norm(world.velocities - [3, -2, 1], axis=1) <= before * (1 + 1e-6) + 1e-6).all()


def flag(resolution=(10, 7), **settings):
    cloth = grid((0.6, 0.4), resolution, pins=["left"], rotation=[1.5707963, 0, 0])
    wind = {"wind": [5, 1, 0], "drag": 1.2, "lift": 0.5, "gust": 0.3}
    return sim.Simulation(scene(cloth, **{"contact": "none", "gravity": [0, 0, -9.81], **wind, **settings}))


@pytest.mark.parametrize("newton", [1, 20])
def test_the_cloth_gains_no_more_energy_than_the_air_gives(newton):
    world, gained = flag(newton=newton, tolerance=1e-8), []
    for _ in range(60):
        before = sum(world.energy().values())
        work = world.step().wind_work
        gained.append(sum(world.energy().values()) - before - work)
    assert max(gained) <= 1e-6  # [J]; linear solves are exact to 1e-8 m under forces of a newton
    assert min(gained) < -1e-4  # and it is no empty bound: steps damp


def test_momentum_changes_by_what_the_air_gives():
    world = sim.Simulation(scene(grid(), **FREE, gravity=[0, 0, 0], wind=[4, 1, -2], drag=1.2, lift=0.7))
    wind = world.model.wind
    for _ in range(5):
        before = world.momentum()[0]
        world.step()
        force = wind.drag[:, None] * (wind.air - world.velocities) + wind.lift
        assert np.allclose(world.momentum()[0] - before, world.settings.dt * force.sum(axis=0), rtol=1e-9)


@pytest.mark.parametrize("name", ["backward_euler", "bdf2", "midpoint", "sdirk2", "tr_bdf2"])
def test_wind_keeps_an_integrator_at_its_order(name):
    def end(steps):
        exact = {"newton": 30, "tolerance": 1e-11, "solver": "direct"}
        steady = {"wind": [0.5, 4, 0], "gust": 0.0, "stretch": 5.0}  # and blows on one side of the cloth only
        world = flag((5, 4), integrator=name, dt=0.1 / steps, **exact, **steady)
        for _ in range(steps):
            world.step()
        return world.positions.copy()

    order = INTEGRATORS[name].order
    coarse, fine, finest = end(64), end(128), end(256)
    truth = finest + (finest - fine) / (2**order - 1)  # Richardson (1911)
    errors = [np.abs(x - truth).max() for x in (end(32), coarse)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def test_gusts_are_seeded_alike_in_all_directions_and_as_strong_as_asked():
    times = np.arange(0.0, 400.0, 0.01)
    gusts = _gusts(3, times)
    assert np.allclose(np.sqrt((gusts**2).mean(axis=0)), 1.0, atol=0.02)  # over many periods of the slowest
    assert (gusts == _gusts(3, times)).all()
    assert np.abs(gusts - _gusts(4, times)).max() > 1.0
    assert abs(np.corrcoef(gusts.T)[0, 1]) < 0.2


def test_gusts_travel_with_the_mean_wind():
    world = flag(wind=[5, 0, 0])
    wind, x = world.model.wind, world.positions
    wind.blow(world.settings, 1.0, x)
    here = wind.air.copy()
    wind.blow(world.settings, 1.2, x + np.array([1.0, 0.0, 0.0]))
    assert np.allclose(wind.air, here, rtol=1e-12)
    wind.blow(world.settings, 1.2, x)
    assert not np.allclose(wind.air, here, rtol=1e-2)


def test_without_drag_there_is_no_air_at_all():
    world, never = flag(drag=0.0), flag(drag=0.0, wind=[0, 0, 0], lift=0.0, gust=0.0)
    assert world.model.wind is None
    for _ in range(10):
        assert world.step().wind_work == 0.0
        never.step()
    assert (world.positions == never.positions).all()


def test_air_switches_live():
    world = flag(drag=0.0)
    world.step()
    world.update(drag=1.2)
    assert world.step().wind_work != 0.0
    world.update(drag=0.0)
    assert world.model.wind is None
    assert world.step().wind_work == 0.0


def test_the_same_bits_follow_from_a_snapshot():
    world = flag()
    for _ in range(5):
        world.step()
    start, ends = world.snapshot(), []
    for _ in range(2):
        world.restore(start)
        for _ in range(5):
            world.step()
        ends.append(world.positions.copy())
    assert (ends[0] == ends[1]).all()
