"""The guard, tried with real connections to a real server."""

import http.client
import logging
import socket
import warnings

import pytest
import viser
from fake_world import RawClient, wait_until
from viser import _messages
from websockets.exceptions import InvalidStatus

from server import guard


def headers(**values):
    return {key.capitalize(): value for key, value in values.items()}


@pytest.mark.parametrize(
    "accepted",
    [
        headers(host="127.0.0.1:8080"),
        headers(host="127.0.0.1:8080", origin="http://127.0.0.1:8080"),
        headers(host="localhost:8080", origin="http://localhost:8080"),
        headers(host="[::1]:8080", origin="http://[::1]:8080"),
        headers(host="192.168.1.5:8080", origin="http://192.168.1.5:8080"),
    ],
)
def test_own_pages_and_programs_pass(accepted):
    assert guard.refusal(accepted) is None


@pytest.mark.parametrize(
    "refused",
    [
        headers(host="127.0.0.1:8080", origin="http://evil.example"),
        headers(host="127.0.0.1:8080", origin="http://127.0.0.1:8081"),
        headers(host="127.0.0.1:8080", origin="http://localhost:8080"),
        headers(host="127.0.0.1:8080", origin="http://127.0.0.1.evil.example:8080"),
        headers(host="127.0.0.1:8080", origin="null"),
        headers(host="127.0.0.1:8080", origin=""),
        headers(host="127.0.0.1:8080", origin="file://"),
        headers(host="127.0.0.1:8080", origin="http://[broken"),
        headers(host="evil.example:8080", origin="http://evil.example:8080"),
        headers(host="evil.example:8080"),
        headers(),
    ],
)
def test_foreign_origins_and_rebound_names_are_refused(refused):
    assert guard.refusal(refused)


def test_websocket_of_a_foreign_origin_is_refused_in_the_handshake(lab):
    with pytest.raises(InvalidStatus) as refused:
        RawClient(lab.url, origin="http://evil.example")
    assert refused.value.response.status_code == 403


def test_websocket_of_the_own_page_is_accepted(client):
    wait_until(lambda: client.controls)


def test_websocket_without_an_origin_is_a_program_and_accepted(lab):
    client = RawClient(lab.url)
    wait_until(lambda: client.controls)
    client.close()


def test_page_is_not_served_under_a_foreign_name(lab):
    connection = http.client.HTTPConnection("127.0.0.1", int(lab.url.rpartition(":")[2]))
    connection.request("GET", "/", headers={"Host": "evil.example"})
    assert connection.getresponse().status == 403
    connection.close()


def test_share_request_by_message_opens_no_tunnel(client, monkeypatch):
    asked = []
    monkeypatch.setattr(viser._viser, "ViserTunnel", lambda *args: asked.append(args))
    client.send(type="ShareUrlRequest")
    client.send(type="ShareUrlDisconnect")
    settle(client)
    assert asked == []
    assert not [m for m in client.messages if m["type"] == "ShareUrlUpdated"]


def test_share_request_from_python_opens_no_tunnel(monkeypatch, caplog):
    monkeypatch.setattr(viser._viser, "ViserTunnel", None)
    server, _ = guard.open_server("127.0.0.1", 0)
    with caplog.at_level(logging.WARNING):
        assert server.request_share_url() is None
    assert "refused" in caplog.text
    server.stop()


def test_only_listed_messages_reach_viser():
    server, _ = guard.open_server("127.0.0.1", 0)
    assert set(server._websock_server._incoming_handlers) <= guard.HANDLED
    assert _messages.FileTransferStartUpload not in server._websock_server._incoming_handlers
    server.stop()


def test_values_of_wrong_types_are_not_printed_one_by_one():
    with warnings.catch_warnings(record=True) as printed:
        warnings.simplefilter("always")
        server, _ = guard.open_server("127.0.0.1", 0)
        client = RawClient(f"http://127.0.0.1:{server.get_port()}")
        for k in range(3):
            client.look(up_direction=[f"{k}\n"])
        client.look()
        wait_until(server.get_clients)
        client.close()
        server.stop()
    assert not [str(each.message) for each in printed if "does not match" in str(each.message)]


def test_other_servers_of_the_process_are_left_alone():
    server, _ = guard.open_server("127.0.0.1", 0)
    server.stop()
    plain = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    client = RawClient(f"http://127.0.0.1:{plain.get_port()}", origin="http://elsewhere.example")
    client.close()
    plain.stop()


@pytest.mark.parametrize("host", ["999.1.1.1", "192.0.2.1", "a..b"])
def test_address_that_cannot_be_listened_at_is_refused_at_once(host):
    with pytest.raises(ValueError, match=f"^--host {host}: cannot listen there: "):
        guard.open_server(host, 0)


