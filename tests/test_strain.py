"""Strain limiting: cloth keeps its limit, momentum, and what contact promises."""

import numpy as np
import pytest

import sim
from sim.strain import make_limit, shorten
from tests.test_scenes import strains
from tests.worlds import ball, chain, grid, scene

MARK = 1e-3
"""Strain beyond the limit that is allowed (hard case N15)."""

EARTH = [0, 0, -9.81]


def hanging(limit, resolution=(5, 33), **settings):
    """A soft strip, a metre long, that hangs from its upper end."""
    cloth = grid((0.2, 1.0), resolution, pins=["top"], rotation=[1.5707963, 0, 0])
    weak = {"stretch": 0.2, "contact": "none", "gravity": EARTH, "strain_limit": limit}
    return sim.Simulation(scene(cloth, **{**weak, **settings}))


@pytest.mark.parametrize("limit", [0.01, 0.1])
@pytest.mark.parametrize("dt", [1 / 240, 1 / 30])
def test_a_soft_strip_that_hangs_keeps_its_limit_at_every_step(limit, dt):
    """By itself it would be half as long again."""
    world, most = hanging(limit, dt=dt), 0
    for _ in range(round(0.5 / dt)):
        report = world.step()
        assert strains(world).max() <= limit + MARK
        assert report.strain == pytest.approx(strains(world).max(), abs=1e-12)
        most = max(most, report.limited)
    assert most > 50


def test_a_strip_in_a_plane_keeps_its_limit_there():
    """One side of it hangs from the other by slanted edges, which pull, but not out of the plane."""
    x = np.array([[0.05 * k, y, 0.0] for y in (0.0, 0.04) for k in range(12)])
    triangles = [t for k in range(11) for t in ([k, k + 1, 12 + k], [k + 1, 13 + k, 12 + k])]
    cloth = {"vertices": x.tolist(), "triangles": triangles, "pins": [0]}
    weak = {"stretch": 0.01, "contact": "none", "gravity": EARTH, "strain_limit": 0.1}
    world, most = sim.Simulation(scene(cloth, **weak) | {"plane": "xz"}), 0
    for _ in range(30):
        most = max(most, world.step().limited)
        assert strains(world).max() <= 0.1 + MARK
        np.testing.assert_array_equal(world.positions[:, 1], x[:, 1])
        assert not world.velocities[:, 1].any()
    assert most > 10


def test_without_a_limit_it_is_far_longer():
    world = hanging(0.0)
    for _ in range(30):
        report = world.step()
    assert strains(world).max() > 0.3
    assert (report.limited, report.strain) == (0, 0.0)


def test_a_chain_of_a_hundred_links_at_its_limit_is_as_long_as_that():
    """All links are taut, and impulses have to agree from end to end."""
    places = np.stack([np.zeros(101), np.zeros(101), -0.01 * np.arange(101)], axis=1)
    taut = {"stretch": 0.01, "contact": "none", "gravity": EARTH, "bend": "none", "strain_limit": 0.05}
    world = sim.Simulation(scene(chain(places.tolist(), [0.001] * 101, pins=[0]), **taut, gamma=1.0))
    for _ in range(60):
        world.step()
    assert strains(world).max() <= 0.05 + MARK
    assert -world.positions[-1, 2] == pytest.approx(1.05, abs=2e-3)


def test_it_takes_no_momentum():
    """Free cloth pulled apart and spun: impulses are between its vertices, along lines through both."""
    world = sim.Simulation(scene(grid(resolution=(8, 8))))
    x = world.positions.copy() * [1.1, 1.0, 1.0]
    v = np.cross([0.3, -0.2, 1.0], x) + np.array([1.0, 2.0, 3.0])
    h, limit = 1e-2, make_limit(world.mesh.edges, world.mesh.rest_vertices)
    end, u = x + h * v, v.copy()
    left, pulling = shorten(limit, 0.05, world.model.inverse_masses, h, end, u)
    m = world.masses[:, None]
    assert pulling > 50
    assert left <= 0.05 + MARK
    assert np.allclose(end, x + h * u, atol=1e-12)  # positions follow the velocities
    assert np.allclose((m * (u - v)).sum(axis=0), 0.0, atol=1e-13 * np.abs(m * u).sum())
    turned = np.abs(np.cross(end, m * (u - v)).sum(axis=0)).max()
    assert turned < 0.01 * np.abs(np.cross(end, m * (u - v))).sum()  # earlier rounds ended elsewhere


def test_it_only_pulls():
    """Cloth that is pushed together is left alone."""
    world = sim.Simulation(scene(grid(), contact="none", gravity=[0, 0, 0], strain_limit=0.05))
    world.place(world.positions * 0.9)
    free = sim.Simulation(scene(grid(), contact="none", gravity=[0, 0, 0]))
    free.place(free.positions * 0.9)
    assert world.step().limited == 0
    free.step()
    assert (world.positions == free.positions).all()


def test_contact_keeps_its_promise_with_a_limit():
    """Soft cloth falls on a ball and on itself: nothing inside, nothing crossed, and hardly too long."""
    cloth = grid((0.8, 0.8), (15, 15), position=[0.0, 0.0, 0.35])
    soft = {"stretch": 5.0, "gravity": EARTH, "strain_limit": 0.1, "self_collision": "auto"}
    world = sim.Simulation(
        scene(cloth, ball((0.1, 0.05, 0.0), 0.25), {"kind": "plane", "point": [0, 0, -0.3]}, **soft)
    )
    for _ in range(60):
        assert world.step().penetrations == 0
        assert not len(sim.intersections(world.positions, world.triangles))
    assert strains(world).max() < 0.15


def test_the_same_bits_follow_from_a_snapshot_and_on_two_threads():
    world, ends = hanging(0.05, (5, 9)), []
    for _ in range(5):
        world.step()
    start = world.snapshot()
    for threads in (1, 2):
        world.restore(start)
        world.update(threads=threads)
        for _ in range(5):
            world.step()
        ends.append(world.positions.copy())
    assert (ends[0] == ends[1]).all()
