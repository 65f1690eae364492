"""What crosses in a simulation now, as the page and `muslin compare` count it: all of it, felt or not."""

import numpy as np
import pytest

import sim
from tests.worlds import chain, scene

FLAT = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 2]]}
UPRIGHT = {"vertices": [[0.2, 0.2, -1], [0.3, 0.2, -1], [0.25, 0.25, 1]], "triangles": [[0, 1, 2]]}
"""Two of its edges go through FLAT, none of whose edges goes through it."""

UNFELT = {"contact": "none", "tangled": "keep"}


def shell(arrays, **placed):
    return {**arrays, **placed}


def count(cloth, *obstacles, **settings):
    return sim.Simulation(scene(cloth, *obstacles, **(UNFELT | settings))).crossings()


def test_edges_through_triangles_of_cloth_and_mesh_obstacles_are_counted_whatever_is_felt():
    assert count([FLAT, UPRIGHT]) == 2
    assert count(FLAT, shell(UPRIGHT)) == 2
    assert count(UPRIGHT, shell(FLAT)) == 2
    assert count(FLAT, shell(UPRIGHT), obstacles="off", contact="penalty") == 2
    assert count(FLAT, shell(UPRIGHT, position=[0, 0, 1.5])) == 0


def test_obstacles_across_each_other_are_nobodys_trouble():
    aside = {**FLAT, "vertices": [[5, 0, 0], [6, 0, 0], [5, 1, 0]]}
    assert count(aside, shell(FLAT), shell(UPRIGHT)) == 0


def test_obstacles_are_taken_where_they_are_at_the_time():
    """A spike that comes up through resting cloth within a step."""
    path = [{"time": 0.0, "position": [0, 0, -1.5]}, {"time": 0.01, "position": [0, 0, 0]}]
    held = {**FLAT, "pins": [0, 1, 2]}
    world = sim.Simulation(scene(held, shell(UPRIGHT, path=path), dt=0.01, **UNFELT))
    assert world.crossings() == 0
    world.step()
    assert world.crossings() == 2


def test_threads_that_cross_in_their_plane_are_counted_and_those_that_share_a_vertex_not():
    """Each of the two edges goes through the other."""
    cross = [chain([[-1, 0, 0], [1, 0, 0.3]], [1, 1]), chain([[0, 0, -1], [0.2, 0, 1]], [1, 1])]
    assert count(cross) == 2
    assert count(chain([[-1, 0, 0], [0, 0, 0], [0.2, 0, 1]], [1, 1, 1])) == 0


def test_a_thread_through_cloth_is_counted():
    assert count([FLAT, chain([[0.2, 0.3, -1], [0.25, 0.35, 1]], [1, 1])]) == 1


@pytest.mark.parametrize("detection", ["static", "continuous"])
def test_what_has_gone_through_the_needle_s_sheet_is_seen_while_no_vertex_is_inside(detection):
    world, crossed = sim.Simulation("needle", detection=detection), []
    while world.time < 0.3:
        assert world.step().penetrations == 0
        crossed.append(world.crossings())
    assert (np.max(crossed) > 0) == (detection == "static")
