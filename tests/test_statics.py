"""Static rest against closed forms: hanging chains and strips, pendulums about it, and drapes that stay."""

import json
import math
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

import sim
from sim.stress.measures import HARD, period_ratio, sag, slack_chain
from tests.worlds import ball, chain, grid, scene

FOLDER = Path(__file__).parent / "vectors"
REFERENCE = json.loads((FOLDER / "reference.json").read_text())

G = 9.81
EARTH = [0.0, 0.0, -G]


# Hanging chains

SAG = {case["N"]: case["sag"] for case in REFERENCE["discrete_chain_unit_weight"]}
CATENARY = next(case for case in REFERENCE["catenary"] if case["span"] == 0.5)


@pytest.mark.parametrize("links", [4, 8, 20])
def test_a_hanging_chain_sags_as_published(links):
    assert sag(links) == pytest.approx(SAG[links], abs=1e-5)


def test_a_chain_lengthens_by_its_tension_over_its_stiffness():
    """Ten times the stiffness, a tenth of what the sag has above that of stiff links."""
    soft, hard = (sag(8, stretch=k) - SAG[8] for k in (1e4, 1e5))
    assert soft / hard == pytest.approx(10.0, rel=1e-3)


def test_a_chain_of_more_links_goes_to_the_catenary_with_second_order():
    errors = [sag(links, stretch=HARD) - CATENARY["sag"] for links in (8, 16, 32)]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 1e-3 * CATENARY["sag"]


def test_a_chain_comes_to_the_same_rest_from_anywhere():
    """Started a centimetre off in all directions, by another seed each time; forces are left of 1e-9."""
    rest = sim.equilibrium(slack_chain(8, stretch=1e4)).positions
    for seed in (1, 2):
        shaken = slack_chain(8, stretch=1e4, jitter=1e-2, seed=seed)
        assert np.abs(sim.Simulation(shaken).positions - rest).max() > 1e-3
        np.testing.assert_allclose(sim.equilibrium(shaken).positions, rest, atol=1e-8)


@pytest.mark.parametrize("case", REFERENCE["hanging_strip"], ids=lambda case: f"N={case['N']}")
def test_a_row_of_springs_hangs_longer_by_half_its_weight_over_its_stiffness(case):
    """W L/(2 K) with the end masses halved, exact for any number of springs."""
    links, weight, stiffness = case["N"], 2.0, 100.0
    masses = np.full(links + 1, weight / (G * links))
    masses[[0, -1]] /= 2.0
    row = chain([[0, 0, -k / links] for k in range(links + 1)], masses, pins=[0])
    world = sim.equilibrium(scene(row, gravity=EARTH, stretch=stiffness))
    lengthened = -world.positions[-1, 2] - 1.0
    assert weight / (2.0 * stiffness) == case["elong"]
    assert lengthened == pytest.approx(case["elong"], rel=1e-6)


# Pendulums

PERIOD = 5e-3
"""Mark of the hard cases; a rod of 1000 N under 0.3 N and 200 steps in a period leave 0.1 %."""


@pytest.mark.parametrize("name", ["sdirk2", "tr_bdf2", "bdf2", "midpoint", "trapezoid"])
@pytest.mark.parametrize("degrees", [30, 90, 150])
def test_a_pendulum_swings_as_slowly_as_elliptic_integrals_say(degrees, name):
    expected = REFERENCE["pendulum_T_over_T0"][str(degrees)]
    assert period_ratio(degrees, name) == pytest.approx(expected, rel=PERIOD)


# Cloth

BALANCE = 1e-8
"""Force that may be left on a free vertex, as part of the largest that a spring exerts on one."""


def unbalanced(world):
    """The largest force on a free vertex over the largest of a spring."""
    left = np.linalg.norm(world.forces()[world.model.free], axis=1).max()
    largest = 0.0
    for springs in world.model.springs:
        e = springs.elements
        largest = max(largest, (np.abs(e.tension)[:, None] * np.linalg.norm(e.gradient, axis=2)).max())
    return left / largest


