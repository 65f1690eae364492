"""The page under load: a class of thirty, some of whom are slow, rude or gone; memory over time; ends.

MUSLIN_SOAK sets how many seconds the soak takes: minutes of it are for those who look for a leak.
"""

import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from crowd import LAST
from fake_world import FakeWorld, RawClient, wait_until

from server import guard

pytestmark = pytest.mark.alone

SOAK = float(os.environ.get("MUSLIN_SOAK", "20"))
THIRTY = {
    "calm": 14,
    "slow": 4,
    "deaf": 2,
    "vanishing": 3,
    "flooding": 1,
    "rude": 1,
    "garbage": 3,
    "fighting": 2,
}

GROWTH = 40.0
"""Megabytes that the process may grow by after its first seconds, in however long a soak."""


def megabytes():
    """Memory of this process that is in use."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def gather(url, seconds, counts, client):
    labels = ("damping ratio γ", "rest angle θ₀ [rad]", "friction")
    controls = {label: client.find(label) for label in labels}
    script = Path(__file__).with_name("crowd.py")
    arguments = [url, str(seconds), json.dumps(counts), json.dumps(controls)]
    return subprocess.Popen([sys.executable, script, *arguments], stdout=subprocess.PIPE, text=True)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.timeout(SOAK + 120)
def test_thirty_clients_of_all_sorts_leave_simulation_memory_and_the_last_word_as_they_should_be(
    lab, client, caplog, record_property
):
    """Nothing stops, nothing piles up, what was sent last is not lost, and all see the same in the end."""
    with caplog.at_level(logging.ERROR):
        crowd = gather(lab.url, SOAK, THIRTY, client)
        wait_until(lambda: len(lab._page.server.get_clients()) > 20, 60)
        client.messages.clear()
        reached, memory, held, still = lab.frames[0].time, [], 0, 0
        while crowd.poll() is None:
            threading.Event().wait(0.5)
            memory.append(megabytes())
            held = max(held, len(lab._page.server.get_clients()))
            client.messages.clear()
            before, reached = reached, lab.frames[0].time
            still = 0 if reached > before else still + 1
            assert still < 20, "it stands still"
    did = json.loads(crowd.stdout.read())
    growth = max(memory[-4:]) - memory[min(len(memory) // 4, 20)]
    figures = {
        "held": held,
        "steps": FakeWorld.made[0].steps,
        "MB": round(memory[-1]),
        "growth": round(growth, 1),
        "curve": [round(m) for m in memory[:: max(1, len(memory) // 30)]],
        **did,
    }
    for name, figure in figures.items():
        record_property(name, figure)
    sys.stdout.write(f"{figures}\n")
    assert crowd.returncode == 0
    assert held >= 27, "of thirty-one, a few come and go"
    assert growth < GROWTH
    assert not caplog.records, "nothing went wrong in the server that is more than a client's nonsense"
    wait_until(lambda: lab.comparison.shared.friction == LAST, 60)
    wait_until(lambda: len(lab._page.server.get_clients()) == 1, 60)
    assert not guard_leftovers(lab)
    client.set(client.find("damping ratio γ"), 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)
    late = RawClient(lab.url)
    uuid = late.find("damping ratio γ")
    wait_until(lambda: late.shows(uuid) == 0.5)
    late.close()


def guard_leftovers(lab):
    """What viser still keeps for connections that are gone."""
    wire = lab._page.server._websock_server
    return len(wire._live_connections) - 1 or len(wire._broadcast_buffer.generator_cursors) - 1


def test_a_flood_is_slowed_down_to_a_pace_and_its_last_word_is_heard(lab, client):
    """Messages wait in the sender's own computer: the lab hears no more than the pace allows."""
    heard = []
    gate = lab._page.server._websock_server._handle_incoming_message
    lab._page.server._websock_server._handle_incoming_message = lambda *a: (heard.append(0), gate(*a))[1]
    hostile, count = RawClient(lab.url), 2 * int(guard.BURST)
    hostile.look()
    uuid = hostile.find("friction")
    begin = threading.Event()
    hostile.drag(uuid, [*(i / count for i in range(count)), LAST])
    begin.wait(0.1)
    assert len(heard) < count, "the rest waits"
    wait_until(lambda: lab.comparison.shared.friction == LAST)
    hostile.close()


