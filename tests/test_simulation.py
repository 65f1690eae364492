"""What a simulation promises: transactions, live settings, snapshots, and the same bits on any threads."""

import hashlib
import subprocess
import sys
import time

import numpy as np
import pytest

import sim
from sim import simulation as module
from tests.worlds import ball, chain, grid, irregular, scene

DRAPE = scene(grid(resolution=(16, 16), position=[0, 0, 0.35]), ball(), gravity=[0, 0, -9.81])


def bits(world):
    """A digest of everything that moves."""
    return hashlib.sha256(world.positions.tobytes() + world.velocities.tobytes()).hexdigest()


def run(steps, **settings):
    world = sim.Simulation(DRAPE, **settings)
    for _ in range(steps):
        world.step()
    return world


@pytest.mark.parametrize("contact", ["penalty", "impulse"])
@pytest.mark.parametrize("bend", ["cross", "angle"])
def test_the_same_scene_gives_the_same_bits_on_any_number_of_threads(contact, bend):
    digests = {bits(run(40, contact=contact, bend=bend, threads=threads)) for threads in (1, 1, 2, 64)}
    assert len(digests) == 1


def test_the_seed_decides_the_jitter_to_the_bit():
    a, b, c = (sim.Simulation(DRAPE, jitter=1e-4, seed=seed) for seed in (1, 1, 2))
    assert bits(a) == bits(b) != bits(c)
    assert 0 < np.abs(a.positions - sim.Simulation(DRAPE).positions).max() < 1e-3


@pytest.mark.parametrize("change", [{}, {"bend": "cross"}, {"mass": "constant"}, {"contact": "none"}])
def test_a_restored_snapshot_goes_on_with_the_same_bits(change):
    world = run(25)
    saved = world.snapshot()
    for _ in range(10):
        world.step()
    once, settings = bits(world), world.settings
    world.update(**change)
    world.step()
    world.restore(saved)
    assert world.time == saved.time
    assert world.settings == settings
    for _ in range(10):
        world.step()
    assert bits(world) == once


def everything(world):
    """What a refused call may not change."""
    return world.positions.tobytes(), world.velocities.tobytes(), world.time, world.settings, world.energy()


def test_a_snapshot_of_other_cloth_is_refused_and_changes_nothing():
    world, other = (sim.Simulation(scene(grid(resolution=(n, n)))) for n in (4, 5))
    world.step()
    before = everything(world)
    with pytest.raises(ValueError, match=r"^snapshot: expected one of 16 vertices, got 25$"):
        world.restore(other.snapshot())
    assert everything(world) == before


@pytest.mark.parametrize(
    "nonsense", ["x", None, [[1, 2], [3]], np.full((16, 3), "1"), np.ones((16, 3), complex), np.ones((3, 16))]
)
def test_cloth_cannot_be_placed_at_what_is_no_place(nonsense):
    world = sim.Simulation(scene(grid(resolution=(4, 4))))
    world.step()
    before = everything(world)
    with pytest.raises(ValueError, match=r"^positions: expected finite numbers of shape \(16, 3\)$"):
        world.place(nonsense)
    assert everything(world) == before


def test_a_snapshot_restores_into_a_new_simulation_of_the_scene():
    world = run(25, bend="cross")
    fresh = sim.Simulation(DRAPE)
    fresh.restore(world.snapshot())
    world.step()
    fresh.step()
    assert bits(world) == bits(fresh)


