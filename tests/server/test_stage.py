"""Shapes of obstacles, and where things stand."""

import numpy as np
import pytest
import viser
from fake_world import SCENE

from server.framing import Framing, droop, hanging, obstacle_corners, swung
from server.lane import Frame
from server.shapes import obstacle_mesh, quaternion, standing
from server.stage import Place
from sim import load_scene
from sim.mesh import build_mesh
from sim.placement import pose
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


WEDGE = {
    "vertices": [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 0.5]],
    "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    "position": [1.0, 2.0, 0.0],
    "rotation": [0.0, 0.0, np.pi / 2],
    "path": [{"time": 0.0}, {"time": 1.0, "position": [4.0, 2.0, 0.0]}],
}


def test_a_mesh_is_drawn_as_it_is_stands_as_it_is_turned_and_is_seen_along_its_path():
    scene = load_scene({**SCENE, "obstacle": [WEDGE]})
    (part,), (shell,) = scene.obstacle, build_mesh(scene).shells
    vertices, triangles = obstacle_mesh(part, shell)
    np.testing.assert_array_equal(vertices[triangles], np.array(WEDGE["vertices"])[WEDGE["triangles"]])
    assert standing(part) @ [1, 0, 0] == pytest.approx(np.array([0.0, 1.0, 0.0]), abs=1e-12)
    corners = obstacle_corners(part, shell)
    assert corners.min(axis=0) == pytest.approx(np.array([-1.0, 2.0, 0.0]), abs=1e-12)
    assert corners.max(axis=0) == pytest.approx(np.array([4.0, 3.0, 0.5]), abs=1e-12)


def test_what_turns_is_seen_half_way():
    turning = [{"time": 0.0}, {"time": 1.0, "rotation": [0.0, -np.pi, 0.0]}]
    arm = {
        "kind": "capsule",
        "start": [0.0, 0.0, 0.0],
        "end": [2.0, 0.0, 0.0],
        "radius": 0.1,
        "path": turning,
    }
    (part,) = load_scene({**SCENE, "obstacle": [arm]}).obstacle
    corners = obstacle_corners(part)
    assert corners.min(axis=0) == pytest.approx(np.array([-0.1, -0.1, -1.1]), abs=1e-12)
    assert corners.max(axis=0) == pytest.approx(np.array([2.1, 0.1, 1.1]), abs=1e-12)


def test_a_mesh_moves_on_the_stage_as_the_simulation_has_it():
    """The drawn node takes the frame's pose, as that of every other obstacle does."""
    scene = load_scene({**SCENE, "obstacle": [WEDGE]})
    mesh, server = build_mesh(scene), viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        place = Place(server.scene, "/take", 0, scene, mesh, Framing(scene, mesh, 1))
        position, rotation = pose(scene.obstacle[0], 0.5)
        place.show(Frame(positions=mesh.vertices, poses=[(position, rotation)]))
        node = place._moving[0]
        assert node.position == pytest.approx(position)
        assert node.wxyz == pytest.approx(quaternion(rotation))
        assert node.vertices.shape == (4, 3)
    finally:
        server.stop()


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


@pytest.mark.parametrize("labels", [0.12, 0.3])
@pytest.mark.parametrize("covered", [0.0, 0.4])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_camera_sees_every_variant_below_labels_and_above_what_covers_the_view(
    count, aspect, covered, labels
):
    scene = load_scene(SCENE)
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, count)
    position, target = framing.camera(aspect, 0.6, covered, labels)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    lowest = 2.0 * covered - 1.0
    for offset in framing.offsets:
        seen = mesh.vertices + offset - position
        depth = seen @ forward
        assert (depth > 0).all()
        assert (np.abs(seen @ right) <= depth * np.tan(0.3) * aspect * 1.001).all()
        heights = seen @ up / (depth * np.tan(0.3))
        assert (heights <= 1.001).all()
        assert (heights >= lowest - 0.001).all()
        label = framing.label_place + offset - position
        assert label @ up / (label @ forward * np.tan(0.3)) <= 1.001 - 2.0 * labels


