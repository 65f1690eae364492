"""The broad phase against a twin that looks at every pair there is."""

import tracemalloc

import numpy as np
import pytest

import sim
from sim.compiled import CHUNKS
from sim.contact import broad
from sim.contact.broad import BroadPhase, CandidateError
from sim.contact.impact import EDGE_EDGE, VERTEX_TRIANGLE
from sim.contact.surface import HUB, build_surface
from sim.mesh import distinct_edges
from sim.threads import LAUNCHED, processor_threads
from tests.contact import judge

NONE = np.zeros((0, 3), dtype=np.int64)
TIMES = np.linspace(0.0, 1.0, 41)
"""When the twin looks. It may miss a pair that is near in between, and never sees one that is not."""

ROUNDING = 1e-9
"""Part of the reach, and of the size of the scene, that neither side need tell apart."""


def soup(rng, count=40):
    x = rng.uniform(-1, 1, (count, 1, 3)) + 0.3 * rng.standard_normal((count, 3, 3))
    return x.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), NONE[:, :2]


def sheet(n=7, size=1.0):
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return points, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]), NONE[:, :2]


def flat(rng):
    return sheet(7, size=0.3)


def crumpled(rng):
    x, triangles, edges = sheet(9)
    return x * [0.2, 0.2, 0.0] + 0.05 * rng.standard_normal(x.shape), triangles, edges


def pieces(rng):
    x, triangles, edges = sheet(5)
    layers = [x + k * np.array([0.02, 0.01, 0.03]) for k in range(3)]
    return np.concatenate(layers), np.concatenate([triangles + 25 * k for k in range(3)]), edges


def chains(rng):
    x = rng.uniform(-0.3, 0.3, (50, 3))
    edges = np.array([[i, i + 1] for i in range(49) if i % 10 != 9])
    return x, NONE, edges


def chain_and_sheet(rng):
    x, triangles, _ = sheet(5)
    links = np.array([[0, 25], *([25 + i, 26 + i] for i in range(9))])  # tied to the sheet's corner
    return np.concatenate([x, rng.uniform(0, 1, (10, 3)) * [1, 1, 0.1]]), triangles, links


def fan(rng, count=100):
    assert count > HUB
    turn = np.linspace(0, 5.0, count + 1)
    rim = np.stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(7 * turn)], axis=1)
    spokes = np.stack([np.zeros(count, int), np.arange(1, count + 1), np.arange(2, count + 2)], axis=1)
    return np.concatenate([np.zeros((1, 3)), rim]), spokes, NONE[:, :2]


def slivers(rng):
    x, triangles, edges = soup(rng, 30)
    return x * [1.0, 1.0, 1e-7], triangles, edges


def no_area(rng):
    x, triangles, edges = soup(rng, 30)
    x = x.reshape(-1, 3, 3)
    x[:10, 2] = 0.5 * (x[:10, 0] + x[:10, 1])  # in a line
    x[10:15, 1] = x[10:15, 0]  # two corners alike
    x[15:20] = x[15:20, :1]  # all three
    return x.reshape(-1, 3), triangles, edges


def twins(rng):
    x, triangles, edges = sheet(4)
    return np.concatenate([x, x]), np.concatenate([triangles, triangles + 16]), edges


def book(rng):
    """Five triangles on each edge."""
    x = np.concatenate([[[0, 0, 0], [1, 0, 0]], rng.standard_normal((5, 3))])
    return x, np.array([[0, 1, k] for k in range(2, 7)]), NONE[:, :2]


def one(rng):
    return rng.standard_normal((3, 3)), np.array([[0, 1, 2]]), NONE[:, :2]


MAKERS = [soup, flat, crumpled, pieces, chains, chain_and_sheet, fan, slivers, no_area, twins, book, one]
SURFACES = pytest.mark.parametrize("make", MAKERS)


class Case:
    """A surface on a random way, which one or the other of its vertices can go."""

    def __init__(self, make, seed, motion, fixed=0.0, strangers=False):
        rng = np.random.default_rng(seed)
        self.start, self.triangles, extra = make(rng)
        n = len(self.start)
        self.edges = distinct_edges(self.triangles, extra, n).astype(np.int64)
        own = rng.standard_normal(self.start.shape) * motion
        self.end = self.start + own + rng.standard_normal(3) * 10.0 * motion  # and all together
        self.movable = rng.random(n) >= fixed
        self.partner = ~self.movable if strangers else np.ones(n, dtype=bool)
        self.surface, tree = build_surface(self.start, self.triangles, self.edges)
        self.phase = BroadPhase(self.surface, tree, self.movable, self.partner, np.zeros(n, np.int64))

    def all_pairs(self):
        """(kind, (p, 4) vertices) of every pair without a common vertex that can move and touch."""
        used = np.unique(np.concatenate([self.triangles.ravel(), self.edges.ravel()]))
        v, f = np.meshgrid(used, np.arange(len(self.triangles)), indexing="ij")
        first = np.column_stack([v.ravel(), self.triangles[f.ravel()]]).reshape(-1, 4)
        a, b = np.triu_indices(len(self.edges), 1)
        second = np.column_stack([self.edges[a], self.edges[b]])
        for kind, nodes in ((VERTEX_TRIANGLE, first), (EDGE_EDGE, second)):
            ordered = np.sort(nodes, axis=1)
            apart = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
            able = self.movable[nodes].any(axis=1) & self.partner[nodes].any(axis=1)
            yield kind, nodes[apart & able]

    def nearest(self, kind, nodes):
        """(p,) the least distance at any of TIMES."""
        name = judge.VERTEX_TRIANGLE if kind == VERTEX_TRIANGLE else judge.EDGE_EDGE
        way = self.end - self.start
        return np.min([judge.distances(name, (self.start + t * way)[nodes]) for t in TIMES], axis=0)


