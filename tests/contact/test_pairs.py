"""Contacts of pairs: gap, normal, weights and names, against differences and ipctk."""

import ipctk
import numpy as np
import pytest

import sim
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE
from sim.contact.obstacles import Solid
from sim.contact.pairs import AFTER, FELT, GAP, THICK, Feels, Pairs
from sim.contact.proximity import measure
from tests.contact import judge
from tests.worlds import grid, scene

FIRST = 1000
"""Where the keys of pairs start; those of obstacles are lower."""

H = 0.01
NONE = np.zeros((0, 3), dtype=np.int64)
NO_SOLID = Solid(np.zeros((0, 3)), NONE, NONE[:, :2], NONE[:, 0])
TETRAHEDRON = Solid(
    np.array([[0.1, 0.1, -0.004], [0.3, 0.1, -0.05], [0.1, 0.3, -0.05], [0.05, 0.05, -0.2]]),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]),
    np.zeros(4, dtype=np.int64),
)


class Case:
    """Some cloth where it starts, maybe with a solid that goes somewhere, and the contacts there."""

    def __init__(self, *cloth, thickness=0.02, solid=NO_SOLID, shift=(0.0, 0.0, 0.0), own=True):
        self.world = sim.Simulation(scene(list(cloth)))
        self.pairs = Pairs(self.world.mesh, self.world.model.free, solid, Feels(own, own), FIRST)
        self.x, self.thickness = self.world.positions.copy(), thickness
        self.before, self.after = solid.vertices, solid.vertices + shift
        self.corners = len(self.x) + len(solid.vertices)
        self.faces = len(self.world.triangles) + len(solid.triangles)
        self.near = self.begin()

    def begin(self):
        return self.pairs.begin(self.x, self.before, self.after, H, self.thickness)

    def kinds(self, contacts):
        return np.where(contacts.key < FIRST + self.corners * self.faces, VERTEX_TRIANGLE, EDGE_EDGE)

    def distances(self, contacts, x):
        """By ipctk, with the cloth's vertices at x."""
        oracle = {VERTEX_TRIANGLE: ipctk.point_triangle_distance, EDGE_EDGE: ipctk.edge_edge_distance}
        kinds = zip(self.kinds(contacts), contacts.node, strict=True)
        return np.sqrt([oracle[kind](*x[node]) for kind, node in kinds])


def rough(seed, *layers, resolution=(6, 6), noise=2e-3):
    """Sheets that are not quite flat, at these heights."""
    rng = np.random.default_rng(seed)
    flat = sim.Simulation(scene(grid((0.3, 0.3), resolution)))
    for k, height in enumerate(layers):
        x = (
            flat.positions
            + noise * rng.standard_normal(flat.positions.shape)
            + [0.013 * k, 0.021 * k, height]
        )
        yield {
            "vertices": x.tolist(),
            "triangles": flat.triangles.tolist(),
            "rest_vertices": flat.positions.tolist(),
        }


@pytest.fixture
def two():
    return Case(*rough(0, 0.0, 0.012))


def test_gaps_are_distances(two):
    c = two.near
    assert {VERTEX_TRIANGLE, EDGE_EDGE} <= set(two.kinds(c).tolist())
    true = two.distances(c, two.x)
    np.testing.assert_allclose(c.start, true, rtol=1e-12)  # rounding of numbers a hundred times as large
    np.testing.assert_allclose(c.gaps(two.x), true, rtol=1e-12)
    assert (true < FELT * two.thickness).all()


def test_weights_are_those_of_points_on_the_features(two):
    c = two.near
    vertex = two.kinds(c) == VERTEX_TRIANGLE
    np.testing.assert_array_equal(c.weight[vertex, 0], 1.0)
    assert (c.weight[vertex, 1:] <= 0.0).all()
    assert (c.weight[~vertex, :2] >= 0.0).all()
    assert (c.weight[~vertex, 2:] <= 0.0).all()
    np.testing.assert_allclose(c.weight.sum(axis=1), 0.0, atol=1e-15)  # two ulps, or momentum leaks
    np.testing.assert_allclose(np.linalg.norm(c.normal, axis=1), 1.0, rtol=1e-12)


