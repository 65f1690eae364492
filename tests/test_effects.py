"""Effects: how they are chosen, what a step says of them, and that auto skips nothing that acts."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

import sim
from sim.effects import EFFECTS, OBSTACLE, chosen, cost, effects_with, state, switch
from sim.scene import scene_files
from sim.settings import READ_OUTS, Settings
from sim.springs import build
from tests.worlds import ball, chain, grid, irregular, scene

SURE = {"contact": "impulse", "detection": "continuous"}
UNSURE = [
    ({"contact": "impulse", "detection": "static"}, "looked for once per step"),
    ({"contact": "penalty", "detection": "static"}, "looked for once per step"),
    ({"contact": "penalty", "detection": "continuous"}, "springs give way"),
    ({"contact": "postprocess", "detection": "continuous"}, "put right once"),
]


def passing(way, **settings):
    """The report of a step in which a sheet far from a ball goes by `way` [m]."""
    world = sim.Simulation(scene(grid(position=[0, 0, 1]), ball(), dt=0.01, thickness=5e-3, **settings))
    world.place(world.positions.copy(), np.full_like(world.positions, way / 0.01 / 3**0.5))
    return world.step()


@pytest.mark.parametrize(("settings", "why"), UNSURE)
def test_a_step_says_that_it_may_tunnel_where_cloth_goes_farther_than_its_thickness(settings, why):
    fast, slow = passing(6e-3, **settings), passing(4e-3, **settings)
    assert fast.moved == pytest.approx(6e-3)
    assert f"may tunnel: moved 6 mm, thickness 5 mm, {why}" in fast.effects["contact"]
    assert "tunnel" not in slow.effects["contact"]


@pytest.mark.parametrize("settings", [SURE, {"contact": "none"}])
def test_nothing_is_said_where_nothing_is_let_through_or_everything(settings):
    assert not any("tunnel" in words for words in passing(6e-3, **settings).effects.values())


def test_self_collision_says_it_by_its_own_thickness():
    """0.4 of an edge of 2 mm is 0.8 mm."""
    cloth = grid(size=(0.02, 0.02), resolution=(11, 11))
    settings = {"contact": "penalty", "self_collision": "on", "dt": 0.01, "thickness": 5e-3}
    world = sim.Simulation(scene(cloth, **settings))
    world.place(world.positions.copy(), np.full_like(world.positions, 0.2 / 3**0.5))
    words = world.step().effects
    assert "may tunnel: moved 2 mm, thickness 0.8 mm" in words["self_collision"]
    assert "tunnel" not in words["contact"]


STEP = {"dt": 0.01}
THERE = [{"time": 0.0}, {"time": 0.01, "rotation": [0.0, 0.0, 0.1]}]
MOVING = {
    "a sphere that goes": (ball(path=[{"time": 0.0}, {"time": 0.01, "position": [0.3, 0.0, 0.4]}]), 0.5),
    "a sphere that turns": (ball(path=THERE), 0.0),
    "a box that turns": (
        {"kind": "box", "center": [0, 0, 0], "size": [0.6, 0.8, 0.0001], "path": THERE},
        0.5 * 2 * np.sin(0.05),
    ),
    "a mesh that turns": (
        {"vertices": [[0.3, 0.4, 0], [0, 0, 0], [0, 0, 1]], "triangles": [[0, 1, 2]], "path": THERE},
        0.5 * 2 * np.sin(0.05),
    ),
}


@pytest.mark.parametrize("name", MOVING)
def test_the_way_of_an_obstacle_counts(name):
    """A point at distance r from the axis goes 2 r sin(φ/2) in a turn by φ."""
    obstacle, way = MOVING[name]
    still = chain([[2, 0, 0], [2.1, 0, 0]], [0.1, 0.1], pins=[0, 1])
    report = sim.Simulation(scene(still, {"motion": "linear", **obstacle}, **STEP)).step()
    assert report.moved == pytest.approx(way, rel=1e-6, abs=1e-12)


# How they are chosen


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_that_is_left_out_can_be_brought_in_again(name):
    scene_has = chosen(Settings(altitudes="all", drag=1.0, strain_limit=0.2, gravity=(0, 1, 0)), {})
    assert state(name, scene_has) == "auto"
    off = chosen(scene_has, {name: "off"})
    assert state(name, off) == "off"
    assert chosen(off, {name: "auto"}) == off  # it is for the settings to say
    again = sim.settings.change(off, **switch(name, "auto", off, scene_has))
    assert again == scene_has
    usual = sim.settings.change(off, **switch(name, "auto", off))
    assert state(name, usual) == "auto"


@pytest.mark.parametrize("name", [name for name, effect in EFFECTS.items() if effect.on])
def test_an_effect_that_can_be_skipped_can_be_forced(name):
    forced = chosen(Settings(), {name: "on"})
    assert state(name, forced) == "on"
    assert sim.settings.change(forced, **switch(name, "auto", forced)) == Settings()


WRONG = [
    ({"winds": "off"}, "effects.winds: no such effect; did you mean wind?"),
    ({"warmth": "off"}, "effects.warmth: no such effect; expected one of gravity, "),
    ({"wind": "maybe"}, 'effects.wind: expected one of "auto", "on", "off", got \'maybe\''),
    ({"wind": "on"}, 'effects.wind: expected "auto" or "off" while settings.drag is 0.0, got "on"'),
    ({"wind": 1}, "effects.wind: expected one of"),
    ({"obstacle 1": "off"}, "effects.obstacle 1: no such effect; did you mean obstacles or obstacle ball"),
    ({"obstacle ball": "no"}, "effects.obstacle ball: expected one of"),
    (["wind"], "effects: expected a table of effects"),
]


@pytest.mark.parametrize(("effects", "words"), WRONG)
def test_a_scene_with_a_wrong_effect_is_refused_in_one_line(effects, words):
    with pytest.raises(sim.SceneError, match=words.replace("[", r"\[")) as error:
        sim.load_scene({**scene(grid(), ball(name="ball")), "effects": effects})
    assert "\n" not in str(error.value)


def test_a_scene_forces_effects_and_a_caller_forces_others():
    made = {**scene(grid(), gravity=[0, 0, -1]), "effects": {"gravity": "off", "self_collision": "on"}}
    assert sim.load_scene(made).settings.gravity == (0.0, 0.0, 0.0)
    world = sim.Simulation(made, effects={"friction": "off"}, bend="none")
    found = world.effects
    assert [found[name] for name in ("gravity", "self_collision", "friction", "bending", "stretch")] == [
        "off",
        "on",
        "off",
        "off",
        "auto",
    ]
    with pytest.raises(ValueError, match="warmth: no such effect"):
        sim.Simulation(made, effects={"warmth": "off"})


TWO = ball((-0.5, 0, 0), 0.3), ball((0.5, 0, 0), 0.3, name="right")
"""Two obstacles, of which one has a name."""

SINGLE = [
    ("nobody=off", "each_obstacle: expected one of 0, right, got 'nobody'"),
    ("1=off", "each_obstacle: expected one of 0, right, got '1'"),
    ("right", "each_obstacle: expected text such as"),
    ("right=maybe", "each_obstacle: expected text such as"),
    ("right=off,", "each_obstacle: expected text such as"),
]


@pytest.mark.parametrize(("switches", "words"), SINGLE)
def test_single_obstacles_that_are_none_are_refused_in_one_line_and_nothing_changes(switches, words):
    with pytest.raises(sim.SceneError, match=words) as error:
        sim.load_scene(scene(grid(), *TWO, each_obstacle=switches))
    assert "\n" not in str(error.value)
    world = sim.Simulation(scene(grid(), *TWO))
    for change in (world.update, world.switch):
        with pytest.raises(ValueError, match=words):
            change(each_obstacle=switches)
    assert world.settings.each_obstacle == ""


def test_obstacles_are_called_by_names_that_nobody_can_mistake():
    names = ["ball", "", "twice", "twice", "a=b", "7", "a, b", " x"]
    made = scene(grid(), *(ball((0, 0, -9), 0.1, name=name) for name in names))
    assert sim.load_scene(made).obstacle_labels == ["ball", *"1234567"]


def test_each_obstacle_is_an_effect_of_its_own():
    made = {**scene(grid(), *TWO), "effects": {"obstacle right": "off"}}
    world = sim.Simulation(made, effects={"obstacle 0": "on"})
    assert world.settings.each_obstacle == "right=off, 0=on"
    assert (world.effects["obstacle 0"], world.effects["obstacle right"]) == ("on", "off")
    for name, choice in (("obstacle right", "auto"), ("obstacle 0", "off"), ("obstacle 0", "auto")):
        world.switch(**switch(name, choice, world.settings))
        assert world.effects[name] == choice
    assert world.settings.each_obstacle == ""


STRIPS = [grid((0.2, 0.2), (5, 5), position=[x, 0.0, 0.32]) for x in (-0.5, 0.5)]
SHELL = {"vertices": [[0.3, -0.3, 0.29], [0.8, -0.3, 0.29], [0.5, 0.5, 0.29]], "triangles": [[0, 1, 2]]}


@pytest.mark.parametrize("right", [TWO[1], {**SHELL, "name": "right"}], ids=["a ball", "a mesh"])
def test_one_obstacle_that_is_off_is_gone_through_and_the_other_holds(right):
    world = sim.Simulation(scene(STRIPS, TWO[0], right, gravity=[0, 0, -9.81], each_obstacle="right=off"))
    for _ in range(30):
        report = world.step()
    left = world.pieces == 0
    assert world.positions[left, 2].max() > 0.27
    assert world.positions[~left, 2].max() < 0.27
    assert report.penetrations == 0
    assert report.effects["obstacle right"] == "off: each_obstacle has right=off"
    assert report.effects["obstacles"] == "ran: 1 of 2 within reach"


def test_of_several_obstacles_only_those_within_reach_are_looked_at():
    world = sim.Simulation(scene(STRIPS[:1], *TWO, gravity=[0, 0, -9.81]))
    words = [world.step().effects for _ in range(10)][-1]
    assert words["obstacle 0"] == "ran"
    assert words["obstacle right"].startswith("skipped: out of reach for 10 steps")


def falling(*, upper, **settings):
    """Least height of what falls on a strip that hangs between pins: of another piece, or of its own end."""
    strip = [[0.1 * k, y, 0.0] for k in range(6) for y in (0.0, 0.1)]
    sides = [t for k in range(0, 10, 2) for t in ([k, k + 2, k + 1], [k + 1, k + 2, k + 3])]
    loose = [[0.1 * k + 0.03, y + 0.02, 0.03] for k in range(1, 4) for y in (0.0, 0.07)]
    tops = [t for k in range(0, 4, 2) for t in ([k, k + 2, k + 1], [k + 1, k + 2, k + 3])]
    pins = [0, 1, 10, 11]
    if upper == "another piece":
        cloth = [
            {"vertices": strip, "triangles": sides, "pins": pins},
            {"vertices": loose, "triangles": tops},
        ]
    else:  # one piece in two parts
        both = [*sides, *([i + len(strip) for i in t] for t in tops)]
        cloth = [{"vertices": strip + loose, "triangles": both, "pins": pins}]
    usual = {"gravity": [0, 0, -9.81], "stretch": 500.0} | dict.fromkeys(WHICH.values(), "auto")
    world = sim.Simulation(scene(cloth, **{**usual, **settings}))
    for _ in range(30):
        report = world.step()
    return world.positions[len(strip) :, 2].min(), report


WHICH = {"itself": "self_collision", "another piece": "cloth_collision"}


@pytest.mark.parametrize("upper", WHICH)
def test_a_piece_feels_itself_and_other_pieces_each_by_its_own_switch(upper):
    (other,) = set(WHICH.values()) - {WHICH[upper]}
    held, report = falling(upper=upper, **{other: "off"})
    assert held > -0.1
    assert report.felt[WHICH[upper]] > 0
    assert other not in report.felt | report.costs
    fallen, report = falling(upper=upper, **{WHICH[upper]: "off"})
    assert fallen < -0.5
    assert not report.felt


def test_lists_of_pairs_are_booked_for_whom_they_are_about_whoever_asks_for_them(monkeypatch):
    """Continuous detection asks for one that holds for the way; it takes 20 ms here."""
    from sim.contact.broad import BroadPhase

    made = BroadPhase.candidates

    def slow(self, *about):
        time.sleep(0.02)
        return made(self, *about)

    world = sim.Simulation(scene(STRIPS, self_collision="auto"))
    world.step()
    world.place(world.positions, 3.0 * np.random.default_rng(0).standard_normal(world.positions.shape))
    world.step()
    monkeypatch.setattr(BroadPhase, "candidates", slow)
    world.place(world.positions, world.velocities)
    report = world.step()
    assert report.lists >= 2  # one of them at the start of the step
    assert report.costs["continuous_detection"] < 20.0
    shares = sum(report.costs.get(name, 0.0) for name in ("self_collision", "cloth_collision", "edge_edge"))
    assert shares >= 20.0 * report.lists


def test_one_piece_alone_has_no_other_to_feel():
    world = sim.Simulation(scene(grid(), cloth_collision="auto"))
    words = world.step().effects["cloth_collision"]
    assert words == "skipped: there is one piece"
    assert world.step().effects["cloth_collision"] == words, "for how many steps says nothing"


def test_edges_go_through_edges_where_edge_edge_tests_are_off():
    """Crossing bare edges have no vertex near anything; vertices and triangles are felt as ever."""
    crossing = [
        chain([[-0.4, 0, 0], [0.4, 0, 0]], [0.1, 0.1]),
        chain([[0, -0.4, 0.02], [0, 0.4, 0.02]], [0.1, 0.1], pins=[0, 1]),
    ]
    heights = []
    for how in ("auto", "off"):
        world = sim.Simulation(scene(crossing, self_collision="auto", edge_edge=how, gravity=[0, 0, 5]))
        reports = [world.step() for _ in range(15)]
        heights.append(world.positions[:2, 2].min())
        assert ("edge_edge" in reports[-1].felt) == (how == "auto")
        assert "edge_edge" not in reports[0].costs or how == "auto"
    assert heights[0] < 0.02 < heights[1]
    held, report = falling(upper="another piece", edge_edge="off")
    assert held > -0.1
    assert report.felt["cloth_collision"] > 0


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_left_out_says_so_and_costs_nothing(name):
    usual = {"altitudes": "all", "drag": 1.2, "strain_limit": 0.1, "gravity": [0, 0, -9.81]}
    usual["self_collision"] = "auto"
    world = sim.Simulation(
        scene(grid(position=[0, 0, 0.305]), ball(radius=0.3), **usual), effects={name: "off"}
    )
    report = world.step()
    assert report.effects[name].startswith("off: ")
    assert name not in report.costs | report.costs_below
    with_it = sim.Simulation(scene(grid(position=[0, 0, 0.305]), ball(radius=0.3), **usual)).step()
    assert not with_it.effects[name].startswith("off")


LOW = grid(position=[0, 0, 0.305])
NEVER = {
    "gravity": ({"gravity": [0, 0, -9.81]}, {}),
    "stretch": ({"stretch": 50.0}, {"stretch": 0.0}),
    "altitudes": ({"altitudes": "all", "altitude": 80.0}, {}),
    "bending": ({"bend": "angle", "bending": 1e-3, "rest_angle": 0.1}, {"bend": "none"}),
    "damping": ({"gamma": 0.5}, {"gamma": 0.0}),
    "wind": ({"drag": 1.2, "lift": 0.5, "gust": 0.3, "wind": [3, 2, 0], "seed": 4}, {"seed": 4}),
    "strain_limiting": ({"strain_limit": 0.01}, {}),
    "obstacles": ({}, {}),
    "self_collision": ({"self_collision": "on", "cloth_collision": "off"}, {}),
    "cloth_collision": ({"cloth_collision": "on"}, {}),
    "edge_edge": (
        {"self_collision": "auto", "edge_edge": "on"},
        {"self_collision": "auto", "edge_edge": "off"},
    ),
    "continuous_detection": ({"detection": "continuous"}, {"detection": "static"}),
    "friction": ({"friction": 0.6}, {"friction": 0.0}),
    "obstacle ball": ({}, {}),
    **dict.fromkeys(READ_OUTS, ({}, {})),
}
"""Settings of a scene that has an effect, and of one that has never heard of it."""


@pytest.mark.parametrize("name", NEVER)
def test_a_step_without_an_effect_has_the_bits_of_a_scene_that_never_had_it(name):
    """The effect has run before it is switched off, so that nothing of it may be left behind."""
    assert set(EFFECTS) < set(NEVER)
    has, never = NEVER[name]
    without = name in ("obstacles", "obstacle ball")
    there = [ball(radius=0.3, name="ball")]
    parts = there if name == "obstacles" else [*there, {"kind": "plane", "point": [0, 0, -1]}]
    left = [] if name == "obstacles" else parts[without:]
    usual = {"gravity": [0, 0, -9.81], "jitter": 1e-3} if name != "gravity" else {"jitter": 1e-3}
    having = sim.Simulation(scene(LOW, *parts, **{**usual, **has}))
    plain = sim.Simulation(scene(LOW, *(left if without else parts), **{**usual, **never}))
    start = having.positions.copy(), np.random.default_rng(0).normal(0.0, 0.3, having.positions.shape)
    for _ in range(3):
        assert having.effects[name] != "off"
        having.step()
    having.switch(**switch(name, "off", having.settings))
    having.place(*start)
    plain.place(*start)
    for _ in range(5):
        report = having.step()
        plain.step()
        assert report.effects[name].startswith("off")
        np.testing.assert_array_equal(having.positions, plain.positions)
        np.testing.assert_array_equal(having.velocities, plain.velocities)


def test_springs_without_stiffness_have_the_bits_of_a_model_that_never_had_them(monkeypatch):
    """And nobody calls a kernel of theirs; switched on, they are as if they had been there all along."""
    usual = {"gravity": [0, 0, -9.81], "solver": "direct", "stretch": 0.0, "bend": "angle"}
    idle = sim.Simulation(scene(LOW, ball(), **usual))
    edges = next(springs for springs in idle.model.springs if springs.name == "edge")
    monkeypatch.setattr(edges, "coordinate", None)  # which would be called
    others = {name: kind for name, kind in sim.springs.STRETCH.items() if name != "edge"}
    monkeypatch.setattr(build, "STRETCH", others)  # a deleted item would come back as the last: other sums
    never = sim.Simulation(scene(LOW, ball(), **usual))
    assert [springs.name for springs in never.model.springs] == ["angle"]
    for _ in range(10):
        words = idle.step().effects["stretch"]
        never.step()
        np.testing.assert_array_equal(idle.positions, never.positions)
    assert words == "off: stretch is zero"
    assert idle.energy()["edge"] == 0.0


def test_springs_that_are_given_stiffness_while_running_start_from_where_the_cloth_is():
    usual = {"gravity": [0, 0, -9.81], "altitudes": "all"}
    woken = sim.Simulation(scene(LOW, ball(), altitude=0.0, **usual))
    for _ in range(10):
        woken.step()
    fresh = sim.Simulation(scene(LOW, ball(), altitude=50.0, **usual))
    fresh.place(woken.positions, woken.velocities)
    woken.switch(altitude=50.0)
    old, new = (next(s for s in w.model.springs if s.name == "altitude").elements for w in (woken, fresh))
    for name in ("q", "gradient", "memory", "stiffness"):
        np.testing.assert_array_equal(getattr(old, name), getattr(new, name))
    assert woken.energy()["altitude"] == fresh.energy()["altitude"] > 0.0


def test_what_was_felt_in_one_part_of_a_step_is_not_called_skipped_as_the_last_part_is_free_of_it():
    """A mesh leaps through a sheet in a step that is done in parts: the last has no pair in reach."""
    there = {"time": 0.01, "position": [0.3, 1.1, -3.8], "rotation": [-25.0, -3.0, 13.0]}
    leap = [{"time": 0.0, "position": [0.0, 0.0, 0.29]}, there]
    thin = {"vertices": [[-0.3, 0, 0], [0.3, 0, 0], [0, 0.3, 0.2]], "triangles": [[0, 1, 2]], "name": "mesh"}
    world = sim.Simulation(
        scene(grid((0.4, 0.4), (7, 7)), {**thin, "motion": "linear", "path": leap}, dt=0.01)
    )
    report = world.step()
    assert report.substeps > 1
    assert {"edge_edge", "obstacle mesh"} <= report.felt.keys()
    for name in report.felt:
        assert report.effects[name].startswith("ran"), name


def test_springs_that_a_chain_has_none_of_are_skipped_and_nobody_calls_a_kernel_of_theirs(monkeypatch):
    world = sim.Simulation(scene(chain([[0, 0, 0], [0.1, 0, 0]], [0.1, 0.1], pins=[0]), bend="angle"))
    bending = next(springs for springs in world.model.springs if springs.name == "angle")
    monkeypatch.setattr(bending, "coordinate", None)  # which would be called
    words = [world.step().effects for _ in range(2)][-1]
    assert (words["stretch"], words["bending"]) == ("ran", "skipped: there are none")


def test_damping_of_no_springs_is_skipped():
    words = sim.Simulation(scene(LOW, stretch=0.0, bend="none")).step().effects
    assert words["damping"] == "skipped: no springs act"


def test_obstacles_that_are_off_are_gone_through():
    made = scene(grid(position=[0, 0, 0.31]), ball(radius=0.3), gravity=[0, 0, -9.81])
    felt, gone = sim.Simulation(made), sim.Simulation(made, obstacles="off")
    for _ in range(30):
        felt.step()
        report = gone.step()
    assert report.penetrations == 0  # nobody asks
    assert felt.positions[:, 2].max() > 0.28
    assert gone.positions[:, 2].max() < 0.31 - 0.9


# That auto skips nothing that acts

FORCED = "obstacles", "self_collision", "cloth_collision", "edge_edge"


class Pair:
    """A simulation that skips what it can, and one that looks at everything, from the same states."""

    def __init__(self, made, **settings):
        self.auto, self.forced = (sim.Simulation(made, **settings) for _ in range(2))
        self.skipped = 0

    def step(self, forced=None):
        """Take a step with both; the forced one from the other's state, with no list of its own.

        `forced` are the effects that it looks at in full, all that can be where left out. Returns its report.
        """
        start = self.auto.snapshot()
        self.forced.restore(start)
        for name in FORCED if forced is None else forced:
            if self.auto.effects[name] != "off":
                self.forced.switch(**switch(name, "on", self.forced.settings))
        report, all_of_it = self.auto.step(), self.forced.step()
        assert (report.contacts, report.hits, report.penetrations, report.substeps) == (
            all_of_it.contacts,
            all_of_it.hits,
            all_of_it.penetrations,
            all_of_it.substeps,
        )
        assert (self.auto.positions == self.forced.positions).all()
        assert (self.auto.velocities == self.forced.velocities).all()
        skipped = {name for name, words in report.effects.items() if words.startswith("skipped")}
        skipped -= set(READ_OUTS)
        assert not skipped & all_of_it.felt.keys()
        depths = self.auto.scene.obstacle_labels if all_of_it.penetrations else []
        assert len(depths) == 0 or not {OBSTACLE + label for label in depths} <= skipped
        self.skipped += len(skipped)
        return report


UNFELT = {"self_collision": "on"}, {"each_obstacle": "0=on"}, {"threads": 2}, {"gamma": 0.2}


@pytest.mark.parametrize("change", UNFELT)
def test_to_look_at_everything_from_now_on_leaves_no_trace_with_an_integrator_that_looks_back(change):
    """Nor do other changes that change nothing: the state of one step before goes on to count."""
    usual = {"self_collision": "auto", "gravity": [0, 0, -9.81], "gamma": 0.2}
    made = scene(LOW, ball((0, 0, -9)), integrator="bdf2", newton=2, **usual)
    changed, left = (sim.Simulation(made) for _ in range(2))
    for k in range(6):
        if k == 3:
            changed.update(**change)
        changed.step()
        left.step()
    np.testing.assert_array_equal(changed.positions, left.positions)


def test_what_is_held_back_goes_as_far_whatever_list_there_was():
    """A spinning ring that is wound one and a half times, so that its layers cannot come apart."""
    random, along, across = np.random.default_rng(4), 25, 4
    turn, radius = np.meshgrid(
        np.linspace(0, 3 * np.pi, along), np.linspace(0.15, 0.2, across), indexing="ij"
    )
    flat = np.stack(
        [radius * np.cos(turn), radius * np.sin(turn), random.normal(0, 1e-4, turn.shape)], axis=2
    )
    corner = np.arange(along * across).reshape(along, across)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=2).reshape(-1, 3) for t in ((a, b, c), (c, b, d))])
    ring = {"vertices": flat.reshape(-1, 3).tolist(), "triangles": triangles.tolist()}
    about = {"dt": 0.01, "thickness": 6e-4, "tangled": "keep", "self_collision": "auto", "stretch": 100.0}
    pair = Pair(scene([ring], **about))
    x = pair.auto.positions
    spin = np.cross([-60.0, 30.0, 100.0], x - x.mean(axis=0))
    pair.auto.place(x, spin + random.normal(0, 0.02, x.shape))
    assert sum(pair.step().held_back for _ in range(6)) > 100


@pytest.mark.parametrize("name", [path.stem for path in scene_files()])
def test_auto_gives_the_bits_of_on_in_every_scene(name):
    """Every twelfth step of the first while, each compared with one that looks at everything."""
    pair = Pair(name)
    while pair.auto.time < 0.8:
        pair.step()
        for _ in range(11):
            pair.auto.step()


def approach(part, *obstacles):
    """A sheet, and another or an obstacle 3 cm below, that cover `part` of what is between in four steps."""
    upper = grid((0.2, 0.2), (5, 5), position=[0.0, 0.0, 0.03], rotation=[0.0, 0.0, 0.4])
    lower = grid((0.2, 0.2), (5, 5), position=[0.0, 0.01, 0.0])
    cloth = [upper] if obstacles else [upper, lower]
    pair = Pair(scene(cloth, *obstacles, self_collision="auto", dt=0.01, thickness=2e-3))
    speed = part * 0.03 / 0.04 * (1.0 if obstacles else 0.5)
    towards = np.where(pair.auto.pieces == 0, -speed, speed)
    pair.auto.place(pair.auto.positions, np.outer(towards, [0.0, 0.0, 1.0]))
    for _ in range(6):
        pair.step()
    return pair


BELOW = {
    "cloth": (),
    "a ball": (ball((0.0, 0.0, -0.1), 0.1),),
    "a plane": ({"kind": "plane"},),
    "a box": ({"kind": "box", "center": [0.03, 0.0, -0.05], "size": [0.1, 0.1, 0.1]},),
    "a mesh": ({"vertices": [[-1, -1, 0], [1, -1, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]},),
}


@pytest.mark.parametrize("what", BELOW)
@pytest.mark.parametrize("part", [0.5, 0.9, 0.97, 1.03, 4.0])
def test_auto_sees_what_just_meets_and_what_just_does_not(what, part):
    pair = approach(part, *BELOW[what])
    assert pair.skipped > 0


def test_a_bound_that_is_too_bold_would_be_noticed(monkeypatch):
    """Bounds that a step may break are the mistake that these tests are there to find."""
    import sim.contact.detectors
    import sim.contact.pairs

    sound = sim.contact.pairs.strayed
    monkeypatch.setattr(sim.contact.pairs, "strayed", lambda a, b: 0.1 * sound(a, b))
    with pytest.raises(AssertionError):
        approach(4.0)
    monkeypatch.undo()
    reach = sim.contact.detectors.within_reach
    monkeypatch.setattr(sim.contact.detectors, "within_reach", lambda *a: reach(*a[:-1], -0.05))
    with pytest.raises(AssertionError):
        approach(4.0, *BELOW["a ball"])


def adversary(seed):
    """Cloth, obstacles and settings at random, where bounds are likely to be wrong if they can be."""
    random = np.random.default_rng(seed)
    size = random.uniform(0.2, 0.5)
    cloth = [grid((size, size), (7, 7), position=random.uniform(-0.3, 0.3, 3).tolist())]
    if random.random() < 0.3:  # bare edges beside the sheet: edges alone can meet
        ends = np.asarray(cloth[0]["position"]) + random.uniform(-0.2, 0.2, (2, 3))
        cloth.append(chain(ends.tolist(), [0.01, 0.01]))
    if random.random() < 0.5:
        turned = {
            "position": random.uniform(-0.3, 0.3, 3).tolist(),
            "rotation": random.uniform(-3, 3, 3).tolist(),
        }
        cloth.append({**irregular(seed, 30), **turned})
    obstacles = [_thing(random) for _ in range(random.integers(0, 4))]
    settings = {
        "contact": random.choice(["penalty", "impulse", "postprocess"]),
        "detection": random.choice(["static", "continuous"]),
        **{name: random.choice(["auto", "off"], p=[0.8, 0.2]) for name in FORCED[1:]},
        "each_obstacle": ", ".join(f"{k}=off" for k in range(len(obstacles)) if random.random() < 0.2),
        "thickness": float(10 ** random.uniform(-4, -1.5)),
        "gravity": (random.uniform(-10, 10, 3) * random.integers(0, 2)).tolist(),
        "dt": float(10 ** random.uniform(-3.5, -1.3)),
        "stretch": float(10 ** random.uniform(0, 3)),
        "tangled": "keep",
    }
    return scene(cloth, *obstacles, **settings), random


def _thing(random):
    there, size = random.uniform(-0.5, 0.5, 3).tolist(), random.uniform(0.05, 0.3)
    keys = np.sort(random.uniform(0, 0.2, 2))
    path = [
        {
            "time": float(t),
            "position": random.uniform(-0.5, 0.5, 3).tolist(),
            "rotation": random.uniform(-3, 3, 3).tolist(),
        }
        for t in keys
    ]
    moves = {"path": path} if random.random() < 0.5 else {}
    kind = random.integers(5)
    if kind == 0:
        return ball(there, size, **moves)
    if kind == 1:
        return {"kind": "box", "center": there, "size": random.uniform(0.01, 0.4, 3).tolist(), **moves}
    if kind == 2:
        return {
            "kind": "capsule",
            "start": there,
            "end": random.uniform(-0.5, 0.5, 3).tolist(),
            "radius": size,
            **moves,
        }
    if kind == 3:
        return {"kind": "plane", "point": there, "normal": random.normal(size=3).tolist(), **moves}
    return {"vertices": random.uniform(-0.3, 0.3, (3, 3)).tolist(), "triangles": [[0, 1, 2]], **moves}


def attack(seed, steps=6):
    """Step an adversary's scene, thrown and thrown again; returns how many effects were skipped."""
    made, random = adversary(seed)
    pair = Pair(made)
    for k in range(steps):
        if k % 3 == 0:  # at all speeds, most of them such that a step goes about as far as the thickness
            settings = pair.auto.settings
            speed = settings.thickness / settings.dt * float(10 ** random.uniform(-1.5, 1.5))
            common = random.uniform(-1, 1, 3) * 10 ** random.uniform(-2, 1.5)
            velocities = random.normal(0, speed, pair.auto.positions.shape) + common
            pair.auto.place(pair.auto.positions + random.normal(0, 1e-3, velocities.shape), velocities)
        every = effects_with(pair.auto.scene.obstacle_labels).items()
        can = [name for name, effect in every if effect.on and name not in READ_OUTS]
        some = random.choice(
            can, random.integers(1, len(can)), replace=False
        )  # each alone, and some together
        try:
            pair.step(None if k % 2 else some)
        except sim.StepError:
            return pair.skipped
    return pair.skipped


