"""The page in a real browser, on labs of all sorts that need no kernels."""

from urllib.parse import urlsplit

import numpy as np
import pytest
from fake_world import SCENE, FakeWorld, nothing_to_compile, wait_until
from visitor import drag_by_keys, row, settings, visit

import sim
from server.lab import Lab
from server.rescue import SAFE, UNDO
from server.stage import MOST_LABELS
from tests.browser import WITHOUT_BROWSER

pytestmark = [pytest.mark.browser, WITHOUT_BROWSER]

CHAIN = {
    "cloth": {"vertices": [[0.1 * i, 0.0, 1.0] for i in range(10)], "edges": [[i, i + 1] for i in range(9)]},
    "settings": {"gravity": [0.0, 0.0, 0.0]},
}


@pytest.fixture
def start_lab():
    """Starts a lab, which is stopped in the end."""
    labs = []

    def start_lab(scene, **how):
        FakeWorld.made.clear()
        labs.append(Lab(scene, port=0, **how))
        labs[-1].start()
        return labs[-1]

    yield start_lab
    for lab in labs:
        lab.stop()


@pytest.fixture
def open_page(browser):
    """Opens a lab's page in a window of that size; none of them may have reported an error in the end."""
    pages = []

    def open_page(lab, width=900, height=560, url=""):
        pages.append(browser.new_context(viewport={"width": width, "height": height}).new_page())
        visit(pages[-1], lab, url)
        return pages[-1]

    yield open_page
    errors = [page.errors for page in pages]
    for page in pages:
        page.context.close()
    assert errors == [[]] * len(pages)


def test_keys_act_on_the_page_and_are_letters_in_a_box(lab, open_page):
    """A digit opens a scene, a letter acts; typed into a box they do nothing."""
    own_page = open_page(lab)
    box = row(own_page, "density").locator("input.mantine-TextInput-input")
    box.click()
    own_page.keyboard.type("2nwp r")
    box.fill("0.3")
    wait_until(lambda: settings(lab, "density") == [0.3, 0.3], seconds=60)
    assert lab._bench.playing
    assert lab._scene.name == "fake"
    assert not lab._page.stage.show_mesh_lines
    assert own_page.locator(".muslin.projector").count() == 0
    box.blur()
    own_page.keyboard.press("n")
    wait_until(lambda: not lab._bench.playing)
    own_page.keyboard.press("w")
    wait_until(lambda: lab._page.stage.show_mesh_lines)
    own_page.keyboard.press("2")
    wait_until(lambda: lab._scene.name == "curtain", seconds=60)
    wait_until(lambda: row(own_page, "scene").locator("input").first.input_value() == "curtain", seconds=60)


CANVAS = (
    "() => { const r = document.querySelector('canvas').getBoundingClientRect(); return [r.left, r.right]; }"
)


@pytest.mark.parametrize("by", ["key", "address"])
def test_a_projector_shows_cloths_and_chart_alone_until_the_key_is_pressed_again(lab, open_page, by):
    other = open_page(lab, height=500)
    beamer = open_page(lab, height=500, url=lab.url + "/projector" * (by == "address"))
    tab = beamer.get_by_role("tab", name="Energy")  # of what is seen: in the mode there is none
    wait_until(
        lambda: len(lab._page.server.get_clients()) == 2, seconds=60
    )  # who is not known yet is not heard
    if by == "key":
        tab.click()  # the dock's own chart is not there then
        beamer.keyboard.press("p")
    chart = beamer.locator(".muslin.projector svg.tradeoff")
    chart.wait_for()
    assert not tab.is_visible()
    assert not beamer.get_by_role("button", name="Reset").is_visible()
    chart_left = beamer.locator(".muslin.projector").bounding_box()["x"]
    wait_until(lambda: beamer.evaluate(CANVAS) == pytest.approx([0, chart_left], abs=1), seconds=60)
    stage = lab._page.stage
    framed, _ = stage._framing.camera(chart_left / 500, labels=MOST_LABELS)
    (client,) = stage._projecting
    wait_until(lambda: np.allclose(client.camera.position, framed, rtol=0.02), seconds=60)
    beamer.get_by_text("P: the controls again").wait_for()
    assert other.get_by_role("button", name="Reset").is_visible(), "no other page is in the mode"
    beamer.keyboard.press("p")
    tab.wait_for()
    assert beamer.locator(".muslin.projector").count() == 0
    wait_until(lambda: beamer.evaluate(CANVAS)[0] > 100, seconds=60)


def test_on_a_phone_the_controls_leave_most_of_the_page_to_the_cloths(lab, open_page):
    phone = open_page(lab, 390, 700)
    slider = row(phone, "rest angle").get_by_role("slider")
    slider.scroll_into_view_if_needed()
    box = phone.locator('.mantine-Paper-root[style*="position: fixed"]').bounding_box()
    assert (box["x"], box["width"]) == (0, 390)
    assert box["y"] >= 0.59 * 700
    assert slider.bounding_box()["x"] + slider.bounding_box()["width"] < 390


def test_on_a_phone_on_its_side_the_cloths_have_all_that_one_dock_leaves(lab, open_page):
    phone = open_page(lab, 844, 390)
    row(phone, "rest angle").get_by_role("slider").wait_for()
    wait_until(lambda: phone.evaluate(CANVAS)[1] == 844, seconds=60)
    assert not phone.get_by_role("tab", name="Energy").is_visible()
    assert phone.evaluate(CANVAS)[0] < 844 / 2, "and that is more than half"