def test_what_a_page_said_before_it_left_is_heard(lab, client):
    """All of it has come when its last ping is answered, and most of it waits for the pace."""
    leaving, count = RawClient(lab.url), 2 * int(guard.BURST)
    leaving.look()
    uuid = leaving.find("friction")
    leaving.drag(uuid, [*(i / count for i in range(count)), LAST])
    leaving.vanish()
    wait_until(lambda: lab.comparison.shared.friction == LAST)
    wait_until(lambda: len(lab._page.server.get_clients()) == 1)
    assert not guard_leftovers(lab)


def test_a_page_that_reads_nothing_is_sent_no_more_than_its_backlog_holds(lab, client, monkeypatch):
    deaf = RawClient(lab.url)
    deaf.look()
    wait_until(lambda: len(lab._page.server.get_clients()) == 2)
    wire = lab._page.server._websock_server
    connection = wire._live_connections[max(wire._live_connections)]
    for end, buffer in ((connection, socket.SO_SNDBUF), (deaf._socket, socket.SO_RCVBUF)):  # soon full
        end.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, buffer, 4096)
    deaf._loop.call_soon_threadsafe(deaf._socket.transport.pause_reading)
    wait_until(lambda: connection.transport.get_write_buffer_size() > 0, 120)
    reached = lab.frames[0].time
    wait_until(lambda: lab.frames[0].time > reached + 1.0)
    assert connection.transport.get_write_buffer_size() < 2**20
    deaf._loop.call_soon_threadsafe(deaf._socket.transport.abort)
    wait_until(lambda: len(lab._page.server.get_clients()) == 1)


def test_two_who_fight_over_a_slider_see_the_same_in_the_end(lab, client):
    other = RawClient(lab.url)
    other.look()
    uuid = client.find("damping ratio γ")
    other.find("damping ratio γ")
    for i in range(50):
        client.set(uuid, 0.5 + i / 1000)
        other.set(uuid, 1.5 + i / 1000)
    last = lab._page.panel._shared["gamma"].inputs[0]
    threading.Event().wait(0.5)
    wait_until(lambda: lab.comparison.shared.gamma == last.value)
    assert last.value in (0.549, 1.549)
    third = RawClient(lab.url)
    third.find("damping ratio γ")
    wait_until(lambda: third.shows(uuid) == last.value)
    assert [w.settings.gamma for w in FakeWorld.made] == [last.value] * 2
    other.close()
    third.close()


def test_whoever_comes_when_too_many_are_there_is_asked_to_come_later(lab, monkeypatch):
    from websockets.exceptions import InvalidStatus

    monkeypatch.setattr(guard, "MOST_CLIENTS", 2)
    here = [RawClient(lab.url) for _ in range(2)]
    with pytest.raises(InvalidStatus) as refused:
        RawClient(lab.url)
    assert refused.value.response.status_code == 503
    here.pop().close()
    wait_until(lambda: len(lab._page.server._websock_server._live_connections) == 1)
    late = RawClient(lab.url)
    wait_until(lambda: late.controls)
    for client in (late, *here):
        client.close()


HEAVY = """
[cloth]
kind = "grid"
resolution = [160, 160]
pins = ["left"]
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_ctrl_c_in_the_middle_of_a_step_ends_the_command_quietly(tmp_path):
    """A step of this sheet takes most of a frame, so that the signal comes within one."""
    scene = tmp_path / "heavy.toml"
    scene.write_text(HEAVY)
    command = [sys.executable, "-u", "-m", "server", "--no-browser", "--port", "0", "--scene", str(scene)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    url = process.stdout.readline().split()[3]
    client = RawClient(url)
    client.look()
    measured = re.compile(r"\d ms · ")
    wait_until(lambda: any(measured.search(str(m)) for m in list(client.messages)), 200)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 0
    assert errors == ""
    client.close()
