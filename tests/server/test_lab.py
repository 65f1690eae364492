"""The lab as a whole, seen through a raw client: what the page says and what the simulations get."""

import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from fake_world import SCENE, FakeWorld, RawClient, label_sizes, nothing_to_compile, wait_until

from server import lane
from server.framing import LABEL_PART
from server.lab import Lab
from server.stage import FINE, LABEL, LABEL_WIDTH, LEAST, LINE, LINES, MANY
from sim import SceneError


def times(lab):
    return [frame.time for frame in lab.frames]


def press(client, label, option):
    client.set(client.find(label), option)


def test_bench_stands_still_until_somebody_looks(lab):
    assert times(lab) == [0.0, 0.0]
    client = RawClient(lab.url)
    client.look()
    wait_until(lambda: all(time > 0.1 for time in times(lab)))
    client.close()
    wait_until(lambda: not lab._page.server.get_clients())
    wait_until(lambda: not lab._bench.busy)
    stopped = times(lab)
    threading.Event().wait(0.3)
    assert times(lab) == stopped


def test_plots_end_with_the_newest_frame_after_a_pause(lab, client, monkeypatch):
    plotted = [0.0]
    add = lab._page.charts.add

    def note(time, meters, moved):
        add(time, meters, moved)
        plotted.append(time if moved else plotted[-1])

    monkeypatch.setattr(lab._page.charts, "add", note)
    wait_until(lambda: times(lab)[0] > 0.1)
    press(client, "run", "❚❚ Pause")
    wait_until(lambda: not lab._bench.playing and not lab._bench.busy)
    wait_until(lambda: plotted[-1] == max(times(lab)))
    assert plotted == sorted(plotted)


def test_nothing_is_published_with_no_client(lab, client, monkeypatch):
    wait_until(lambda: times(lab)[0] > 0.1)
    shown = []
    monkeypatch.setattr(lab._page.stage, "show", shown.append)
    wait_until(lambda: shown)
    client.close()
    wait_until(lambda: not lab._page.server.get_clients())
    threading.Event().wait(0.1)
    shown.clear()
    press_step = threading.Event()
    lab.post(lab.step)
    lab.post(press_step.set)
    press_step.wait(5)
    threading.Event().wait(0.3)
    assert shown == []


def test_variants_are_on_one_clock(lab, client):
    wait_until(lambda: times(lab)[0] > 0.5)
    press(client, "run", "❚❚ Pause")
    wait_until(lambda: not lab._bench.playing and not lab._bench.busy)
    assert times(lab)[0] == pytest.approx(times(lab)[1])


def test_step_makes_one_step_in_every_variant(lab, client):
    press(client, "run", "❚❚ Pause")
    wait_until(lambda: not lab._bench.playing and not lab._bench.busy)
    before = [world.steps for world in FakeWorld.made]
    press(client, "run", "⇥ Step")
    wait_until(lambda: [world.steps for world in FakeWorld.made] == [n + 1 for n in before])


def test_reset_starts_every_variant_again(lab, client):
    wait_until(lambda: times(lab)[0] > 0.1)
    press(client, "run", "❚❚ Pause")
    press(client, "run", "⟲ Reset")
    wait_until(lambda: times(lab) == [0.0, 0.0] and len(FakeWorld.made) == 4)


def test_shared_setting_reaches_every_variant_and_they_go_on(lab, client):
    client.set(client.find("rest angle θ₀ [rad]"), 0.7)
    wait_until(lambda: [w.settings.rest_angle for w in FakeWorld.made] == [0.7, 0.7])
    reached = times(lab)
    wait_until(lambda: all(now > then for now, then in zip(times(lab), reached, strict=True)))


def test_compared_setting_reaches_its_own_variant_only(lab, client):
    client.set(client.find("● left"), "none")
    wait_until(lambda: [lane._world.settings.contact for lane in lab._bench.lanes] == ["none", "impulse"])
    assert lab.comparison.name(0) == "collision method none"


def test_comparing_by_another_setting_gives_each_variant_its_own_control(lab, client):
    client.set(client.find("compare by"), "damping ratio γ")
    wait_until(lambda: len(FakeWorld.made) == 4)
    assert lab.comparison.by == "gamma"
    first, second = (w.settings.gamma for w in FakeWorld.made[2:])
    assert first != second
    assert len({w.settings.contact for w in FakeWorld.made[2:]}) == 1


def test_there_are_two_to_four_variants(lab, client):
    client.set(client.find("compare by"), "bending spring")
    wait_until(lambda: lab.comparison.by == "bend")
    for count in (3, 4, 4):
        lab.post(lab.change_count, 1)
        wait_until(lambda count=count: lab.comparison.count == count)
    for count in (3, 2, 2):
        lab.post(lab.change_count, -1)
        wait_until(lambda count=count: lab.comparison.count == count)