ORANGE = """() => new Promise(done => {
    const image = new Image();
    const canvas = window.__viserMutable.canvas;
    image.onload = () => {
        const flat = new OffscreenCanvas(image.width, image.height).getContext('2d');
        flat.drawImage(image, 0, 0);
        const data = flat.getImageData(0, 0, image.width, image.height).data;
        const rows = [];
        for (let i = 0; i < data.length; i += 4)
            if (data[i] - data[i + 2] > 90 && data[i + 3] > 200) rows.push(Math.floor(i / 4 / image.width));
        done(rows.length ? rows[rows.length - 1] - rows[0] : 0);
    };
    image.src = (canvas.querySelector?.('canvas') ?? canvas).toDataURL();
})"""
"""From the first to the last row of the 3-D view that has something orange: of the bar alone, a few."""


def test_chain_is_seen_without_a_triangle_and_without_an_error(start_lab, open_page):
    lab = start_lab(CHAIN, build=FakeWorld, prepare=nothing_to_compile)
    chain_page = open_page(lab)
    for node in ("strands", "balls"):
        chain_page.wait_for_function(
            f"() => Object.keys(window.__viserMutable?.nodeRefFromName ?? {{}})"
            f".some(key => key.endsWith('/variant0/{node}'))"
        )
    wait_until(lambda: lab.frames[0].time > 0)
    lab.post(lab.pause)
    lab.post(lab.reset)
    wait_until(lambda: chain_page.evaluate(ORANGE) > 20, seconds=120)
    chain_page.get_by_role("tab", name="Energy").click()
    chain_page.get_by_text("momentum, SI").wait_for()


def test_a_stopped_variant_is_led_on_by_undo_by_safe_settings_and_by_the_key(lab, open_page):
    """The way out of a refused step as a hand takes it: the buttons come, act, and go."""
    own_page = open_page(lab)
    undo, safe = (own_page.get_by_role("button", name=name) for name in (UNDO, SAFE))
    box = row(own_page, "density").locator("input.mantine-TextInput-input")

    def stop():
        box.fill("500")
        undo.wait_for()
        own_page.get_by_text("load of vertex 3 is too heavy").first.wait_for()
        assert all(frame.refused for frame in lab.frames)
        return [frame.time for frame in lab.frames]

    def led_on(reached, density):
        undo.wait_for(state="hidden")
        safe.wait_for(state="hidden")
        wait_until(lambda: all(f.time > t for f, t in zip(lab.frames, reached, strict=True)), seconds=60)
        assert settings(lab, "density") == [density, density]
        wait_until(lambda: float(box.input_value()) == density, seconds=60)

    assert undo.count() == safe.count() == 0
    for press, density in ((undo.click, 0.2), (safe.click, 2.0), (lambda: own_page.keyboard.press("z"), 2.0)):
        reached = stop()
        box.blur()
        press()
        led_on(reached, density)


@pytest.fixture(scope="module")
def tangled():
    """Two sheets, the upper of which has a dent through the lower."""
    world = sim.Simulation({"cloth": {"kind": "grid", "size": [0.4, 0.4], "resolution": [20, 20]}})
    x, triangles = world.positions, world.triangles
    upper = x + np.array([0.003, 0.002, 0.005])
    upper[:, 2] -= 0.015 * np.exp(-((x[:, :2] - [0.07, 0.05]) ** 2).sum(axis=1) / 2e-3)
    layers = [{"vertices": p, "triangles": triangles, "pins": [0, 19, 380, 399]} for p in (upper, x)]
    return {"cloth": layers, "settings": {"contact": "impulse"}, "compare": {"values": ["impulse"]}}


def test_a_tangled_start_is_refused_on_the_page_and_untangled_with_the_button(start_lab, open_page, tangled):
    lab = start_lab(tangled)
    own_page = open_page(lab)
    own_page.get_by_text("crosses itself or a mesh obstacle at the start").first.wait_for()
    own_page.get_by_text("Likeliest: tangled start refuse").wait_for()
    own_page.get_by_role("button", name=SAFE).click()
    wait_until(lambda: lab.frames and lab.frames[0].time > 0, seconds=60)
    assert settings(lab, "tangled") == ["untangle"]
    assert lab.frames[0].note.startswith("untangled the start, by up to")
    own_page.get_by_role("button", name=SAFE).wait_for(state="hidden")


def test_a_browser_is_let_in_by_its_address_which_shows_no_token_then_and_a_guest_watches(
    browser, start_lab, open_page
):
    lab = start_lab(SCENE, host="0.0.0.0", build=FakeWorld, prepare=nothing_to_compile, view_only=True)
    pages = []
    for url in (lab.url, lab.guest_url):
        pages.append(open_page(lab, url=url.replace(urlsplit(url).hostname, "127.0.0.1")))
        row(pages[-1], "damping ratio γ").get_by_role("slider").wait_for()
        assert "token" not in pages[-1].url
    teacher, guest = pages
    guest.get_by_text("You are watching.").wait_for()
    assert teacher.get_by_text("You are watching.").count() == 0
    drag_by_keys(guest, "damping ratio γ", "ArrowRight", 3)
    drag_by_keys(teacher, "rest angle", "ArrowRight", 2)
    wait_until(lambda: lab.comparison.shared.rest_angle == pytest.approx(0.02), seconds=60)
    assert lab.comparison.shared.gamma == 0.2
    slider = row(guest, "damping ratio γ").get_by_role("slider")
    wait_until(lambda: float(slider.get_attribute("aria-valuenow")) == 0.2, seconds=60)
    refused = browser.new_context().new_page()
    assert refused.goto(teacher.url).status == 403
    assert "ask whoever started Muslin" in refused.inner_text("body")
    refused.context.close()
