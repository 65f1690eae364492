"""Cloth slides over a flat mesh as over a plane: edges between its triangles are no bumps."""

import numpy as np
import pytest

import sim

MU, THICKNESS, DT = 0.3, 3e-3, 1 / 60


def floor(path, cells):
    """A square of 1 m as an .obj file, of cells × cells squares that are cut along their diagonals."""
    ticks = np.linspace(-0.5, 0.5, cells + 1)
    lines = [f"v {x!r} {y!r} 0" for y in ticks.tolist() for x in ticks.tolist()]
    for j in range(cells):
        for i in range(cells):
            a = j * (cells + 1) + i + 1
            b, c, d = a + 1, a + cells + 2, a + cells + 1
            lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    path.write_text("\n".join(lines))
    return path


def on_slope(path, steepness):
    """Cloth on the floor, which the pull of gravity makes a slope as steep as `steepness` × MU."""
    slope = np.arctan(steepness * MU)
    cloth = {"kind": "grid", "size": [0.2, 0.17], "resolution": [7, 6], "position": [0.0, 0.0, THICKNESS]}
    settings = {"gravity": [9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope)], "contact": "impulse"}
    settings |= {"friction": MU, "thickness": THICKNESS, "bending": 1e-3, "newton": 3, "dt": DT}
    obstacle = {"kind": "mesh", "file": path.name}
    scene = {"cloth": cloth, "obstacle": [obstacle], "settings": settings, "folder": str(path.parent)}
    return sim.Simulation(sim.load_scene(scene))


@pytest.mark.parametrize("cells", [1, 32])
def test_cloth_slides_over_a_flat_mesh_as_over_a_plane(tmp_path, cells):
    world = on_slope(floor(tmp_path / "floor.obj", cells), 1.05)
    speeds = []
    for _ in range(60):
        world.step()
        speeds.append(world.velocities[:, 0].mean())
    slope = np.arctan(1.05 * MU)
    expected = 9.81 * (np.sin(slope) - MU * np.cos(slope))
    assert (speeds[-1] - speeds[9]) / (50 * DT) == pytest.approx(expected, rel=0.03)  # that of a plane


def test_cloth_rests_on_a_flat_mesh_within_its_cone(tmp_path):
    world = on_slope(floor(tmp_path / "floor.obj", 1), 0.95)
    start = world.positions.copy()
    for _ in range(60):
        world.step()
    assert np.abs(world.positions - start).max() < 1e-4