def coarse(name, resolution):
    """A scene that comes with Muslin, with fewer vertices."""
    shipped = sim.load_scene(name)
    cloth = msgspec.structs.replace(shipped.cloth[0], resolution=resolution)
    return msgspec.structs.replace(shipped, cloth=[cloth])


@pytest.mark.parametrize(("name", "resolution"), [("strip", (36, 6)), ("curtain", (17, 16))])
def test_no_force_is_left_on_hanging_cloth(name, resolution):
    world = sim.equilibrium(coarse(name, resolution), contact="none")
    assert unbalanced(world) <= BALANCE
    assert world.time == 0.0
    assert not world.velocities.any()


@pytest.mark.parametrize("bend", ["none", "cross", "modified", "angle"])
def test_no_force_is_left_on_a_sheet_that_hangs_from_two_corners(bend):
    sheet = grid(resolution=(7, 7), pins=["corner00", "corner10"])
    world = sim.equilibrium(scene(sheet, gravity=EARTH, bend=bend, altitudes="all", rest_angle=0.1))
    assert unbalanced(world) <= BALANCE
    lowest = world.positions[:, 2].min()
    assert -1.5 < lowest < -0.8  # it came down from where it lay, and hangs
    assert (world.positions[world.pinned, 2] == 0.0).all()


def test_cloth_at_rest_stays_there_when_it_is_stepped():
    world = sim.equilibrium(coarse("strip", (36, 6)))
    rest = world.positions.copy()
    for _ in range(30):
        world.step()
    # A step is solved to this; forces that are left would move the strip by 1e-9 g t².
    assert np.abs(world.positions - rest).max() <= world.settings.tolerance


@pytest.mark.parametrize("bend", ["cross", "modified", "angle"])
def test_weightless_cloth_that_nothing_holds_keeps_its_rest_shape(bend):
    world = sim.equilibrium(scene(grid(resolution=(5, 5)), bend=bend, altitudes="all"))
    np.testing.assert_allclose(world.positions, world.mesh.rest_vertices, atol=1e-9)


QUIET = 2e-3
"""How far a drape may still settle [m] once it is let go of: less than half its thickness."""


@pytest.mark.parametrize(("contact", "dt"), [("penalty", 1 / 60), ("impulse", 1 / 120)])
def test_a_sheet_draped_on_a_ball_rests_there(contact, dt):
    sheet = grid(size=(0.5, 0.5), resolution=(8, 8), position=[0.01, 0.02, 0.22])
    springs = {"stretch": 20.0, "altitudes": "all", "altitude": 20.0, "density": 0.3}
    draped = scene(sheet, ball(radius=0.2), gravity=EARTH, contact=contact, dt=dt, **springs)
    world = sim.equilibrium(draped)
    rest = world.positions.copy()
    assert rest[:, 2].min() < 0.0  # its corners hang
    for _ in range(round(0.5 / dt)):
        world.step()
        assert np.linalg.norm(world.positions - rest, axis=1).max() < QUIET


@pytest.mark.parametrize("obstacles", [[], [ball()]], ids=["alone", "contact off"])
def test_cloth_that_nothing_holds_up_is_refused_in_one_line(obstacles):
    with pytest.raises(ValueError, match=r"cloth\[0\]: expected pins, or an obstacle") as error:
        sim.equilibrium(scene(grid(), *obstacles, gravity=EARTH, contact="none"))
    assert "\n" not in str(error.value)


def test_the_piece_that_nothing_holds_up_is_named():
    held, loose = grid(pins=["left"]), grid(position=[0, 2, 0])
    with pytest.raises(ValueError, match=r"cloth\[1\]: expected"):
        sim.equilibrium({"cloth": [held, loose]})


def test_a_loose_part_of_a_cloth_that_is_pinned_elsewhere_is_named_by_a_vertex():
    two = {"vertices": [[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0]], "edges": [[0, 1], [2, 3]], "pins": [0]}
    with pytest.raises(ValueError, match="nothing holds vertex 2"):
        sim.equilibrium(scene(two, gravity=EARTH))


