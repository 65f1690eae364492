"""Continuous detection against exact truth: none missed, none late, none but touching pairs reported."""

from pathlib import Path

import ipctk
import numba
import numpy as np
import pytest

import sim
from sim.compiled import Vec3
from sim.contact.impact import EDGE_EDGE, NEAR, ROUNDING, VERTEX_TRIANGLE, impact
from tests.exact import distance_at, surely_apart
from tests.jit import compiled

SAMPLE = Path(__file__).resolve().parents[2] / "shared" / "ccd" / "sample.npz"
IMPACT = compiled(impact)
KINDS = {"vertex-triangle": VERTEX_TRIANGLE, "edge-edge": EDGE_EDGE}
TOUCHING = (
    1.5 * NEAR * ROUNDING
)  # of the size: what is promised, and half as much for the rounding of the time
EARLIEST = 3e-3  # how long before the reported time a pair is proved apart; nearer, the proof takes too long
ORDERS = {
    "vertex-triangle": [(0, 2, 3, 1), (0, 3, 1, 2), (0, 1, 3, 2), (0, 2, 1, 3), (0, 3, 2, 1)],
    "edge-edge": [(1, 0, 2, 3), (0, 1, 3, 2), (1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 0, 1), (3, 2, 1, 0)],
}


def size_of(x):
    return max(np.abs(x[:4] - x[0]).max(), np.abs(x[4:] - x[4]).max())


def lattice(rng, kind):
    """Small whole numbers: half of them degenerate, many touching exactly, at rational times."""
    return rng.integers(-2, 3, (8, 3)).astype(float)


def perturbed(rng, kind):
    """As before, but for rounding, which decides whether they touch."""
    return lattice(rng, kind) + rng.integers(-1, 2, (8, 3)) * 2.0 ** -int(rng.integers(30, 53))


def coplanar(rng, kind):
    """In one plane all the time: the usual cubic vanishes."""
    x = rng.integers(-4, 5, (8, 3)) / 2.0
    x[:, 2] = x[0, 2]
    return x[:, rng.permutation(3)]


def collinear(rng, kind):
    x = rng.integers(-8, 9, (8, 1)) * np.array([1.0, 2.0, -1.0])
    return x + rng.integers(-1, 2, 3)


def parallel(rng, kind):
    """Two edges, or an edge and the way to the vertex, that stay parallel."""
    x = rng.integers(-4, 5, (8, 3)) / 2.0
    x[3], x[7] = x[2] + (x[1] - x[0]) * rng.integers(-2, 3), x[6] + (x[5] - x[4]) * rng.integers(-2, 3)
    return x


def still(rng, kind):
    """No motion at all, or one that all share."""
    x = lattice(rng, kind)
    x[4:] = x[:4] + rng.integers(0, 2) * rng.integers(-3, 4, 3)
    return x


def collapsed(rng, kind):
    """A triangle without area, an edge without length, or four points that are one."""
    x = lattice(rng, kind)
    x[3::4] = x[2::4] if rng.integers(2) else 2 * x[2::4] - x[1::4]
    if rng.integers(4) == 0:
        x[1::4] = x[0::4]
    return x


def corner(rng, kind):
    """A vertex that passes exactly through another, or through a side."""
    x = rng.integers(-4, 5, (8, 3)).astype(float)
    t = 1.0 / rng.integers(1, 3)
    target = (1 - t) * x[3] + t * x[7]
    if rng.integers(2):
        target = (target + (1 - t) * x[2] + t * x[6]) / 2
    x[4] = (target - (1 - t) * x[0]) / t
    return x


def graze(rng, kind):
    """Comes to within a power of two, or to nothing, at an instant, and goes again: a double root."""
    d = float(rng.choice([0.0, 0.0, 2.0**-20, 2.0**-40]))
    if kind == "vertex-triangle":  # a vertex slides past one side that turns about its middle
        x = [[0, 1, 0], [-2, 0, 0], [2, 0, 0], [0, -2, 1], [0, -1, 0], [-2, -2, 0], [2, 2, 0], [0, -2, -1]]
    else:
        x = [[-2, 0, 1], [2, 0, -1], [0, -2, -d], [0, 2, -d], [-2, 0, -1], [2, 0, 1], [0, -2, -d], [0, 2, -d]]
    return np.array(x, dtype=float) + rng.integers(-2, 3, 3)


def tunnel(rng, kind):
    """Past in an instant: the motion is ten to a million times as long as the primitives."""
    x = np.tile(rng.integers(-4, 5, (4, 3)).astype(float), (2, 1))
    way = 10.0 ** rng.integers(1, 7) * rng.integers(-4, 5, 3)
    moved = [0] if kind == "vertex-triangle" else [0, 1]
    x[moved] -= way
    x[[4 + k for k in moved]] += way
    return x


def far(rng, kind):
    """Fifty metres from the origin, moving by less than a nanometre."""
    x = lattice(rng, kind) * 0.01
    x[4:] = x[:4] + 1e-10 * rng.integers(-9, 10, (4, 3))
    return x + 50.0


def general(rng, kind):
    return rng.normal(size=(8, 3))