CHAIN = {"vertices": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]], "edges": [[0, 1], [1, 2]]}
WEIGHTLESS = {"gravity": [0.0, 0.0, 0.0]}

THIN = {
    "a spring across": {"vertices": [[0, 0, 1], [1, 0, 1]], "edges": [[0, 1]]},
    "a spring towards the camera": {"vertices": [[0, 0, 1], [-0.25, 1, 0.58]], "edges": [[0, 1]]},
    "a level spring away from the camera": {"vertices": [[0, 0, 1], [0, 1, 1]], "edges": [[0, 1]]},
    "an upright spring": {"vertices": [[0, 0, 1], [0, 0, 0]], "edges": [[0, 1]]},
    "a point": {"vertices": [[0, 0, 0]]},
    "a chain": CHAIN,
}


def seen(framing, points, aspect=0.94):
    """Where on the screen points of every variant are, as shares of half its width and half its height."""
    position, target = framing.camera(aspect, 0.6)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    points = (points + framing.offsets[:, None]).reshape(-1, 3) - position
    half = points @ forward * np.tan(0.3)
    return np.stack([points @ right / (half * aspect), points @ np.cross(right, forward) / half], axis=1)


@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize("settings", [{}, WEIGHTLESS], ids=["falling", "weightless"])
@pytest.mark.parametrize("cloth", THIN.values(), ids=THIN)
def test_thin_scenes_are_seen_whole_and_large_with_room_for_labels(cloth, settings, count):
    scene = load_scene({**SCENE, "cloth": cloth, "obstacle": [], "settings": settings})
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, count)
    bar = framing.label_place + np.outer([-0.5, 0.5], framing.bar)
    places = seen(framing, np.concatenate([mesh.vertices, bar]))
    assert (np.abs(places) <= 1.0).all()
    assert np.ptp(places, axis=0).max() > 0.4, "of 2"
    assert np.ptp(places[:, 0]) > 0.1 * count, "and labels do not lie over each other"
    assert framing.scale > 0


@pytest.mark.parametrize("cloth", THIN.values(), ids=THIN)
def test_label_is_seen_above_its_cloth(cloth):
    scene = load_scene({**SCENE, "cloth": cloth, "obstacle": []})
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, 1)
    label = seen(framing, framing.label_place[None])
    assert label[0, 1] > seen(framing, mesh.vertices)[:, 1].max()


def test_pendulum_is_seen_on_its_other_side_too():
    scene = load_scene({**SCENE, "cloth": {**CHAIN, "pins": [0]}, "obstacle": []})
    mesh = build_mesh(scene)
    framing = Framing(scene, mesh, 2)
    other_side = mesh.vertices * [-1.0, 1.0, 1.0]
    below = np.array([[0.0, 0.0, -1.0]])
    assert (np.abs(seen(framing, np.concatenate([other_side, below]))) <= 1.0).all()
    assert framing.label_place[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_cloth_with_two_pins_does_not_swing_round_either():
    scene = load_scene({**SCENE, "cloth": {**CHAIN, "pins": [0, 2]}})
    assert len(swung(build_mesh(scene), np.array([0.0, 0.0, -1.0]))) == 0


def test_heavy_spring_stays_above_the_ground_when_it_is_let_go():
    cloth = {"vertices": [[0, 0, 1], [0, 0, 0]], "edges": [[0, 1]], "masses": [0.5, 0.5], "pins": [0]}
    settings = {"stretch": 50.0, "gravity": [0.0, 0.0, -10.0]}
    scene = load_scene({**SCENE, "cloth": cloth, "obstacle": [], "settings": settings})
    assert droop(scene, build_mesh(scene)) == pytest.approx(0.2), "twice 5 N over 50 N"
    assert Framing(scene, build_mesh(scene), 2).floor < -0.3


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
    low, high = np.sort(
        [mesh.vertices.mean(axis=0), hanging(mesh, np.array([0.0, 0.0, -1.0])).mean(axis=0)], axis=0
    )
    assert (low[:2] - 1e-9 <= framing.label_place[:2]).all()
    assert (framing.label_place[:2] <= high[:2] + 1e-9).all()