def test_an_update_keeps_positions_and_velocities_to_the_bit():
    world = run(20)
    before = bits(world)
    world.update(gamma=1.0, rest_angle=0.3, bend="cross", stretch=500.0, contact="penalty", mass="constant")
    assert bits(world) == before
    assert world.settings.bend == "cross"
    world.step()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gamma": -1}, "gamma: expected ≥ 0"),
        ({"bend": "glue"}, 'bend: expected one of "none", "cross", "modified", "angle"'),
        ({"dt": float("nan")}, "dt: expected"),
        ({"stretch": "stiff"}, "stretch: expected"),
        ({"newton": 1.5}, "newton: expected a whole number"),
        ({"gravity": [0, 0, -1e4]}, "gravity: expected three numbers from -1000 to 1000"),
        ({"gravity": [0, 0]}, "gravity: expected three numbers from -1000 to 1000"),
        ({"colour": "red"}, "colour: no such setting"),
        ({"friction": 0.1, "thickness": 0}, "thickness: expected"),
    ],
)
def test_a_bad_update_is_refused_in_one_line_and_changes_nothing(change, words):
    world = run(3)
    before, settings = bits(world), world.settings
    with pytest.raises(ValueError, match=r"expected|no such") as error:
        world.update(**change)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert (bits(world), world.settings) == (before, settings)
    with pytest.raises(ValueError, match=r"expected|no such"):
        sim.Simulation(DRAPE, **change)


def test_the_energy_that_a_change_puts_in_is_booked_once():
    world = sim.Simulation(scene(irregular(), bend="angle", bending=1e-2))
    before = sum(world.energy().values())
    world.update(rest_angle=0.5, stretch=500.0)
    put_in = sum(world.energy().values()) - before
    assert put_in > 0
    assert world.step().energy_injected == pytest.approx(put_in, rel=1e-12)
    assert world.step().energy_injected == 0.0


def test_a_step_that_blows_up_is_refused_and_leaves_the_state(monkeypatch):
    world = run(10)
    before, time = bits(world), world.time
    memory = {k: v.copy() for k, v in world.model.memory().items()}

    def poisoned(*args):
        result, name = taken(*args)
        result.velocities[0] = np.nan
        return result, name

    taken = module.take_step
    monkeypatch.setattr(module, "take_step", poisoned)
    with pytest.raises(sim.StepError) as error:
        world.step()
    assert error.value.phase == "solve"
    assert error.value.reason == "velocity of vertex 0 is nan m/s, beyond 1e+06 m/s"
    assert error.value.setting in str(error.value)
    assert (bits(world), world.time) == (before, time)
    assert all(np.array_equal(memory[k], v) for k, v in world.model.memory().items())
    monkeypatch.undo()
    world.step()
    assert bits(world) == bits(run(11))


def test_an_unsolvable_system_names_the_phase():
    world = run(2)
    world.model.masses[:] = -1.0
    before = bits(world)
    with pytest.raises(sim.StepError, match="solve") as error:
        world.step()
    assert error.value.phase == "solve"
    assert bits(world) == before


def test_views_cannot_be_written_to():
    world = run(1)
    for view in (world.positions, world.velocities, world.masses, world.triangles, world.edges, world.pinned):
        with pytest.raises(ValueError, match="read-only"):
            view[...] = 0


def test_pinned_vertices_do_not_move_by_a_bit():
    pinned = scene(grid(pins=["left", 30]), ball((0.2, 0, -0.3), 0.25), gravity=[0, 0, -9.81])
    world = sim.Simulation(pinned)
    start = world.positions[world.pinned].copy()
    for _ in range(40):
        world.step()
    assert (world.positions[world.pinned] == start).all()
    assert not world.velocities[world.pinned].any()


def test_a_fully_pinned_cloth_stands_still():
    world = sim.Simulation(scene(grid(resolution=(3, 3), pins=list(range(9))), gravity=[0, 0, -9.81]))
    start = bits(world)
    world.step()
    assert bits(world) == start


