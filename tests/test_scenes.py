"""Every scene that comes with Muslin, stepped headless to numbers that physics gives.

One test runs all of them in all the variants that they compare; then each scene is held to its own lesson.
"""

import re
import tomllib

import msgspec
import numpy as np
import pytest

import sim
from sim.effects import chosen, effects_with
from sim.scene import scene_files
from sim.studies import STUDIES, cantilever, lumping, oscillator
from tests.test_collision_scenes import KEPT

ROUND_OFF = 1e-12
"""Distances that differ by less than this [m] are the same: positions are about 1 m in double precision."""


def run(scene, seconds, **settings):
    """Step a scene; returns the simulation, its reports, and its total energy [J] at the start and after."""
    world = sim.Simulation(scene, **settings)
    reports, energies = [], [sum(world.energy().values())]
    while world.time < seconds - ROUND_OFF:
        reports.append(world.step())
        energies.append(sum(world.energy().values()))
    return world, reports, np.array(energies)


def strains(world):
    """Relative change of length of each edge."""
    now, rest = (
        np.linalg.norm(np.diff(points[world.edges], axis=1)[:, 0], axis=1)
        for points in (world.positions, world.mesh.rest_vertices)
    )
    return now / rest - 1.0


def variants():
    for path in scene_files():
        compare = sim.load_scene(path.stem).compare
        yield from (pytest.param(path.stem, {compare.by: value}) for value in compare.values)


@pytest.mark.parametrize("path", scene_files(), ids=lambda path: path.stem)
def test_a_scene_carries_what_its_audit_recommends(path):
    """With figures, in a comment that is a table of effects if uncommented; or it needs them all."""
    lines = path.read_text(encoding="utf-8").splitlines()
    (first,) = (k for k, line in enumerate(lines) if line.startswith(f"# muslin audit {path.stem} over "))
    words = " ".join(line.lstrip("# ") for line in lines[first:])
    if " it needs every effect that runs." in words or "nothing else that would save" in words:
        return
    assert re.search(r"moves the cloth by \d+(\.\d+)? % and (takes \d+ % off a step|saves nothing)", words)
    (table,) = (k for k, line in enumerate(lines) if line.endswith("[effects]"))
    block = "\n".join(line.removeprefix("# ") for line in lines[table:])
    effects = tomllib.loads(block)["effects"]
    scene = sim.load_scene(path)
    assert effects
    assert chosen(scene.settings, effects, effects_with(scene.obstacle_labels))


LARGEST_STRAIN = 0.1
"""Cloth that stretches or shrinks more than this by the weight of itself looks like rubber."""

RUBBER = {"oscillator": 0.51, "interference": 0.6, "needle": 0.4, "bullet": 0.3, "spin": 0.25}
RUBBER |= {"response": 0.5, "stack": 0.2}
"""Scenes whose cloth is soft, hangs from a point, is pushed far or thrown, or tangles, and by how much."""

FASTEST = 8.0
"""Free fall from the highest scene's cloth to the floor ends at 4.6 m/s [m/s]; faster is an explosion."""

SHOT = {"bullet": 18.0}
"""Scenes with an obstacle that is faster than that, and how fast it makes the cloth [m/s]."""


UNBOOKED = 4e-3
"""Part of all energy that went from one kind to another which the ledger may not know of.

It is what the solver's tolerance leaves of the motion's equation: 2.8e-3 at worst, in response by penalty."""


@pytest.mark.parametrize(("scene", "settings"), list(variants()))
def test_the_first_two_seconds_of_every_variant_are_calm(scene, settings):
    """No step fails, nothing flies apart, cloth keeps its size, impulses let nothing in; energy adds up."""
    world = sim.Simulation(scene, **settings)
    world.keep_ledger()
    while world.time < 2.0:
        report = world.step()
        assert report.residual <= world.settings.tolerance
        assert np.abs(world.velocities).max() < SHOT.get(scene, FASTEST)
        if world.settings.contact == "impulse" and world.settings.detection == "continuous":
            assert report.penetrations == 0
    ledger = world.ledger
    assert abs(ledger.residual) <= UNBOOKED * ledger.turnover
    assert np.abs(strains(world)).max() < RUBBER.get(scene, LARGEST_STRAIN)


