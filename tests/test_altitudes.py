"""Altitude springs: which act, when that changes, what they keep a triangle from; and how mass is shared."""

import math

import numpy as np
import pytest

import sim
from sim.springs.build import Springs
from tests.worlds import grid, irregular, scene

EARTH = [0.0, 0.0, -9.81]


def corners(world, points):
    """(t, 3, 3) each triangle's corners, of an array (n, 3) of points."""
    return points[world.triangles]


def heights(triangles):
    """(t, 3) over the edge opposite to each corner: twice the area over its length."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return doubled[:, None] / edges(triangles)


def edges(triangles):
    """(t, 3) lengths of the edges opposite to each corner."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.stack([np.linalg.norm(d, axis=1) for d in (c - b, a - c, b - a)], axis=1)


def stored(world, chosen):
    """Energy [J] in the altitudes that `chosen` (t, 3) says, from a formula of our own."""
    rest = heights(corners(world, world.mesh.rest_vertices))
    stretch = heights(corners(world, world.positions)) - rest
    return float((0.5 * world.settings.altitude / rest * stretch**2)[chosen].sum())


def on_the_longest_edge(world):
    """(t, 3) bool: true for the corner that is opposite to the longest edge now."""
    lengths = edges(corners(world, world.positions))
    return lengths == lengths.max(axis=1)[:, None]


SUMMED = 1e-12
"""Rounding of a sum of a few hundred terms, as part of it."""


# Which act


def test_shortest_is_the_altitude_on_the_longest_present_edge_of_each_triangle():
    """Not of the rest shape: 0.9 in one direction and 1.4 in the other makes other edges the longest."""
    world = sim.Simulation(scene(irregular(1), altitudes="shortest", altitude=30.0))
    world.place(world.positions * [0.9, 1.4, 1.0])
    chosen = on_the_longest_edge(world)
    assert (chosen.sum(axis=1) == 1).all()
    assert world.energy()["altitude"] == pytest.approx(stored(world, chosen), rel=SUMMED)
    rest = edges(corners(world, world.mesh.rest_vertices))
    assert (chosen != (rest == rest.max(axis=1)[:, None])).any()


def test_all_altitudes_are_three_in_each_triangle_and_none_are_none():
    world = sim.Simulation(scene(irregular(1), altitudes="all", altitude=30.0))
    every = np.ones(world.triangles.shape, dtype=bool)
    assert world.energy()["altitude"] == pytest.approx(stored(world, every), rel=SUMMED)
    edges_alone = sim.Simulation(scene(irregular(1), altitudes="none", altitude=30.0))
    assert "altitude" not in edges_alone.energy()
    world.update(altitudes="none")
    assert world.energy().keys() == edges_alone.energy().keys()
    np.testing.assert_array_equal(world.forces(), edges_alone.forces())
    assert world.step().effects["altitudes"] == "off: altitudes is none"


def moving(**settings):
    """A crumpled mesh, soft enough for explicit steps; longest edges change, and none turns inside out."""
    soft = {"stretch": 0.1, "altitude": 0.1, "bending": 1e-6, "dt": 1e-3}
    common = {"altitudes": "shortest", "newton": 10, "tolerance": 1e-9}
    world = sim.Simulation(scene(irregular(2), **{**soft, **common, **settings}))
    world.place(world.positions, 0.4 * np.random.default_rng(0).standard_normal(world.positions.shape))
    return world


@pytest.mark.parametrize("name", ["backward_euler", "sdirk2", "trapezoid", "symplectic_euler"])
def test_the_choice_holds_through_all_the_solves_of_a_step(name, monkeypatch):
    """Who acts is noted whenever springs are measured, which every evaluation of forces begins with."""
    seen = []

    def noted(springs, positions):
        if springs.name == "altitude":
            seen.append(springs.active.copy())
        measure(springs, positions)

    measure = Springs.measure
    monkeypatch.setattr(Springs, "measure", noted)
    world = moving(integrator=name)
    world.step()  # the first one of an explicit integrator also works out how long a step may be
    changes, longest = 0, on_the_longest_edge(world).ravel()
    for _ in range(20):
        seen.clear()
        changes += world.step().energy_jumps
        assert seen
        assert all((active == longest).all() for active in seen)
        longest = on_the_longest_edge(world).ravel()
    assert changes > 10


@pytest.mark.parametrize("name", ["backward_euler", "sdirk2", "symplectic_euler"])
def test_every_change_of_altitude_is_counted_and_the_energy_that_it_puts_in_booked(name):
    world = moving(integrator=name)
    longest, changes = on_the_longest_edge(world), 0
    for _ in range(20):
        report = world.step()
        before, longest = longest, on_the_longest_edge(world)
        assert report.energy_jumps == np.count_nonzero(before != longest)
        put_in = stored(world, longest) - stored(world, before)
        assert report.energy_jump == pytest.approx(put_in, rel=1e-9, abs=1e-12 * stored(world, longest))
        changes += report.energy_jumps
    assert changes > 10


@pytest.mark.parametrize("altitudes", ["none", "all"])
def test_nothing_jumps_where_nothing_is_chosen(altitudes):
    world = moving(altitudes=altitudes)
    for _ in range(20):
        report = world.step()
        assert (report.energy_jumps, report.energy_jump) == (0, 0.0)


SIDE = math.sqrt(3.0) / 2.0
"""Height of an equilateral triangle with sides of a metre."""


