"""Edges that cross triangles, against all pairs in rational numbers."""

import numpy as np
import pytest

import sim
from sim.contact.intersections import intersections
from sim.mesh import build_mesh
from tests.exact import rational, squared_distance
from tests.worlds import ball, grid, irregular, scene

TRIANGLE = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


def sheet(nx, ny):
    """Flat vertices and triangles of a grid of whole numbers."""
    x = np.stack([*np.meshgrid(np.arange(nx), np.arange(ny)), np.zeros((ny, nx))], axis=2).reshape(-1, 3)
    a = (np.arange(nx - 1) + nx * np.arange(ny - 1)[:, None]).ravel()
    return x, np.stack([a, a + 1, a + nx, a + 1, a + nx + 1, a + nx], axis=1).reshape(-1, 3)


def twin(x, triangles):
    """Every edge with every triangle, whether they have a point in common."""
    points = rational(x)
    return [
        (e, f)
        for e, edge in enumerate(sides(triangles))
        for f, corners in enumerate(triangles)
        if not {*edge} & {*corners}
        and (x[edge].min(axis=0) <= x[corners].max(axis=0)).all()
        and (x[corners].min(axis=0) <= x[edge].max(axis=0)).all()
        and squared_distance([points[i] for i in edge], [points[i] for i in corners]) == 0
    ]


def sides(triangles):
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def found(x, triangles):
    return [tuple(map(int, pair)) for pair in intersections(x, triangles)]


def crosses(edge, triangle=TRIANGLE):
    """Whether an edge (of a triangle that ends far away, on its own line) is listed with a triangle."""
    p, q = np.array(edge, dtype=float)
    x = np.concatenate([np.array(triangle, dtype=float), [p, q, q]])
    pairs = found(x, np.array([[0, 1, 2], [3, 4, 5]]))
    return any(f == 0 for _, f in pairs)


def soup(rng, points, count):
    return np.array([rng.choice(points, 3, replace=False) for _ in range(count)])


@pytest.mark.parametrize("seed", range(4))
def test_random_soups(seed):
    rng = np.random.default_rng(seed)
    x, triangles = rng.normal(size=(24, 3)), soup(rng, 24, 24)
    pairs = twin(x, triangles)
    assert len(pairs) > 20
    assert found(x, triangles) == pairs


@pytest.mark.parametrize("flat", [0, 1, 2], ids=["in space", "in a plane", "on a line"])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_degenerate_soups(seed, turned, flat):
    """Whole numbers: touching at corners, sides and overlapping, and then all that but for rounding."""
    rng = np.random.default_rng(seed)
    x, triangles = rng.integers(-2, 3, (16, 3)).astype(float), soup(rng, 16, 16)
    x[:, 3 - flat :] = 0.0
    if turned:
        x = x @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pairs = twin(x, triangles)
    assert turned or len(pairs) > 20
    assert found(x, triangles) == pairs


@pytest.mark.parametrize("scale", [1e-2, 1e2])
def test_crumpled_sheets(scale):
    """The grid finds every pair that the twin finds, whether triangles are smaller or larger than cells."""
    rng = np.random.default_rng(0)
    x, triangles = sheet(8, 8)
    x = scale * (x + 0.8 * rng.normal(size=x.shape)) + 50.0
    pairs = twin(x, triangles)
    assert len(pairs) > 50
    assert found(x, triangles) == pairs


def test_triangles_of_very_different_size():
    rng = np.random.default_rng(1)
    x, triangles = sheet(7, 7)
    x = x * 10.0 ** rng.uniform(-3, 0, (len(x), 1)) + 0.1 * rng.normal(size=x.shape)
    pairs = twin(x, triangles)
    assert len(pairs) > 20
    assert found(x, triangles) == pairs


@pytest.mark.parametrize("edge", [[[1, 1, -1], [1, 1, 1]], [[1, 1, -1], [1, 1, 0]], [[1, 1, 0], [9, 9, 0]]])
@pytest.mark.parametrize("lift", [0.0, 2.0**-40, -(2.0**-40)])
def test_touching_counts_and_the_least_gap_does_not(edge, lift):
    """From one side through, up to it, or within its plane; with the triangle lifted off a little."""
    through = edge[0][2] < 0 < edge[1][2]
    up_to = edge[1][2] == 0 and edge[0][2] < 0
    listed = crosses(edge, np.add(TRIANGLE, [0, 0, lift]))
    assert listed == (through or lift == 0.0 or (up_to and lift < 0.0))


