"""Coordinates against the vectors of the notes, finite differences, and invariances."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.elements import elastic_energy, make_elements, set_damping, set_matrix_factors, set_tension
from sim.springs import BENDING, STRETCH
from sim.springs.build import fold, measure_each

VECTORS = json.loads((Path(__file__).parent / "vectors" / "methods.json").read_text())
KINDS = {**STRETCH, **BENDING}

ROUNDING = 1e-12  # a dozen operations on numbers of size one, each good to 2e-16
DIFFERENCES = 1e-8  # central differences with a step of 1e-6: truncation 1e-12, cancellation 1e-10


def elements_at(kind, positions, stiffness=1.0, rest=0.0):
    """Elements of one stencil at `positions` (stencil, 3), measured."""
    chosen = np.ascontiguousarray(positions[list(kind.vertices)], dtype=float)
    e = make_elements(np.arange(len(chosen))[None], kind.memory)
    e.stiffness[:], e.rest[:] = stiffness, rest
    kind.load().coordinate(chosen, e.nodes, e.memory, e.q, e.gradient, e.new_memory)
    return e


def force(e, velocities=None):
    """Force (k, 3) on each node of the first element."""
    set_tension(
        e, np.zeros((e.nodes.shape[1], 3)) if velocities is None else np.asarray(velocities, dtype=float)
    )
    return -e.tension[0] * e.gradient[0]


def random_stencils(count, seed=0):
    """Hinges (count, 4, 3) of every sort: generic, sliver, obtuse, strongly folded, tiny and huge."""
    rng = np.random.default_rng(seed)
    hinges = rng.standard_normal((count, 4, 3))
    hinges[::5, 2] = hinges[::5, 0] + 1.4 * (hinges[::5, 1] - hinges[::5, 0]) + 0.1 * hinges[::5, 2]
    hinges[1::5, 3] = hinges[1::5, 2] + 0.05 * hinges[1::5, 3]
    hinges[2::5] *= 1e-3
    hinges[3::5] *= 1e2
    return hinges


@pytest.mark.parametrize("case", VECTORS["edge_spring"])
def test_edge_spring_has_the_energy_force_and_stiffness_of_the_notes(case):
    e = elements_at(STRETCH["edge"], np.array(case["x"]), case["k"] / case["l0"], case["l0"])
    assert e.q[0] == pytest.approx(case["length"], rel=ROUNDING)
    assert elastic_energy(e) == pytest.approx(case["energy"], rel=1e-9)
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-12)
    set_matrix_factors(e, 1.0, True)
    n = e.gradient[0, 1]
    block = e.along[0] * np.outer(n, n) + e.across[0] * np.eye(3)
    values = np.sort(np.linalg.eigvalsh(block))
    expected = np.sort([case["eig_normal"], case["eig_tangent_clamp"], case["eig_tangent_clamp"]])
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("case", VECTORS["edge_damping"])
def test_edge_damping_uses_the_reduced_mass(case):
    e = elements_at(STRETCH["edge"], np.array(case["x"]), case["k"] / case["l0"], case["l0"])
    inverse = np.array([1.0 / case["m1"], 0.0 if case["m2"] == "fixed" else 1.0 / case["m2"]])
    set_damping(e, inverse, case["gamma"])
    assert e.damping[0] == pytest.approx(case["b"], rel=1e-9)
    e.stiffness[:] = 0.0
    np.testing.assert_allclose(force(e, case["v"]), case["force"], rtol=1e-9)


@pytest.mark.parametrize("case", VECTORS["dihedral_angle"], ids=lambda c: c["name"])
def test_angle_gradient_and_force_are_those_of_the_notes(case):
    e = elements_at(BENDING["angle"], np.array(case["x"]), case["c"] * case["w"], case["theta0"])
    assert e.q[0] == pytest.approx(case["theta"], abs=ROUNDING)
    np.testing.assert_allclose(e.gradient[0], case["grad_theta"], atol=1e-9 * np.abs(e.gradient).max())
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-9 * np.abs(case["force"]).max())


@pytest.mark.parametrize("case", VECTORS["hinge_damping"])
def test_hinge_damping_follows_the_general_rule(case):
    e = elements_at(BENDING["angle"], np.array(case["x"]), case["c"] * case["w"])
    set_damping(e, 1.0 / np.array(case["masses"]), case["gamma"])
    assert e.damping[0] == pytest.approx(case["b_theta"], rel=1e-9)
    e.stiffness[:] = 0.0
    np.testing.assert_allclose(force(e, case["v"]), case["force"], rtol=1e-9)


@pytest.mark.parametrize("case", VECTORS["cross_spring_rest_length"], ids=lambda c: c["name"])
def test_cross_rest_length_is_that_of_the_folded_rest_hinge(case):
    hinge = next(h for h in VECTORS["dihedral_angle"] if h["name"] == case["name"])
    x = np.array(hinge["x"])[None]
    assert measure_each(BENDING["cross"], x)[0][0] == pytest.approx(case["length"], rel=ROUNDING)
    for degrees, length in case["rest_length_of_theta0"].items():
        folded, _ = fold(x, np.radians(float(degrees)))
        assert measure_each(BENDING["cross"], folded)[0][0] == pytest.approx(length, rel=1e-9)


@given(theta=st.floats(-3.1, 3.1), seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=60)
def test_folding_the_rest_hinge_gives_the_angle_asked_for_and_keeps_the_triangles(theta, seed):
    hinge = np.random.default_rng(seed).standard_normal((1, 4, 3))
    folded, motion = fold(hinge, theta)
    thin = min(np.linalg.norm(np.cross(hinge[0, 1] - hinge[0, 0], hinge[0, v] - hinge[0, 0])) for v in (2, 3))
    if thin < 1e-2:
        return
    assert measure_each(BENDING["angle"], folded)[0][0] == pytest.approx(theta, abs=1e-10)
    for a, b in ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3)):
        was, now = np.linalg.norm(hinge[0, a] - hinge[0, b]), np.linalg.norm(folded[0, a] - folded[0, b])
        assert now == pytest.approx(was, rel=1e-12)
    ahead, behind = fold(hinge, theta + 1e-6)[0], fold(hinge, theta - 1e-6)[0]
    np.testing.assert_allclose(motion, (ahead - behind) / 2e-6, atol=1e-8)


@pytest.mark.parametrize("name", KINDS)
def test_gradient_is_the_derivative_of_the_coordinate(name):
    kind = KINDS[name]
    for hinge in random_stencils(40):
        x = hinge[list(kind.vertices)]
        size = np.abs(x - x.mean(axis=0)).max()
        q, gradient = measure_each(kind, hinge[None])
        if not gradient.any():  # too thin to have an angle
            continue
        height = 1.0 / np.abs(gradient[0]).max()  # the length over which the gradient itself changes
        step = 1e-5 * min(size, height if name == "angle" else size)
        for a, vertex in enumerate(kind.vertices):
            for r in range(3):
                values = []
                for side in (1.0, -1.0):
                    moved = hinge.copy()
                    moved[vertex, r] += side * step
                    values.append(measure_each(kind, moved[None])[0][0])
                slope = (
                    (values[0] - values[1] + np.pi) % (2 * np.pi) - np.pi
                    if name == "angle"
                    else values[0] - values[1]
                )
                error = abs(slope / (2 * step) - gradient[0, a, r]) / np.abs(gradient[0]).max()
                assert error < DIFFERENCES, (name, hinge, a, r)
        assert np.isfinite(q).all()


@pytest.mark.parametrize("name", KINDS)
def test_a_coordinate_does_not_feel_rigid_motion(name):
    """Σ g = 0 and Σ x × g = 0: no net force and no net torque, whatever the shape."""
    kind = KINDS[name]
    hinges = random_stencils(1000)
    gradient = measure_each(kind, hinges)[1]
    x = hinges[:, list(kind.vertices)]
    x = x - x.mean(axis=1, keepdims=True)
    size = np.abs(gradient).sum(axis=(1, 2))
    reach = np.abs(x).max(axis=(1, 2))
    assert (np.linalg.norm(gradient.sum(axis=1), axis=1) <= 1e-12 * size).all()
    assert (np.linalg.norm(np.cross(x, gradient).sum(axis=1), axis=1) <= 1e-11 * size * reach).all()


def test_the_angle_is_unwrapped_past_a_half_turn():
    kind = BENDING["angle"]
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0]])
    memory = 0.0
    for theta in np.arange(0.0, 3 * np.pi, 0.05):
        positions = np.ascontiguousarray(fold(flat[None], theta)[0][0])
        e = make_elements(np.arange(4)[None], kind.memory)
        e.memory[0, 0] = memory
        kind.load().coordinate(positions, e.nodes, e.memory, e.q, e.gradient, e.new_memory)
        assert e.q[0] == pytest.approx(theta, abs=1e-9)
        memory = e.new_memory[0, 0]


@pytest.mark.parametrize(
    "third", [[0.5, 0, 0], [0, 0, 0], [0.5, 1e-7, 0]], ids=["flat", "repeated", "needle"]
)
def test_a_collapsed_triangle_gives_no_force_and_no_nan(third):
    x = np.array([[0.0, 0, 0], [1, 0, 0], third, [0.5, -1, 0]])
    q, gradient = measure_each(BENDING["angle"], x[None])
    assert np.isfinite(q).all()
    assert not gradient.any()


def test_vertices_that_coincide_give_no_force_and_no_nan():
    q, gradient = measure_each(STRETCH["edge"], np.zeros((1, 2, 3)))
    assert q[0] == 0.0
    assert not gradient.any()


@pytest.mark.parametrize("name", BENDING)
def test_bending_kinds_resist_the_same_fold_alike(name):
    """K (dq/dθ)² = c w at the fold where the kind is matched, for any hinge."""
    from sim.mesh import build_mesh
    from sim.scene import load_scene
    from sim.springs.build import build_springs, hinge_shape

    kind = BENDING[name]
    mesh = build_mesh(load_scene({"cloth": {"kind": "grid", "size": [1, 0.7], "resolution": [5, 4]}}))
    springs = build_springs(name, kind, mesh)
    rest = mesh.rest_vertices[springs.stencil]
    length, _, height3, _, height4 = hinge_shape(rest)
    step = 1e-5
    up, down = (measure_each(kind, fold(rest, kind.match_fold + s * step)[0])[0] for s in (1.0, -1.0))
    rate = (up - down) / (2 * step)
    np.testing.assert_allclose(springs.unit_stiffness * rate**2, length / (height3 + height4), rtol=1e-8)


def test_a_cross_spring_has_no_linear_bending_stiffness_when_flat():
    hinge = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, 0.9, 0], [0.5, -0.9, 0]]])
    flat, small = (measure_each(BENDING["cross"], fold(hinge, theta)[0])[0][0] for theta in (0.0, 1e-3))
    up, down = (measure_each(BENDING["cross"], fold(hinge, theta)[0])[0][0] for theta in (0.4, -0.4))
    assert flat - small == pytest.approx(0.9 * 1e-6 / 4, rel=1e-3)  # second order in the fold: h θ²/4
    assert up == pytest.approx(down, rel=1e-14)  # and blind to its side