def test_gradients_of_gaps_are_slopes_of_the_distance(two):
    """A distance has the slope wᵢ n while the nearest points stay where they are to first order."""
    c, step = two.near, 1e-7
    slope = np.zeros((len(c.key), 4, 3))
    for corner in range(4):
        for axis in range(3):
            for k, node in enumerate(c.node):
                ends = []
                for sign in (1.0, -1.0):
                    x = two.x[node].copy()
                    x[corner, axis] += sign * step
                    kind = judge.VERTEX_TRIANGLE if two.kinds(c)[k] == VERTEX_TRIANGLE else judge.EDGE_EDGE
                    ends.append(judge.distances(kind, x[None])[0])
                slope[k, corner, axis] = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(slope, c.weight[:, :, None] * c.normal[:, None], atol=2e-5)  # step / distance


def test_every_pair_has_a_name_of_its_own_which_lasts(two):
    names = {
        key: tuple(node) for key, node in zip(two.near.key.tolist(), two.near.node.tolist(), strict=True)
    }
    assert len(names) == len(two.near.key)
    assert min(names) >= FIRST
    two.x[:] += 1e-3 * np.random.default_rng(1).standard_normal(two.x.shape)
    later = two.begin()
    known = 0
    for key, node in zip(later.key.tolist(), later.node.tolist(), strict=True):
        assert names.get(key, tuple(node)) == tuple(node)
        known += key in names
    assert known > 30


def test_the_same_state_has_the_same_contacts_whatever_the_list_was_made_for(two):
    fresh, used = Case(*rough(0, 0.0, 0.012)), Case(*rough(0, 0.0, 0.012))
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-1, 1e-3):
        used.pairs.hits(used.x + size * rng.standard_normal(used.x.shape))
        for a, b in zip(used.begin(), fresh.near, strict=True):
            np.testing.assert_array_equal(a, b)


def test_pairs_near_at_rest_push_only_where_they_would_meet():
    """methods.md §7.1: a pair of one piece that rests nearer than the thickness is no contact by nearness."""
    (low, high), height = rough(2, 0.0, 0.004, noise=1e-4), 0.004
    flat = np.concatenate([low["vertices"], high["vertices"]])
    both = np.concatenate([low["triangles"], np.array(high["triangles"]) + 36])
    joined = {"vertices": flat.tolist(), "triangles": both.tolist(), "rest_vertices": flat.tolist()}
    as_one, as_two = Case(joined), Case(low, high)
    assert len(as_one.near.key) == 0
    assert len(as_two.near.key) > 100
    end = as_one.x.copy()
    end[36:, 2] -= 2.0 * height
    assert len(as_one.pairs.hits(end).key) > 100
    far = flat.copy()
    far[36:, 2] += 1.0
    apart = Case({**joined, "rest_vertices": far.tolist()})
    assert len(apart.near.key) == len(as_two.near.key)


@pytest.mark.parametrize("resolution", [(4, 4), (9, 5)])
def test_a_flat_sheet_does_not_touch_itself_however_thick(resolution):
    case = Case(grid((0.3, 0.3), resolution), thickness=0.1)
    assert case.pairs.thickness == pytest.approx(THICK * case.pairs.edge)
    assert len(case.near.key) == 0


def test_what_meets_keeps_a_gap(two):
    """Normals and weights are those of the time of impact, and where all would stay the pair keeps apart."""
    case = Case(*rough(3, 0.0, 0.03))
    end = case.x.copy()
    end[36:, 2] -= 0.06
    c = case.pairs.hits(end)
    assert len(c.key) > 50
    start = case.distances(c, case.x)
    np.testing.assert_allclose(c.start, start, rtol=1e-12)
    np.testing.assert_allclose(c.thickness, np.minimum(AFTER * GAP * case.thickness, start), rtol=1e-12)
    assert (c.gaps(end) < 0.0).all()  # it has gone through
    closing = np.einsum("ij,ij->i", c.normal, c.passing((end - case.x) / H))
    assert (closing < 0.0).all()
    for node, kind in zip(c.node, case.kinds(c), strict=True):
        name = "vertex-triangle" if kind == VERTEX_TRIANGLE else "edge-edge"
        way = np.concatenate([case.x[node], end[node]])[None]
        assert np.isfinite(sim.time_of_impact(name, way)).all() or (
            judge.distances(name, case.x[node][None] + 0.5 * (end - case.x)[node])[0] < 0.03
        )


