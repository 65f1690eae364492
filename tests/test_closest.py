"""Nearest points of vertex and triangle and of two edges, against all cases solved in rational numbers."""

import numpy as np
import pytest

from sim.compiled import Vec3
from sim.contact.closest import edge_edge, separation, vertex_triangle
from tests.exact import rational, squared_distance
from tests.jit import compiled

ROUNDED = 2e-15  # of the size: some ulp of what is subtracted
FUNCTIONS = {"vertex-triangle": (compiled(vertex_triangle), 1), "edge-edge": (compiled(edge_edge), 2)}
SEPARATION = compiled(separation)


def random(rng):
    return rng.normal(size=(4, 3))


def lattice(rng):
    """Touching, parallel, collinear, coplanar, without length or area: half are degenerate."""
    return rng.integers(-1, 2, (4, 3)).astype(float)


def near_lattice(rng):
    return lattice(rng) + rng.integers(-1, 2, (4, 3)) * 2.0 ** -int(rng.integers(20, 53))


def needle(rng):
    x = random(rng)
    x[:, 1:] *= 10.0 ** -rng.uniform(3, 9)
    return x


def sliver(rng):
    x = random(rng)
    x[3] = x[1] + rng.uniform(-1, 2) * (x[2] - x[1]) + 10.0 ** -rng.uniform(6, 15) * random(rng)[0]
    return x


def parallel(rng):
    x = random(rng)
    x[3] = x[2] + rng.uniform(-2, 2) * (x[1] - x[0]) + 10.0 ** -rng.uniform(4, 17) * random(rng)[0]
    return x


def collinear(rng):
    """All on one line, but for rounding: angles, and where lines cross, are nothing else."""
    return rng.normal(size=(4, 1)) * random(rng)[0] + rng.integers(0, 2) * random(rng)[0]


FAMILIES = (random, lattice, near_lattice, needle, sliver, parallel, collinear)


def found(kind, x):
    points = [Vec3(*map(float, p)) for p in x]
    w = FUNCTIONS[kind][0](*points)
    return np.array(w), np.array(SEPARATION(w, *points))


@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("kind", FUNCTIONS)
def test_no_points_are_nearer(kind, family):
    rng, split = np.random.default_rng(0), FUNCTIONS[kind][1]
    for _ in range(300):
        x = family(rng)
        p = rational(x)
        truth = float(squared_distance(p[:split], p[split:])) ** 0.5
        distance = np.linalg.norm(found(kind, x)[1])
        assert distance == pytest.approx(truth, abs=ROUNDED * np.abs(x - x[0]).max())


@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: f.__name__)
@pytest.mark.parametrize("kind", FUNCTIONS)
def test_weights_are_those_of_points_on_the_primitives(kind, family):
    rng, split = np.random.default_rng(1), FUNCTIONS[kind][1]
    for _ in range(300):
        w = found(kind, family(rng))[0]
        assert (w[:split] >= 0).all()
        assert (w[split:] <= 0).all()
        assert w[:split].sum() == pytest.approx(1, abs=4e-16)  # the rounding of the sums
        assert w[split:].sum() == pytest.approx(-1, abs=4e-16)


@pytest.mark.parametrize("scale", [2.0**-100, 2.0**100])
@pytest.mark.parametrize("kind", FUNCTIONS)
def test_a_power_of_two_changes_no_weight(kind, scale):
    rng = np.random.default_rng(2)
    for x in [near_lattice(rng) for _ in range(200)]:
        np.testing.assert_array_equal(found(kind, scale * x)[0], found(kind, x)[0])


def test_weights_that_a_side_or_end_clamps_are_exactly_zero():
    a, b, c = [0, 0, 0], [1, 0, 0], [0, 1, 0]
    cases = [
        ([0.2, 0.3, 5], (-0.5, -0.2, -0.3)),
        ([0.25, -2, 1], (-0.75, -0.25, 0)),
        ([3, -1, 1], (0, -1, 0)),
    ]
    for p, beta in cases:
        assert tuple(found("vertex-triangle", [p, a, b, c])[0]) == pytest.approx((1, *beta), abs=0)
    assert tuple(found("edge-edge", [[0.25, -1, 1], [0.25, 1, 1], a, b])[0]) == (0.5, 0.5, -0.75, -0.25)
    assert tuple(found("edge-edge", [[4, 0, 1], [5, 0, 1], a, b])[0]) == (1, 0, 0, -1)