@pytest.mark.parametrize(
    "cloth",
    [
        {"vertices": [[0, 0, 0]]},
        {"vertices": [[0, 0, 0], [1, 1, 1]]},
        {"vertices": [[0, 0, 0]] * 3, "triangles": [[0, 1, 2]]},
        {"vertices": [[0, 0, 0], [1, 0, 0], [2, 0, 0]], "triangles": [[0, 1, 2]]},
        {
            "vertices": [[0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0], [0.5, -1, 0]],
            "triangles": [[0, 1, 2], [1, 0, 3]],
        },
        chain([[0, 0, 0], [0, 0, 0], [0, 0, 1]], [1e-6, 1.0, 1e6], pins=[2]),
    ],
    ids=["point", "two points", "one place", "zero area", "needle", "chain of a trillion to one"],
)
@pytest.mark.parametrize("bend", ["none", "cross", "angle"])
def test_degenerate_cloth_stays_finite(cloth, bend):
    world = sim.Simulation(
        scene(cloth, {"kind": "plane", "point": [0, 0, -0.5]}, gravity=[0, 0, -9.81], bend=bend)
    )
    for _ in range(60):
        world.step()
    assert np.isfinite(world.positions).all()
    assert world.positions[:, 2].min() > -0.5


@pytest.mark.parametrize(
    "extreme",
    [
        *({"stretch": k} for k in (0.0, 1e8)),
        *({"gamma": ratio} for ratio in (0.0, 1000.0)),
        *({"dt": h} for h in (1e-6, 1.0)),
        *({"density": rho} for rho in (1e-4, 1e3)),
        *({"thickness": d} for d in (1e-5, 0.1)),
        *({"tolerance": error} for error in (1e-12, 1e-2)),
        {"bending": 1e4},
        {"rest_angle": 3.14, "bending": 1.0},
        {"rest_angle": -3.14, "bend": "cross", "bending": 1.0},
        {"friction": 10.0},
        {"gravity": [0, 0, -1e3]},
        {"newton": 3, "dt": 0.1, "stretch": 1e6},
        {"mass": "constant"},
    ],
    ids=str,
)
@pytest.mark.parametrize("contact", ["penalty", "impulse"])
def test_every_end_of_every_slider_gives_a_finite_state(extreme, contact):
    world = sim.Simulation(
        scene(grid(resolution=(8, 8), position=[0, 0, 0.31]), ball(), gravity=[0, 0, -9.81], contact=contact),
        **extreme,
    )
    for _ in range(20):
        world.step()
    assert np.isfinite(world.positions).all()
    assert np.isfinite(list(world.energy().values())).all()


def test_the_report_says_what_ran_and_why_not():
    world = sim.Simulation(scene(grid(), bend="none", gamma=0.0))
    report = world.step()
    assert report.effects["gravity"].startswith("off")
    assert report.effects["bending"].startswith("off")
    assert report.effects["damping"].startswith("off")
    assert report.effects["contact"].startswith("off")
    assert report.effects["stretch"] == "ran"
    assert report.ms["total"] == pytest.approx(sum(v for k, v in report.ms.items() if k != "total"))


def test_the_total_is_all_of_a_step_and_what_no_phase_counts_is_the_rest(monkeypatch):
    world = sim.Simulation(scene(grid(), gravity=[0, 0, -9.81], drag=1.2))
    world.step()
    longest_way = type(world)._longest_way
    monkeypatch.setattr(type(world), "_longest_way", lambda *about: time.sleep(0.02) or longest_way(*about))
    begin = time.perf_counter()
    report = world.step()
    wall = 1e3 * (time.perf_counter() - begin)
    assert 20.0 < report.ms["rest"] < report.ms["total"] <= wall
    assert report.ms["total"] == pytest.approx(wall, abs=1.0)
    assert report.ms["total"] == pytest.approx(sum(v for k, v in report.ms.items() if k != "total"))


def test_stepping_with_the_usual_solver_does_not_wait_for_scipys_sparse_matrices():
    """Only the direct solver and the stability limit need them, and their import takes half a second."""
    code = (
        "import sys, sim; sim.Simulation({'cloth': {'kind': 'grid', 'resolution': [3, 3]}}).step(); "
        "sys.exit('scipy.sparse' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_angular_momentum_is_the_sum_of_every_vertex_s():
    world = sim.Simulation(scene(irregular(1, 50)))
    world.place(world.positions, np.random.default_rng(0).standard_normal(world.positions.shape))
    each = np.cross(world.positions, world.masses[:, None] * world.velocities)
    np.testing.assert_allclose(world.momentum()[1], each.sum(axis=0), rtol=1e-12)
