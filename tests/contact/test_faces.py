"""Faces of cloth against round shapes and boxes: the nearest points, the way, and whole scenes."""

import ipctk
import numpy as np
import pytest
import trimesh

import sim
from sim.contact import faces as module
from sim.contact import pipeline
from sim.contact.contacts import NO_CONTACTS
from sim.contact.faces import GAP, NEAR, REACH, ROOM, Faces
from sim.contact.obstacles import Obstacles
from sim.mesh import build_mesh
from sim.placement import pose
from sim.scene import Box, Capsule
from tests.contact.judge import EDGE_EDGE, VERTEX_TRIANGLE, distances
from tests.worlds import ball, grid, scene

G = 9.81
SHAPES = {
    "sphere": ball((0.1, 0, 0), 0.2),
    "capsule": {"kind": "capsule", "start": [-0.2, 0.1, 0], "end": [0.3, 0.2, 0.3], "radius": 0.05},
    "point": {"kind": "capsule", "start": [0, 0, 0], "end": [0, 0, 0], "radius": 0.1},
    "box": {"kind": "box", "center": [0, 0.1, 0], "size": [0.4, 0.6, 0.2]},
}
BOX = trimesh.creation.box((1, 1, 1))
H = 0.02
NOWHERE = np.zeros(3), np.eye(3)


def faces_of(part, triangle):
    loaded = sim.load_scene(scene({"vertices": triangle, "triangles": [[0, 1, 2]]}, part))
    obstacles = Obstacles(loaded)
    return Faces(build_mesh(loaded), np.ones(3, bool), obstacles, 0), obstacles, loaded.obstacle[0]


def distance(part, triangle, position, rotation):
    """Of a triangle from an obstacle in a pose, all pairs of features; a box is its twelve triangles."""
    corners = (np.asarray(triangle) - position) @ rotation
    sides = corners[[[0, 1], [1, 2], [2, 0]]]
    if isinstance(part, Box):
        core, faces, radius = BOX.vertices * part.size, BOX.faces, 0.0
        lines = core[BOX.edges_unique]
    else:
        half = 0.5 * np.linalg.norm(np.subtract(part.end, part.start)) if isinstance(part, Capsule) else 0.0
        core, faces, radius = np.array([[0, 0, -half], [0, 0, half]]), np.zeros((0, 3), int), part.radius
        lines = core[None]
    points = [np.concatenate([p[None], corners]) for p in core]
    points += [np.concatenate([p[None], core[f]]) for p in corners for f in faces]
    pairs = [np.concatenate([line, side]) for line in lines for side in sides]
    found = [distances(VERTEX_TRIANGLE, np.array(points)).min(), distances(EDGE_EDGE, np.array(pairs)).min()]
    return min(found) - radius


def outside(part, triangle, position, rotation):
    """Whether the triangle is outside of the obstacle: of a box, whether sampled points of it are."""
    if not isinstance(part, Box):
        return distance(part, triangle, position, rotation) > 0
    share = np.random.default_rng(0).dirichlet(np.ones(3), 1000)
    points = (share @ triangle - position) @ rotation
    return (np.abs(points) > np.array(part.size) / 2).any(axis=1).all()


@pytest.mark.parametrize("name", SHAPES)
def test_the_nearest_points_are_the_nearest_of_all_pairs_of_features(name):
    """And the plane between them keeps the gap that the contact says, at the place where the triangle is."""
    rng, seen = np.random.default_rng(0), 0
    for _ in range(200):
        triangle = rng.uniform(-0.5, 0.5, (1, 3)) + rng.uniform(-1, 1, (3, 3)) * 10 ** rng.uniform(-3, 0)
        faces, obstacles, part = faces_of(SHAPES[name], triangle)
        if not outside(part, triangle, *pose(part, 0.0)):
            continue
        poses = obstacles.poses(0.0)
        found = faces.begin(triangle, poses, poses, H, 10.0 / REACH, obstacles.shapes)
        seen += 1
        assert len(found.key) == 1
        assert found.start[0] == pytest.approx(distance(part, triangle, *pose(part, 0.0)), abs=1e-9)
        assert found.gaps(triangle)[0] == pytest.approx(found.start[0], abs=1e-12)
        assert found.weight.sum() == pytest.approx(1.0, abs=1e-12)
        assert (found.weight >= 0).all()
    assert seen > 60


