"""A variant that cannot go on: it alone pauses, says why, and both ways out lead on."""

import pytest
from fake_world import SCENE, FakeWorld, RawClient, wait_until

from server.comparison import Comparison
from server.lane import Frame
from server.rescue import SAFE, UNDO, made_safe
from sim.scene import load_scene


def state(client, uuid):
    """The present properties of a control on a client's page."""
    found = dict(client.controls[uuid]["props"])
    for message in list(client.messages):
        if message["type"] == "GuiUpdateMessage" and message["uuid"] == uuid:
            found.update(message["updates"])
    return found


def button(client, label):
    return client.find(label, "Button")


def offered(client):
    return [label for label in (UNDO, SAFE) if state(client, button(client, label))["visible"]]


def said(client):
    pages = [uuid for uuid, m in list(client.controls.items()) if "Html" in m["type"]]
    return " ".join(s["content"] for s in (state(client, uuid) for uuid in pages) if s["visible"])


def times(lab):
    return [frame.time for frame in lab.frames]


def densities(lab):
    return [lane._world.settings.density for lane in lab._bench.lanes]


@pytest.fixture
def stopped(lab, client):
    """The left of two variants that differ in density cannot go on, after a friction that both share."""
    lab.post(lab.compare_by, "density")
    wait_until(lambda: lab.comparison.by == "density" and len(lab.frames) == 2 and len(FakeWorld.made) == 4)
    wait_until(lambda: min(times(lab)) > 0)
    lab.post(lab.set_shared, "friction", 0.7)
    client.set(client.find("● left", "Text"), "200")
    wait_until(lambda: lab.frames[0].refused and offered(client) == [UNDO, SAFE])
    return lab


def test_nothing_is_offered_while_all_go_on(lab, client):
    wait_until(lambda: min(times(lab)) > 0.2)
    assert offered(client) == []


def test_a_stopped_variant_says_its_quantity_and_the_likeliest_setting_in_the_dock_and_above_the_cloth(
    stopped, client
):
    assert "load of vertex 3 is too heavy" in said(client)
    assert "too heavy.</b> Likeliest: <b>density 200 kg/m²</b>." in said(client)
    texts = [
        m["updates"]["text"].replace("\n", " ") for m in client.messages if "text" in m.get("updates", {})
    ]
    assert any("stopped" in t and "too heavy" in t and "likeliest: density 200 kg/m²" in t for t in texts)
    hint = state(client, button(client, UNDO))["hint"]
    assert hint.startswith("Back to before density (left): 0.2 kg/m² → 200 kg/m²")


def test_it_alone_stands_still_with_its_last_good_state(stopped):
    frame, (still, going) = stopped.frames[0], times(stopped)
    wait_until(lambda: times(stopped)[1] > going + 0.2)
    assert times(stopped)[0] == still > 0
    assert (stopped.frames[0].positions == frame.positions).all()


def test_undo_takes_back_the_last_change_alone_and_the_variant_goes_on(stopped, client):
    still = times(stopped)[0]
    client.set(button(client, UNDO), True)
    wait_until(lambda: times(stopped)[0] > still)
    assert densities(stopped)[0] == 0.2
    assert stopped.comparison.shared.friction == 0.7
    wait_until(lambda: offered(client) == [])
    wait_until(lambda: "undone: density (left): 200 kg/m² → 0.2 kg/m²" in said(client))


def test_safe_settings_moderate_what_is_out_of_range_and_leave_the_others(stopped, client):
    still, right = times(stopped)[0], densities(stopped)[1]
    client.set(button(client, SAFE), True)
    wait_until(lambda: times(stopped)[0] > still)
    assert densities(stopped) == [2.0, right]
    wait_until(lambda: offered(client) == [])
    stopped.post(stopped.undo)
    wait_until(lambda: densities(stopped)[0] == 200.0, 5)


def test_the_controls_move_to_what_was_undone(stopped, client):
    client.set(button(client, UNDO), True)
    text = client.find("● left", "Text")
    wait_until(lambda: client.values.get(text) == "0.2")


