"""Peers: the registry, a row for one that is not installed, and a frame of each that is."""

import importlib.util
import subprocess
import sys

import numpy as np
import pytest

from sim import bench
from sim.bench.peers import MUSLIN, PEERS, Peer, version_of, words
from sim.bench.sheet import FRAME, GRAVITY, KINDS, Sheet
from sim.bench.tables import tabulate

SHORT = 0.02
"""Part of free fall that damping and the pinned corners may take off the lowest vertex in a few frames."""


def test_listing_peers_imports_none_of_them():
    probe = (
        "import sys\nimport sim.bench\nsim.bench.solvers()\n"
        "heavy = {'numba', 'numpy', 'scipy', 'mujoco', 'taichi', 'newton', 'warp'} & sys.modules.keys()\n"
        "sys.stdout.write(str(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout == "set()"


@pytest.mark.parametrize("name", [MUSLIN, *PEERS])
def test_every_peer_has_a_module_and_says_what_differs(name):
    peer = bench.solvers()[name]
    assert importlib.util.find_spec(peer.module) is not None
    assert peer.note.endswith(".")


def test_a_peer_that_is_not_installed_has_a_row_that_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(PEERS, "Nobody's", Peer("sim.bench.peers.nobody", ("no_such_package",), "Nobody's."))
    assert PEERS["Nobody's"].missing == ("no_such_package",)
    cases = [bench.Case(measure, "Nobody's", "hang", 64, 1, 3, 1.0) for measure in ("frames", "accuracy")]
    result = tabulate(bench.run(cases, measure=lambda case: pytest.fail("it was run")))
    for table in result.tables:
        (row,) = table.rows
        assert len(row) == len(table.columns)
        assert "not installed: pip install 'muslin[peers]'" in row


def test_settings_are_put_into_words():
    assert words({"substeps": 8, "iterations": 400, "solver": "CG"}) == "8×400 CG"
    assert words({"substeps": 8}) == "8"


def test_versions_are_those_of_the_distribution_and_empty_where_there_is_none():
    assert version_of("numpy") == np.__version__
    assert version_of("no_such_package") == ""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", [MUSLIN, *PEERS])
def test_a_peer_moves_the_sheet_as_gravity_does(name, kind):
    peer = bench.solvers()[name]
    if peer.missing:
        pytest.skip(f"{' and '.join(peer.missing)} not installed: pip install 'muslin[peers]'")
    sheet, frames = Sheet(kind, 6), 3
    module = peer.load()
    assert len(module.FRAMES) == peer.settings
    run = module.start(sheet, module.FRAMES[0], 1)
    start = run.positions()
    np.testing.assert_allclose(start, sheet.mesh.vertices, atol=1e-6)  # Newton is in single precision
    for _ in range(frames):
        run.frame()
    end = run.positions()
    np.testing.assert_allclose(end[sheet.mesh.pinned], start[sheet.mesh.pinned], atol=1e-6)
    time = frames * FRAME
    fallen = (start - end)[:, 2].max()
    free_fall = 0.5 * GRAVITY * time**2
    first_order = free_fall * (1.0 + 1.0 / frames)  # of implicit Euler with one step a frame, the most of all
    assert (1.0 - SHORT) * free_fall < fallen < (1.0 + SHORT) * first_order