def needle(rng, kind):
    return rng.normal(size=(8, 3)) * np.array([1.0, 1e-6, 1e-6])


def turning(rng, kind):
    """Turns by up to half a turn while a millionth to a tenth of its size away: no contact."""
    x = rng.normal(size=(4, 3))
    distance = 10.0 ** -rng.uniform(1, 6)
    if kind == "vertex-triangle":
        n = np.cross(x[2] - x[1], x[3] - x[1])
        x[0] = rng.dirichlet([1, 1, 1]) @ x[1:] + distance * n / np.linalg.norm(n)
    else:
        n, (s, t) = np.cross(x[1] - x[0], x[3] - x[2]), rng.uniform(size=2)
        x[:2] += (1 - t) * x[2] + t * x[3] - (1 - s) * x[0] - s * x[1] + distance * n / np.linalg.norm(n)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.concatenate([x, x @ (q * np.sign(np.linalg.det(q))).T + rng.normal(size=3)])


FAMILIES = (
    lattice,
    perturbed,
    coplanar,
    collinear,
    parallel,
    still,
    collapsed,
    corner,
    graze,
    tunnel,
    far,
    general,
    needle,
    turning,
)


def queries(family, kind, count, seed=0):
    rng = np.random.default_rng([seed, FAMILIES.index(family), KINDS[kind]])
    return np.array([family(rng, kind) for _ in range(count)])


def many(kind, count=500):
    return np.concatenate([queries(family, kind, count, seed=1) for family in FAMILIES])


families = pytest.mark.parametrize("family", FAMILIES, ids=lambda f: f.__name__)
kinds = pytest.mark.parametrize("kind", KINDS)


@kinds
@families
def test_misses_are_proved_and_hits_touch(kind, family):
    """Whatever it answers is true, in rational numbers: apart all the time, or touching, and apart before."""
    x = queries(family, kind, 60)
    hits = 0
    for pair, t in zip(x, sim.time_of_impact(kind, x), strict=True):
        if np.isinf(t):
            assert surely_apart(kind, pair)
        else:
            hits += 1
            assert distance_at(kind, pair, t) <= TOUCHING * size_of(pair)
            if t > EARLIEST and hits <= 5:
                assert surely_apart(kind, pair, 0.0, t - EARLIEST)
    if family is turning:
        assert hits == 0


def at_rational_times(rng, kind, count):
    """Pairs that surely touch at a time of a few binary digits, every vertex and motion being exact."""
    x, times = np.empty((count, 8, 3)), np.empty(count)
    for k in range(count):
        times[k] = t = rng.integers(1, 17) / 16.0
        now, motion = rng.integers(-64, 65, (4, 3)) / 16.0, rng.integers(-64, 65, (4, 3)) / 4.0
        weights = rng.multinomial(8, rng.dirichlet([0.5, 0.5, 0.5])) / 8.0  # often on a side or a corner
        if kind == "vertex-triangle":
            now[0] = weights @ now[1:]
        else:
            s, u = weights[:2]
            now[:2] += (1 - u) * now[2] + u * now[3] - (1 - s) * now[0] - s * now[1]
        x[k, :4], x[k, 4:] = now - t * motion, now + (1 - t) * motion
    return x, times


@kinds
def test_no_contact_is_missed_or_late(kind):
    x, times = at_rational_times(np.random.default_rng(3), kind, 20_000)
    assert (sim.time_of_impact(kind, x) <= times).all()


@kinds
def test_a_hit_is_at_its_time(kind):
    """One side passes through the other at constant speed: the time is known, and is not needlessly early."""
    rng = np.random.default_rng(4)
    for speed in (1e-3, 1.0, 1e3):
        t = rng.uniform(0.1, 0.9, 500)
        now = rng.normal(size=(500, 4, 3))
        other = slice(0, 1) if kind == "vertex-triangle" else slice(0, 2)
        if kind == "vertex-triangle":
            now[:, 0] = now[:, 1:].mean(axis=1)
            n = np.cross(now[:, 2] - now[:, 1], now[:, 3] - now[:, 1])
        else:
            now[:, :2] += (now[:, 2:].mean(axis=1) - now[:, :2].mean(axis=1))[:, None]
            n = np.cross(now[:, 1] - now[:, 0], now[:, 3] - now[:, 2])
        way = (speed * n / np.linalg.norm(n, axis=1)[:, None])[:, None]
        x = np.concatenate([now, now], axis=1)
        x[:, other] -= t[:, None, None] * way
        x[:, 4:][:, other] += (1 - t)[:, None, None] * way
        # the gap, of the size, by the speed; twice, for what rounding adds
        early = 2 * NEAR * ROUNDING * np.array([size_of(pair) for pair in x]) / speed
        assert (np.abs(sim.time_of_impact(kind, x) - t) <= early).all()


