"""Shapes of obstacles, and where things stand."""

import numpy as np
import pytest
from fake_world import SCENE

from server.framing import Framing, hanging
from server.shapes import obstacle_mesh, quaternion, standing
from sim import load_scene
from sim.mesh import build_mesh
from sim.rotation import rotation_matrix
from sim.scene import Box, Capsule, Plane, Sphere

SOLIDS = [
    (Sphere(center=(1.0, 2.0, 3.0), radius=0.5), 4 / 3 * np.pi * 0.5**3),
    (Box(center=(1.0, 2.0, 3.0), size=(1.0, 2.0, 3.0)), 6.0),
    (Capsule(start=(0.0, 0.0, 0.0), end=(1.0, 1.0, 0.0), radius=0.2), np.pi * 0.04 * (2**0.5 + 4 / 3 * 0.2)),
]


@pytest.mark.parametrize(("solid", "volume"), SOLIDS, ids=lambda v: type(v).__name__)
def test_solids_enclose_their_volume_with_outward_triangles(solid, volume):
    vertices, triangles = obstacle_mesh(solid)
    a, b, c = np.moveaxis(vertices[triangles].astype(float), 1, 0)
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(volume, rel=0.01)


def test_capsule_and_plane_stand_as_the_scene_says():
    tilted = Plane(normal=(1.0, 0.0, 1.0))
    assert standing(tilted) @ [0, 0, 1] == pytest.approx(np.array([1.0, 0.0, 1.0]) / 2**0.5)
    lying = Capsule(start=(0.0, 0.0, 0.0), end=(0.0, 2.0, 0.0), radius=0.1)
    assert standing(lying) @ [0, 0, 1] == pytest.approx(np.array([0.0, 1.0, 0.0]))


@pytest.mark.parametrize(
    "vector", [(0, 0, 0), (1, 2, 3), (np.pi, 0, 0), (0, np.pi, 0), (0, 0, 3.1), (0.1, 0, 0)]
)
def test_quaternion_turns_as_the_matrix_does(vector):
    matrix = rotation_matrix(np.array(vector, float))
    w, *axis = quaternion(matrix)
    turned = [v + 2 * np.cross(axis, np.cross(axis, v) + w * v) for v in np.eye(3)]
    assert pytest.approx(matrix, abs=1e-12) == np.array(turned).T


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_camera_sees_every_variant(count, aspect):
    scene = load_scene(SCENE)
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, count)
    position, target = framing.camera(aspect, 0.6)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    for offset in framing.offsets:
        seen = mesh.vertices + offset - position
        depth = seen @ forward
        assert (depth > 0).all()
        assert (np.abs(seen @ right) <= depth * np.tan(0.3) * aspect * 1.001).all()
        assert (np.abs(seen @ up) <= depth * np.tan(0.3) * 1.001).all()


def test_variants_stand_from_left_to_right_and_apart():
    scene = load_scene(SCENE)
    framing = Framing(scene, build_mesh(scene), 4)
    position, target = framing.camera()
    right = np.cross(target - position, [0.0, 0.0, 1.0])
    across = framing.offsets @ (right / np.linalg.norm(right))
    assert (np.diff(across) >= 1.0).all()


def test_strip_that_is_seen_edge_on_has_room_for_its_label_above_it():
    scene = load_scene("strip")
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, 2)
    assert np.linalg.norm(np.diff(framing.offsets, axis=0)) >= 0.5 * np.ptp(mesh.vertices[:, 2])
    low, high = np.sort([mesh.vertices.mean(axis=0), hanging(mesh).mean(axis=0)], axis=0)
    assert (low[:2] - 1e-9 <= framing.label_place[:2]).all()
    assert (framing.label_place[:2] <= high[:2] + 1e-9).all()