def moving(part, seed):
    """The obstacle on its way over a step, turning; and a triangle's way."""
    rng = np.random.default_rng(seed)
    key = {"position": rng.uniform(-0.3, 0.3, 3).tolist(), "rotation": rng.uniform(-0.4, 0.4, 3).tolist()}
    middle = rng.uniform(-0.8, 0.8, (1, 3))
    start = middle + rng.uniform(-0.3, 0.3, (3, 3))
    end = start - 2.0 * middle + rng.uniform(-0.4, 0.4, (1, 3)) + rng.uniform(-0.1, 0.1, (3, 3))
    return {**part, "path": [{"time": 0.0}, {"time": H, **key}], "motion": "linear"}, start, end


@pytest.mark.parametrize("name", SHAPES)
def test_no_way_that_comes_nearer_than_the_gap_is_missed_and_none_that_stays_away_is_met(name):
    """Against samples of the way, seen from the obstacle; what is between one gap and two is left open."""
    met, seen, thickness = 0, 0, 0.05
    for seed in range(100):
        described, start, end = moving(SHAPES[name], seed)
        faces, obstacles, part = faces_of(described, start)
        (p, r), (q, s) = pose(part, 0.0), pose(part, H)
        if not outside(part, start, p, r):
            continue
        faces.begin(start, obstacles.poses(0.0), obstacles.poses(H), H, thickness, obstacles.shapes)
        found = len(faces.hits(end, obstacles.shapes).key) > 0
        a, b = (start - p) @ r, (end - q) @ s
        times = np.linspace(0, 1, 100)
        nearest = min(distance(part, a + t * (b - a), *NOWHERE) for t in times)
        gap = min(GAP * thickness, ROOM * distance(part, start, p, r))
        if nearest < gap:
            assert found, seed
        elif nearest > NEAR * gap + np.linalg.norm(b - a, axis=1).max() / len(times):
            assert not found, seed
        met, seen = met + found, seen + 1
    assert 10 < met < seen - 10


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("apart", [1e-6, 1e-9, 1e-12])
def test_what_all_but_touches_is_still_met(name, apart):
    """Held back over and over, cloth may come as near as rounding lets it: half of what is left each time."""
    rng, seen = np.random.default_rng(1), 0
    for _ in range(200):
        triangle = rng.uniform(-0.5, 0.5, (1, 3)) + rng.uniform(-1, 1, (3, 3)) * 10 ** rng.uniform(-1, 0)
        described = {**SHAPES[name], "path": [{"time": 0.0, "rotation": rng.uniform(-2, 2, 3).tolist()}]}
        faces, obstacles, _ = faces_of(described, triangle)
        poses = obstacles.poses(0.0)
        found = faces.begin(triangle, poses, poses, H, 10.0 / REACH, obstacles.shapes)
        if not len(found.key):  # they overlap
            continue
        near = triangle - (found.start - apart) * found.normal
        faces.begin(near, poses, poses, H, 1e-3, obstacles.shapes)
        assert len(faces.hits(near - 0.05 * found.normal, obstacles.shapes).key) == 1
        assert len(faces.hits(near + 0.05 * found.normal, obstacles.shapes).key) == 0
        seen += 1
    assert seen > 40


# Scenes