def test_refused_step_pauses_its_variant_and_others_go_on(lab, client):
    lab.post(lab.compare_by, "density")
    wait_until(lambda: lab.comparison.by == "density" and len(lab.frames) == 2 and len(FakeWorld.made) == 4)
    lab.post(lab.set_own, 0, 200.0)
    wait_until(lambda: "too heavy" in lab.frames[0].refused)
    stopped, going = times(lab)
    wait_until(lambda: times(lab)[1] > going + 0.2)
    assert times(lab)[0] == stopped
    wait_until(lambda: any("stopped" in text for text in labels(client)))
    lab.post(lab.set_own, 0, 0.2)
    wait_until(lambda: times(lab)[0] > stopped)


def labels(client):
    updates = [m for m in client.messages if m["type"] == "SceneNodeUpdateMessage"]
    return [m["updates"]["text"] for m in updates if "text" in m["updates"]]


def test_labels_say_what_was_measured(lab, client):
    said = "1.0 ms · – %", "nothing crosses"  # of the first that had something to measure
    wait_until(lambda: any(tuple(text.split("\n")[1:]) == said for text in labels(client)))


def test_what_crosses_is_up_to_date_in_a_pause_and_after_each_single_step(lab, client, monkeypatch):
    monkeypatch.setattr(lane, "SHARE", 1e-9)  # so that nothing is counted while time runs
    world = FakeWorld.made[0]
    wait_until(lambda: lab.frames[0].steps and lab.frames[0].crossings is None)
    world.crossed = 7
    lab.post(lab.pause)
    wait_until(lambda: any("▲ 7 crossings" in text for text in labels(client)))
    world.crossed = 1
    lab.post(lab.step)
    wait_until(lambda: any("▲ 1 crossing" in text.split("\n") for text in labels(client)))


def test_scene_words_are_no_html(lab, client):
    wait_until(lambda: any("&lt;b&gt;" in str(m) for m in client.messages))
    assert not any("A <b>fake</b>" in str(m) for m in client.messages)


WEIGHTLESS = {**SCENE, "settings": {"gravity": [0.0, 0.0, 0.0]}}


def captions(client):
    """The words of HTML elements that are seen now, by element."""
    state = {uuid: dict(m["props"]) for uuid, m in list(client.controls.items()) if "Html" in m["type"]}
    for message in list(client.messages):
        if message["type"] == "GuiUpdateMessage" and message["uuid"] in state:
            state[message["uuid"]].update(message["updates"])
    return [props["content"] for props in state.values() if props["visible"]]


def momentum_plot(client):
    return [text for text in captions(client) if "momentum, " in text]


@pytest.fixture
def open_lab():
    """Opens labs on other scenes, with somebody who looks at each."""
    opened = []

    def open_lab(scene):
        lab = Lab(scene, port=0, build=FakeWorld, prepare=nothing_to_compile)
        client = RawClient(lab.url)
        opened.append((lab, client))
        lab.start()
        client.look()
        return lab, client

    yield open_lab
    for lab, client in opened:
        client.close()
        lab.stop()


def test_momentum_is_plotted_while_nothing_pulls_or_holds_the_cloth(open_lab):
    lab, client = open_lab(WEIGHTLESS)
    wait_until(lambda: momentum_plot(client))
    plot = lab._page.charts._momenta
    wait_until(lambda: plot._plot._handle.visible)
    assert [float(column[-1]) for column in plot._plot._handle.data[1:5]] == [5.0, 5.0, 2.5e-7, 2.5e-7]
    lab.post(lab.set_shared, "gravity", (0.0, 0.0, -9.81))
    wait_until(lambda: not momentum_plot(client) and not plot._plot._handle.visible)
    lab.post(lab.set_shared, "gravity", (0.0, 0.0, 0.0))
    wait_until(lambda: momentum_plot(client) and plot._plot._handle.visible)


@pytest.mark.parametrize("hindrance", ["pins", "gravity"])
def test_momentum_is_not_plotted_where_something_pulls_or_holds_the_cloth(open_lab, hindrance):
    scene = SCENE if hindrance == "gravity" else {**WEIGHTLESS, "cloth": {**SCENE["cloth"], "pins": [0]}}
    lab, client = open_lab(scene)
    wait_until(lambda: lab._page.charts._energies._plot._handle.visible)
    assert not momentum_plot(client)
    assert any("|P| [kg m/s]</td><td>5</td>" in text for text in captions(client)), "the numbers are there"