@kinds
def test_order_and_powers_of_two_change_no_bit(kind):
    x = many(kind)
    times = sim.time_of_impact(kind, x)
    assert 0.1 < np.isfinite(times).mean() < 0.9
    for order in ORDERS[kind]:
        np.testing.assert_array_equal(
            sim.time_of_impact(kind, x[:, [*order, *(4 + k for k in order)]]), times
        )
    for power in (-900, -300, -60, -1, 60, 300, 900):
        np.testing.assert_array_equal(sim.time_of_impact(kind, np.ldexp(x, power)), times)


@kinds
def test_reversing_time_changes_no_answer(kind):
    x = many(kind)
    hit = np.isfinite(sim.time_of_impact(kind, x))
    np.testing.assert_array_equal(np.isfinite(sim.time_of_impact(kind, x[:, [4, 5, 6, 7, 0, 1, 2, 3]])), hit)


@kinds
def test_any_number_of_threads_gives_the_same_bits(kind):
    x, launched = many(kind, 100), numba.get_num_threads()
    times = sim.time_of_impact(kind, x)
    try:
        for count in range(1, launched + 1):
            numba.set_num_threads(count)
            np.testing.assert_array_equal(sim.time_of_impact(kind, x), times)
    finally:
        numba.set_num_threads(launched)


@kinds
def test_tight_inclusion_agrees(kind):
    """An interval method, which bounds the time from below: what it clears is clear."""
    ccd = ipctk.tight_inclusion
    oracle = ccd.point_triangle_ccd if kind == "vertex-triangle" else ccd.edge_edge_ccd
    x = np.concatenate([queries(family, kind, 150, seed=2) for family in (general, lattice, corner)])
    times = sim.time_of_impact(kind, x)
    for pair, t in zip(x, times, strict=True):
        hit, bound, _ = oracle(*pair, min_distance=0.0, tolerance=1e-6, max_iterations=100_000)
        if not hit:
            assert np.isinf(t)
        elif np.isfinite(t):
            assert t >= bound - TOUCHING  # times the size over the speed, which are both about one
        else:
            assert surely_apart(kind, pair)


@pytest.mark.skipif(not SAMPLE.exists(), reason="the published queries are not beside this checkout")
@pytest.mark.parametrize("name", ["vf_published", "ee_published", "vf_degenerate", "ee_degenerate"])
def test_published_and_degenerate_queries_with_exact_truth(name):
    data = np.load(SAMPLE)
    kind = "vertex-triangle" if name.startswith("vf") else "edge-edge"
    x, hit, truth = data[f"{name}_x"], data[f"{name}_hit"], data[f"{name}_toi"]
    times = sim.time_of_impact(kind, x)
    assert np.isfinite(times[hit]).all()
    known = hit & np.isfinite(truth)
    assert (times[known] <= truth[known] + 1e-15).all()  # an ulp: the truth is rounded
    # not needlessly early, unless it touches already (within the tolerance) at the time given
    for k in np.flatnonzero(np.isfinite(times) & ~(known & (times >= truth - 1e-6))):
        assert distance_at(kind, x[k], times[k]) <= TOUCHING * size_of(x[k])


@kinds
def test_normal_and_weights_are_those_of_the_contact(kind):
    gap = 1e-6
    x, _ = at_rational_times(np.random.default_rng(5), kind, 200)
    for pair in x:
        t, n, w = IMPACT(KINDS[kind], *(Vec3(*p) for p in pair), gap, 64)
        r = np.array(w) @ ((1 - t) * pair[:4] + t * pair[4:])
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-15)
        if t > 0.0:
            assert gap * (1 - 1e-6) <= np.linalg.norm(r) <= NEAR * gap * (1 + 1e-6)  # rounding, of the gap
            assert n @ r > 0.0


def test_nothing_is_missed_with_a_gap_either():
    """The distance at the time is the gap, or up to twice it, and before it was more."""
    gap = 1e-3
    for kind, number in KINDS.items():
        for pair in queries(general, kind, 100, seed=6):
            t, _, _ = IMPACT(number, *(Vec3(*p) for p in pair), gap, 64)
            samples = np.linspace(0.0, min(t, 1.0), 20)
            distances = [distance_at(kind, pair, s) for s in samples]
            assert min(distances) >= min(gap, distances[0]) * (1 - 1e-9)
            assert np.isinf(t) or distances[-1] <= NEAR * gap * (1 + 1e-9) or t == 0.0


def test_refusals_say_what_was_expected():
    x = np.zeros((3, 8, 3))
    with pytest.raises(ValueError, match=r"^kind: expected one of vertex-triangle, edge-edge, got 'vf'$"):
        sim.time_of_impact("vf", x)
    with pytest.raises(ValueError, match=r"^x: expected an array of shape \(n, 8, 3\), got \(8, 3\)$"):
        sim.time_of_impact("edge-edge", x[0])
    with pytest.raises(ValueError, match=r"^x: expected numbers, got "):
        sim.time_of_impact("edge-edge", [["a"]])  # pyright: ignore[reportArgumentType]
    for value in (np.nan, np.inf):
        x[1, 2, 0] = value
        with pytest.raises(ValueError, match=r"^x\[1\]: expected finite numbers, got "):
            sim.time_of_impact("edge-edge", x)
    assert sim.time_of_impact("edge-edge", np.zeros((0, 8, 3))).shape == (0,)