@pytest.mark.parametrize("seed", range(12))
def test_no_state_that_an_adversary_makes_has_auto_skip_what_acts(seed):
    attack(seed)


def test_the_adversary_is_worth_its_name():
    """It makes states in which effects are skipped; else it would test nothing."""
    assert sum(attack(seed) for seed in range(12)) > 50


# What they cost


@pytest.mark.parametrize("contact", ["impulse", "penalty", "postprocess", "none"])
def test_every_effect_of_a_step_has_a_figure_or_says_whose_it_is_in(contact):
    obstacles = (
        ball(radius=0.3, name="ball"),
        {"kind": "plane", "point": [0, 0, -1]},
        {**SHELL, "name": "mesh"},
    )
    usual = {"altitudes": "all", "drag": 1.2, "strain_limit": 0.1, "gravity": [0, 0, -9.81], "sleep": "auto"}
    world = sim.Simulation(scene(LOW, *obstacles, self_collision="auto", contact=contact, **usual))
    for _ in range(4):
        report = world.step()
    costs = {name: cost(name, words, report) for name, words in report.effects.items()}
    unknown = {name for name, found in costs.items() if found.ms is None}
    assert unknown <= ({"friction"} if contact == "postprocess" else set())
    assert all(found.why for found in costs.values())
    ran = {name for name, words in report.effects.items() if words.startswith("ran")}
    assert {"gravity", "damping", "stretch"} <= ran
    assert all(costs[name].ms > 0.0 for name in ran - unknown)
    assert sum(found.ms for found in costs.values() if found.ms and not found.most) < 1.5 * report.ms["total"]