def test_strands_move_with_each_frame(open_lab):
    chain = {"vertices": [[0, 0, 1], [1, 0, 1]], "edges": [[0, 1]]}
    _, client = open_lab({**SCENE, "cloth": chain})

    def moved(node, prop):
        updates = [m for m in list(client.messages) if m["type"] == "SceneNodeUpdateMessage"]
        return any(m["name"].endswith(f"/variant1/{node}") and prop in m["updates"] for m in updates)

    wait_until(lambda: moved("strands", "points") and moved("balls", "batched_positions"))


def test_scale_of_a_plot_says_in_which_power_of_ten_it_counts(lab):
    plot = lab._page.charts._energies
    plot.clear()
    for time in (0.0, 1.0):
        plot.add(time, [(2e-5, 1e-5), (float("nan"), float("nan"))])
    assert "energy, 10⁻⁶ J · total and (dashed) kinetic" in plot._caption.content
    assert plot._plot._handle.data[1] == pytest.approx([20.0, 20.0])
    plot.add(2.0, [(1.0, 1.0), (0.0, 0.0)])
    assert "energy, J" in plot._caption.content
    plot.clear()
    for time in (0.0, 1.0):
        plot.add(time, [(1e-40, 0.0)])
    assert "10⁻¹² J" in plot._caption.content, "noise does not fill the plot"


def test_progress_of_compiling_is_shown_over_the_still(monkeypatch):
    go_on = threading.Event()

    def prepare(scene, progress):
        progress(4, 9, "hinges")
        go_on.wait(20)

    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=prepare)
    lab.start()
    client = RawClient(lab.url)
    client.look()
    wait_until(lambda: any(text.endswith("compiling …") for text in labels(client)))
    assert any(m["type"] == "MeshMessage" and m["name"] == "/take1/variant1/cloth" for m in client.messages)
    assert lab.frames == []
    go_on.set()
    wait_until(lambda: lab.frames and lab.frames[0].time > 0)
    client.close()
    lab.stop()


def test_cloth_moves_before_what_counts_crossings_is_compiled(monkeypatch):
    go_on = threading.Event()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=lambda scene, progress: lambda: go_on.wait(20))
    monkeypatch.setattr(FakeWorld, "crossings", lambda world: 7 if go_on.is_set() else 1 / 0)
    lab.start()
    client = RawClient(lab.url)
    client.look()
    wait_until(lambda: lab.frames and lab.frames[0].time > 0.2)
    assert all(frame.crossings is None for frame in lab.frames)
    lab.post(lab.pause)
    wait_until(lambda: any(text.endswith("– crossings") for text in labels(client)))
    go_on.set()
    wait_until(lambda: any("▲ 7 crossings" in text for text in labels(client)), seconds=5)
    client.close()
    lab.stop()


def test_compiler_that_fails_is_reported_and_the_page_lives():
    def prepare(scene, progress):
        raise RuntimeError("no compiler here")

    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=prepare)
    lab.start()
    client = RawClient(lab.url)
    client.look()
    wait_until(lambda: any("no compiler here" in str(m) for m in client.messages))
    client.close()
    lab.stop()


def test_sliders_that_are_moved_while_it_starts_again_do_not_have_it_start_anew_each_time():
    """A class that moves sliders all the time had it build worlds for ever, and never step."""
    building, go_on = threading.Event(), threading.Event()

    def slow(scene, settings):
        if building.is_set():
            assert go_on.wait(20)
        return FakeWorld(scene, settings)

    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=slow)
    lab.start()
    wait_until(lambda: lab._bench.ready and not lab._bench.busy)
    lanes = lab._comparison.count
    building.set()
    lab.post(lab.reset)
    wait_until(lambda: not any(lane.ready for lane in lab._bench.lanes))
    for k in range(10):
        lab.post(lab.set_shared, "friction", 0.1 * k)
    wait_until(lambda: lab._comparison.settings(0).friction == pytest.approx(0.9))
    go_on.set()
    wait_until(lambda: lab._bench.ready and not lab._bench.busy)
    assert len(FakeWorld.made) == 2 * lanes
    lab.stop()


def test_what_was_mended_of_a_mesh_is_said_on_the_page(open_lab):
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    lab, _ = open_lab({"cloth": {"vertices": points, "triangles": [[0, 1, 2], [2, 0, 1]]}})
    wait_until(lambda: lab._page._note == "scene: cloth[0]: left out 1 repeated triangle: 1")


def test_bad_scene_is_refused_before_anything_starts():
    before = set(threading.enumerate())
    with pytest.raises(SceneError):
        Lab("no such scene", port=0)
    assert set(threading.enumerate()) <= before


