"""Tokens and roles: whom the page lets in, whom it listens to, and what it tells those who watch."""

import http.client
import re
from urllib.parse import urlsplit

import pytest
from fake_world import SCENE, FakeWorld, RawClient, nothing_to_compile, wait_until
from websockets.exceptions import InvalidStatus

from server.access import Access, Role, cookie, cookie_name, is_loopback, token_in, tokens_in
from server.lab import Lab


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "::1", "localhost"])
def test_no_token_is_asked_for_where_only_this_computer_reaches_the_page(host):
    access = Access.at(host)
    assert is_loopback(host)
    assert access.role([]) is Role.ACTS
    assert access.host_address("http://x") == access.guest_address("http://x") == "http://x"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "", "bench.example"])
def test_a_token_is_asked_for_where_others_reach_it(host):
    access = Access.at(host)
    assert access.role([]) is access.role([""]) is access.role(["no", "ünïcode"]) is None
    assert access.role([access.host_token]) is access.role(["old", access.guest_token]) is Role.ACTS
    assert (
        access.guest_address("http://x")
        == access.host_address("http://x")
        == f"http://x/?token={access.host_token}"
    )


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_with_view_only_guests_watch_and_the_host_acts(host):
    access = Access.at(host, view_only=True)
    token = re.search("token=(.*)", access.host_address("http://x"))[1]
    assert access.role([token]) is Role.ACTS
    given = re.search("token=(.*)", access.guest_address("http://x"))
    assert access.role([given[1]] if given else []) is Role.WATCHES
    assert token not in access.guest_address("http://x")


def test_tokens_are_new_each_time_and_no_representation_shows_them():
    one, other = Access(), Access()
    assert len({one.host_token, one.guest_token, other.host_token, other.guest_token}) == 4
    assert one.host_token not in repr(one)


@pytest.mark.parametrize(
    ("path", "token", "rest"),
    [
        ("/", "", "/"),
        ("/?token=abc", "abc", "/"),
        ("/?a=1&token=abc&b=", "abc", "/?a=1&b="),
        ("//evil.example/?token=abc", "abc", "/"),
        ("/x/y?token=", "", "/x/y"),
    ],
)
def test_a_path_is_told_from_its_token_and_leads_nowhere_else(path, token, rest):
    assert token_in(path) == (token, rest)


def test_a_cookie_comes_back_as_it_was_given_and_nonsense_is_none():
    name = cookie_name(8080)
    given = cookie(8080, "abc").partition(";")[0]
    assert tokens_in([f"other=1; {given}", "\0=;;", "muslin-8081=no"], name) == ["abc"]


@pytest.fixture
def open_lab():
    labs = []

    def open_lab(**options):
        lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile, **options)
        labs.append(lab)
        lab.start()
        return lab

    FakeWorld.made.clear()
    yield open_lab
    for lab in labs:
        lab.stop()


def local(url):
    """The same address by way of the loopback, which every test machine has."""
    parts = urlsplit(url)
    return f"http://127.0.0.1:{parts.port}{parts.path}{'?' * bool(parts.query)}{parts.query}"


def get(url, **headers):
    parts = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port)
    connection.request("GET", f"{parts.path or '/'}?{parts.query}", headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong"])
def test_a_request_without_the_token_is_refused_in_one_friendly_line(open_lab, query):
    lab = open_lab(host="0.0.0.0")
    response, body = get(local(lab.url).partition("/?")[0] + "/" + query)
    assert response.status == 403
    assert body.decode().startswith("Refused: this page needs an address that ends in ?token=…; ask ")
    assert body.count(b"\n") == 1


def test_a_websocket_without_the_token_is_refused(open_lab):
    lab = open_lab(host="0.0.0.0")
    with pytest.raises(InvalidStatus) as refused:
        RawClient(local(lab.url).partition("/?")[0])
    assert refused.value.response.status_code == 403


def test_the_address_gives_a_cookie_and_leads_on_without_its_token_and_the_cookie_opens_the_rest(open_lab):
    lab = open_lab(host="0.0.0.0")
    response, _ = get(local(lab.url))
    assert (response.status, response.getheader("Location")) == (303, "/")
    given = response.getheader("Set-Cookie")
    assert "HttpOnly" in given
    held = given.partition(";")[0]
    page = local(lab.url).partition("/?")[0]
    response, body = get(page, Cookie=f"a=b; {held}")
    assert response.status == 200
    assert b"<html" in body
    client = RawClient(page, origin=page, Cookie=held)
    wait_until(lambda: client.controls)
    client.close()


def test_a_program_may_carry_the_token_in_the_address_of_its_websocket(open_lab):
    lab = open_lab(host="0.0.0.0")
    client = RawClient(local(lab.url))
    client.look()
    client.set(client.find("damping ratio γ"), 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)
    client.close()


def test_the_printed_address_is_one_that_others_can_reach(open_lab):
    host = urlsplit(open_lab(host="0.0.0.0").url).hostname
    assert host not in ("0.0.0.0", "localhost")


def texts(client):
    return " ".join(m["props"].get("content", "") for m in list(client.controls.values()))


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_of_somebody_who_watches_the_camera_alone_is_heard(open_lab, host):
    lab = open_lab(host=host, view_only=True)
    guest, teacher = RawClient(local(lab.guest_url)), RawClient(local(lab.url))
    guest.look()
    teacher.look()
    wait_until(lambda: "You are watching" in texts(guest))
    assert "You are watching" not in texts(teacher)
    wait_until(lambda: lab.frames and lab.frames[0].time > 0, 20)
    before, playing = lab.comparison, lab._bench.playing
    slider, speed = guest.find("damping ratio γ"), guest.find("speed")
    guest.set(slider, 1.5)
    guest.set(speed, "4 ×")
    guest.set(guest.find("run"), "❚❚ Pause")
    guest.set(guest.find("compare by"), "density")
    for message in list(guest.messages):
        if message["type"] == "RegisterCommandMessage":
            guest.send(type="CommandTriggerMessage", uuid=message["uuid"])
    wait_until(lambda: guest.values.get(slider) == before.shared.gamma, 20)
    assert (lab.comparison, lab._bench.playing, lab._bench.clock.speed) == (before, playing, 1.0)
    teacher.set(slider, 0.7)
    wait_until(lambda: lab.comparison.shared.gamma == 0.7)
    wait_until(lambda: guest.values.get(slider) == 0.7)
    reached = lab.frames[0].time
    wait_until(lambda: lab.frames[0].time > reached)
    guest.close()
    teacher.close()


def test_without_view_only_all_share_the_controls_and_are_told_how_many_they_are(open_lab):
    lab = open_lab()
    first, second = RawClient(lab.url), RawClient(lab.guest_url)
    first.look()
    second.look()
    wait_until(
        lambda: any("2 pages" in str(m) and "shares this simulation" in str(m) for m in first.messages)
    )
    second.set(second.find("damping ratio γ"), 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)
    assert "You are watching" not in texts(second)
    first.close()
    second.close()