def test_every_way_of_touching():
    assert crosses([[2, 0, 0], [2, 0, 5]])  # an end on a side
    assert crosses([[0, 0, 0], [0, 0, 5]])  # an end on a corner
    assert crosses([[2, 0, -1], [2, 0, 1]])  # through a side
    assert crosses([[1, 1, 0], [1.5, 1, 0]])  # inside, in its plane
    assert crosses([[-1, 1, 0], [9, 1, 0]])  # across, in its plane
    assert crosses([[1, 0, 0], [2, 0, 0]])  # within a side
    assert crosses([[1, 1, 0], [1, 1, 0]])  # a point inside
    assert crosses([[0, 0, -1], [0, 0, 1]], [[0, 0, 0]] * 3)  # a triangle that is a point
    assert crosses([[1, 0, -1], [1, 0, 1]], [[0, 0, 0], [3, 0, 0], [2, 0, 0]])  # and one that is a line
    assert not crosses([[2, 2.5, -1], [2, 2.5, 1]])
    assert not crosses([[2, -(2.0**-40), -1], [2, -(2.0**-40), 1]])
    assert not crosses([[1, 1, 1], [1, 1, 1]])
    assert not crosses([[1, 1, 1], [1, 1, 5]])


def test_what_underflows_is_still_exact():
    tiny = np.array(TRIANGLE) * 2.0**-400
    assert crosses(np.array([[1, 1, -1], [1, 1, 1]]) * 2.0**-400, tiny)
    assert not crosses(np.array([[3, 3, -1], [3, 3, 1]]) * 2.0**-400, tiny)
    assert not crosses(np.array([[1, 1, 2.0**-600], [1, 1, 1]]), TRIANGLE)


def test_a_sheet_does_not_cross_itself_flat_tilted_or_bent():
    x, triangles = sheet(40, 40)
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    bent = np.stack([20 * np.sin(x[:, 0] / 20), x[:, 1], 20 * np.cos(x[:, 0] / 20)], axis=1)
    for shape in (x, x @ q + 3.0, bent, bent @ q):
        assert len(intersections(shape, triangles)) == 0


def test_a_fold_through_itself_is_found_where_it_is():
    x, triangles = sheet(30, 4)
    folded = x.copy()
    folded[:, 0] = 10 - np.abs(x[:, 0] - 14.5)
    folded[:, 2] = 0.1 * (x[:, 0] - 14.5)  # two layers, apart but at the fold
    assert len(intersections(folded, triangles)) == 0
    folded[5, 2] = -folded[5, 2] + 0.3  # one vertex pushed through the other layer
    edges = sides(triangles)
    pairs = intersections(folded, triangles)
    assert len(pairs) > 0
    assert all(5 in edges[e] or 5 in triangles[f] for e, f in pairs)


@pytest.mark.parametrize("cloth", [grid(resolution=(9, 7)), irregular()], ids=["grid", "irregular"])
def test_edges_are_numbered_as_those_of_the_world(cloth):
    mesh = build_mesh(sim.load_scene(scene(cloth, ball((9, 9, 9)))))
    x = mesh.vertices + 0.2 * np.random.default_rng(0).normal(size=mesh.vertices.shape)
    pairs, points = intersections(x, mesh.triangles), rational(x)
    assert len(pairs) > 20
    for e, f in pairs[:: len(pairs) // 20]:
        edge, corners = mesh.edges[e], mesh.triangles[f]
        assert squared_distance([points[i] for i in edge], [points[i] for i in corners]) == 0


def test_layers_on_each_other_and_none_at_all():
    x, triangles = sheet(6, 6)
    twice, both = np.concatenate([x, x]), np.concatenate([triangles, triangles + len(x)])
    assert found(twice, both) == twin(twice, both)
    assert intersections(x, np.zeros((0, 3), dtype=int)).shape == (0, 2)
    assert intersections(np.zeros((0, 3)), np.zeros((0, 3), dtype=int)).shape == (0, 2)
    assert len(intersections(np.zeros((9, 3)), np.arange(9).reshape(3, 3))) == 18  # all one point


def test_refusals_say_what_was_expected():
    x, triangles = sheet(3, 3)
    for value in (np.nan, np.inf):
        wrong = x.copy()
        wrong[4, 1] = value
        with pytest.raises(ValueError, match=r"^positions\[4\]: expected finite numbers, got "):
            intersections(wrong, triangles)
    with pytest.raises(ValueError, match=r"^positions: expected an array of shape \(n, 3\), got \(9, 2\)$"):
        intersections(x[:, :2], triangles)
    with pytest.raises(ValueError, match=r"^triangles: expected integers of shape \(m, 3\), got float64"):
        intersections(x, triangles * 1.0)
    with pytest.raises(ValueError, match=r"^triangles: expected vertices from 0 to 8, got 0 to 9$"):
        intersections(x, np.array([[0, 1, 9]]))
