"""What must hold of every coordinate: its derivatives, and that it does not feel rigid motion."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sim.springs import BENDING, STRETCH
from sim.springs.build import measure_each

KINDS = {**STRETCH, **BENDING}
RIGHT = [name for name, kind in KINDS.items() if not kind.wrong]

GRADIENT, HESSIAN = 1e-8, 1e-7  # fourth-order differences over 1e-3 of the least height: 1e-12 and rounding
NET = 1e-12  # a sum of some dozen terms, each rounded to 2e-16

SHAPES = {
    "generic": [[0, 0, 0], [1, 0.1, 0.2], [0.3, 0.8, 0.1], [0.5, -0.7, 0.3]],
    "flat": [[0, 0, 0], [1, 0, 0], [0.4, 0.8, 0], [0.6, -0.7, 0]],
    "sliver": [[0, 0, 0], [1, 0, 0], [0.3, 0.02, 0.001], [0.6, -0.4, 0.1]],
    "obtuse": [[0, 0, 0], [1, 0, 0], [2.5, 0.3, 0.1], [-1.4, -0.4, 0.2]],
    "folded": [[0, 0, 0], [1, 0, 0], [0.4, -0.3, 0.6], [0.6, -0.5, 0.2]],
    "beyond the fold limit": [[0, 0, 0], [1, 0, 0], [0.4, 0.1, 0.8], [0.6, 0.3, 0.6]],
    "almost collapsed": [[0, 0, 0], [1, 0, 0], [0.3, 0.004, 0.002], [0.6, -0.003, 0.001]],
    "huge": [[0, 0, 0], [1000, 0, 0], [300, 800, 100], [600, -700, 300]],
    "tiny": [[0, 0, 0], [1e-4, 0, 0], [3e-5, 8e-5, 1e-5], [6e-5, -7e-5, 3e-5]],
}


def measured(name, positions, memory=None):
    """Q and gradient (k, 3) of one stencil given by all of its vertices."""
    kind = KINDS[name]
    chosen = np.ascontiguousarray(positions[list(kind.vertices)], dtype=float)
    k = len(chosen)
    q, gradient, after = np.zeros(1), np.zeros((1, k, 3)), np.zeros((1, kind.memory))
    before = np.zeros((1, kind.memory)) if memory is None else memory
    kind.load().coordinate(chosen, np.arange(k)[None], before, q, gradient, after)
    return q[0], gradient[0], after


def least_height(positions):
    """The shortest length of the hinge's triangles: over it, coordinates change their derivatives."""
    lengths = []
    for a, b, c in ((0, 1, 2), (1, 0, 3)):
        p, q, r = positions[[a, b, c]]
        area = np.linalg.norm(np.cross(q - p, r - p))
        sides = [np.linalg.norm(q - p), np.linalg.norm(r - q), np.linalg.norm(p - r)]
        lengths.append(area / max(sides))
    return min(lengths)


def fold_and_limit(x):
    """|θ| and θ_s, where modified springs go over to the angle; their second derivative jumps there."""
    q = abs(measure_each(BENDING["angle"], x[None])[0][0])
    edge = np.linalg.norm(x[1] - x[0])
    h1, h2 = (np.linalg.norm(np.cross(x[1] - x[0], x[k] - x[0])) / edge for k in (2, 3))
    r = h1 / h2
    return q, math.acos(-0.9 * (r**8 + r**-8) ** (-1 / 8))


def differences(f, positions, vertex, component, step):
    """∂f/∂x of fourth order."""
    values = []
    for side in (1.0, -1.0, 2.0, -2.0):
        moved = positions.copy()
        moved[vertex, component] += side * step
        values.append(f(moved))
    return (8.0 * (values[0] - values[1]) - (values[2] - values[3])) / (12.0 * step)


def check_derivatives(name, x):
    kind = KINDS[name]
    step = 1e-3 * least_height(x)
    q, gradient, memory = measured(name, x)
    size = np.abs(gradient).max()
    for a, vertex in enumerate(kind.vertices):
        for r in range(3):
            slope = differences(lambda p: measured(name, p, memory)[0], x, vertex, r, step)
            noise = 1e-13 * abs(q) / step  # rounding of q over the step
            assert abs(slope - gradient[a, r]) < GRADIENT * size + noise, (a, r)
    module = kind.load()
    k = len(kind.vertices)
    out = np.empty((1, 3 * k, 3 * k))
    chosen = np.ascontiguousarray(x[list(kind.vertices)])
    module.curvature(chosen, np.arange(k)[None], memory, out)
    if name == "modified" and fold_and_limit(x)[0] > fold_and_limit(x)[1]:
        assert not out.any()  # left out there
        return
    scale = np.abs(out).max()
    assert np.abs(out[0] - out[0].T).max() <= 1e-12 * scale
    for a, vertex in enumerate(kind.vertices):
        for r in range(3):
            column = differences(lambda p: measured(name, p, memory)[1].ravel(), x, vertex, r, step)
            noise = 1e-13 * size / step
            assert np.abs(column - out[0, :, 3 * a + r]).max() < HESSIAN * scale + noise, (a, r)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", RIGHT)
