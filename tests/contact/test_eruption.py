"""Steps of contact that would put in energy."""

from sim.scene import load_scene
from sim.simulation import Simulation

FINE = {
    "cloth": {"kind": "grid", "size": [0.4, 0.4], "resolution": [41, 41], "position": [0.0, 0.0, 0.02]},
    "obstacle": [{"kind": "sphere", "center": [0.0, 0.0, -0.15], "radius": 0.15}],
    "settings": {"density": 0.2, "stretch": 10.0, "altitude": 10.0, "bending": 1e-4, "thickness": 3e-3},
}
"""Cloth that falls by three edges' lengths a step when it meets the ball."""


def total(sim):
    return sum(sim.energy().values())


def test_fine_cloth_that_is_stopped_is_asked_twice_and_not_halved():
    sim = Simulation(load_scene(FINE))
    twice, start = 0, total(sim)
    for _ in range(12):
        report = sim.step()
        assert report.substeps == 1
        twice += report.newton > 1
        assert total(sim) < start
    assert twice > 0  # else the linearised step was good enough, and nothing is shown


def test_a_step_that_lands_softly_is_linearised():
    soft = FINE | {"settings": FINE["settings"] | {"stretch": 0.1, "altitude": 0.1}}
    sim = Simulation(load_scene(soft))
    assert [sim.step().newton for _ in range(5)] == [1] * 5