def named(kind, nodes):
    """Pairs as a set, each under one name."""
    if kind == VERTEX_TRIANGLE:
        return [(i, *sorted(rest)) for i, *rest in nodes.tolist()]
    return [tuple(sorted((tuple(sorted(p[:2])), tuple(sorted(p[2:]))))) for p in nodes.tolist()]


def check(case, skin, reach, tight=False):
    found = case.phase.candidates(case.start, case.end, skin, reach)
    assert set(found.kind.tolist()) <= {VERTEX_TRIANGLE, EDGE_EDGE}
    near = 0
    for kind, nodes in case.all_pairs():
        listed = named(kind, found.node[found.kind == kind])
        assert len(set(listed)) == len(listed), "a pair is listed twice"
        everything = named(kind, nodes)
        assert set(listed) <= set(everything), "a pair is listed that is none"
        # Both features may go the whole skin towards each other, and no farther.
        away = case.nearest(kind, nodes) - reach - 2.0 * skin
        slack = ROUNDING * (reach + np.ptp(case.start))
        must = {name for name, d in zip(everything, away, strict=True) if d < -slack}
        near += len(must)
        assert must <= set(listed), f"{len(must - set(listed))} pairs are missed"
        if tight:
            assert set(listed) == {name for name, d in zip(everything, away, strict=True) if d < slack}
    return near, found


@SURFACES
@pytest.mark.parametrize("fixed", [0.0, 0.5])
@pytest.mark.parametrize(
    ("motion", "skin", "reach"), [(0.05, 0.02, 0.01), (0.5, 0.0, 1e-3), (1e-3, 0.1, 0.1)]
)
def test_every_pair_that_can_come_within_reach_is_listed_once(make, fixed, motion, skin, reach):
    for seed in range(3):
        check(Case(make, seed, motion, fixed), skin, reach)


@SURFACES
def test_where_nothing_moves_the_list_holds_what_is_near_and_nothing_else(make):
    """Otherwise the plane between two nearest points could not tell them apart, and it can."""
    total = 0
    for seed in range(3):
        total += check(Case(make, seed, 0.0), 0.02, 0.05, tight=True)[0]
    assert total > 0 or make is one


@SURFACES
def test_pairs_of_what_can_move_and_what_may_be_touched_alone(make):
    """As cloth is paired with a mesh obstacle, and with itself not."""
    check(Case(make, 4, 0.05, fixed=0.5, strangers=True), 0.02, 0.05)


def test_what_cannot_move_is_in_no_list():
    case = Case(crumpled, 0, 0.0, fixed=1.0)
    assert len(case.phase.candidates(case.start, case.end, 1.0, 1.0).kind) == 0


def test_what_moves_together_is_listed_as_if_it_stood_still():
    case = Case(crumpled, 0, 0.0)
    still = case.phase.candidates(case.start, case.start, 0.01, 0.01)
    flying = case.phase.candidates(case.start, case.start + np.array([64.0, 0.0, -32.0]), 0.01, 0.01)
    np.testing.assert_array_equal(flying.pair, still.pair)


@SURFACES
def test_distances_are_those_at_the_start(make):
    case = Case(make, 5, 0.05)
    found = case.phase.candidates(case.start, case.end, 0.02, 0.05)
    for kind, name in ((VERTEX_TRIANGLE, judge.VERTEX_TRIANGLE), (EDGE_EDGE, judge.EDGE_EDGE)):
        of = found.kind == kind
        true = judge.distances(name, case.start[found.node[of]])
        np.testing.assert_allclose(found.distance[of], true, rtol=1e-9, atol=1e-12)


@SURFACES
def test_numbers_of_pairs_name_their_features(make):
    case = Case(make, 6, 0.05)
    found = case.phase.candidates(case.start, case.end, 0.05, 0.05)
    faces, edges = case.surface.faces, case.surface.edges
    for kind, (a, b), node in zip(found.kind, found.pair, found.node, strict=True):
        if kind == VERTEX_TRIANGLE:
            assert node.tolist() == [a, *faces[b]]
        else:
            assert node.tolist() == [*edges[a], *edges[b]]


@pytest.mark.skipif(LAUNCHED < 2, reason="there is one thread only")
@SURFACES
def test_the_order_is_the_same_on_any_number_of_threads(make):
    case, lists = Case(make, 7, 0.1), []
    for count in (1, LAUNCHED, 1):
        with processor_threads(count):
            lists.append(case.phase.candidates(case.start, case.end, 0.05, 0.05))
    for other in lists[1:]:
        np.testing.assert_array_equal(other.node, lists[0].node)
        np.testing.assert_array_equal(other.distance, lists[0].distance)