def test_last_port_taken_is_refused_and_not_waited_for():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 65535))
        taken.listen()
        with pytest.raises(ValueError, match="--port 65535"):
            guard.open_server("127.0.0.1", 65535)


def settle(client):
    """Until everything sent before has been handled: a last, harmless change has come through."""
    uuid = client.find("speed")
    before = len(client.messages)
    client.set(uuid, "no such speed")
    wait_until(lambda: any(m.get("uuid") == uuid for m in client.messages[before:]))


HOSTILE = ["text", None, True, [], {}, [1, 2], float("nan"), float("inf"), -float("inf"), "9" * 100_000, ""]


@pytest.mark.parametrize(
    "label",
    [
        "damping ratio γ",
        "bending spring",
        "stretch stiffness [N]",
        "speed",
        "scene",
        "gravity [m/s²]",
        "compare by",
    ],
)
def test_value_of_a_wrong_kind_is_refused(lab, client, label):
    before = lab.comparison
    for value in HOSTILE:
        client.set(client.find(label), value)
    client.set(client.find("friction"), 2**63)
    wait_until(lambda: lab.comparison.shared.friction == 1.0)
    assert lab.comparison == before.with_shared("friction", 1.0)


@pytest.mark.parametrize(("sent", "kept"), [(9999.0, 2.0), (-5.0, 0.0), (0.75, 0.75), (1, 1.0)])
def test_number_out_of_range_is_clamped_everywhere(lab, client, sent, kept):
    uuid = client.find("damping ratio γ")
    client.set(uuid, sent)
    wait_until(lambda: lab.comparison.shared.gamma == kept)
    other = RawClient(lab.url)
    wait_until(lambda: other.controls.get(uuid))
    wait_until(lambda: other.values.get(uuid, other.controls[uuid]["value"]) == kept)
    if sent != kept:
        wait_until(lambda: client.values.get(uuid) == kept)
    other.close()


def test_box_beside_a_log_slider_refuses_what_is_out_of_bounds(lab, client):
    box = client.find("stretch stiffness [N]", "Text")
    client.set(box, "1e99")
    wait_until(lambda: client.values.get(box) == "50")
    client.set(box, "2e5")
    wait_until(lambda: lab.comparison.shared.stretch == 2e5)


def test_somebody_without_a_camera_changes_neither_the_simulation_nor_what_the_pages_show(lab, client):
    """Viser would show the value everywhere and tell nobody of it."""
    early, uuid = RawClient(lab.url), client.find("damping ratio γ")
    early.find("damping ratio γ")
    early.set(uuid, 1.5)
    wait_until(lambda: early.values.get(uuid) == 0.2)
    assert lab.comparison.shared.gamma == 0.2
    early.look()
    early.set(uuid, 1.5)
    wait_until(lambda: lab.comparison.shared.gamma == 1.5)
    early.close()


def test_unknown_choice_is_refused_and_shown_as_it_was(lab, client):
    uuid = client.find("bending spring")
    client.set(uuid, "rubber")
    wait_until(lambda: client.values.get(uuid) == lab.comparison.shared.bend)


def test_other_properties_of_a_control_cannot_be_set(lab, client):
    uuid = client.find("damping ratio γ")
    client.set(uuid, 1.0, disabled=True)
    client.send(type="GuiUpdateMessage", uuid=uuid, updates={"update_cb": []})
    client.send(type="GuiUpdateMessage", uuid=uuid, updates=[])
    settle(client)
    client.set(uuid, 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)


def test_a_client_can_upload_nothing(lab, client):
    """Each upload would be kept in memory, whatever its size, and for ever if it is never finished."""
    wait_until(lab._page.server.get_clients)
    (handle,) = lab._page.server.get_clients().values()
    assert _messages.FileTransferStartUpload not in handle._websock_connection._incoming_handlers
    client.send(
        type="FileTransferStartUpload",
        source_component_uuid=client.find("friction"),
        transfer_uuid="x",
        filename="x",
        mime_type="x",
        part_count=10**9,
        size_bytes=10**15,
    )
    settle(client)
    assert not handle.gui._current_file_upload_states


def test_greyed_control_cannot_be_set(lab, client):
    threads = client.find("threads")
    before = lab.comparison
    client.set(threads, 4)
    settle(client)
    assert lab.comparison == before


@pytest.mark.parametrize("data", ["text", b"", b"\xff\xfe", b"\x80", b"\x81\xa4type\xa7Nothing"])
def test_garbage_ends_its_own_connection_only(lab, client, data, caplog):
    hostile = RawClient(lab.url)
    wait_until(lambda: hostile.controls)
    hostile.send_bytes(data)
    uuid = client.find("damping ratio γ")
    client.set(uuid, 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)
    assert not [record for record in caplog.records if record.exc_info]
