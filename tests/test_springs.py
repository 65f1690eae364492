"""Coordinates against the vectors of the notes, finite differences, and invariances."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sim
from sim.elements import LENGTH, elastic_energy, make_elements, set_damping, set_matrix_factors, set_tension
from sim.springs import BENDING, STRETCH
from sim.springs.build import fold, measure_each
from sim.stress.measures import elements_at, swept
from tests.worlds import irregular, scene

VECTORS = json.loads((Path(__file__).parent / "vectors" / "methods.json").read_text())
KINDS = {**STRETCH, **BENDING}

ROUNDING = 1e-12  # a dozen operations on numbers of size one, each good to 2e-16


def ratio(gamma):
    """The same γ at every frequency, as `set_damping` takes it."""
    return np.array([[1.0, gamma]])


def curvature(kind, positions):
    """∇²q (3 k, 3 k) of one stencil at `positions`."""
    chosen = np.ascontiguousarray(np.asarray(positions, dtype=float)[list(kind.vertices)])
    k = len(chosen)
    out = np.empty((1, 3 * k, 3 * k))
    kind.load().curvature(chosen, np.arange(k)[None], np.zeros((1, kind.memory)), out)
    return out[0]


def hessian(kind, e, positions):
    """K (∇q ∇qᵀ + (q − q0) ∇²q) of the first element."""
    g = e.gradient[0].ravel()
    return e.stiffness[0] * (np.outer(g, g) + (e.q[0] - e.rest[0]) * curvature(kind, positions))


def force(e, velocities=None):
    """Force (k, 3) on each node of the first element."""
    set_tension(
        e, np.zeros((e.nodes.shape[1], 3)) if velocities is None else np.asarray(velocities, dtype=float)
    )
    return -e.tension[0] * e.gradient[0]


@pytest.mark.parametrize("case", VECTORS["edge_spring"])
def test_edge_spring_has_the_energy_force_and_stiffness_of_the_notes(case):
    e = elements_at(STRETCH["edge"], np.array(case["x"]), case["k"] / case["l0"], case["l0"])
    assert e.q[0] == pytest.approx(case["length"], rel=ROUNDING)
    assert elastic_energy(e) == pytest.approx(case["energy"], rel=1e-9)
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-12)
    set_matrix_factors(e, 1.0, LENGTH)
    block = e.weight[0, 1] ** 2 * e.tensor[0][[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    values = np.sort(np.linalg.eigvalsh(block))
    expected = np.sort([case["eig_normal"], case["eig_tangent_clamp"], case["eig_tangent_clamp"]])
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("case", VECTORS["edge_damping"])
def test_edge_damping_uses_the_reduced_mass(case):
    e = elements_at(STRETCH["edge"], np.array(case["x"]), case["k"] / case["l0"], case["l0"])
    inverse = np.array([1.0 / case["m1"], 0.0 if case["m2"] == "fixed" else 1.0 / case["m2"]])
    set_damping(e, inverse, ratio(case["gamma"]))
    assert e.damping[0] == pytest.approx(case["b"], rel=1e-9)
    e.stiffness[:] = 0.0
    np.testing.assert_allclose(force(e, case["v"]), case["force"], rtol=1e-9)


@pytest.mark.parametrize("case", VECTORS["altitude_spring"])
def test_altitude_spring_is_that_of_the_notes(case):
    e = elements_at(STRETCH["altitude"], np.array(case["x"]), case["k"] / case["h0"], case["h0"])
    assert e.q[0] == pytest.approx(case["h"], rel=1e-9)
    normal = e.gradient[0, 0]
    np.testing.assert_allclose(e.gradient[0] @ normal, case["weights"], rtol=1e-9)
    assert elastic_energy(e) == pytest.approx(case["energy"], rel=1e-9)
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(hessian(STRETCH["altitude"], e, case["x"]), case["hessian"], atol=1e-9 * 20)
    set_damping(e, 1.0 / np.array(case["masses"]), ratio(case["gamma"]))
    assert e.damping[0] == pytest.approx(case["b"], rel=1e-9)
    e.stiffness[:] = 0.0
    np.testing.assert_allclose(force(e, case["v"]), case["damping_force"], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", VECTORS["modified_bending_spring"], ids=lambda c: c["name"])
def test_modified_spring_is_that_of_the_notes(case):
    kind, x = BENDING["modified"], np.array(case["x"])
    for degrees, distance in case["delta_of_theta0"].items():
        q = measure_each(kind, fold(x[None], np.radians(float(degrees)))[0])[0][0]
        limit = np.radians(case["theta_max_monotone_deg"])
        if abs(np.radians(float(degrees))) < 0.9 * limit:
            assert q == pytest.approx(distance, rel=1e-9, abs=1e-12)
    if case["name"].startswith("near_full_fold"):  # beyond the limit the angle takes over
        return
    e = elements_at(kind, x, case["kappa"], case["delta0"])
    assert e.q[0] == pytest.approx(case["delta"], rel=1e-9, abs=1e-14)
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(e.gradient[0] @ np.array(case["n"]), case["weights_x1_x4"], rtol=1e-9)
    second = curvature(kind, x)
    assert np.linalg.norm(second) == pytest.approx(case["hess_delta_frobenius"], rel=1e-9)
    assert np.trace(second) == pytest.approx(case["hess_delta_trace"], abs=1e-12)
    np.testing.assert_allclose(second[0], case["hess_delta_first_row"], atol=1e-12)
    set_damping(e, 1.0 / np.array(case["masses"]), ratio(case["gamma"]))
    assert e.damping[0] == pytest.approx(case["b"], rel=1e-9)
    e.stiffness[:] = 0.0
    np.testing.assert_allclose(force(e, case["v"]), case["damping_force"], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("case", VECTORS["dihedral_angle"], ids=lambda c: c["name"])
def test_the_second_derivative_of_the_angle_is_that_of_the_notes(case):
    second = curvature(BENDING["angle"], np.array(case["x"]))
    assert np.linalg.norm(second) == pytest.approx(case["hess_theta_frobenius"], rel=1e-9)
    assert np.trace(second) == pytest.approx(0.0, abs=1e-12 * np.linalg.norm(second))  # θ is harmonic
    np.testing.assert_allclose(second[0], case["hess_theta_first_row"], atol=1e-9 * np.linalg.norm(second))


@pytest.mark.parametrize("case", VECTORS["dihedral_angle"], ids=lambda c: c["name"])
def test_angle_gradient_and_force_are_those_of_the_notes(case):
    e = elements_at(BENDING["angle"], np.array(case["x"]), case["c"] * case["w"], case["theta0"])
    assert e.q[0] == pytest.approx(case["theta"], abs=ROUNDING)
    np.testing.assert_allclose(e.gradient[0], case["grad_theta"], atol=1e-9 * np.abs(e.gradient).max())
    np.testing.assert_allclose(force(e), case["force"], rtol=1e-9, atol=1e-9 * np.abs(case["force"]).max())


@pytest.mark.parametrize("case", VECTORS["hinge_damping"])
def test_hinge_damping_follows_the_general_rule(case):
    e = elements_at(BENDING["angle"], np.array(case["x"]), case["c"] * case["w"])
    set_damping(e, 1.0 / np.array(case["masses"]), ratio(case["gamma"]))
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


@pytest.mark.parametrize("name", [name for name, kind in BENDING.items() if not kind.wrong])
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


@pytest.mark.parametrize("tips", [(0.8, 0.7), (0.5, 0.5), (0.9, 0.2), (0.01, 1.0)])
@pytest.mark.parametrize("name", ["modified", "angle"])
def test_a_hinge_folded_over_three_half_turns_resists_all_the_way_without_a_jump(name, tips):
    step = 2e-3
    for way in (1.0, -1.0):
        angles = way * np.arange(0.0, 3 * np.pi, step)
        q, turn, gradient = swept(name, tips, angles)
        scale = np.prod(tips) / np.sum(tips) if name == "modified" else 1.0
        assert (way * np.diff(q) > 0.0).all()
        np.testing.assert_allclose(
            np.diff(q) / np.diff(angles), 0.5 * (turn[1:] + turn[:-1]), atol=1e-3 * scale
        )  # where ∂²q/∂θ² jumps
        assert np.abs(np.diff(turn)).max() < 5.0 * step * scale * max(1.0, max(tips) / min(tips))
        # x turns by half of each step, and the gradient's direction with it
        assert np.abs(np.diff(gradient, axis=0)).max() < 8.0 * step * np.abs(gradient).max()


def test_a_modified_spring_measures_the_distance_of_lines_almost_up_to_the_fold_limit():
    h1, h2 = 0.8, 0.7
    limit = math.acos(-h2 / h1)
    angles = np.linspace(0.0, 0.92 * limit, 50)
    q, _, _ = swept("modified", (h1, h2), angles)
    distance = h1 * h2 * np.sin(angles) / np.sqrt(h1**2 + h2**2 + 2 * h1 * h2 * np.cos(angles))
    np.testing.assert_allclose(q, distance, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("exponent", range(3, 16))
def test_lines_close_to_parallel_give_finite_continuous_forces(exponent):
    """Two thin triangles that make the lines x1x2 and x3x4 parallel within 10^-exponent."""
    angle = 10.0**-exponent
    x = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0.5 * angle, 0], [2, -0.5 * angle, 0]])
    near = [elements_at(BENDING["modified"], x * [1, s, 1]) for s in (1.0, 1.01)]
    for e in near:
        assert np.isfinite(e.gradient).all()
        assert np.abs(e.gradient).max() <= 2.0
        assert abs(e.q[0]) <= angle
    assert np.abs(near[0].gradient - near[1].gradient).max() < 1e-3


def test_a_triangle_pushed_through_its_edge_is_pushed_back_the_way_it_came():
    kind, memory = STRETCH["altitude"], np.zeros((1, 3))
    heights = np.linspace(0.8, -0.4, 241)
    for height in heights:
        x = np.array([[0.4, height, 0.0], [0, 0, 0], [1, 0, 0]])
        e = elements_at(kind, x, 10.0, 0.8, memory=memory)
        assert e.q[0] == pytest.approx(height, abs=1e-15)
        np.testing.assert_allclose(force(e)[0], [0.0, 10.0 * (0.8 - height), 0.0], atol=1e-12)
        memory = e.new_memory.copy()


def test_a_triangle_may_turn_over_as_a_whole():
    kind, memory = STRETCH["altitude"], np.zeros((1, 3))
    for turn in np.arange(0.0, 7.0, 1.0):  # a whole turn in steps of less than a quarter
        x = np.array([[0.4, 0.8 * np.cos(turn), 0.8 * np.sin(turn)], [0, 0, 0], [1, 0, 0]])
        e = elements_at(kind, x, 10.0, 0.8, memory=memory)
        assert e.q[0] == pytest.approx(0.8, rel=1e-14)
        memory = e.new_memory.copy()


@pytest.mark.parametrize("rule", ["tips", "half", "lever"])
def test_ad_hoc_rules_have_the_ghost_forces_of_the_notes(rule):
    """The table of the notes: a hinge folded by 60°, c w = 0.05, at rest."""
    x = np.array([[0, 0, 0], [1, 0, 0], [0.3, 0.45, 0.9 * math.sin(math.pi / 3)], [0.6, -0.4, 0]])
    kind = BENDING["adhoc"]
    q, gradient = np.zeros(1), np.zeros((1, 4, 3))
    getattr(kind.load(), rule)(x, np.arange(4)[None], np.zeros((1, 1)), q, gradient, np.zeros((1, 1)))
    assert q[0] == pytest.approx(math.pi / 3)
    forces = -0.05 * q[0] * gradient[0]
    torque = np.cross(x - x.mean(axis=0), forces).sum(axis=0)
    expected = {
        "tips": ([0, 0.0453, -0.0785], [-0.0164, 0.0020, -0.0079]),
        "half": ([0, 0, 0], [-0.0262, 0, -0.0091]),
        "lever": ([0, 0, 0], [0, 0.0073, -0.0101]),
    }[rule]
    np.testing.assert_allclose(forces.sum(axis=0), expected[0], atol=6e-5)  # four digits are given
    np.testing.assert_allclose(torque, expected[1], atol=6e-5)


def test_a_rest_hinge_whose_coordinate_feels_no_fold_is_left_out_and_said_so():
    """The line x3x4 all but parallel to the edge: matched to the angle, its stiffness would have no bound."""
    thin = {
        "vertices": [[0, 0, 0], [1, 0, 0], [3, 0.002, 0], [-2, -0.002, 0]],
        "triangles": [[0, 1, 2], [1, 0, 3]],
    }
    world = sim.Simulation({"cloth": thin}, bend="modified", gravity=(0, 0, 0))
    assert world.energy()["modified"] == 0.0
    assert np.isfinite(world.forces()).all()
    assert "1 left out" in world.step().effects["bending"]


def test_tension_is_told_with_the_energy_to_the_bit_and_with_what_damping_takes():
    """A ledger has both of one pass over the elements."""
    world = sim.Simulation(scene(irregular(3, 200), altitudes="all", bend="angle", gamma=0.3))
    velocities = np.random.default_rng(0).standard_normal(world.positions.shape)
    world.forces()
    for springs in world.model.springs:
        e = springs.elements
        stored, taken = set_tension(e, velocities)
        assert stored == elastic_energy(e)
        rate = np.einsum("eki,eki->e", e.gradient, velocities[e.nodes]) - e.drift
        assert stored == pytest.approx(0.5 * float(e.stiffness @ (e.q - e.rest) ** 2), rel=ROUNDING)
        assert taken == pytest.approx(float(e.damping @ rate**2), rel=ROUNDING)
        assert taken > 0.0