@pytest.mark.parametrize(
    ("scene", "settings"), [("flag", {"drag": 0.0}), ("response", {"contact": "penalty"})]
)
def test_what_the_ledger_does_not_know_of_goes_with_the_tolerance(scene, settings):
    world = sim.Simulation(scene, **settings, tolerance=1e-6)
    world.keep_ledger()
    while world.time < 2.0:
        world.step()
    assert abs(world.ledger.residual) <= 1e-2 * UNBOOKED * world.ledger.turnover  # as of the usual tolerance


# Drape


@pytest.fixture(scope="module")
def draped():
    return {
        "impulse": run("drape", 2.5, contact="impulse"),
        # Without self-collision, or its folds would tangle; without jitter all four lie in the same odd fold.
        "penalty": run("drape", 2.5, contact="penalty", self_collision="off", jitter=1e-3),
    }


def radius_in_drape(world):
    ball = world.scene.obstacle[0]
    return np.linalg.norm(world.positions - np.array(ball.center), axis=1).min(), ball.radius


FOLDS = 0.04
"""Folds lift a corner from where a flat diagonal would end, and its weight lowers it, by up to this [m]."""


@pytest.mark.parametrize("contact", ["impulse", "penalty"])
def test_the_corners_of_the_drape_hang_where_its_diagonal_ends(draped, contact):
    """Half a diagonal lies on a quarter of the ball's girth; the rest hangs straight down from its waist."""
    world = draped[contact][0]
    ball, side = world.scene.obstacle[0], world.scene.cloth[0].size[0]
    around = 0.5 * np.pi * (ball.radius + world.settings.thickness)
    lowest = ball.center[2] - (side / 2**0.5 - around)
    assert world.positions[:, 2].min() == pytest.approx(lowest, abs=FOLDS)


def test_impulses_keep_the_drape_outside_the_ball_at_every_step(draped):
    world, reports, _ = draped["impulse"]
    assert max(report.deepest for report in reports) == 0.0
    nearest, radius = radius_in_drape(world)
    assert nearest >= radius + world.settings.thickness - ROUND_OFF


def test_penalty_springs_let_the_drape_sink_in_where_it_lands_as_the_lesson_says(draped):
    world, reports, _ = draped["penalty"]
    assert 0.005 < max(report.deepest for report in reports) < 0.05
    nearest, radius = radius_in_drape(world)
    assert nearest < radius


def test_the_drape_comes_to_rest(draped):
    """At rest its energy is a thousandth of the 1.1 J that it lost."""
    for world, _, energies in draped.values():
        assert world.energy()["kinetic"] < 1e-3 * (energies[0] - energies[-1])


LINEARISED = 1e-3
"""One Newton iteration per step of 1/480 s may err by this much [J] where the drape lands, of 3 J.

The error falls steeply with the step: 1.3 J at 1/60 s, 0.4 J at 1/120 s, 0.03 J at 1/240 s.
"""


def test_the_drape_only_loses_energy_in_small_steps():
    _, _, energies = run("drape", 1.0, dt=1 / 480)
    assert np.diff(energies).max() < LINEARISED
    assert energies.max() < energies[0] + LINEARISED


# Curtain


def test_the_curtains_pins_do_not_move_a_bit():
    world = sim.Simulation("curtain")
    pinned = world.positions[world.pinned].copy()
    assert len(pinned) == 2
    for _ in range(60):
        world.step()
        assert np.array_equal(world.positions[world.pinned], pinned)


def test_the_curtain_is_pushed_out_by_the_ball_and_falls_back():
    """At 1.5 s the ball is furthest and has cloth on its far side; at 3 s it is back where it began."""
    world, reports, _ = run("curtain", 1.5)
    ball = world.scene.obstacle[0]
    assert np.allclose(world.obstacle_poses()[0][0], ball.path[1].position, atol=ROUND_OFF)
    touching = ball.path[1].position[1] + ball.radius + world.settings.thickness
    assert world.positions[:, 1].max() >= touching - 1e-3
    while world.time < 3.0 - ROUND_OFF:
        reports.append(world.step())
    assert max(report.deepest for report in reports) == 0.0
    assert world.positions[:, 1].max() < 0.1


# Flag


