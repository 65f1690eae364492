"""The page in a real browser, on real simulations."""

from urllib.parse import urlsplit

import numpy as np
import pytest
from fake_world import SCENE, FakeWorld, nothing_to_compile, wait_until

import sim
from server.lab import Lab
from server.rescue import SAFE, UNDO
from server.stage import MOST_LABELS
from tests.browser import CHROMIUM, WITHOUT_BROWSER, WITHOUT_GPU

PATIENCE = 120_000
"""Milliseconds that a browser without a graphics card may take over anything."""

pytestmark = [pytest.mark.browser, WITHOUT_BROWSER]

CHAIN = {
    "cloth": {"vertices": [[0.1 * i, 0.0, 1.0] for i in range(10)], "edges": [[i, i + 1] for i in range(9)]},
    "settings": {"gravity": [0.0, 0.0, 0.0]},
}

CLOTH = """name => {
    const nodes = window.__viserMutable?.nodeRefFromName ?? {};
    return nodes[Object.keys(nodes).findLast(key => nodes[key] && key.endsWith(`/${name}/cloth`))];
}"""
"""The newest node of a variant's cloth; its path has a number that counts how often the stage was set up."""

VERTICES = f"""name => {{
    let sum = 0;
    ({CLOTH})(name).traverse(node => {{
        const place = node.geometry?.attributes?.position;
        if (place) for (let i = 0; i < place.array.length; i++) sum += place.array[i] * (1 + i % 7);
    }});
    return sum;
}}"""
"""A number that changes when the cloth in the page moves."""


@pytest.fixture(scope="module")
def lab():
    lab = Lab("drape", port=0)
    lab.start()
    yield lab
    lab.stop()


@pytest.fixture(scope="module")
def page(lab):
    from playwright.sync_api import sync_playwright

    assert CHROMIUM, "MUSLIN_REQUIRE_BROWSER=1, but there is no chromium"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=WITHOUT_GPU)
        page = browser.new_page(viewport={"width": 900, "height": 560})
        visit(page, lab)
        page.wait_for_function(f"() => ({CLOTH})('variant1') != null")
        wait_until(lambda: lab.frames and all(frame.time > 0 for frame in lab.frames), seconds=120)
        yield page
        browser.close()


