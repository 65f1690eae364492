"""Starts that cross themselves: refused with what crosses, untangled on request, or kept."""

import ipctk
import numpy as np
import pytest

import sim
from sim import tangles
from sim.check import check_scene
from sim.stress.measures import EARTH
from sim.tangles import contour
from tests.worlds import grid, scene

N = 20
"""Vertices along a sheet of 0.4 m, 21 mm apart."""


def sheet():
    world = sim.Simulation(scene(grid((0.4, 0.4), (N, N))), contact="none")
    return world.positions.copy(), world.triangles.copy()


def poked(depth=0.015, **settings):
    """Two layers 5 mm apart, the upper of which has two dents through the lower; its corners are pinned."""
    x, triangles = sheet()
    upper = x + np.array([0.003, 0.002, 0.005])
    for middle in ([0.07, 0.05], [-0.1, -0.08]):
        upper[:, 2] -= depth * np.exp(-((x[:, :2] - middle) ** 2).sum(axis=1) / 2e-3)
    layers = [{"vertices": p, "triangles": triangles} for p in (upper, x)]
    layers[0]["pins"] = [0, N - 1, N * N - N, N * N - 1]
    return scene(layers, **{"self_collision": "auto", "contact": "impulse", **settings})


def crossing(world):
    """By ipctk, and by our own exact judge, which must agree."""
    mesh = ipctk.CollisionMesh(world.positions, world.edges, world.triangles)
    crosses = ipctk.has_intersections(mesh, world.positions)
    assert crosses == (len(sim.intersections(world.positions, world.triangles)) > 0)
    return crosses


def test_impulses_refuse_a_start_that_crosses_itself_and_list_the_pairs():
    with pytest.raises(
        sim.SceneError, match=r"crosses itself .* pairs of triangles: \d+ and \d+, "
    ) as refused:
        sim.Simulation(poked())
    assert refused.value.setting == "tangled"
    with pytest.raises(sim.SceneError) as checked:
        check_scene(sim.load_scene(poked()))
    assert str(checked.value) == str(refused.value)  # by fcl, and by exact signs


@pytest.mark.parametrize(
    "settings", [{"contact": "penalty"}, {"contact": "none"}, {"self_collision": "off"}, {"tangled": "keep"}]
)
def test_whoever_does_not_keep_cloth_apart_or_says_so_may_start_tangled(settings):
    made = poked(**settings)
    world = sim.Simulation(made)
    assert crossing(world)
    assert not world.note
    check_scene(sim.load_scene(made))


@pytest.mark.parametrize("contact", ["impulse", "penalty"])
def test_what_pokes_through_is_untangled_on_request_and_stays_so(contact):
    before = sim.Simulation(poked(tangled="keep"))
    world = sim.Simulation(poked(tangled="untangle", contact=contact, gravity=EARTH))
    assert crossing(before)
    assert not crossing(world)
    moved = np.linalg.norm(world.positions - before.positions, axis=1)
    assert moved.max() < 0.03  # twice the depth of a dent
    assert f"by up to {moved.max():.2g} m" in world.note
    assert moved[world.pinned].max() == 0.0
    if contact == "impulse":
        for _ in range(20):
            world.step()
            assert not crossing(world)


def test_the_same_scene_is_untangled_to_the_same_bits():
    one, other = (sim.Simulation(poked(tangled="untangle", threads=t)) for t in (1, 2))
    assert np.array_equal(one.positions, other.positions)


def test_a_start_that_crosses_nothing_is_left_as_it_is():
    made = poked(depth=0.0)
    for tangled in ("refuse", "untangle", "keep"):
        world = sim.Simulation(made, tangled=tangled)
        assert np.array_equal(world.positions, world.mesh.vertices)
        assert not world.note