def test_taken_port_is_not_printed(lab):
    other = Lab(SCENE, port=int(lab.url.rpartition(":")[2]), build=FakeWorld, prepare=nothing_to_compile)
    assert other.url != lab.url
    client = RawClient(other.url, origin=other.url)
    client.close()
    other.start()
    other.stop()


def test_stop_in_the_middle_of_a_step_ends_all_threads(client, lab):
    wait_until(lambda: times(lab)[0] > 0)
    threading.Timer(0.3, lambda: [world.gate.set() for world in FakeWorld.made]).start()
    for world in FakeWorld.made:
        world.gate.clear()
    lab.stop()
    assert not lab._thread.is_alive()
    assert not any(lane.is_alive() for lane in lab._bench.lanes)


PROGRAM = """
import sys
sys.path.insert(0, {tests!r})
import server.launch
from fake_world import SCENE, FakeWorld, nothing_to_compile
server.launch.webbrowser.open = lambda url: sys.stdout.write(f"opened {{url}}\\n")
server.launch.Lab.__init__.__defaults__ = ("drape", "127.0.0.1", 8080, FakeWorld, nothing_to_compile, None)
server.launch.run_lab(SCENE, port=0, open_browser={open_browser})
sys.stdout.write("ended cleanly\\n")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("open_browser", [True, False])
def test_lab_prints_its_real_address_and_ends_on_a_signal(number, open_browser):
    code = PROGRAM.format(tests=str(Path(__file__).parent), open_browser=open_browser)
    process = subprocess.Popen([sys.executable, "-u", "-c", code], stdout=subprocess.PIPE, text=True)
    first = process.stdout.readline()
    url = re.fullmatch(r"Muslin is at (http://127\.0\.0\.1:\d+) .*\n", first)[1]
    if open_browser:
        assert process.stdout.readline() == f"opened {url}\n"
    client = RawClient(url, origin=url)
    client.look()
    wait_until(lambda: any("1.0 ms" in text for text in labels(client)))
    process.send_signal(number)
    rest, _ = process.communicate(timeout=30)
    assert rest.endswith("ended cleanly\n")
    assert process.returncode == 0
    assert "opened" not in rest
    client.close()


def test_stopped_variant_has_no_numbers_and_a_revived_one_says_how_far_behind_it_is(lab, client):
    lab.post(lab.compare_by, "density")
    wait_until(lambda: lab.comparison.by == "density" and len(lab.frames) == 2 and len(FakeWorld.made) == 4)
    wait_until(lambda: times(lab)[0] > 0)
    lab.post(lab.set_own, 0, 200.0)
    wait_until(lambda: lab.frames[0].refused and times(lab)[1] > times(lab)[0] + 0.5)
    wait_until(lambda: lab._bench.meters[0].ms is None and lab._bench.meters[1].ms is not None)
    lab.post(lab.set_own, 0, 0.2)
    wait_until(lambda: any("s behind" in text for text in labels(client)))


def framed(client):
    """Where a client's camera was put, each time."""
    sent = [m for m in list(client.messages) if m["type"] == "SetCameraPositionMessage" and not m["initial"]]
    return [m["position"] for m in sent]


def settle(lab, client):
    """Wait until the lab has done what a client's last message led to, and the client has heard of it."""
    for _ in range(2):
        heard, done = client.count("NotificationShowMessage"), threading.Event()
        client.press("?")
        wait_until(lambda heard=heard: client.count("NotificationShowMessage") > heard)
        lab.post(done.set)
        assert done.wait(20)


def camera(lab, width):
    position, _ = lab._page.stage._framing.camera(width / 720, labels=LINES * LINE / 720)
    return pytest.approx(list(position), rel=1e-6)


def test_a_view_that_docks_leave_less_of_is_framed_anew_until_somebody_moves_the_camera(lab, client):
    """A page tells its width as it connects, and again once docks are there."""
    late = RawClient(lab.url)
    late.look(image_width=1280)
    wait_until(lambda: framed(late) and framed(late)[-1] == camera(lab, 1280))
    late.look(image_width=680, position=framed(late)[-1])
    wait_until(lambda: framed(late)[-1] == camera(lab, 680))
    times = len(framed(late))
    rounded, moved = (682, framed(late)[-1]), (1280, [0.1, -3.0, 1.0])
    for width, position in (rounded, moved):
        late.look(image_width=width, position=position)
        settle(lab, late)
        assert len(framed(late)) == times
    late.press("F")
    wait_until(lambda: framed(late)[-1] == camera(lab, 1280))
    late.close()