def visit(page, lab, url=""):
    """Open the lab's page, and note every error that it reports."""
    page.set_default_timeout(PATIENCE)
    page.errors = []
    page.on("console", lambda message: page.errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.goto(url or lab.url)


def row(page, label):
    """The control with a label: its row in the dock."""
    return page.locator("label", has_text=label).locator(
        "xpath=ancestor::div[contains(@class,'Flex-root')][1]"
    )


def pick(page, label, option):
    row(page, label).locator("input:not([type=hidden])").first.click()
    page.get_by_role("option", name=option, exact=True).click()


def settings(lab, name):
    return [getattr(frame.settings, name) for frame in lab.frames if frame.settings]


def all_go_on(lab):
    """Every simulation makes further steps, and its cloth is elsewhere afterwards."""
    before = lab.frames
    wait_until(
        lambda: all(
            now.time > then.time and not np.array_equal(now.positions, then.positions)
            for now, then in zip(lab.frames, before, strict=True)
        ),
        seconds=60,
    )
    assert [frame.refused for frame in lab.frames] == [""] * len(before)


def drag_by_keys(page, label, key, times):
    slider = row(page, label).get_by_role("slider")
    slider.focus()
    for _ in range(times):
        page.keyboard.press(key)


def test_page_shows_two_cloths_that_move(lab, page):
    before = [page.evaluate(VERTICES, f"variant{i}") for i in range(2)]
    wait_until(
        lambda: all(page.evaluate(VERTICES, f"variant{i}") != before[i] for i in range(2)), seconds=120
    )
    assert settings(lab, "contact") == ["penalty", "impulse"]


def test_damping_slider_reaches_both_simulations(lab, page):
    drag_by_keys(page, "damping ratio γ", "ArrowRight", 5)
    wait_until(lambda: settings(lab, "gamma") == pytest.approx([0.25, 0.25]), seconds=60)
    all_go_on(lab)


def test_rest_angle_slider_reaches_both_simulations(lab, page):
    drag_by_keys(page, "rest angle", "ArrowRight", 10)
    wait_until(lambda: settings(lab, "rest_angle") == pytest.approx([0.1, 0.1]), seconds=60)
    all_go_on(lab)


def test_bending_kind_is_switched_while_running(lab, page):
    pick(page, "bending spring", "cross")
    wait_until(lambda: settings(lab, "bend") == ["cross", "cross"], seconds=120)
    all_go_on(lab)


def test_collision_method_of_one_variant_is_switched_while_running(lab, page):
    pick(page, "● left", "none")
    wait_until(lambda: settings(lab, "contact") == ["none", "impulse"], seconds=60)
    all_go_on(lab)
    pick(page, "● left", "penalty")
    wait_until(lambda: settings(lab, "contact") == ["penalty", "impulse"], seconds=60)
    all_go_on(lab)


def test_log_slider_box_takes_a_number(lab, page):
    box = row(page, "stretch stiffness").locator("input.mantine-TextInput-input")
    box.fill("80")
    wait_until(lambda: settings(lab, "stretch") == [80.0, 80.0], seconds=60)
    all_go_on(lab)


def test_a_budget_may_be_a_part_of_a_percent(lab, page):
    page.get_by_role("tab", name="Budget").click()
    box = row(page, "at most").locator("input").first
    box.fill("0.025")
    box.press("Enter")
    wait_until(lambda: lab._page.charts.budget._most.value == 0.025)
    assert box.input_value() == "0.025"
    page.get_by_role("tab", name="Cost").click()


def test_pause_step_and_reset(lab, page):
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for()
    wait_until(lambda: not lab._bench.busy)
    before = [frame.time for frame in lab.frames]
    page.get_by_role("button", name="Step").click()
    wait_until(lambda: all(frame.time > t for frame, t in zip(lab.frames, before, strict=True)))
    page.get_by_role("button", name="Reset").click()
    wait_until(lambda: [frame.time for frame in lab.frames] == [0.0, 0.0], seconds=60)
    page.get_by_role("button", name="Play").click()
    all_go_on(lab)


def test_plots_hold_live_data(page):
    points = (
        "() => Object.values(window.__viserTestpoints?.uplots ?? {}).map(plot => plot.chart.data[0].length)"
    )
    # Kernels may have to be compiled first, beside a browser that draws without a graphics card.
    wait_until(lambda: len(page.evaluate(points)) == 2 and min(page.evaluate(points)) > 2, seconds=400)
    page.get_by_role("tab", name="Energy").click()
    page.get_by_text("residual").wait_for()
    wait_until(lambda: len(page.evaluate(points)) == 3 and min(page.evaluate(points)) > 2, seconds=120)
    page.get_by_role("tab", name="Cost").click()


POINT = """i => {
    const point = document.querySelector(`svg.tradeoff circle.variant${i}`);
    const filled = point && point.getAttribute('fill') != '#ffffff';
    return filled ? [Number(point.getAttribute('cx')), Number(point.getAttribute('cy'))] : null;
}"""
"""Where a variant's point is in the chart of error against cost, once it is up to date."""


def test_point_of_error_against_cost_moves_when_a_setting_does(lab, page):
    """In free fall, and in a pause, where a frame of five steps has 0.3 times the error of one of one."""
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Reset").click()
    wait_until(lambda: [frame.time for frame in lab.frames] == [0.0, 0.0], seconds=60)
    page.get_by_role("button", name="Step").click()
    wait_until(lambda: not lab._bench.busy and all(frame.time > 0 for frame in lab.frames), seconds=60)
    at = [frame.time for frame in lab.frames]
    wait_until(lambda: [reading.time for reading in lab._prober.readings] == at, seconds=120)
    wait_until(lambda: all(page.evaluate(POINT, i) for i in range(2)), seconds=60)
    before = [page.evaluate(POINT, i)[1] for i in range(2)]
    page.get_by_role("tab", name="Solver").click()
    row(page, "time step").locator("input.mantine-TextInput-input").fill("0.004")
    wait_until(lambda: settings(lab, "dt") == [0.004, 0.004], seconds=60)

    def lower(i):
        point = page.evaluate(POINT, i)
        return point is not None and point[1] > before[i] + 5

    wait_until(lambda: lower(0) and lower(1), seconds=240)
    row(page, "time step").locator("input.mantine-TextInput-input").fill("0.0166667")
    wait_until(lambda: settings(lab, "dt") == [0.0166667, 0.0166667], seconds=60)
    page.get_by_role("tab", name="Cloth").click()
    page.get_by_role("button", name="Play").click()


def test_another_setting_is_compared(lab, page):
    pick(page, "compare by", "damping ratio γ")
    wait_until(lambda: len(set(settings(lab, "gamma"))) == 2, seconds=120)
    all_go_on(lab)
    row(page, "● right").get_by_role("slider").wait_for()


def test_the_key_for_help_says_how_to_read_the_page_and_what_keys_do(page):
    page.evaluate("document.activeElement.blur()")  # keys that are typed into a box are no commands
    page.keyboard.press("Shift+?")
    page.get_by_text("How to read this page").wait_for()
    words = page.locator(".mantine-Notification-description").last.inner_text().splitlines()
    assert "space: Play or pause" in words
    assert "?: Help" in words
    assert any(word.startswith("1–9: Scenes drape, curtain, ") for word in words)
    page.locator(".mantine-Notification-closeButton").first.click()  # that there is no graphics card
    page.wait_for_timeout(1000)
    title = page.get_by_text("How to read this page").bounding_box()
    box = page.locator(".mantine-Notification-root").last.bounding_box()
    assert title["y"] >= box["y"], "all of it can be read"
    assert box["y"] + box["height"] <= 560


def lab_of_its_own(page):
    """A lab whose two cloths move, and a page of it: to be stopped and closed by whoever asks for them."""
    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile)
    lab.start()
    own_page = page.context.browser.new_page(viewport={"width": 900, "height": 560})
    visit(own_page, lab)
    wait_until(lambda: len(lab.frames) == 2 and lab.frames[0].time > 0, seconds=60)
    return lab, own_page


