"""What contacts couple in the matrix, against the dense matrix, and with either solver."""

import numpy as np
import pytest

import sim
from sim.contact.contacts import make_contacts
from sim.contact.gap import gap_springs
from sim.contact.response import RESPONSES
from sim.settings import change
from sim.solve.cg import make_workspace, multiply
from sim.solve.coupling import build_coupling, uncoupled
from sim.solve.direct import as_sparse
from sim.solve.implicit import backward_euler
from sim.threads import LAUNCHED, processor_threads
from tests.worlds import grid, scene

SIDE = 9


def stack(**more):
    """Two sheets, one on the other, the upper one's side held."""
    cloth = [
        grid((0.4, 0.4), (SIDE, SIDE)),
        grid((0.4, 0.4), (SIDE, SIDE), pins=["left"], position=[0, 0, 0.01]),
    ]
    return sim.Simulation(scene(cloth, friction=0.5, gravity=[0, 0, -9.81], **more))


def random_contacts(world, c, seed=0):
    """So many contacts of vertices all over, in a random direction each, that press."""
    rng, contacts = np.random.default_rng(seed), make_contacts(c)
    contacts.key[:] = np.arange(c)
    for k in range(c):
        contacts.node[k] = rng.choice(len(world.masses), 4, replace=False)
        if k % 2:
            contacts.weight[k] = [1.0, *-rng.dirichlet([1, 1, 1])]
        else:
            s, t = rng.random(2)
            contacts.weight[k] = [1 - s, s, t - 1, -t]
    contacts.weight[:5, 3] = 0.0  # some weigh nothing
    contacts.weight[:5, 2] = -contacts.weight[:5, :2].sum(axis=1)
    contacts.normal[:] = rng.standard_normal((c, 3))
    contacts.normal[:] /= np.linalg.norm(contacts.normal, axis=1)[:, None]
    contacts.thickness[:] = 0.01
    contacts.start[:] = 0.005
    contacts.offset[:] = contacts.gaps(world.positions) - contacts.start
    return contacts


def springs_of(world, contacts, seed=0):
    velocities = 0.1 * np.random.default_rng(seed).standard_normal(world.positions.shape)
    velocities *= world.model.free[:, None]
    pressed = np.ones(len(contacts.key))
    where = world.positions, world.positions
    state = world.model.inverse_masses, *where, velocities, pressed, np.zeros(len(pressed))
    springs = gap_springs(RESPONSES["impulse"], contacts, len(contacts.key), *state, world.settings)
    return springs, velocities


def linearised(c=120):
    world = stack()
    springs, velocities = springs_of(world, random_contacts(world, c))
    world.model.linearise(world.positions, velocities, springs, world.settings.dt)
    return world.model


@pytest.fixture(scope="module")
def model():
    return linearised()


def dense(model):
    """The matrix the obvious way: springs' blocks, and w_a w_b S for every contact."""
    n, coupling = len(model.masses), model.coupling
    full = as_sparse(model.matrix, uncoupled(n)).toarray().reshape(n, 3, n, 3)
    for node, weight, tensor in zip(coupling.node, coupling.weight, coupling.tensor, strict=True):
        s = tensor[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        for a in range(4):
            for b in range(4):
                if a != b:  # what a vertex has with itself is on the matrix's own diagonal
                    full[node[a], :, node[b]] += weight[a] * weight[b] * s
    return full.reshape(3 * n, 3 * n)


def product(model, x, free=None):
    free = np.ones(len(x), dtype=bool) if free is None else free
    y, work = np.empty_like(x), make_workspace(len(x))
    return multiply(model.matrix, model.coupling, free, x, y, work.partial), y


def test_the_product_is_that_of_the_dense_matrix(model):
    assert len(model.coupling.node) == 120
    whole = dense(model)
    sparse = as_sparse(model.matrix, model.coupling).toarray()
    size = np.abs(whole).max()
    np.testing.assert_allclose(sparse, whole, atol=1e-14 * size)  # sums of some thirty terms, rounded
    x = np.random.default_rng(1).standard_normal((len(model.masses), 3))
    square, y = product(model, x)
    # A vertex's own share is taken off again in the product: that costs digits of its contacts' tensors.
    np.testing.assert_allclose(y.ravel(), whole @ x.ravel(), atol=1e-12 * size)
    assert square == pytest.approx(x.ravel() @ whole @ x.ravel(), rel=1e-12)


def test_fixed_vertices_are_left_out(model):
    x = np.random.default_rng(2).standard_normal((len(model.masses), 3)) * model.free[:, None]
    _, y = product(model, x, model.free)
    np.testing.assert_array_equal(y[~model.free], 0.0)
    free = np.repeat(model.free, 3)
    np.testing.assert_allclose(
        y.ravel()[free], (dense(model) @ x.ravel())[free], atol=1e-12 * np.abs(dense(model)).max()
    )


def test_the_matrix_is_symmetric_and_positive_definite(model):
    whole = as_sparse(model.matrix, model.coupling).toarray()
    # a drag's part across n is written as I − nnᵀ, so that sums may differ in the last bits
    np.testing.assert_allclose(whole, whole.T, atol=1e-14 * np.abs(whole).max())
    assert np.linalg.eigvalsh(whole).min() > 0.99 * model.masses.min()  # M is part of it, the rest only adds


def test_contacts_add_nothing_to_what_moves_as_a_whole(model):
    """Σ w = 0, so the matrix takes a translation to M times it, and the solve keeps momentum."""
    way = np.broadcast_to([1.0, -2.0, 3.0], (len(model.masses), 3)).copy()
    _, y = product(model, way)
    size = np.abs(dense(model)).max()
    np.testing.assert_allclose(y, model.masses[:, None] * way, atol=1e-12 * size)


def test_contacts_pull_the_way_their_springs_do(model):
    """Without contacts the matrix is another: the test above must not pass for want of any."""
    x = np.random.default_rng(3).standard_normal((len(model.masses), 3))
    with_them, _ = product(model, x)
    along = 0.0
    for node, weight, tensor in zip(*model.coupling[:3], strict=True):
        d = weight @ x[node]
        along += d @ tensor[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]] @ d
    assert along > 0.1 * with_them


