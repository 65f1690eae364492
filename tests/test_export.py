"""Recordings: what they hold, and that a file is whole or not there."""

import os
from pathlib import Path

import numpy as np
import pytest

import sim
from sim.export import Recording, check_outputs, check_size, check_writable, save_json, write_whole

SCENE = {"cloth": {"kind": "grid", "resolution": [4, 4], "pins": ["left"]}}


def recorded(steps, frame_time, **settings):
    world = sim.Simulation(SCENE, **settings)
    recording = Recording(world, frame_time)
    for _ in range(steps):
        world.step()
        if recording.due:
            recording.add()
    return recording


def test_a_recording_holds_every_frame_and_needs_no_pickle(tmp_path):
    recording = recorded(5, 1 / 60)
    recording.save(tmp_path / "out.npz")
    assert os.listdir(tmp_path) == ["out.npz"]
    with np.load(tmp_path / "out.npz", allow_pickle=False) as file:
        assert file["positions"].shape == (6, 16, 3)
        assert np.array_equal(file["positions"][-1], recording.world.positions)
        assert np.allclose(file["times"], np.arange(6) / 60, atol=1e-12)
        assert np.array_equal(file["triangles"], recording.world.triangles)
        assert np.array_equal(file["edges"], recording.world.edges)
        assert '"gamma":0.2' in str(file["settings"])
        assert str(file["version"]) == sim.__version__


@pytest.mark.parametrize(("dt", "steps", "frames"), [(1 / 240, 24, 7), (1 / 50, 10, 11), (0.007, 50, 22)])
def test_frames_come_at_the_time_asked_for_or_each_step(dt, steps, frames):
    times = recorded(steps, 1 / 60, dt=dt).arrays()["times"]
    assert len(times) == frames
    assert np.abs(times - np.arange(frames) * max(dt, 1 / 60)).max() <= 0.5 * dt + 1e-12


def test_a_write_that_fails_leaves_what_was_there(tmp_path):
    path = tmp_path / "out.npz"
    path.write_text("before")

    def fail(stream):
        stream.write(b"half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_whole(path, fail)
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["out.npz"]


def test_a_file_is_readable_by_whom_other_files_are(tmp_path):
    save_json(tmp_path / "out.json", {"γ": 1})
    (tmp_path / "other").touch()
    assert (tmp_path / "out.json").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert (tmp_path / "out.json").read_text(encoding="utf-8") == '{\n  "γ": 1\n}\n'


@pytest.mark.parametrize("path", ["", "nowhere/out.npz", "file/out.npz"])
def test_a_place_that_cannot_be_written_is_refused_beforehand(tmp_path, path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="cannot be written"):
        check_writable(tmp_path / path)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no such device here")
def test_a_device_is_not_replaced_by_a_file():
    with pytest.raises(OSError, match="it is not a file"):
        check_writable("/dev/null")


def test_asking_whether_a_place_can_be_written_leaves_nothing_there(tmp_path):
    check_writable(tmp_path / "out.npz")
    assert os.listdir(tmp_path) == []


def test_a_recording_that_would_not_fit_is_refused():
    check_size(10_000, 1000)
    with pytest.raises(ValueError, match="1,000,000 frames would take 240 GB, more than 2 GB"):
        check_size(10_000, 1_000_000)


def test_files_that_options_ask_for_are_checked_together(tmp_path):
    check_outputs(out=None, json=None)
    check_outputs(out=str(tmp_path / "a.npz"), json=str(tmp_path / "a.json"))
    with pytest.raises(ValueError, match="--html: expected a file, got an empty name"):
        check_outputs(json=None, html="")
    both = str(tmp_path / "same")
    with pytest.raises(ValueError, match="--json: expected another file than --out"):
        check_outputs(out=both, json=both)