def test_keys_act_on_the_page_and_are_letters_in_a_box(page):
    """A digit opens a scene, a letter acts; typed into a box they do nothing."""
    lab, own_page = lab_of_its_own(page)
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
    assert own_page.errors == []
    own_page.close()
    lab.stop()


def test_space_plays_and_pauses_once_where_a_button_was_pressed_last(lab, page):
    page.evaluate("document.activeElement.blur()")
    page.get_by_role("button", name="Pause").click()
    wait_until(lambda: not lab._bench.playing)
    page.keyboard.press(" ")
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_timeout(500)
    assert lab._bench.playing


CANVAS = (
    "() => { const r = document.querySelector('canvas').getBoundingClientRect(); return [r.left, r.right]; }"
)


@pytest.mark.parametrize("by", ["key", "address"])
def test_a_projector_shows_cloths_and_chart_alone_until_the_key_is_pressed_again(page, by):
    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile)
    lab.start()
    other, beamer = (page.context.browser.new_page(viewport={"width": 900, "height": 500}) for _ in range(2))
    visit(other, lab)
    visit(beamer, lab, lab.url + "/projector" if by == "address" else lab.url)
    tab = beamer.get_by_role("tab", name="Energy")
    tab.wait_for(state="attached")
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
    assert beamer.errors == other.errors == []
    beamer.close()
    other.close()
    lab.stop()


def test_on_a_phone_the_controls_leave_most_of_the_page_to_the_cloths(lab, page):
    phone = page.context.browser.new_page(viewport={"width": 390, "height": 700})
    visit(phone, lab)
    slider = row(phone, "rest angle").get_by_role("slider")
    slider.scroll_into_view_if_needed()
    box = phone.locator('.mantine-Paper-root[style*="position: fixed"]').bounding_box()
    assert (box["x"], box["width"]) == (0, 390)
    assert box["y"] >= 0.59 * 700
    assert slider.bounding_box()["x"] + slider.bounding_box()["width"] < 390
    assert phone.errors == []
    phone.close()