def triangle(velocity, apex=(0.5, SIDE), pins=(0, 1), **settings):
    """One triangle at rest but for the velocity of its apex, in the x–y plane."""
    cloth = {"vertices": [[0, 0, 0], [1, 0, 0], [*apex, 0]], "triangles": [[0, 1, 2]], "masses": [0.01] * 3}
    common = {"stretch": 1.0, "altitude": 1.0, "dt": 2e-3, "newton": 20, "tolerance": 1e-11}
    world = sim.Simulation(
        scene({**cloth, "pins": list(pins)}, bend="none", integrator="sdirk2", **{**common, **settings})
    )
    world.place(world.positions, [[0, 0, 0], [0, 0, 0], [*velocity, 0]])
    return world


DRIFT = 1e-6
"""Part of its energy that SDIRK2 may lose in a second at h ω = 0.02; the jumps are a thousandth and more."""


def test_the_energy_of_a_triangle_whose_longest_edge_changes_is_what_the_jumps_put_in():
    """Without damping; as the apex swings, one side becomes the longest edge and then the other."""
    world = triangle((3.0, 0.5), gamma=0.0, altitudes="shortest", altitude=4.0)
    begin = sum(world.energy().values())
    jumps, put_in = 0, 0.0
    for _ in range(500):
        report = world.step()
        jumps += report.energy_jumps
        put_in += report.energy_jump
    assert jumps >= 4  # each time one begins and one ceases
    assert abs(put_in) > 1e-3 * begin
    assert sum(world.energy().values()) - begin == pytest.approx(put_in, abs=DRIFT * begin)


# What they keep a triangle from


@pytest.mark.parametrize(("altitudes", "side"), [("none", -1.0), ("shortest", 1.0), ("all", 1.0)])
def test_a_triangle_pushed_inside_out_comes_back_by_its_altitudes_alone(altitudes, side):
    """Edges are as long in the mirror image, and stay there; an altitude remembers which side was up."""
    world = triangle((0.0, -45.0), gamma=0.3, altitudes=altitudes)
    deepest = 0.0
    for _ in range(800):
        world.step()
        deepest = min(deepest, world.positions[2, 1] / SIDE)
    assert deepest < -0.2
    assert world.positions[2, 1] / SIDE == pytest.approx(side, abs=0.02)  # 1.6 s, and γ = 0.3: at rest nearly
    assert not world.positions[:, 2].any()  # it never left its plane, in which there is no other way back


def test_altitudes_hold_a_triangle_up_that_edges_let_collapse():
    """Two edges of 1 N carry at most 0.41 N on their apex; under 1 N it goes through, and hangs on them."""
    ends = {}
    for altitudes in ("none", "all"):
        world = triangle((0.0, 0.0), gamma=1.0, altitudes=altitudes, gravity=[0, -100.0, 0], dt=0.01)
        for _ in range(200):
            world.step()
        ends[altitudes] = world.positions[2, 1] / SIDE
    assert ends["none"] < -1.0
    assert ends["all"] > 0.3


# Mass


def two_sheets(**settings):
    """A crumpled piece of 0.5 kg/m², and a grid beside it that weighs what the settings say."""
    pieces = [{**irregular(5), "density": 0.5}, grid(position=[3, 0, 0])]
    return sim.Simulation({"cloth": pieces, "settings": {"tangled": "keep", **settings}})


def rest_area(world, piece):
    """Areas [m²] and centres of the triangles of a piece at rest."""
    triangles = corners(world, world.mesh.rest_vertices)[world.pieces[world.triangles[:, 0]] == piece]
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas, triangles.mean(axis=1)


@pytest.mark.parametrize("mass", ["area", "constant"])
def test_each_piece_weighs_its_own_density_times_its_area_however_shared_out(mass):
    world = two_sheets(mass=mass, density=0.2)
    for density in (0.2, 0.9):
        world.update(density=density)  # a piece that has its own keeps it
        for piece, own in ((0, 0.5), (1, density)):
            masses = world.masses[world.pieces == piece]
            assert masses.sum() == pytest.approx(own * rest_area(world, piece)[0].sum(), rel=SUMMED)
            assert (np.ptp(masses) == 0.0) == (mass == "constant")


def test_mass_by_area_has_the_centre_of_the_area_and_both_have_it_where_the_mesh_is_even():
    for mass in ("area", "constant"):
        world = two_sheets(mass=mass)
        rest = world.mesh.rest_vertices
        for piece in (0, 1):
            own = world.pieces == piece
            center = world.masses[own] @ rest[own] / world.masses[own].sum()
            areas, centers = rest_area(world, piece)
            if mass == "area" or piece == 1:
                np.testing.assert_allclose(center, areas @ centers / areas.sum(), atol=SUMMED)
            else:
                np.testing.assert_allclose(center, rest[own].mean(axis=0), atol=SUMMED)


@pytest.mark.parametrize("mass", ["area", "constant"])
def test_pieces_of_any_density_fall_alike(mass):
    """Each as one body, by g h² n (n + 1)/2 in steps of backward Euler, also while it deforms."""
    world = two_sheets(mass=mass, gravity=EARTH, altitudes="all")
    begin, h, n = world.positions.copy(), world.settings.dt, 20
    for _ in range(n):
        world.step()
    fallen = [0.0, 0.0, 0.5 * EARTH[2] * h * h * n * (n + 1)]
    for piece in (0, 1):
        own = world.pieces == piece
        moved = (world.positions - begin)[own]
        center = world.masses[own] @ moved / world.masses[own].sum()
        np.testing.assert_allclose(center, fallen, atol=SUMMED)
    assert np.ptp(world.positions[world.pieces == 0, 2]) > 1e-3
