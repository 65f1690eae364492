"""Cloth that is spread out does not meet itself: the proof against all pairs, and what it must not prove."""

import itertools
import math

import ipctk
import numpy as np
import pytest

import sim
import sim.contact.pairs
from sim.contact.outspread import border_of, clearance
from sim.effects import SPREAD_OUT
from tests.test_effects import Pair
from tests.worlds import ball, chain, grid, scene

SIDE = 6
TIMES = np.linspace(0.0, 1.0, 9)


def sheet(resolution=(SIDE, SIDE)):
    return sim.Simulation(scene(grid((1.0, 1.0), resolution)))


SHEET = sheet()
TRIANGLES, BORDER, FLAT = SHEET.mesh.triangles, border_of(SHEET.mesh), SHEET.positions
FACES = [(i, *t) for i, t in itertools.product(range(len(FLAT)), TRIANGLES.tolist()) if i not in t]
EDGES = [(*a, *b) for a, b in itertools.combinations(SHEET.edges.tolist(), 2) if not set(a) & set(b)]


def least_distance(x):
    """Of all features without a common vertex, one by one."""
    nearest = min(ipctk.point_triangle_distance(*x[list(p)]) for p in FACES)
    return math.sqrt(min(nearest, *(ipctk.edge_edge_distance(*x[list(p)]) for p in EDGES)))


def wavy(random):
    """The sheet with some long waves, and all of it turned."""
    x = FLAT.copy()
    for _ in range(3):
        wave, phase = random.normal(0.0, 4.0, 2), random.uniform(0.0, 6.0)
        x = x + random.normal(0.0, 0.06, 3) * np.sin(x[:, :2] @ wave + phase)[:, None]
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return x @ turn.T, turn


def ways(count=60):
    """Ways from one wavy sheet to another, some of them short, most of them turned a little on the way."""
    for seed in range(count):
        random = np.random.default_rng(seed)
        start, turn = wavy(random)
        bent, other = wavy(random)
        yield (
            start,
            start
            + 10.0 ** random.uniform(-2.0, 0.3) * (bent @ other @ turn.T - start)
            + random.normal(size=3),
        )


def test_no_two_features_come_nearer_than_is_proven():
    proven = 0
    for start, end in ways():
        bound = clearance(TRIANGLES, BORDER, start, end, 0.0)
        if bound == 0.0:
            continue
        proven += 1
        assert min(least_distance((1.0 - t) * start + t * end) for t in TIMES) >= bound
    assert 20 < proven < 60  # else nothing were tried, or nothing hard


def test_of_a_flat_sheet_at_rest_the_least_altitude_is_proven_and_nothing_below_what_is_of_use():
    least = 0.2 / math.sqrt(2.0)  # of right triangles with legs of 0.2 m
    assert clearance(TRIANGLES, BORDER, FLAT, FLAT, 0.0) == pytest.approx(least, rel=1e-6)
    assert clearance(TRIANGLES, BORDER, FLAT, FLAT, 0.15) == 0.0


def rolled(turns):
    x = FLAT.copy()
    angle = 2.0 * math.pi * turns * x[:, 0]
    return np.stack([np.sin(angle), x[:, 1], np.cos(angle)], axis=1) / (2.0 * math.pi * turns)


def test_of_a_rolled_sheet_nothing_is_proven_until_it_shows_one_face_alone():
    about = [clearance(TRIANGLES, BORDER, x, x, 0.0) for x in (rolled(0.3), rolled(0.8))]
    assert about[0] > 0.0
    assert about[1] == 0.0


def test_a_ramp_that_winds_over_itself_shows_one_face_and_is_told_by_its_border():
    """One and a half turns, seen from above: each triangle is the right way up, half of them cover others."""
    found = {}
    for turns in 0.7, 1.5:
        world = sheet((24, 3))
        x = world.positions - world.positions.min(axis=0)
        angle, radius = -2.0 * math.pi * turns * x[:, 0], 1.0 + x[:, 1]
        ramp = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 * x[:, 0]], axis=1)
        about = world.mesh.triangles, border_of(world.mesh), ramp, ramp, 0.0
        found[turns] = clearance(*about)
    assert found[0.7] > 0.0
    assert found[1.5] == 0.0


def test_what_is_spread_out_at_both_ends_but_not_between_is_not_proven():
    """Half a turn in its own plane on straight ways goes through one point."""
    turned = FLAT * [-1.0, -1.0, 1.0]
    assert clearance(TRIANGLES, BORDER, FLAT, turned, 0.0) == 0.0
    start = [[-1.7, -2.0, 0.0], [-0.3, 0.0, 0.0], [-0.2, 0.2, 0.0], [-0.5, 1.3, 0.0]]
    end = [[-0.7, 0.0, 0.0], [0.3, -0.3, 0.0], [2.9, -0.3, 0.0], [0.8, 1.9, 0.0]]
    both, loop = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.arange(4, dtype=np.int32)
    for x in start, end:  # and of this way the border tells nothing
        assert clearance(both, loop, np.array(x), np.array(x), 0.0) > 0.0
    assert clearance(both, loop, np.array(start), np.array(end), 0.0) == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("vertex", [0, 14, SIDE * SIDE - 1])
