"""Projector mode: whose page is in it, how it is entered and left, and what is there then."""

import http.client
from urllib.parse import urlsplit

import pytest
from fake_world import SCENE, FakeWorld, RawClient, label_sizes, nothing_to_compile, wait_until

from server.guard import PROJECTOR
from server.lab import Lab
from server.stage import ENLARGED, LABEL


def pieces(client):
    """What hides the docks of a client's page, as it is now."""
    html = {uuid: dict(m["props"]) for uuid, m in list(client.controls.items()) if "content" in m["props"]}
    for m in list(client.messages):
        if m["type"] == "GuiUpdateMessage" and m["uuid"] in html:
            html[m["uuid"]].update(m["updates"])
    return [p["content"] for p in html.values() if p["visible"] and "muslin projector" in p["content"]]


def test_the_key_brings_one_page_into_the_mode_and_out_again_and_no_other(lab, client):
    other = RawClient(lab.url)
    other.look()
    wait_until(lambda: len(lab._page.server.get_clients()) == 2)
    client.press("P")
    wait_until(lambda: pieces(client) and "tradeoff" in pieces(client)[0])
    chart = pieces(client)[0]
    assert "local error of a frame against its cost" in chart
    assert "<span>collision method</span>" in chart
    wait_until(lambda: list(label_sizes(client).values()) == [pytest.approx(ENLARGED * LABEL)] * 2)
    client.press("P")
    wait_until(lambda: not pieces(client))
    wait_until(lambda: not label_sizes(client))
    assert not pieces(other)
    assert not label_sizes(other)
    other.close()


def test_labels_are_large_and_say_the_same_after_another_scene_was_opened(lab, client):
    client.press("P")
    wait_until(lambda: len(label_sizes(client)) == 2)
    before = set(label_sizes(client))
    lab.post(lab.change_count, 1)
    wait_until(lambda: len(label_sizes(client)) == 3)
    assert not before & set(label_sizes(client))
    wait_until(lambda: lab.frames and lab.frames[0].time > 0)
    wait_until(lambda: all("ms" in place._text for place in lab._page.stage._places))
    for place in lab._page.stage._places:
        ((own, _),) = place._own_labels.values()
        wait_until(lambda own=own, place=place: own.text == place._text == place._label.text)


def test_an_address_opens_the_page_in_the_mode(lab, client):
    address = lab.url + PROJECTOR
    connection = http.client.HTTPConnection("127.0.0.1", urlsplit(address).port)
    connection.request("GET", PROJECTOR)
    assert b"<html" in connection.getresponse().read()
    connection.close()
    beamer = RawClient(address, origin=lab.url)
    beamer.look()
    wait_until(lambda: pieces(beamer))
    assert not pieces(client)
    beamer.close()


def test_who_only_watches_may_project_and_frame_the_view_and_nothing_else():
    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile, view_only=True)
    lab.start()
    guest = RawClient(lab.guest_url)
    guest.look()
    wait_until(lambda: lab.frames and lab.frames[0].time > 0)
    guest.press("2")
    guest.press("space")
    guest.press("P")
    wait_until(lambda: pieces(guest))
    assert lab._scene.name == "fake"
    assert lab._bench.playing
    guest.close()
    lab.stop()