def test_what_cannot_be_untangled_is_said_with_what_is_left():
    """Two sheets in one plane: there is no contour."""
    x, triangles = sheet()
    made = scene([{"vertices": x, "triangles": triangles}] * 2, self_collision="auto", tangled="untangle")
    with pytest.raises(
        sim.SceneError, match=r"could not be untangled: of ([\d,]+) pairs, there are left \1 "
    ):
        sim.Simulation(made)


def test_cloth_in_a_plane_is_moved_within_it_or_not_at_all():
    """Dents across the only two directions that there are stay."""
    made = {**poked(tangled="untangle"), "plane": "xy"}
    with pytest.raises(sim.SceneError, match="could not be untangled"):
        sim.Simulation(made)


def obstacle(**settings):
    """A sheet with a dent, over a mesh obstacle in the form of a plate that stands still."""
    x, triangles = sheet()
    dented = x + np.array([0.003, 0.002, 0.005])
    dented[:, 2] -= 0.015 * np.exp(-(x[:, :2] ** 2).sum(axis=1) / 2e-3)
    plate = {"vertices": x, "triangles": triangles}
    return scene({"vertices": dented, "triangles": triangles}, plate, **{"contact": "impulse", **settings})


@pytest.mark.parametrize("own", ["off", "auto"])
def test_cloth_across_a_mesh_obstacle_is_refused_whether_it_feels_itself_or_not(own):
    with pytest.raises(sim.SceneError, match=r"\d+ and \d+ of the obstacle"):
        sim.Simulation(obstacle(self_collision=own))
    with pytest.raises(sim.SceneError, match=r"\d+ and \d+ of the obstacle"):
        check_scene(sim.load_scene(obstacle(self_collision=own)))
    sim.Simulation(obstacle(self_collision=own, each_obstacle="0=off"))


def test_pieces_across_each_other_are_refused_where_pieces_feel_each_other():
    layers = poked()
    settings = {**layers["settings"], "self_collision": "off", "cloth_collision": "auto"}
    with pytest.raises(sim.SceneError, match="crosses itself"):
        sim.Simulation({**layers, "settings": settings})
    sim.Simulation({**layers, "settings": {**settings, "self_collision": "auto", "cloth_collision": "off"}})


def test_cloth_across_a_mesh_obstacle_is_refused_or_moved_off_it():
    with pytest.raises(sim.SceneError, match=r"\d+ and \d+ of the obstacle"):
        sim.Simulation(obstacle())
    with pytest.raises(sim.SceneError, match=r"\d+ and \d+ of the obstacle"):
        check_scene(sim.load_scene(obstacle()))
    world = sim.Simulation(obstacle(tangled="untangle"))
    plate, triangles = sheet()
    assert across(world.positions, plate, triangles) == 0
    assert across(sim.Simulation(obstacle(tangled="keep")).positions, plate, triangles) > 10
    sim.Simulation(obstacle(obstacles="off"))


def across(x, plate, triangles):
    both, faces = np.concatenate([x, plate]), np.concatenate([triangles, triangles + len(plate)])
    return len(sim.intersections(both, faces))


def test_the_gradient_of_the_contour_is_the_slope_of_its_length(monkeypatch):
    monkeypatch.setattr(tangles, "GRAZING", 0.0)  # below it the gradient is bounded on purpose
    world = sim.Simulation(poked(tangled="keep", jitter=1e-3))
    x, mesh = world.positions, (world.triangles, world.edges)
    found = sim.intersections(x, world.triangles)
    length, gradient = contour(x, *mesh, found)
    assert length > 0.1
    rng = np.random.default_rng(0)
    for _ in range(5):
        way, h = rng.standard_normal(x.shape), 1e-8
        ahead, behind = (contour(x + s * h * way, *mesh, found)[0] for s in (1.0, -1.0))
        # Rounding of two lengths of some metres, and the third derivative at crossings of about 0.1 rad.
        assert (ahead - behind) / (2 * h) == pytest.approx(float((gradient * way).sum()), rel=1e-4)
