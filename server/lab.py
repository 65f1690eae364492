"""The lab: opens scenes, does what the page asks for, and keeps bench and page going.

Threads: viser's own loop, where callbacks only post what is to be done; the lab's thread here, which does it,
starts frames and publishes them; one lane per variant, which steps; one that compiles. Everything in Lab that
is not `post`, `start` or `stop` runs in the lab's thread, so nothing of it needs a lock.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import msgspec

from server.access import Access
from server.bench import Bench
from server.comparison import Comparison
from server.compiler import Compiler, Prepare, compile_kernels
from server.history import History, changed
from server.inbox import Inbox
from server.lane import Frame
from server.page import READ_EVERY, Page
from server.palette import MAX_VARIANTS
from server.prober import Prober
from server.rescue import made_safe
from server.ringdown import RingDown, measure_damping
from sim.effects import find_effect, switch
from sim.mesh import build_mesh
from sim.scene import Scene, SceneError, read_scene, scene_files
from sim.settings import FIELDS, Settings, differing, only_read_outs

_log = logging.getLogger(__name__)


def build_world(scene: Scene, settings: Settings) -> Any:
    """The real simulation of a scene."""
    import sim

    world = sim.Simulation(msgspec.structs.replace(scene, settings=settings))
    world.keep_ledger()
    return world


class Lab:
    """One bench, shared by everyone who connects: all see the same cloths and move the same controls.

    Args:
        scene: Name or path of the scene to open.
        host: Address to listen on.
        port: Port to listen on; the next free one is taken where it is not free.
        build: Makes a simulation of a scene with some settings.
        prepare: Compiles what a scene needs.
        measure: Measures the damping of a scene.
        view_only: Let guests watch only; whoever has the host's address moves the controls.

    Raises:
        SceneError: if the scene cannot be used; nothing has been started then.
    """

    def __init__(
        self,
        scene: str = "drape",
        host: str = "127.0.0.1",
        port: int = 8080,
        build: Callable[[Scene, Settings], Any] = build_world,
        prepare: Prepare = compile_kernels,
        measure: Callable[[Scene], Any] = measure_damping,
        *,
        view_only: bool = False,
    ):
        self._scene = read_scene(scene)
        self._mesh = build_mesh(self._scene)
        self._build = build
        self._scenes = {path.stem: str(path) for path in scene_files()} | {self._scene.name: str(scene)}
        self._comparison = Comparison.of_scene(self._scene)
        self._history = History()
        self._inbox = Inbox(settling=(self.set_shared, self.set_own))
        self._stopping = threading.Event()
        access = Access.at(host, view_only)
        self._page = Page(self, host, port, list(self._scenes), self._scene.name, access)
        self._bench = Bench(lambda: self._page.watched, on_frame=lambda: self.post(lambda: None))
        answers = self._show_progress, self.say, self._launch, self._bench.count_crossings
        self._compiler = Compiler(prepare, self.post, *answers)
        self._ringdown = RingDown(measure, self.post, self._page.charts.show_damping)
        self._prober = Prober(self.post)
        self._thread = threading.Thread(target=self._run, name="muslin lab", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is, with the port that was really taken, for whoever started it."""
        return self._page.access.host_address(self._page.url)

    @property
    def guest_url(self) -> str:
        """The same, for everybody else."""
        return self._page.access.guest_address(self._page.url)

    @property
    def comparison(self) -> Comparison:
        """The present settings of all variants."""
        return self._comparison

    @property
    def frames(self) -> list[Frame]:
        """Each variant's newest frame; empty while kernels compile."""
        return [lane.frame for lane in self._bench.lanes]

    def start(self) -> None:
        """Show the still and start to prepare; returns at once."""
        self.post(self._open)
        self._thread.start()

    def stop(self) -> None:
        """End all threads and the server. A step that is being made is waited for, but not for long."""
        self._stopping.set()
        self._compiler.stop()
        self._ringdown.stop()
        self.post(lambda: None)
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        self._prober.stop()
        self._bench.stop()
        self._page.stop()

    def post(self, action: Callable, *args: Any) -> None:
        """Have the lab's thread call `action(*args)` soon. Any thread may post."""
        self._inbox.post(action, *args)

    # The loop: do what was posted, take in finished frames, start the next, show the finished ones meanwhile.

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                wait = self._bench.wait()
                self._inbox.act(READ_EVERY if wait is None else max(wait, 1e-3))
                self._bench.collect()
                self._bench.advance()
                self._prober.tick(self._bench, self._page.watched)
                self._page.publish(self._bench, self._comparison, self._history, self._prober.readings)
            except Exception:  # a mistake in one part of the page must not stop the clock
                _log.exception("the page could not do what it was asked")

    # What the page can ask for. Values have been checked by the guard.

    def play(self) -> None:
        """Let time run."""
        self._bench.play()
        self._page.show_status(self._bench)

    def pause(self) -> None:
        """Stop time."""
        self._bench.pause()
        self._page.show_status(self._bench)

    def toggle(self) -> None:
        """Pause or play."""
        (self.pause if self._bench.playing else self.play)()

    def step(self) -> None:
        """Pause, and make one time step in every variant."""
        self._bench.step()
        self._page.show_status(self._bench)

    def reset(self) -> None:
        """Start again, with the present settings."""
        self._bench.reset(self._comparison)
        self._page.charts.clear()
        for i in range(self._comparison.count):
            self._prober.changed(i)

    def set_speed(self, speed: float) -> None:
        """Simulated time per wall time."""
        self._bench.clock.speed = speed
        self._bench.clock.hold()

    def show_lines(self, visible: bool) -> None:
        """Draw the cloth's triangles, or not."""
        self._page.show_lines(visible)

    def frame_view(self, client: Any) -> None:
        """Put one client's camera where it sees everything."""
        self._page.stage.frame_view(client)

    def project(self, client: Any) -> None:
        """Show one client the cloths without docks, for a projector, or with them again."""
        self._page.project(client)

    def say(self, line: str) -> None:
        """Say for a while what went wrong."""
        self._page.note(line)
        self._page.show_status(self._bench)

    def measure_damping(self) -> None:
        """Measure what damping ratio each variant really has, and show it as it comes in."""
        if self._bench.ready:
            self._ringdown.start(self._scene, self._comparison)

    def _forget_damping(self) -> None:
        """What was measured holds no longer."""
        self._ringdown.stop()
        self._page.charts.show_damping(())

    def set_shared(self, name: str, value: Any) -> None:
        """Change a setting of all variants."""
        if name == self._comparison.by:
            return
        self._history.note(self._comparison, name)
        self._change(self._comparison.with_shared(name, value))

    def switch_effect(self, name: str, choice: str) -> None:
        """Have an effect in all variants "auto", "on" or "off"."""
        now = self._comparison.settings(0)
        for setting, value in switch(name, choice, now, self._scene.settings).items():
            if setting == self._comparison.by:
                self.say(f"{FIELDS[setting].label} is what the cloths differ in: change it in each of them")
            self.set_shared(setting, value)
        self._page.panel.show_comparison(self._comparison)

    def show_effect(self, name: str) -> None:
        """Put a cloth without an effect beside one that has it; starts again."""
        now = self._comparison.settings(0)
        having = switch(name, "auto", now, self._scene.settings)
        ((setting, without),) = find_effect(name).off.items()
        values = having.get(setting, getattr(now, setting)), without
        self._compare(Comparison(self._comparison.shared, setting, values))

    def set_own(self, index: int, value: Any) -> None:
        """Change the compared setting of one variant."""
        if index >= len(self._comparison.values):
            return
        self._history.note(self._comparison, (self._comparison.by, index))
        self._change(self._comparison.with_value(index, value))
        self._page.name_charts(self._comparison)

    def _change(self, comparison: Comparison) -> None:
        """Have other settings of the same variants, while they run."""
        before, self._comparison = self._comparison, comparison
        changes = [differing(before.settings(i), comparison.settings(i)) for i in range(comparison.count)]
        if not all(map(only_read_outs, changes)):
            self._forget_damping()
        self._page.panel.show_relevance(comparison)
        for i in range(len(self._bench.lanes)):
            if changes[i]:
                self._bench.change(i, changes[i])
            if changes[i] and not only_read_outs(changes[i]):
                self._prober.changed(i)

    def _change_on_page(self, comparison: Comparison, what: str) -> None:
        """Have other settings that no control was moved to, and move the controls there."""
        words = changed(self._comparison, comparison)
        self._change(comparison)
        self._page.panel.show_comparison(comparison)
        self._page.name_charts(comparison)
        self.say(f"{what}: {words}" if words else f"{what}: nothing")

    def undo(self) -> None:
        """Go back to before the last change; if the scene started again with it, it does with this, too."""
        last = self._history.undo()
        if last is None or not last.anew:
            self._change_on_page(last.before if last else self._comparison, "undone")
            return
        words = changed(self._comparison, last.before)
        self._comparison = last.before
        self._open()
        self.say(f"undone: {words}")

    def make_safe(self) -> None:
        """Put right what is out of the ordinary in variants that stand still."""
        comparison = made_safe(self._comparison, self.frames)
        if comparison != self._comparison:
            self._history.note(self._comparison, "safe settings")
            self._change_on_page(comparison, "made safe")

    def find_settings(self, index: int = 0, **budget: float) -> None:
        """Find settings with which a variant meets a budget, and set them in all of them.

        The budget is as `sim.budget.choose_settings` takes it. Time stands still meanwhile, so that nothing
        disturbs what is timed.
        """
        tab, playing, fixed = self._page.charts.budget, self._bench.playing, (self._comparison.by,)
        if not self._bench.ready or not budget:
            tab.say("There is nothing to measure yet." if budget else "Give a number above 0.")
            return
        count = self._comparison.count
        if index >= count:
            tab.say(f"There {'is one cloth' if count == 1 else f'are {count} cloths'} only: choose another.")
            return

        def work(probe: Any, state: Any) -> Any:
            from sim.budget import choose_settings

            told = lambda part: self.post(tab.say, f"measuring … {part:.0%}")  # noqa: E731
            return choose_settings(probe, state, fixed=fixed, told=told, **budget)

        def take(choice: Any) -> None:
            if playing:
                self.play()
            if isinstance(choice, Exception):
                tab.say(str(choice) or "A setting was changed meanwhile; ask again.")
                return
            name = self._comparison.short_name(index)
            tab.say(f"{name}: {choice.sentence}" if count > 1 else choice.sentence)
            comparison = self._comparison
            for setting, value in choice.changes.items():
                comparison = comparison.with_shared(setting, value)
            if comparison != self._comparison:
                self._history.note(self._comparison, work)  # one change, though of several settings
                self._change_on_page(comparison, "budget")

        self.pause()
        tab.say("measuring …")
        self._prober.ask(self._bench, index, work, take)

    def compare_by(self, by: str) -> None:
        """Have the variants differ in another setting; starts again."""
        if by != self._comparison.by:
            self._compare(self._comparison.compared_by(by))

    def change_count(self, more: int) -> None:
        """Add or leave out variants at the end; starts again."""
        count = min(max(self._comparison.count + more, 2), MAX_VARIANTS)
        if self._comparison.by and count != self._comparison.count:
            self._compare(self._comparison.with_count(count))

    def _compare(self, comparison: Comparison) -> None:
        """Have other variants, which starts again, and can be undone."""
        self._history.note(self._comparison, comparison, anew=True)
        self._comparison = comparison
        self._open()

    def open_scene(self, name: str) -> None:
        """Open another scene."""
        try:
            scene = read_scene(self._scenes[name])
            mesh = build_mesh(scene)
        except SceneError as error:
            self.say(str(error))
            self._page.panel.show_scene(self._scene)
            return
        self._scene, self._mesh, self._comparison = scene, mesh, Comparison.of_scene(scene)
        self._history.clear()
        self._open()

    # Opening a scene: its still at once, then kernels in a thread, then one lane per variant.

    def _open(self) -> None:
        self._ringdown.stop()
        self._prober.clear()
        self._bench.clear(self._comparison.count)
        self._page.set_up(self._scene, self._mesh, self._comparison)
        self._wait_for("preparing")
        if lines := self._mesh.warnings:
            more = f"; and {len(lines) - 3:,} more: see muslin check" if len(lines) > 3 else ""
            self.say("; ".join(lines[:3]) + more)
        self._compiler.start(self._scene, self._comparison)

    def _show_progress(self, done: int, total: int, name: str) -> None:
        self._wait_for(f"compiling {min(done + 1, total)} of {total}, kernel {name}", done / max(total, 1))

    def _launch(self) -> None:
        self._wait_for("")
        scene = self._scene
        build = lambda settings: self._build(scene, settings)  # noqa: E731
        self._bench.launch(build, self._comparison)
        self._prober.clear(build, self._comparison.count)

    def _wait_for(self, what: str, share: float = 0.0) -> None:
        self._page.wait_for(what, share)
        self._page.show_status(self._bench)