def test_what_stays_within_half_of_the_nearest_distance_meets_nothing():
    case = Case(*rough(4, 0.0, 0.012))
    end = case.x + 0.05 * np.random.default_rng(0).standard_normal(case.x.shape)
    hits = case.pairs.hits(end)
    every = np.arange(len(case.x))
    short = case.pairs.shorten(end, every, case.x)
    assert set(np.unique(hits.node)) <= set(short)
    met = judge.Judge(case.world).meetings(case.x, end)
    assert not met


def test_a_second_look_shortens_no_way_again():
    case = Case(*rough(5, 0.0, 0.012))
    end = case.x + 0.05 * np.random.default_rng(1).standard_normal(case.x.shape)
    every = np.arange(len(case.x))
    case.pairs.shorten(end, every, case.x)
    once = end.copy()
    assert len(case.pairs.shorten(end, every, case.x)) == 0
    np.testing.assert_array_equal(end, once)


def test_ways_are_shortened_by_the_list_that_was_made_for_them():
    case = Case(*rough(4, 0.0, 0.012))
    end = case.x + 0.05 * np.random.default_rng(0).standard_normal(case.x.shape)
    lists, ends = [], []
    for looked_before in (False, True):
        case.pairs.forget()
        case.begin()
        ends.append(end.copy())
        if looked_before:
            case.pairs.hits(ends[-1])
        before = case.pairs.lists
        case.pairs.shorten(ends[-1], np.arange(len(case.x)), case.x)
        lists.append(case.pairs.lists - before)
    assert lists == [1, 0]
    np.testing.assert_array_equal(*ends)


def test_a_solid_is_in_offset_and_speed_alone():
    shift = np.array([0.001, -0.002, 0.003])
    case = Case(*rough(6, 0.0), solid=TETRAHEDRON, shift=shift, own=False)
    c = case.near
    assert len(c.key) > 0
    # At the start the gap is the distance; what the solid does then takes n · shift off it.
    back = c._replace(offset=c.offset - moved_by(c)[:, 0] * (c.normal @ shift))
    np.testing.assert_allclose(back.gaps(case.x), c.start, rtol=1e-9)
    np.testing.assert_allclose(c.speed, np.broadcast_to(shift / H * moved_by(c), c.speed.shape), rtol=1e-9)
    assert (c.start < FELT * case.thickness).all()


def moved_by(contacts):
    """(c, 1) how much of the cloth's side weighs, and so the solid's: one or minus one."""
    return contacts.weight.sum(axis=1)[:, None]


def test_cloth_that_does_not_feel_itself_feels_a_solid():
    cloth = list(rough(7, 0.0, 0.012))
    alone, both = Case(*cloth, solid=TETRAHEDRON, own=False), Case(*cloth, solid=TETRAHEDRON)
    assert 0 < len(alone.near.key) < len(both.near.key)
    np.testing.assert_array_equal(alone.near.key, both.near.key[np.isin(both.near.key, alone.near.key)])


@pytest.mark.parametrize("kind", [VERTEX_TRIANGLE, EDGE_EDGE])
@pytest.mark.parametrize("scale", [1.0, 1e-5])
def test_measured_distances_are_exact_where_near_and_bounds_where_not(kind, scale):
    rng, p, reach = np.random.default_rng(int(kind)), 500, 0.3 * scale
    places = scale * rng.standard_normal((4 * p, 3))
    positions = places + 0.1 * scale * rng.standard_normal(places.shape)
    node, kinds = np.arange(4 * p, dtype=np.int32).reshape(p, 4), np.full(p, kind, dtype=np.int8)
    oracle = ipctk.point_triangle_distance if kind == VERTEX_TRIANGLE else ipctk.edge_edge_distance
    listed, true = (np.sqrt([oracle(*x[i]) for i in node]) for x in (places, positions))
    distance, weight = np.empty(p), np.empty((p, 4))
    measure(kinds, node, listed, places, positions, reach, distance, weight)
    assert (distance <= true * (1.0 + 1e-9) + 1e-15 * scale).all()
    near = true < reach
    assert 20 < near.sum() < p - 20
    np.testing.assert_allclose(distance[near], true[near], rtol=1e-9)
    between = np.einsum("ij,ijk->ik", weight[near], positions[node[near]])
    np.testing.assert_allclose(np.linalg.norm(between, axis=1), true[near], rtol=1e-9)