def test_no_contact_couples_nothing():
    model = linearised(0)
    assert len(model.coupling.node) == 0
    x = np.random.default_rng(4).standard_normal((len(model.masses), 3))
    _, y = product(model, x)
    whole = as_sparse(model.matrix, model.coupling).toarray()
    np.testing.assert_allclose(y.ravel(), whole @ x.ravel(), atol=1e-13 * np.abs(whole).max())


def test_contacts_are_gathered_by_vertex_in_order():
    node = np.array([[3, 1, 2, 0], [1, 0, 3, 2]], dtype=np.int32)
    weight = np.array([[1.0, -0.5, -0.5, 0.0], [0.25, 0.75, -1.0, 0.0]])
    coupling = build_coupling(4, node, weight, np.zeros((2, 6)))
    seen = [
        sorted(zip(coupling.contact[a:b].tolist(), coupling.corner[a:b].tolist(), strict=True))
        for a, b in zip(coupling.first[:-1], coupling.first[1:], strict=True)
    ]
    assert seen == [[(1, 1)], [(0, 1), (1, 0)], [(0, 2)], [(0, 0), (1, 2)]]


@pytest.mark.parametrize("newton", [1, 3])
def test_both_solvers_agree_on_a_step(newton):
    ends = {}
    for solver in ("cg", "direct"):
        world = stack(solver=solver, tolerance=1e-10, newton=newton)
        springs, velocities = springs_of(world, random_contacts(world, 60))
        s, x = world.settings, world.positions
        solution = backward_euler(world.model, springs, s, x, velocities, s.dt, x)
        assert solution.solver == solver
        ends[solver] = solution
    # Each is right to the tolerance at the worst vertex, and friction takes up two of them.
    np.testing.assert_allclose(ends["cg"].positions, ends["direct"].positions, atol=3e-10 * newton)
    assert ends["direct"].residual < 1e-10


@pytest.mark.parametrize("solver", ["cg", "direct"])
def test_a_step_solves_the_linear_system_with_its_contacts(solver):
    """A step = M (v̂ − v) + h f with the dense matrix; without friction, which is solved for anew."""
    world = stack(solver=solver, tolerance=1e-11)
    world.update(friction=0.0)
    springs, velocities = springs_of(world, random_contacts(world, 60))
    s, x, h, model = world.settings, world.positions, world.settings.dt, world.model
    solution = backward_euler(model, springs, s, x, velocities, h, x)
    springs, _ = springs_of(world, random_contacts(world, 60))
    forces = model.linearise(x, np.zeros_like(velocities), springs, h)
    free = np.repeat(model.free, 3)
    right = (model.masses[:, None] * velocities + h * forces).ravel()
    step = np.zeros_like(right)
    step[free] = np.linalg.solve(dense(model)[free][:, free], right[free])
    np.testing.assert_allclose(h * solution.velocities.ravel(), h * step, atol=1e-10)


@pytest.mark.skipif(LAUNCHED < 2, reason="there is one thread only")
def test_any_number_of_threads_gives_the_same_bits(model):
    x = np.random.default_rng(5).standard_normal((len(model.masses), 3))
    products = []
    for count in (1, LAUNCHED):
        with processor_threads(count):
            products.append(product(model, x))
    assert products[0][0] == products[1][0]
    np.testing.assert_array_equal(products[0][1], products[1][1])


def test_a_converged_solve_keeps_gaps_however_stiff_the_cloth_is():
    """Impulses would take back what is left of overlaps, and do not ask what that stretches."""
    world = stack(stretch=1e3, altitude=1e3, bending=1e-4, newton=60, tolerance=1e-5)
    springs, _ = springs_of(world, random_contacts(world, 10))
    first = springs.elements.stiffness + springs.aside[0]
    x, h = world.positions, world.settings.dt
    end = backward_euler(world.model, springs, world.settings, x, np.zeros_like(x), h, x)
    assert end.converged
    pushes = springs.pushes(end.positions, end.velocities, h) > 0.0
    off = springs.contacts.gaps(end.positions) - springs.target
    assert pushes.any()
    assert (springs.elements.stiffness > first).any()
    assert np.abs(off[pushes]).max() <= world.settings.tolerance
    assert off.min() >= -world.settings.tolerance


def test_the_settings_change_nothing_about_the_contacts_of_a_step():
    """Guards the helper of these tests: friction on or off, the same contacts press."""
    world = stack()
    contacts = random_contacts(world, 60)
    state = (
        world.model.inverse_masses,
        world.positions,
        world.positions,
        np.zeros_like(world.positions),
        np.ones(60),
        np.zeros(60),
    )
    for friction in (0.0, 0.5):
        settings = change(world.settings, friction=friction)
        springs = gap_springs(RESPONSES["impulse"], contacts, 60, *state, settings)
        np.testing.assert_array_equal(springs.contacts.key, contacts.key)