def gap_of(world):
    """Least distance of cloth from spheres and capsules [m]; of a box, 1 or −1 where they cross.

    It is −1, too, where what comes from above has cloth behind it that it must have passed.
    """
    x, least = world.positions, 1.0
    for part, (position, rotation) in zip(world.scene.obstacle, world.obstacle_poses(), strict=True):
        behind = position + np.outer([0.0, 10.0], [0.0, 0.0, 1.0])
        if len(part.path) > 1 and pierced(behind, x[world.triangles]) % 2:
            return -1.0
        if isinstance(part, Box):
            both = np.concatenate([x, BOX.vertices * part.size @ rotation.T + position])
            faces = np.concatenate([world.triangles, BOX.faces + len(x)])
            inside = (np.abs((x - position) @ rotation) < np.array(part.size) / 2).all(axis=1)
            least = min(least, -1.0 if inside.any() or crossings(both, faces, len(x)) else 1.0)
            continue
        half = 0.5 * np.linalg.norm(np.subtract(part.end, part.start)) if isinstance(part, Capsule) else 0.0
        ends, corners = position + np.outer([-half, half], rotation[:, 2]), x[world.triangles]
        for end in ends:
            points = np.broadcast_to(end, (len(corners), 1, 3))
            pairs = np.concatenate([points, corners], axis=1)
            least = min(least, distances(VERTEX_TRIANGLE, pairs).min() - part.radius)
        if half:
            axis = np.broadcast_to(ends, (len(world.edges), 2, 3))
            pairs = np.concatenate([axis, x[world.edges]], axis=1)
            least = min(least, distances(EDGE_EDGE, pairs).min() - part.radius)
            least = -1.0 if pierced(ends, corners) else least  # far from the sides, and yet through
    return least


def crossings(points, triangles, n):
    """How often the first n vertices' surface crosses the rest's; ipctk must agree where all is clean."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    found = sim.intersections(points, triangles)
    mesh = ipctk.CollisionMesh(points, edges, triangles)
    assert ipctk.has_intersections(mesh, points) == (len(found) > 0)
    return np.count_nonzero((edges[found[:, 0], 0] < n) != (triangles[found[:, 1], 0] < n))


def pierced(ends, corners):
    """How many triangles the segment runs through (Möller and Trumbore 1997)."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    way = ends[1] - ends[0]
    h, r = np.cross(way, v), ends[0] - a
    q, d = np.cross(r, u), np.einsum("ij,ij->i", u, h)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t, at = np.einsum("ij,ij->i", r, h) / d, q @ way / d, np.einsum("ij,ij->i", v, q) / d
    return np.count_nonzero((s >= 0) & (t >= 0) & (s + t <= 1) & (at >= 0) & (at <= 1))


TRIANGLE = 0.0133, 0.0067
"""Middle of a triangle, 9.4 mm from its nearest vertex."""


def shot(speed, start=0.3, turn=0.0):
    """A path through z = 0, from z = start to −start."""
    first, last = ([*TRIANGLE, z] for z in (start, -start))
    keys = [{"time": 0.0, "position": first}]
    keys += [{"time": 2 * start / speed, "position": last, "rotation": [0.0, 0.0, turn]}]
    return {"path": keys, "motion": "linear"}


SHEET = {"size": (0.4, 0.4), "resolution": (21, 21)}
"""Of 20 mm edges."""

FALLING = grid(**SHEET, position=[0.007, 0.004, 0.03])
HELD = grid(**SHEET, pins=["left", "right"])
COARSE = grid(resolution=(15, 15), pins=["left", "right"])
UPRIGHT = {"kind": "capsule", "start": [0.003, 0.004, -0.5], "end": [0.003, 0.004, 0.0], "radius": 0.001}
LYING = {"kind": "capsule", "start": [-0.3, 0.004, -0.01], "end": [0.3, 0.009, 0.0], "radius": 0.001}
SHORT = {"kind": "capsule", "start": [0, 0, -0.1], "end": [0, 0, 0.1], "radius": 0.002}
CUBE = {"kind": "box", "size": [0.2, 0.2, 0.2]}
CORNER = [{"time": 0.0, "rotation": [0.6155, 0.6155, 0.3]}]  # a corner points up, about
EDGE = [{"time": 0.0, "rotation": [np.pi / 4, 0, 0]}]
PLATE = {"kind": "box", "center": [0, 0, 0], "size": [0.15, 0.002, 0.1]}
CASES = {
    "a small ball under a falling sheet": (FALLING, ball(radius=0.003)),
    "a small ball at 10 m/s": (HELD, ball(radius=0.003, **shot(10.0))),
    "a ball at 100 m/s": (COARSE, ball(radius=0.05, **shot(100.0, 0.5))),
    "the end of a needle": (FALLING, UPRIGHT),
    "a rod edge-on": (FALLING, LYING),
    "a needle at 10 m/s": (HELD, {**SHORT, **shot(10.0)}),
    "a box with a corner up": (FALLING, {**CUBE, "center": [0.003, 0.002, -0.17], "path": CORNER}),
    "a box with an edge up": (FALLING, {**CUBE, "center": [0, 0.003, -0.15], "path": EDGE}),
    "a plate edge-on at 10 m/s": (HELD, {**PLATE, **shot(10.0, turn=2.0)}),
}