def test_on_a_phone_on_its_side_the_cloths_have_all_that_one_dock_leaves(lab, page):
    phone = page.context.browser.new_page(viewport={"width": 844, "height": 390})
    visit(phone, lab)
    row(phone, "rest angle").get_by_role("slider").wait_for()
    wait_until(lambda: phone.evaluate(CANVAS)[1] == 844, seconds=60)
    assert not phone.get_by_role("tab", name="Energy").is_visible()
    assert phone.evaluate(CANVAS)[0] < 844 / 2, "and that is more than half"
    assert phone.errors == []
    phone.close()


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


def test_chain_is_seen_without_a_triangle_and_without_an_error(page):
    lab = Lab(CHAIN, port=0, build=FakeWorld, prepare=nothing_to_compile)
    lab.start()
    chain_page = page.context.browser.new_page(viewport={"width": 900, "height": 560})
    visit(chain_page, lab)
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
    assert chain_page.errors == []
    chain_page.close()
    lab.stop()


def test_a_stopped_variant_is_led_on_by_undo_by_safe_settings_and_by_the_key(page):
    """The way out of a refused step as a hand takes it: the buttons come, act, and go."""
    lab, own_page = lab_of_its_own(page)
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
    assert own_page.errors == []
    own_page.close()
    lab.stop()


@pytest.fixture(scope="module")
def tangled():
    """Two sheets, the upper of which has a dent through the lower."""
    world = sim.Simulation({"cloth": {"kind": "grid", "size": [0.4, 0.4], "resolution": [20, 20]}})
    x, triangles = world.positions, world.triangles
    upper = x + np.array([0.003, 0.002, 0.005])
    upper[:, 2] -= 0.015 * np.exp(-((x[:, :2] - [0.07, 0.05]) ** 2).sum(axis=1) / 2e-3)
    layers = [{"vertices": p, "triangles": triangles, "pins": [0, 19, 380, 399]} for p in (upper, x)]
    return {"cloth": layers, "settings": {"contact": "impulse"}, "compare": {"values": ["impulse"]}}


def test_a_tangled_start_is_refused_on_the_page_and_untangled_with_the_button(page, tangled):
    lab = Lab(tangled, port=0)
    lab.start()
    own_page = page.context.browser.new_page(viewport={"width": 900, "height": 560})
    visit(own_page, lab)
    own_page.get_by_text("crosses itself or a mesh obstacle at the start").first.wait_for()
    own_page.get_by_text("Likeliest: tangled start refuse").wait_for()
    own_page.get_by_role("button", name=SAFE).click()
    wait_until(lambda: lab.frames and lab.frames[0].time > 0, seconds=60)
    assert settings(lab, "tangled") == ["untangle"]
    assert lab.frames[0].note.startswith("untangled the start, by up to")
    own_page.get_by_role("button", name=SAFE).wait_for(state="hidden")
    assert own_page.errors == []
    own_page.close()
    lab.stop()


def test_a_browser_is_let_in_by_its_address_which_shows_no_token_then_and_a_guest_watches(page):
    FakeWorld.made.clear()
    lab = Lab(SCENE, host="0.0.0.0", port=0, build=FakeWorld, prepare=nothing_to_compile, view_only=True)
    lab.start()
    pages = []
    for url in (lab.url, lab.guest_url):
        context = page.context.browser.new_context(viewport={"width": 900, "height": 560})
        pages.append(context.new_page())
        visit(pages[-1], lab, url.replace(urlsplit(url).hostname, "127.0.0.1"))
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
    refused = page.context.browser.new_context().new_page()
    assert refused.goto(teacher.url).status == 403
    assert "ask whoever started Muslin" in refused.inner_text("body")
    assert teacher.errors == guest.errors == []
    for one in (*pages, refused):
        one.context.close()
    lab.stop()


def test_page_reported_no_error(page):
    assert page.errors == []