def test_of_numbers_that_are_none_nothing_is_proven(value, vertex):
    wild = FLAT.copy()
    wild[vertex, 2] = value
    assert clearance(TRIANGLES, BORDER, FLAT, wild, 0.0) == 0.0
    assert clearance(TRIANGLES, BORDER, wild, FLAT, 0.0) == 0.0


HOLED = [[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0], [1, 2, 0]]
AROUND = [[a, (a + 1) % 4, 4 + a] for a in range(4)] + [
    [(a + 1) % 4, 4 + (a + 1) % 4, 4 + a] for a in range(4)
]
NO_SHEET = {
    "two pieces": [grid(), grid(position=[0, 0, 1])],
    "bare edges": [chain([[0, 0, 0], [0, 0, 1]], [1, 1])],
    "a hole": [{"vertices": HOLED, "triangles": AROUND}],
    "two parts": [{"vertices": [*HOLED[:3], *HOLED[4:7]], "triangles": [[0, 1, 2], [3, 4, 5]]}],
    "an edge that sticks out": [
        {"vertices": HOLED[:5], "triangles": [[0, 1, 2], [0, 2, 3]], "edges": [[3, 4]]}
    ],
    "a single triangle": [{"vertices": HOLED[:3], "triangles": [[0, 1, 2]]}],
}


@pytest.mark.parametrize("name", NO_SHEET)
def test_only_one_sheet_with_one_border_has_a_border(name):
    assert border_of(sim.Simulation(scene(NO_SHEET[name])).mesh) is None


def test_the_border_of_a_sheet_goes_once_around_it():
    assert len(BORDER) == len(set(BORDER.tolist())) == 4 * (SIDE - 1)
    steps = np.linalg.norm(FLAT[np.roll(BORDER, -1)] - FLAT[BORDER], axis=1)
    np.testing.assert_allclose(steps, 0.2)


def test_a_flag_that_flutters_makes_no_list_and_says_why():
    world = sim.Simulation("flag")
    reports = [world.step() for _ in range(60)]
    assert sum(report.lists for report in reports) == 0
    assert all(report.outspread for report in reports)
    words = reports[-1].effects
    for name in "self_collision", "edge_edge":
        assert words[name].startswith(f"{SPREAD_OUT} for 60 steps")
    assert sim.Simulation("flag", self_collision="on").step().lists > 0


def test_what_is_proven_serves_until_vertices_have_gone_past_each_other(monkeypatch):
    asked = []
    proof = sim.contact.pairs.clearance
    monkeypatch.setattr(sim.contact.pairs, "clearance", lambda *about: asked.append(1) or proof(*about))
    world = sim.Simulation(scene(grid(), self_collision="auto", dt=0.01))
    for _ in range(10):
        world.step()
    assert len(asked) == 1  # nothing moves
    world.place(world.positions, np.outer(world.positions[:, 0], [0.0, 0.0, 4.0]))
    for _ in range(10):
        assert world.step().outspread
    assert 2 < len(asked) < 20  # of two bounds a step


def thrown(seed):
    """A lone sheet, wavy or folded, that is thrown about at random, beside one that looks at everything."""
    random = np.random.default_rng(seed)
    settings = {
        "contact": random.choice(["penalty", "impulse", "postprocess"]),
        "detection": random.choice(["static", "continuous"]),
        "thickness": float(10 ** random.uniform(-4, -1.5)),
        "dt": float(10 ** random.uniform(-3, -1.3)),
        "stretch": float(10 ** random.uniform(0, 2)),
        "self_collision": "auto",
        "tangled": "keep",
    }
    pair = Pair(scene(grid((1.0, 1.0), (SIDE, SIDE)), *[ball((0, 0, -3))] * (seed % 2), **settings))
    spread = felt = 0
    for k in range(12):
        if k % 4 == 0:
            start, _ = wavy(random)
            start[:, 0] += random.uniform(0.0, 0.5) * np.sin(6.0 * FLAT[:, 1])
            smooth = random.normal(size=3) * np.sin(FLAT @ random.normal(0.0, 3.0, 3))[:, None]
            speed = 10 ** random.uniform(-2, 0.5) / pair.auto.settings.dt
            pair.auto.place(start, speed * (smooth + random.normal(0.0, 0.1, start.shape)))
        try:
            report = pair.step()
        except sim.StepError:
            break
        spread, felt = spread + report.outspread, felt + bool(report.felt)
    return spread, felt


def thrown_all():
    return [thrown(seed) for seed in range(40)]


def test_a_lone_sheet_that_is_thrown_about_is_never_taken_to_be_spread_out_where_it_meets_itself():
    found = np.array(thrown_all())
    assert found[:, 0].sum() > 50
    assert found[:, 1].sum() > 50


LIES = {
    "of orientation": lambda proof, about: proof(*about) or 0.01,
    "of distance": lambda proof, about: 100.0 * proof(*about),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_proof_that_is_too_bold_would_be_noticed(lie, monkeypatch):
    proof = sim.contact.pairs.clearance
    monkeypatch.setattr(sim.contact.pairs, "clearance", lambda *about: LIES[lie](proof, about))
    with pytest.raises(AssertionError):
        thrown_all()
