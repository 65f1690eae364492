"""Processes that work on what nobody times."""

import os
import signal
import subprocess
import sys
import time

import pytest

from server.cli import main

LONG = 60.0
"""What a worker is busy with [s]: far more than a test may take."""

SOON = 5.0
"""Within which a command is to be gone [s]: far less than LONG, and far more than the ending takes."""

BUSY = f"""
import time
from sim.workers import local_pool
from waits import pid_after

if __name__ == "__main__":
    with local_pool(2) as pool:
        pids = set()
        while len(pids) < 2:  # until both are there
            pids |= set(pool.map(pid_after, [0.1, 0.1]))
        for _ in range(4):
            pool.submit(time.sleep, {LONG})
        print(*pids, flush=True)
        time.sleep({LONG})
"""

WAITS = """
import os
import time


def pid_after(seconds):
    time.sleep(seconds)
    return os.getpid()
"""


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C reaches a process group")
def test_ctrl_c_ends_all_processes_at_once_without_a_word_of_theirs(tmp_path):
    (tmp_path / "waits.py").write_text(WAITS)
    script = tmp_path / "busy.py"
    script.write_text(BUSY)
    command = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert command.stdout is not None
    workers = [int(pid) for pid in command.stdout.readline().split()]
    assert len(workers) == 2
    begin = time.monotonic()
    os.killpg(command.pid, signal.SIGINT)
    _, said = command.communicate(timeout=LONG)
    assert time.monotonic() - begin < SOON
    assert said.count("Traceback") == 1, "that of the first process alone"
    for pid in workers:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_command_that_ctrl_c_ends_says_so_in_one_line(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("server.cost.run_study", interrupted)
    assert main(["cost", "drape"]) == 130
    assert capsys.readouterr().err == "muslin: ended by Ctrl-C\n"