def test_a_shorter_list_keeps_the_order():
    """Contacts are solved one after the other in this order, so that it decides about bits."""
    case = Case(crumpled, 8, 0.1)
    far, near = (case.phase.candidates(case.start, case.end, skin, 0.02) for skin in (0.05, 0.01))
    places = {tuple(row): k for k, row in enumerate(np.column_stack([far.kind, far.pair]).tolist())}
    order = [places[tuple(row)] for row in np.column_stack([near.kind, near.pair]).tolist()]
    assert len(order) > 50
    assert order == sorted(order)


def test_a_list_holds_within_its_skin_and_not_beyond():
    case, skin = Case(crumpled, 9, 0.05), 0.02
    found = case.phase.candidates(case.start, case.end, skin, 0.05)
    assert found.hold_on(case.start, case.end)
    assert found.hold_at(case.start)
    assert found.hold_at(case.end)
    n = len(case.start)
    for factor, holds in ((0.999, True), (1.001 * n / (n - 1), False)):  # also past the mean of all vertices
        for vertex in (0, 17, len(case.start) - 1):
            off = np.zeros_like(case.start)
            off[vertex] = factor * skin * np.array([0.6, 0.0, -0.8])
            assert found.hold_on(case.start + off, case.end) is holds
            assert found.hold_on(case.start, case.end - off) is holds
            assert found.hold_at(case.start + off) is holds
            assert found.hold_at(case.end - off) is holds
    assert found.hold_at(case.end + 3.0)  # all together may go anywhere
    assert found.hold_on(case.start + 5.0, case.end - np.array([1.0, 2.0, 3.0]))
    lost = case.end.copy()
    lost[3, 1] = np.nan
    assert not found.hold_on(case.start, lost)
    assert not found.hold_at(lost)


@SURFACES
def test_a_list_that_holds_misses_nothing_on_the_new_way(make):
    """The whole point of a skin: the list of one way serves for another."""
    case, skin, reach = Case(make, 10, 0.05), 0.03, 0.02
    found, rng = case.phase.candidates(case.start, case.end, skin, reach), np.random.default_rng(0)
    for part in (case.start, case.end):
        way = rng.standard_normal(part.shape)
        part += 0.999 * skin * way / np.linalg.norm(way, axis=1)[:, None]
    assert found.hold_on(case.start, case.end)
    for kind, nodes in case.all_pairs():
        must = nodes[case.nearest(kind, nodes) < reach * (1.0 - ROUNDING)]
        assert set(named(kind, must)) <= set(named(kind, found.node[found.kind == kind]))


def test_more_pairs_than_a_list_may_hold_are_refused(monkeypatch):
    case = Case(soup, 11, 0.0)
    monkeypatch.setattr(broad, "MOST_CANDIDATES", 1000)
    with pytest.raises(CandidateError, match="at most 1,000"):
        case.phase.candidates(case.start, case.end, 10.0, 1.0)


def test_a_refusal_tells_the_memory_that_the_list_would_take_at_least(monkeypatch):
    about = (case := Case(soup, 11, 0.0)).start, case.end, 10.0, 1.0
    found = case.phase.candidates(*about)
    tracemalloc.start()
    case.phase.candidates(*about)
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    monkeypatch.setattr(broad, "MOST_CANDIDATES", len(found.kind) - 1)
    monkeypatch.setattr(broad, "LOPSIDED", 1)  # so that all are counted
    with pytest.raises(CandidateError) as refused:
        Case(soup, 11, 0.0).phase.candidates(*about)
    assert refused.value.taken == pytest.approx(taken, rel=0.1)
    assert f"at least {len(found.kind):,} pairs, {1e-6 * refused.value.taken:,.0f} MB" in str(refused.value)


def test_a_step_with_too_many_pairs_is_refused_in_words_that_say_what_helps(monkeypatch):
    monkeypatch.setattr(broad, "MOST_CANDIDATES", 1000)
    cloth = {"kind": "grid", "size": [0.1, 0.1], "resolution": [20, 20]}
    ball = {"kind": "sphere", "center": [0, 0, -0.2], "radius": 0.1}
    scene = {"cloth": cloth, "obstacle": [ball], "settings": {"dt": 0.1, "self_collision": "on"}}
    world = sim.Simulation(scene)
    world.place(world.positions, np.random.default_rng(0).standard_normal(world.positions.shape))
    with pytest.raises(sim.StepError, match=r"at most 1,000 .*time step, less thickness or a coarser mesh"):
        world.step()


def test_room_grows_where_it_is_too_small():
    """Of the first list, of which each part is longer than the room at first."""
    case = Case(soup, 12, 0.0)
    found = case.phase.candidates(case.start, case.end, 10.0, 1.0)
    assert len(found.kind) > 64 * CHUNKS
    assert len(found.kind) == sum(len(nodes) for _, nodes in case.all_pairs())