def test_what_one_obstacle_takes_is_its_part_of_what_all_take():
    """Two balls that are near are asked alike, one far away is not; of meshes, by their pairs."""
    near = ball((-0.3, 0.0, 0.0), 0.3), ball((0.3, 0.0, 0.0), 0.3)
    meshes = (
        {**SHELL, "name": "mesh"},
        {**SHELL, "vertices": [[0, 0, 9], [1, 0, 9], [0, 1, 9]], "name": "high"},
    )
    world = sim.Simulation(scene(LOW, *near, ball((9, 9, 9), 0.1), *meshes))
    for _ in range(3):
        report = world.step()
    parts = {name: ms for name, ms in report.costs.items() if name.startswith(OBSTACLE)}
    assert parts.keys() == {f"{OBSTACLE}{label}" for label in ("0", "1", "mesh")}
    assert parts["obstacle 0"] == parts["obstacle 1"]
    assert sum(parts.values()) == pytest.approx(report.costs["obstacles"])
    away = sim.Simulation(scene(LOW, ball((9, 9, 9), 0.1), ball((-9, 9, 9), 0.1)))
    report = away.step()
    assert report.effects["obstacle 0"].startswith("skipped")
    assert report.costs["obstacle 0"] == report.costs["obstacle 1"] > 0.0  # to see that they are away