def test_gradient_and_hessian_are_the_derivatives_of_the_coordinate(name, shape):
    check_derivatives(name, np.array(SHAPES[shape], dtype=float))


@given(seed=st.integers(0, 2**31), size=st.floats(-3, 3))
@settings(deadline=None, max_examples=60)
@pytest.mark.parametrize("name", RIGHT)
def test_gradient_and_hessian_hold_on_random_hinges(name, seed, size):
    x = np.random.default_rng(seed).standard_normal((4, 3)) * 10.0**size
    longest = np.abs(x - x.mean(axis=0)).max()
    assume(least_height(x) > 0.02 * longest)
    folded, limit = fold_and_limit(x)
    assume(abs(folded - limit) > 0.02)
    assume(folded < math.pi - 0.02)  # there, the angle of a hinge without a past jumps by a turn
    check_derivatives(name, x)


@given(seed=st.integers(0, 2**31), thin=st.floats(0, 8), folded=st.floats(-math.pi, math.pi))
@settings(deadline=None, max_examples=200)
@pytest.mark.parametrize("name", RIGHT)
def test_a_coordinate_does_not_feel_rigid_motion(name, seed, thin, folded):
    """Σ g = 0 and Σ x × g = 0: no net force and no net torque, also of triangles all but collapsed."""
    kind = KINDS[name]
    x = np.random.default_rng(seed).standard_normal((4, 3))
    along = x[1] - x[0]
    x[2] = x[0] + 0.7 * along + 10.0**-thin * (x[2] - x[0])
    x[3] = x[0] + 0.3 * along + math.cos(folded) * (x[3] - x[0])
    _, gradient, _ = measured(name, x)
    assert np.isfinite(gradient).all()
    own = x[list(kind.vertices)] - x.mean(axis=0)
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() <= NET * size
    assert np.abs(np.cross(own, gradient).sum(axis=0)).max() <= NET * size * np.abs(own).max()


@pytest.mark.parametrize("name", RIGHT)
@pytest.mark.parametrize(
    "x",
    [
        np.zeros((4, 3)),
        np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.2, 0, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [0.5, -1, 0]]),
        np.array([[0.0, 0, 0], [0, 0, 0], [0.5, 1, 0], [0.5, -1, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 1, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-12, 0], [0.5, -1, 0]]),
        np.array([[0.0, 0, 0], [1e-9, 0, 0], [1, 1e-9, 0], [0.5, -1, 0]]),
    ],
    ids=["all in one", "in one line", "repeated", "no edge", "on each other", "needle", "short edge"],
)
def test_a_collapsed_stencil_gives_finite_numbers_without_net_force(name, x):
    q, gradient, memory = measured(name, x)
    assert np.isfinite(q)
    assert np.isfinite(gradient).all()
    assert np.isfinite(memory).all()
    assert np.abs(gradient.sum(axis=0)).max() <= NET * max(np.abs(gradient).sum(), 1.0)
    kind = KINDS[name]
    k = len(kind.vertices)
    out = np.empty((1, 3 * k, 3 * k))
    kind.load().curvature(np.ascontiguousarray(x[list(kind.vertices)]), np.arange(k)[None], memory, out)
    assert np.isfinite(out).all()


@pytest.mark.parametrize("name", KINDS)
def test_what_is_remembered_of_a_place_changes_no_bit_of_what_is_measured_there(name):
    """Steps rely on it: where one ends, springs are measured once for it and for the next."""
    rng = np.random.default_rng(5)
    memory = None
    for size in (0.1, 1.0, 1e-3, 3.0):
        for shape in SHAPES.values():
            x = np.array(shape) * (1 + size * rng.standard_normal((4, 3)))
            q, gradient, memory = measured(name, x, memory)
            again, same, after = measured(name, x, memory)
            assert again == q
            np.testing.assert_array_equal(same, gradient)
            np.testing.assert_array_equal(after, memory)