def test_the_flag_flies_in_the_wind_and_hangs_without():
    """Half its width out on average, as one would say that a flag flies; hanging it is a fifth at most."""
    out = {}
    for drag in (0.0, 1.2):
        world, reports, _ = run("flag", 2.0, drag=drag)
        tip = world.positions[:, 0].max()
        out[drag] = [tip]
        while world.time < 4.0:
            reports.append(world.step())
            out[drag].append(world.positions[:, 0].mean())
        assert (sum(report.wind_work for report in reports) > 0.0) == (drag > 0.0)
    assert np.mean(out[1.2][1:]) > 0.6
    assert np.mean(out[0.0][1:]) < 0.45


# Strip


def middle_row(world):
    """Positions along the middle of the strip, from the clamp to the tip."""
    rest = world.mesh.rest_vertices
    middle = np.flatnonzero(rest[:, 1] == np.unique(rest[:, 1])[world.scene.cloth[0].resolution[1] // 2])
    return world.positions[middle[np.argsort(rest[middle, 0])]]


def curvature(row):
    """Mean turn per length [1/m] of a row of points in the x–z plane, its ends left out; up is positive."""
    steps = np.diff(row[:, [0, 2]], axis=0)
    turn = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return (turn[-5] - turn[5]) / np.linalg.norm(steps[5:-5], axis=1).sum()


WIDTH_STIFFENS = 0.15
"""Share of its curl that the width takes: it curls a little across as well, which holds it straight along."""


@pytest.mark.parametrize("rest_angle", [0.03, -0.03])
def test_a_weightless_strip_curls_as_tight_as_its_hinges_want(rest_angle):
    """On a cylinder of curvature κ, hinges aslant fold by κ a/√3 and those along it by −κ a/(2√3).

    The least ½ Σ (θ − θ₀)² over one hinge of each direction is at κ = 2 θ₀/(√3 a), with triangles of side a.
    """
    world, _, _ = run("strip", 3.0, gravity=(0, 0, 0), gamma=1.0, rest_angle=rest_angle)
    side = world.scene.cloth[0].size[0] / (world.scene.cloth[0].resolution[0] - 1)
    wanted = 2.0 * rest_angle / (3.0**0.5 * side)
    assert curvature(middle_row(world)) == pytest.approx(wanted, rel=WIDTH_STIFFENS)


def test_cross_springs_do_not_know_to_which_side_to_curl():
    """Cloth that is flat to the bit stays so, for either sign of the rest angle and in the same way."""
    strip = sim.load_scene("strip")
    level = msgspec.structs.replace(strip.cloth[0], rotation=(0.0, 0.0, 0.0))
    scene = msgspec.structs.replace(strip, cloth=[level])
    ends = [
        run(scene, 0.5, gravity=(0, 0, 0), bend="cross", rest_angle=angle)[0].positions
        for angle in (0.08, -0.08)
    ]
    assert np.array_equal(*ends)
    assert np.ptp(ends[0][:, 2]) == 0.0


@pytest.mark.parametrize("sign", [1, -1])
def test_the_hanging_strips_tip_curls_to_the_side_of_its_rest_angle(sign):
    """It hangs from its left end, its upper side to the right: a positive angle turns the tip that way."""
    angle = sign * sim.load_scene("strip").settings.rest_angle
    row = middle_row(run("strip", 3.0, rest_angle=angle)[0])
    along = np.diff(row, axis=0)
    lean = np.arctan2(along[:, 0], -along[:, 2])  # from straight down towards positive x
    assert sign * (lean[-1] - lean[len(lean) // 2]) > 0.3


# Tablecloth from a mesh file


def test_the_tablecloth_weighs_what_an_oval_of_its_size_weighs():
    """Its rim is a polygon of about a hundred sides in an ellipse, which is smaller by 2 π² / (3 · 100²)."""
    world = sim.Simulation("meshcloth")
    oval = np.pi * 0.72 * 0.56 * world.settings.density
    assert world.masses.sum() == pytest.approx(oval, rel=1e-3)
    assert world.masses.sum() < oval


def test_the_tablecloth_is_no_grid():
    """Its edges differ fivefold in length, and its vertices in their number of neighbours."""
    world = sim.Simulation("meshcloth")
    lengths = np.linalg.norm(np.diff(world.positions[world.edges], axis=1)[:, 0], axis=1)
    assert lengths.max() > 5 * lengths.min()
    assert len(np.unique(np.bincount(world.edges.ravel()))) >= 6
    assert 1000 < len(world.positions) < 1300


def test_the_tablecloth_hangs_still_over_its_bolster():
    """On both sides it reaches below the capsule's middle, and has swung out to 2 cm/s on average in 4 s."""
    world, _, energies = run("meshcloth", 4.0)
    bolster = world.scene.obstacle[0]
    beside = np.abs(world.positions[:, 0]) > bolster.radius
    left, right = (world.positions[beside & (sign * world.positions[:, 0] > 0), 2] for sign in (-1, 1))
    assert min(len(left), len(right)) > 100
    assert max(left.min(), right.min()) < bolster.start[2]
    assert np.sqrt(2.0 * world.energy()["kinetic"] / world.masses.sum()) < 0.02
    assert energies[-1] < energies[0]


# Oscillator


@pytest.mark.parametrize("gamma", [0.2, 1.0, 2.0])
def test_the_oscillators_springs_move_as_their_closed_forms_say(gamma):
    """In 4 s, at steps of 1/60 s and ω h = 0.1, SDIRK2 errs by 0.5 mm at most, of 0.5 m."""
    world = sim.Simulation("oscillator", gamma=gamma)
    assert np.array_equal(world.pinned, [0])
    pulled = -world.positions[1, 2] + 0.6
    omega = (world.settings.stretch / world.masses[1]) ** 0.5
    assert 2 * np.pi / omega == pytest.approx(1.0, abs=0.05)  # a period that one can watch
    roots = oscillator.roots(gamma, omega)
    while world.time < 4.0:
        world.step()
        expected = pulled * oscillator.released(world.time, *roots)
        assert 0.6 - world.positions[1, 2] == pytest.approx(expected, abs=5e-4)


def test_the_critical_spring_is_the_first_to_come_to_rest():
    """The time after which they stay within 1 cm of the end."""
    settled = {}
    for gamma in (0.2, 1.0, 2.0):
        world = sim.Simulation("oscillator", gamma=gamma)
        while world.time < 4.0:
            if abs(world.step() and world.positions[1, 2] - 0.6) > 0.01:
                settled[gamma] = world.time
    assert settled[1.0] < 1.0 < min(settled[0.2], settled[2.0])


# Ghost


def ghost(seconds, **settings):
    """How far the middle of the fold goes [m], and how far any of its vertices."""
    world, _, _ = run("ghost", seconds, **settings)
    start = world.mesh.vertices
    middle = np.linalg.norm((world.positions - start).mean(axis=0))
    return middle, np.abs(world.positions - start).max()


def test_a_fold_held_by_a_strut_stays_where_it_is_with_angle_springs():
    """Its edges give way by a few millimetres; its middle does not move."""
    middle, farthest = ghost(2.0, bend="angle")
    assert middle < ROUND_OFF
    assert farthest < 5e-3


def test_ad_hoc_forces_carry_the_fold_off_or_turn_it_on_the_spot():
    assert ghost(2.0, bend="adhoc")[0] > 0.3
    for rule in ("half", "lever"):
        middle, farthest = ghost(3.0, bend="adhoc", adhoc_rule=rule)
        assert middle < ROUND_OFF
        assert farthest > 0.15


def test_where_the_rest_angle_is_that_of_the_strut_there_is_no_ghost():
    assert max(ghost(2.0, bend="adhoc", rest_angle=np.pi / 3)) < 1e-5


# Cantilever


def end_of_cantilever(world):
    """Drop and reach of the strip's end, from half a row inside its clamp, over its length from there."""
    rest, row = world.mesh.rest_vertices[:, 1], np.diff(np.unique(world.mesh.rest_vertices[:, 1]))[0]
    end = world.positions[rest > rest.max() - 0.5 * row].mean(axis=0)
    clamp = world.positions[rest < rest.min() + 1.5 * row].max(axis=0)
    length = np.ptp(rest) - 0.5 * row
    return (clamp[2] - end[2]) / length, (end[0] - clamp[0] + 0.5 * row) / length, length


@pytest.mark.parametrize("kind", ["modified", "angle"])
def test_the_cantilever_hangs_as_the_elastica_does(kind):
    """D = c/2; its triangles are nearly equilateral, and it is narrow: it may err by 3 %."""
    world = sim.equilibrium("cantilever", bend=kind)
    *end, length = end_of_cantilever(world)
    weight = world.settings.density * 9.81 * length**3 / (0.5 * world.settings.bending)
    assert end == pytest.approx(cantilever.elastica(weight), rel=0.03)


@pytest.mark.parametrize("rest_angle", [0.0, 0.1])
def test_a_cantilever_of_cross_springs_falls_whatever_its_rest_angle(rest_angle):
    world, _, _ = run("cantilever", 4.0, bend="cross", rest_angle=rest_angle, gamma=1.0)
    assert end_of_cantilever(world)[0] > 0.85


def test_a_rest_angle_lifts_the_end_of_a_cantilever_of_angle_springs():
    assert end_of_cantilever(sim.equilibrium("cantilever", bend="angle"))[0] > 0.4
    assert end_of_cantilever(sim.equilibrium("cantilever", bend="angle", rest_angle=0.1))[0] < 0.0


# Interference


def test_only_cross_springs_shorten_the_soft_cloth():
    """Lengths after 5 s: those with modified springs and with none agree to what still moves."""
    lengths = {}
    for kind in ("none", "modified", "angle", "cross"):
        world, _, _ = run("interference", 5.0, bend=kind, tolerance=1e-6)
        lengths[kind] = np.ptp(world.positions[:, 2])
    natural = np.ptp(sim.Simulation("interference").mesh.vertices[:, 2])
    assert lengths["modified"] == pytest.approx(lengths["none"], abs=1e-6)
    assert lengths["angle"] == pytest.approx(lengths["none"], abs=1e-6)
    assert lengths["none"] - natural > 3 * (lengths["cross"] - natural)


# Lumping


@pytest.mark.parametrize("mass", ["area", "constant"])
def test_the_panel_hangs_with_its_centre_of_mass_below_its_pin(mass):
    """Level, to the sag of its upper edge, with masses by area; with constant ones by 11.5° askew."""
    world = sim.equilibrium("lumping", mass=mass)
    upper = world.positions[world.mesh.vertices[:, 2] == world.mesh.vertices[:, 2].max()]
    across = upper[-1] - upper[0]
    askew = np.degrees(np.arctan2(across[2], across[0]))
    expected, _ = lumping.rigid_panel(world.mesh.vertices + np.array([0.5, 0.0, 0.0]), world.masses)
    assert askew == pytest.approx(-expected, abs=0.01)
    assert abs(askew) < 0.01 if mass == "area" else askew > 11.0


# Needle


def crossings(world):
    """(needle, knife) how many edges and triangles of cloth and each obstacle cross."""
    obstacles, n = world.contact.obstacles, len(world.positions)
    solid = obstacles.solid
    x = np.concatenate([world.positions, obstacles.corners(obstacles.poses(world.time))])
    triangles = np.concatenate([world.triangles, solid.triangles + n])
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    found = sim.intersections(x, triangles)
    first = np.stack([edges[found[:, 0], 0], triangles[found[:, 1]].min(axis=1)], axis=1)
    mixed = first[(first < n).sum(axis=1) == 1].max(axis=1)
    needle = len(world.mesh.shells[0].vertices)
    return np.count_nonzero(mixed < n + needle), np.count_nonzero(mixed >= n + needle)


def most_crossings(seconds=0.6, **settings):
    world, found = sim.Simulation("needle", **settings), []
    while world.time < seconds:
        world.step()
        found.append(crossings(world))
    return np.max(found, axis=0)


def test_needle_and_knife_go_through_the_sheet_that_looks_once_per_step_only():
    assert not most_crossings(detection="continuous").any()
    assert (most_crossings(detection="static") > 0).all()


def test_static_detection_sees_needle_and_knife_in_steps_of_less_than_the_thickness():
    """Until 0.36 s: then folds slap against the needle at 4 m/s, and some get through in steps of 1/480 s."""
    assert not most_crossings(0.36, detection="static", dt=1 / 1920).any()


def test_no_scene_is_left_without_a_test_of_its_own():
    names = {"curtain", "drape", "flag", "meshcloth", "needle", "strip"} | set(STUDIES)
    names |= {name for name, _ in KEPT}
    assert {path.stem for path in scene_files()} == names