@pytest.mark.parametrize("change", [{"dt": 1e-6}, {"dt": 0.01}, {"dt": 1.0}])
def test_rest_does_not_depend_on_the_time_step(change):
    sheet = grid(resolution=(5, 5), pins=["corner00", "corner10"])
    usual = sim.equilibrium(scene(sheet, gravity=EARTH))
    other = sim.equilibrium(scene(sheet, gravity=EARTH, **change))
    # The residual over the softest stiffness, its weight per length, some 1 N/m.
    np.testing.assert_allclose(other.positions, usual.positions, atol=1e-6)


@pytest.mark.parametrize("density", [1.0, 100.0])
def test_heavy_cloth_finds_its_rest_far_from_where_it_starts(density):
    world = sim.equilibrium(scene(grid(resolution=(5, 5), pins=["top"]), gravity=EARTH, density=density))
    weight = world.masses.max() * G
    assert np.abs(world.forces()[world.model.free]).max() < 1e-6 * weight


@pytest.mark.parametrize("bend", ["angle", "modified"])
def test_rest_beyond_a_half_turn_is_rest_in_the_simulation_that_is_given_back(bend):
    """The angle found is past π: a simulation that forgot it would see it on the other side."""
    lean = math.pi - 2.9
    hinge = {
        "vertices": [
            [0, 0, 0],
            [1, 0, 0],
            [0.5, -0.9 * math.cos(lean), 0.9 * math.sin(lean)],
            [0.5, -0.9, 0],
        ],
        "rest_vertices": [[0, 0, 0], [1, 0, 0], [0.5, 0.9, 0], [0.5, -0.9, 0]],
        "triangles": [[0, 1, 2], [1, 0, 3]],
        "pins": [0, 1, 3],
    }
    world = sim.equilibrium(scene(hinge, gravity=EARTH, bend=bend, bending=0.05, rest_angle=math.pi))
    assert np.abs(world.forces()[2]).max() < 1e-6 * 0.1 * G


def test_cloth_beside_an_obstacle_that_nothing_moves_is_at_rest_at_once():
    world = sim.equilibrium(scene(grid(resolution=(4, 4)), ball(center=(0, 0, -0.4))))
    assert not world.velocities.any()
    assert world.time == 0.0


def test_a_coarse_sheet_comes_to_rest_on_a_ball_with_impulses():
    sheet = grid(size=(0.5, 0.5), resolution=(6, 6), position=[0, 0, 0.22])
    sim.equilibrium(scene(sheet, ball(radius=0.2), gravity=EARTH, friction=1.0))


def test_obstacles_stay_at_their_first_key_until_the_cloth_rests():
    path = [{"time": 0.0}, {"time": 0.5, "position": [3.0, 0.0, 0.0]}]
    sheet = grid(size=(0.5, 0.5), resolution=(6, 6), position=[0, 0, 0.22])
    draped = scene(sheet, ball(radius=0.2, path=path), gravity=EARTH, friction=1.0, contact="penalty")
    world = sim.equilibrium(draped)
    assert np.abs(world.positions[:, :2].mean(axis=0)).max() < 0.1  # it lies where the ball began
    assert world.obstacle_poses()[0][0] == pytest.approx([0.0, 0.0, 0.0])


def test_a_curtain_comes_to_rest_in_the_mean_wind_without_its_gusts():
    """What is left of the forces is that of cloth which goes 1e-4 of its size in a second: far less."""
    hung = grid((0.6, 0.6), (7, 7), pins=["top"], rotation=[math.pi / 2, 0, 0])
    blown = {"gravity": EARTH, "wind": [0.3, 2.0, 0.0], "drag": 1.2, "lift": 0.3}
    steady, gusty = (sim.equilibrium(scene(hung, **blown, gust=gust)) for gust in (0.0, 0.5))
    assert gusty.settings.gust == 0.5
    np.testing.assert_array_equal(gusty.positions, steady.positions)
    assert steady.positions[:, 1].max() > 0.3  # it leans
    weight = steady.masses.max() * G
    assert np.abs(steady.forces()[steady.model.free]).max() < 1e-3 * weight


def test_cloth_that_only_the_wind_could_hold_is_refused():
    with pytest.raises(ValueError, match=r"cloth\[0\]: expected pins, or an obstacle"):
        sim.equilibrium(scene(grid(), wind=[0.0, 0.0, 1.0], drag=1.2))