STEPS, SHOT = 30, 12
"""Steps of a fall, and of a shot, which is over in four."""


def run(case, **settings):
    """Least of all gaps at the ends of steps, and the reports."""
    cloth, part = CASES[case]
    dt = 1 / 30 if "100 m/s" in case else 1 / 60
    world = sim.Simulation(scene(cloth, part, **{"gravity": [0, 0, -G], "dt": dt, **settings}))
    assert gap_of(world) > 0
    least, reports = np.inf, []
    for _ in range(SHOT if "m/s" in case else STEPS):
        reports.append(world.step())
        assert np.isfinite(world.positions).all()
        least = min(least, gap_of(world))
    return least, reports


@pytest.mark.parametrize("own", ["off", "on"])
@pytest.mark.parametrize("case", CASES)
def test_no_triangle_meets_what_is_finer_than_the_sheet(case, own):
    least, reports = run(case, self_collision=own)
    assert least > 0.0
    assert max(report.penetrations for report in reports) == 0


@pytest.mark.parametrize("case", CASES)
def test_the_same_scenes_fail_where_only_vertices_are_looked_at(case, monkeypatch):
    monkeypatch.setattr(Faces, "_found", lambda *_, **more: NO_CONTACTS)
    assert run(case, self_collision="off")[0] <= 0.0


@pytest.mark.parametrize("case", ["a small ball at 10 m/s", "a plate edge-on at 10 m/s"])
def test_the_last_resort_alone_holds_cloth_before_an_obstacle_that_moves(case, monkeypatch):
    """Without rounds of impulses, and in whole steps: vertices that would meet it go along with it."""
    monkeypatch.setattr(pipeline, "MOST_ROUNDS", 0)
    monkeypatch.setattr(pipeline, "MOST_HALVINGS", 0)
    least, reports = run(case, self_collision="off", friction=0.0)
    assert max(report.held_back for report in reports) > 0
    assert least > 0.0


def test_a_large_ball_has_no_contact_more_than_its_vertices_have(monkeypatch):
    """Chords of 16 mm cut 0.2 mm into a thickness of 2 mm: no face has a contact of its own."""
    found, search = [], Faces._found

    def counted(*args, **more):
        found.append(search(*args, **more))
        return found[-1]

    monkeypatch.setattr(module.Faces, "_found", counted)
    cloth = grid(resolution=(63, 63), position=[0, 0, 0.32])
    world = sim.Simulation(scene(cloth, ball(), gravity=[0, 0, -G], thickness=2e-3))
    contacts = [world.step().contacts for _ in range(30)]
    assert contacts[-1] > 100
    assert len(found) > 30
    assert sum(len(contact.key) for contact in found) == 0


def test_bare_edges_meet_a_rod_between_their_vertices():
    points = [[x, 0.0, 0.01] for x in np.linspace(-0.1, 0.1, 6)]
    chain = {"vertices": points, "edges": [[k, k + 1] for k in range(5)]}
    rod = {"kind": "capsule", "start": [0.01, -0.1, 0], "end": [0.01, 0.1, 0], "radius": 0.001}
    world = sim.Simulation(scene(chain, rod, gravity=[0, 0, -G]))
    axis = np.broadcast_to([rod["start"], rod["end"]], (5, 2, 3))
    for _ in range(20):
        world.step()
        pairs = np.concatenate([axis, world.positions[world.edges]], axis=1)
        assert distances(EDGE_EDGE, pairs).min() > rod["radius"]
    assert world.positions[:, 2].min() < -0.05
