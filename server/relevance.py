"""Which settings cannot act at the moment, and why: the page greys them and says so."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sim.settings import FIELDS, Settings

NEEDS: dict[str, tuple[Callable[[Settings], bool], str]] = {
    "rest_angle": (lambda s: s.bend != "none", "there are no bending springs"),
    "bending": (lambda s: s.bend != "none", "there are no bending springs"),
    "altitude": (lambda s: s.altitudes != "none", "there are no altitude springs"),
    "adhoc_rule": (lambda s: s.bend == "adhoc", "the bending spring is not adhoc"),
    "obstacles": (lambda s: s.contact != "none", "the collision method is none"),
    "each_obstacle": (lambda s: s.contact != "none" and s.obstacles != "off", "no obstacle is felt"),
    "self_collision": (lambda s: s.contact != "none", "the collision method is none"),
    "cloth_collision": (lambda s: s.contact != "none", "the collision method is none"),
    "edge_edge": (lambda s: s.contact != "none", "the collision method is none"),
    "detection": (lambda s: s.contact != "none", "the collision method is none"),
    "thickness": (lambda s: s.contact != "none", "the collision method is none"),
    "friction": (lambda s: s.contact != "none", "the collision method is none"),
    "newton": (lambda s: s.integrator != "symplectic_euler", "an explicit step solves nothing"),
    "tolerance": (lambda s: s.integrator != "symplectic_euler", "an explicit step solves nothing"),
    "compensate": (lambda s: s.gamma > 0, "there is no damping to reduce"),
    "wind": (lambda s: s.drag > 0, "there is no drag"),
    "lift": (lambda s: s.drag > 0, "there is no drag"),
    "gust": (lambda s: s.drag > 0 and any(s.wind), "there is no wind, or no drag"),
    "seed": (lambda s: s.jitter > 0 or s.gust > 0, "nothing is random without gusts or start jitter"),
}
"""What a setting needs to act, and what to say where that is missing. Settings not listed always act."""

AT_RESET = {"jitter", "seed"}
"""Settings that shape the start of a simulation: a change acts when it is reset."""


def why_idle(name: str, variants: Sequence[Settings]) -> str:
    """Why setting `name` can act in none of the variants; empty if it can in some."""
    field = FIELDS[name]
    if field.choices is not None and len(field.choices()) < 2:
        return f"{field.default} is the only one so far"
    if name == "threads" and len(variants) > 1:
        return "each variant has one thread while several share the machine"
    acts, reason = NEEDS.get(name, (lambda _: True, ""))
    return "" if any(acts(settings) for settings in variants) else reason