def test_gravity_is_timed_where_it_acts_and_nowhere_else(monkeypatch):
    """A weighing that takes 5 ms is told as such."""
    weigh = np.copyto

    def slow(*about, **how):
        time.sleep(5e-3)
        return weigh(*about, **how)

    heavy, light = (sim.Simulation(scene(LOW, gravity=[0, 0, g])) for g in (-9.81, 0.0))
    for world in heavy, light:
        world.step()
    monkeypatch.setattr(sim.model, "np", SimpleNamespace(**vars(np) | {"copyto": slow}))
    report = heavy.step()
    assert 5.0 <= report.costs["gravity"] < report.ms["total"]
    assert cost("gravity", "ran", report).ms == report.costs["gravity"]
    assert "gravity" not in light.step().costs


def test_damping_is_told_as_a_part_of_the_springs_and_off_it_is_not_computed():
    damped, free = (sim.Simulation(scene(LOW, gamma=gamma)) for gamma in (0.2, 0.0))
    for world in damped, free:
        world.step()
    report = damped.step()
    found = cost("damping", report.effects["damping"], report)
    assert found.most
    assert 0.0 < found.ms < report.costs["stretch"] + report.costs["bending"]
    report = free.step()
    assert "damping" not in report.costs_below
    assert cost("damping", report.effects["damping"], report).ms == 0.0
    assert not any(springs.elements.damping.any() for springs in free.model.springs)
