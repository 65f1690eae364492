"""The left dock: scene, lesson, transport, comparison, and a tab of controls for each group of settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import viser

from server import style
from server.comparison import Comparison, comparable
from server.controls import Control, make_control
from server.export import as_html
from server.guard import Guard
from server.palette import MAX_VARIANTS, VARIANTS
from server.relevance import why_idle
from server.rescue import Rescue
from server.switches import Switches
from sim.scene import Scene
from sim.settings import FIELDS, READ_OUTS

if TYPE_CHECKING:
    from server.lab import Lab

PLAY, PAUSE, STEP, RESET = "▶ Play", "❚❚ Pause", "⇥ Step", "⟲ Reset"
NOTHING = "nothing (one cloth)"
MORE, FEWER = "+ variant", "− variant"
LESSONS = ("drape", "curtain", "strip", "flag", "clap", "spin", "fold", "oscillator", "interference")
"""The scenes that the keys 1 to 9 open: of each subject the one that shows most within seconds."""

SPEEDS = {"1/8 ×": 0.125, "1/4 ×": 0.25, "1/2 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "4 ×": 4.0}


class Shortcut(NamedTuple):
    """What a key does.

    Attributes:
        key: As viser and people call it.
        what: In words.
        act: Does it for the client that pressed it; called on viser's event loop.
        own: Whether it acts on that client's page alone, so that those who only watch may do it, too.
    """

    key: str
    what: str
    act: Callable[[Any], None]
    own: bool = False


class Panel:
    """Builds the dock and keeps it to what the lab says. Callbacks only `post` to the lab.

    Everybody who connects sees and moves the same controls: one bench, however many browsers.
    """

    def __init__(self, server: viser.ViserServer, guard: Guard, lab: Lab, scenes: Sequence[str], scene: str):
        self._gui, self._guard, self._lab = server.gui, guard, lab
        self._shared: dict[str, Control] = {}
        self._own: dict[tuple[str, int], Control] = {}
        self._open: Scene | None = None
        self._by_label = {NOTHING: ""} | {f.label: f.name for f in comparable()}
        server.gui.main_panel.dock_left()
        server.gui.main_panel.set_width(style.LEFT_WIDTH)
        self._style = server.gui.add_html("")
        self._scene = self.choice("scene", scenes, scene, lab.open_scene, "What is simulated.")
        self._lesson = server.gui.add_html("")
        self._transport = server.gui.add_button_group("run", (PLAY, STEP, RESET))
        self.act(self._transport, (PLAY, PAUSE, STEP, RESET), self._on_transport)
        self._speed = self.choice(
            "speed",
            list(SPEEDS),
            "1 ×",
            lambda s: lab.set_speed(SPEEDS[s]),
            "Simulated time per wall time, if the machine keeps up.",
        )
        self._status = server.gui.add_html("")
        self._progress = server.gui.add_progress_bar(0.0, visible=False)
        self.rescue = Rescue(server, guard, lab)
        self._by = self.choice(
            "compare by",
            list(self._by_label),
            NOTHING,
            lambda label: lab.compare_by(self._by_label[label]),
            "The one setting that differs between the cloths; all else is shared. Starts the scene again.",
        )
        self._variants = server.gui.add_folder(None)
        self._count = server.gui.add_button_group("variants", (MORE,))
        self.act(self._count, (MORE, FEWER), lambda option: lab.change_count(1 if option == MORE else -1))
        self._add_tabs()
        self._add_commands()

    def choice(self, label: str, options: Sequence[str], value: str, then, hint: str):
        """A dropdown that has the lab do `then(option)`."""
        handle = self._gui.add_dropdown(label, tuple(options), initial_value=value, hint=hint)
        self.act(handle, options, then)
        return handle

    def folder(self, label: str) -> viser.GuiFolderHandle:
        """A folder for more controls."""
        return self._gui.add_folder(label)

    def act(self, handle: Any, options: Sequence[str], then) -> None:
        """Have the lab do `then(option)` when a client picks one of `options`; others are refused."""

        def check(value: Any) -> str:
            if value not in options:
                raise ValueError(f"{handle.label}: expected one of {', '.join(options)}")
            return value

        async def act(event: viser.GuiEvent) -> None:
            if event.client_id is not None:
                self._lab.post(then, handle.value)

        self._guard.watch(handle, check)
        (handle.on_click if isinstance(handle, viser.GuiButtonGroupHandle) else handle.on_update)(act)

    def _on_transport(self, option: str) -> None:
        {PLAY: self._lab.play, PAUSE: self._lab.pause, STEP: self._lab.step, RESET: self._lab.reset}[option]()

    def _add_tabs(self) -> None:
        """A tab for each group of settings, in the order of their definition; for effects, view and export.

        Read-outs have no other control than their switch among the effects.
        """
        tabs = self._gui.add_tab_group()
        fields = [field for field in FIELDS.values() if field.name not in READ_OUTS]
        for group in dict.fromkeys(field.group for field in fields):
            with tabs.add_tab(group):
                for field in fields:
                    if field.group == group:
                        self._shared[field.name] = self._setting(field.name, field.default)
        with tabs.add_tab("Effects"):
            self._switches = Switches(self, self._lab.switch_effect, self._lab.show_effect)
        with tabs.add_tab("View"):
            lines = self._gui.add_checkbox("mesh lines", False, hint="Draw the triangles of the cloth (W).")
            self._guard.watch(lines, bool)

            @lines.on_update
            async def _(event: viser.GuiEvent) -> None:
                if event.client_id is not None:
                    self._lab.post(self._lab.show_lines, lines.value)

            self._keys = self._gui.add_html("")
        with tabs.add_tab("Export"):
            self._export = self._gui.add_html("")

        self._lines = lines

    def _setting(self, name: str, value: Any) -> Control:
        change = lambda v: self._lab.post(self._lab.set_shared, name, v)  # noqa: E731
        return make_control(self._gui, self._guard, FIELDS[name], value, change)

    def _add_commands(self) -> None:
        lab = self._lab
        shortcuts = (
            Shortcut("space", "Play or pause", lambda _: lab.post(lab.toggle)),
            Shortcut("N", "One step", lambda _: lab.post(lab.step)),
            Shortcut("R", "Reset", lambda _: lab.post(lab.reset)),
            Shortcut("Z", "Undo the last change", lambda _: lab.post(lab.undo)),
            Shortcut("W", "Mesh lines on or off", lambda _: lab.post(lab.show_lines, not self._lines.value)),
            Shortcut("F", "Frame the view", lambda client: lab.post(lab.frame_view, client), own=True),
            Shortcut(
                "P",
                "Projector: cloths and chart alone, larger",
                lambda client: lab.post(lab.project, client),
                own=True,
            ),
            Shortcut("?", "Help", self._help, own=True),
        )
        lessons = tuple(
            Shortcut(str(i + 1), f"Scene {name}", lambda _, name=name: lab.post(lab.open_scene, name))
            for i, name in enumerate(LESSONS)
        )
        for shortcut in shortcuts + lessons:
            self._add_command(shortcut)
        self._keys_said = {s.key: s.what for s in shortcuts}
        self._keys_said[f"1–{len(lessons)}"] = "Scenes " + ", ".join(LESSONS)
        self._keys.content = style.keys(self._keys_said)

    def _add_command(self, shortcut: Shortcut) -> None:
        # viser lists no key "?", but hands on to the browser whatever it is told.
        modifier = "shift" if shortcut.key == "?" else None
        command = self._gui.add_command(shortcut.what, hotkey=shortcut.key, modifier=modifier)  # pyright: ignore[reportArgumentType]
        if shortcut.own:
            self._guard.open_to_all(command)

        @command.on_trigger
        async def _(event: Any) -> None:
            shortcut.act(event.client)

    def _help(self, client: Any) -> None:
        client.add_notification("How to read this page", style.help_text(self._keys_said))

    def show_scene(self, scene: Scene) -> None:
        """Say which scene is open and what to look for in it."""
        self._open = scene
        self._scene.value = scene.name
        self._switches.offer(scene.obstacle_labels)
        lesson = scene.lesson
        self._lesson.content = style.lesson(lesson.title, lesson.look_for, lesson.tries) if lesson else ""

    def show_comparison(self, comparison: Comparison) -> None:
        """Make one control per variant for the compared setting, and set all others."""
        by = comparison.by
        if self._by.value != (label := FIELDS[by].label if by else NOTHING):
            self._by.value = label
        self._show_own(comparison)
        for name, control in self._shared.items():
            if control.visible != (name != by):
                control.visible = name != by
            control.show(getattr(comparison.settings(0) if name == "threads" else comparison.shared, name))
        self.show_relevance(comparison)
        options = ((MORE,) if comparison.count < MAX_VARIANTS else ()) + (
            (FEWER,) if comparison.count > 2 else ()
        )
        self._count.visible = bool(by)
        if self._count.options != options:
            self._count.options = options
        css = "".join(c.css() for c in (*self._shared.values(), *self._own.values()))
        if self._style.content != (content := style.page(css, self._transport, self._count)):
            self._style.content = content

    def show_relevance(self, comparison: Comparison) -> None:
        """Grey what cannot act with these settings, say how to have them elsewhere, and nothing else.

        Values are left alone: while a slider is dragged, the page is ahead of the lab.
        """
        variants = [comparison.settings(i) for i in range(comparison.count)]
        for name, control in self._shared.items():
            control.enable(why_idle(name, variants))
        self._switches.show(variants)
        if self._open is not None and self._export.content != (text := as_html(self._open, comparison)):
            self._export.content = text

    def _show_own(self, comparison: Comparison) -> None:
        """One control per variant for the compared setting: made when needed, then hidden, never removed."""
        for i, value in enumerate(comparison.values):
            label = f"● {comparison.place(i)}"
            if (comparison.by, i) not in self._own:
                change = lambda v, i=i: self._lab.post(self._lab.set_own, i, v)  # noqa: E731
                field, color = FIELDS[comparison.by], VARIANTS[i]
                with self._variants:
                    control = make_control(
                        self._gui, self._guard, field, value, change, label=label, color=color
                    )
                self._own[comparison.by, i] = control
            self._own[comparison.by, i].name(label)
            self._own[comparison.by, i].show(value)
        for (name, i), control in self._own.items():
            wanted = name == comparison.by and i < len(comparison.values)
            if control.visible != wanted:
                control.visible = wanted

    def show_lines(self, visible: bool) -> None:
        """Say whether mesh lines are drawn."""
        self._lines.value = visible

    def show_status(
        self, playing: bool, time: float | None, factor: float | None, note: str, crowd: int = 1
    ) -> None:
        """Say how time runs, how many look on, and the last thing that went wrong."""
        options = (PAUSE if playing else PLAY, STEP, RESET)
        if self._transport.options != options:
            self._transport.options = options
        content = style.status(playing, time, factor, escape(note), crowd)
        if self._status.content != content:
            self._status.content = content

    def show_progress(self, share: float | None) -> None:
        """Show how far compiling is (0 to 1), or that it is over."""
        self._progress.visible = share is not None
        self._progress.value = 100.0 * min(max(share or 0.0, 0.0), 1.0)
