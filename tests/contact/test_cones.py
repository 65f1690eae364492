"""Normal cones: what lies beside the nearest points of a pair, where the surface goes on, is no contact."""

import numpy as np
import pytest

from sim.contact.cones import around, in_cones

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float)
FACES = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int32)


def counts(other, node, weight, ridge=0.0):
    """Whether a pair of the square, bent along 1–2 to be so high a ridge, and the vertices `other` counts."""
    places = np.concatenate([SQUARE, other])
    places[1:3, 2] += ridge
    weight = np.array([weight], dtype=float)
    normal = np.einsum("ij,ijk->ik", weight, places[[node]])
    normal /= np.linalg.norm(normal)
    found = in_cones(around(FACES, len(places)), np.array([node]), weight, normal, places)
    return bool(found[0])


@pytest.mark.parametrize(("ridge", "expected"), [(0.0, False), (-0.5, False), (0.6, True)])
def test_where_triangles_join_a_vertex_beside_is_a_contact_only_of_a_ridge(ridge, expected):
    above = [[0.55, 0.55, 0.1 + ridge]]
    assert counts(above, [4, 1, 2, 0], [1, -0.5, -0.5, 0], ridge) is expected


def test_a_border_where_the_surface_ends_has_contacts_beside_it():
    assert counts([[0.5, -0.2, 0.1]], [4, 0, 1, 2], [1, -0.5, -0.5, 0])
    assert counts([[-0.2, -0.2, 0.1]], [4, 0, 1, 2], [1, -1, 0, 0])
    assert not counts([[0.5, 0.2, 0.1]], [4, 0, 1, 2], [1, -0.5, -0.5, 0])
    assert not counts([[0.2, 0.1, 0.1]], [4, 0, 1, 2], [1, -1, 0, 0])


def test_either_side_may_have_none():
    """The square's edge 1–2 ahead of the end of another: beside it both triangles are nearer to that end."""
    ahead = [[0.3, 0.3, 0.1], [-1.0, -1.0, 0.1]]
    for sign in (1.0, -1.0):
        assert not counts(ahead, [4, 5, 1, 2], sign * np.array([1, 0, -0.5, -0.5]))


def test_within_an_edge_that_no_triangle_has_a_pair_always_counts():
    """As within a triangle; what lies beside a joint of such edges, where the chain goes on, does not."""
    chain = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0.4, 0.1, 0.1]])
    edges = around(np.array([[0, 1, 1], [1, 2, 2]], dtype=np.int32), 4)
    for weight, expected in (([1, -0.6, -0.4], True), ([1, 0, -1], False)):
        normal = weight @ chain[[3, 0, 1]]
        normal /= np.linalg.norm(normal)
        about = np.array([[3, 0, 1, 0]]), np.array([[*weight, 0.0]]), normal[None]
        assert bool(in_cones(edges, *about, chain)[0]) is expected


def test_what_is_near_within_two_edges_or_a_triangle_always_counts():
    crossing = [[0.3, 0.3, 0.1], [0.9, 0.6, 0.1]]
    assert counts(crossing, [4, 5, 1, 2], [0.6, 0.4, -0.5, -0.5])
    assert counts([[0.3, 0.2, 0.1]], [4, 0, 1, 2], [1, -0.4, -0.3, -0.3])
