"""The page in a real browser, on real simulations."""

import numpy as np
import pytest
from fake_world import wait_until
from visitor import drag_by_keys, pick, row, settings, visit

from server.lab import Lab
from tests.browser import WITHOUT_BROWSER

pytestmark = [pytest.mark.browser, WITHOUT_BROWSER]

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
def page(lab, browser):
    page = browser.new_page(viewport={"width": 960, "height": 560})  # viser notes lie over 640
    visit(page, lab)
    page.wait_for_function(f"() => ({CLOTH})('variant1') != null")
    wait_until(lambda: lab.frames and all(frame.time > 0 for frame in lab.frames), seconds=120)
    return page


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


def test_space_plays_and_pauses_once_where_a_button_was_pressed_last(lab, page):
    page.evaluate("document.activeElement.blur()")
    page.get_by_role("button", name="Pause").click()
    wait_until(lambda: not lab._bench.playing)
    page.keyboard.press(" ")
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_timeout(500)
    assert lab._bench.playing


def test_page_reported_no_error(page):
    assert page.errors == []