def test_a_shared_change_that_stops_all_is_undone_for_all(lab, client):
    lab.post(lab.set_shared, "density", 500.0)
    wait_until(lambda: all(frame.refused for frame in lab.frames) and offered(client) == [UNDO, SAFE])
    reached = times(lab)
    client.set(button(client, UNDO), True)
    wait_until(lambda: all(now > then for now, then in zip(times(lab), reached, strict=True)))
    assert densities(lab) == [0.2, 0.2]


def test_key_z_undoes_while_all_is_well(lab, client):
    wait_until(lambda: min(times(lab)) > 0)
    client.set(client.find("damping ratio γ"), 1.0)
    wait_until(lambda: lab.comparison.shared.gamma == 1.0)
    client.press("Z")
    wait_until(lambda: [lane._world.settings.gamma for lane in lab._bench.lanes] == [0.2, 0.2])


def test_what_is_not_offered_cannot_be_pressed(lab, client):
    client.set(client.find("damping ratio γ"), 1.0)
    wait_until(lambda: lab.comparison.shared.gamma == 1.0)
    client.set(button(client, UNDO), True)
    client.set(client.find("friction"), 0.5)
    wait_until(lambda: lab.comparison.shared.friction == 0.5)
    assert lab.comparison.shared.gamma == 1.0


def test_undo_with_nothing_to_undo_says_so(lab, client):
    lab.post(lab.undo)
    wait_until(lambda: "undone: nothing" in said(client))


def test_another_scene_has_no_past(lab, client):
    client.set(client.find("damping ratio γ"), 1.0)
    wait_until(lambda: lab.comparison.shared.gamma == 1.0)
    lab.post(lab.compare_by, "density")
    lab.post(lab.open_scene, "drape")
    wait_until(lambda: lab.comparison.shared.gamma != 1.0)
    opened = lab.comparison
    lab.post(lab.undo)
    wait_until(lambda: "undone: nothing" in said(client))
    assert lab.comparison == opened


def test_undo_leads_back_through_what_was_compared_and_starts_again_with_it(lab, client):
    """Out of "what does this one do?", another number of cloths, and another setting, one after the other."""
    start = lab.comparison
    lab.post(lab.set_shared, "friction", 0.7)
    lab.post(lab.compare_by, "density")
    lab.post(lab.change_count, 1)
    lab.post(lab.show_effect, "bending")
    wait_until(lambda: lab.comparison.by == "bend" and len(lab.frames) == 2)
    wait_until(lambda: min(times(lab), default=0) > 0.2)
    client.press("Z")
    wait_until(lambda: "undone: bending spring" in said(client))
    assert (lab.comparison.by, lab.comparison.count) == ("density", 3)
    wait_until(lambda: len(lab.frames) == 3)
    assert min(times(lab)) < 0.2
    for by, count in (("density", 2), ("contact", 2)):
        lab.post(lab.undo)
        wait_until(lambda by=by, count=count: (lab.comparison.by, lab.comparison.count) == (by, count))
    wait_until(lambda: min(times(lab), default=0) > 0)
    assert lab.comparison.shared.friction == 0.7
    lab.post(lab.undo)
    wait_until(lambda: lab.comparison == start)


def test_shared_suspects_are_put_right_for_all_and_the_compared_one_only_where_it_stands_still():
    comparison = (
        Comparison.of_scene(load_scene(SCENE)).compared_by("dt").with_value(0, 1.0).with_value(1, 0.5)
    )
    made = made_safe(comparison.with_shared("stretch", 1e7), [Frame(refused="too stiff"), Frame()])
    assert made.values == (pytest.approx(1 / 30), 0.5)
    assert made.shared.stretch == 1e4


def test_a_start_that_is_refused_for_a_tangle_is_untangled_and_kept_where_that_failed():
    comparison, refused = (
        Comparison.of_scene(load_scene(SCENE)),
        Frame(refused="it crosses", blamed="tangled"),
    )
    untangled = made_safe(comparison, [Frame(), refused])
    assert untangled == comparison.with_shared("tangled", "untangle")
    assert made_safe(untangled, [Frame(), refused]) == comparison.with_shared("tangled", "keep")


def test_a_newcomer_sees_the_offer_too(stopped):
    late = RawClient(stopped.url)
    late.look()
    wait_until(lambda: len(late.controls) > 20 and offered(late) == [UNDO, SAFE])
    late.close()