def test_a_browser_that_goes_back_to_where_all_begin_is_framed_for_the_shape_it_has(lab, client):
    """One that draws in software does so at times, after it was told where its camera should be."""
    slow = RawClient(lab.url)
    slow.look(image_width=1280)
    wait_until(lambda: framed(slow) and framed(slow)[-1] == camera(lab, 1280))
    slow.look(image_width=680, position=map(float, lab._page.server.initial_camera.position))
    wait_until(lambda: framed(slow)[-1] == camera(lab, 680))
    slow.close()


def test_labels_are_smaller_where_a_view_is_too_narrow_for_them(lab, client):
    """Each client's own, so that they neither lie over each other nor are smaller than need be on others."""
    narrow = RawClient(lab.url)
    narrow.look(image_width=260)
    wait_until(lambda: list(label_sizes(narrow).values()) == [pytest.approx(LABEL * 130 / LABEL_WIDTH)] * 2)
    assert not label_sizes(client)
    lab.post(lab.change_count, 2)
    wait_until(lambda: list(label_sizes(narrow).values()) == [pytest.approx(LABEL * MANY * LEAST)] * 4)
    assert not label_sizes(client)
    settle(lab, narrow)
    narrow.look(image_width=1280, position=framed(narrow)[-1])
    wait_until(lambda: not label_sizes(narrow))
    narrow.close()


PHONE = (
    "Mozilla/5.0 (Linux; Android 14) AppleWebKit/537.36 (KHTML, like Gecko) Chrome/130 Mobile Safari/537.36"
)


@pytest.mark.parametrize(("width", "height", "covered"), [(1170, 2532, 0.4), (2532, 1170, 0.0)])
def test_a_phone_is_framed_above_the_sheet_that_it_has_when_upright(lab, client, width, height, covered):
    """However fine its pixels are."""
    phone = RawClient(lab.url, **{"User-Agent": PHONE})
    phone.look(image_width=width, image_height=height)
    labels = max(LABEL_PART, LINES * LINE / (height / FINE))
    position, _ = lab._page.stage._framing.camera(width / height, covered=covered, labels=labels)
    wait_until(lambda: framed(phone) and framed(phone)[-1] == pytest.approx(list(position), rel=1e-6))
    phone.close()


def test_the_view_tab_says_what_keys_and_mouse_do(lab, client):
    def said():
        return [m["props"]["content"] for m in client.messages if "Turn the view" in str(m.get("props"))]

    wait_until(said)
    for key in ("space", "N", "R", "Z", "W", "F"):
        assert f"<td>{key}</td>" in said()[0]


NO_CAMERAS = [
    {"up_direction": [0.0, 0.0, 0.0]},
    {"look_at": [0.0, -3.0, 1.0]},
    {"look_at": [0.0, float("nan"), 0.0]},
    {"position": [1e308, -1e308, 1e308]},
    {"position": "far"},
    {"up_direction": [1.0]},
    {"wxyz": [float("inf")] * 4},
]


def test_a_camera_that_cannot_be_one_keeps_nobody_else_from_seeing_what_is_opened(lab, client, caplog):
    """One that had no way up ended the opening of every scene, for all."""
    crowd = [RawClient(lab.url) for _ in NO_CAMERAS]
    for hostile, camera in zip(crowd, NO_CAMERAS, strict=True):
        hostile.look()
        wait_until(lambda hostile=hostile: framed(hostile))
        hostile.look(**camera)
    late = RawClient(lab.url)
    late.look()
    wait_until(lambda: framed(late))
    before, made = len(framed(late)), len(FakeWorld.made)
    lab.post(lab.change_count, 1)
    wait_until(lambda: len(framed(late)) > before and len(FakeWorld.made) == made + 3)
    assert not [record for record in caplog.records if record.exc_info]
    for one in (*crowd, late):
        one.close()


def test_nonsense_camera_leaves_the_lab_running(lab, client):
    crowd = [RawClient(lab.url) for _ in range(4)]
    for hostile, size in zip(crowd, ("wide", float("nan"), 0, -5), strict=True):
        hostile.look(image_width=size, image_height=size)
    client.set(client.find("damping ratio γ"), 0.5)
    wait_until(lambda: lab.comparison.shared.gamma == 0.5)
    reached = times(lab)
    wait_until(lambda: times(lab)[0] > reached[0])
    late = RawClient(lab.url)
    late.look()
    wait_until(lambda: framed(late))
    before = len(framed(late))
    lab.post(lab.change_count, 1)
    wait_until(lambda: len(framed(late)) > before)
    for one in (*crowd, late):
        one.close()
