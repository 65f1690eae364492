"""The lab: one bench of variants, its clock, and the page that shows and steers them.

Threads: viser's own loop, where callbacks only post what is to be done; the lab's thread here, which does it,
starts frames and publishes them; one lane per variant, which steps. Everything below that is not `post`,
`start` or `stop` runs in the lab's thread, so nothing of it needs a lock.
"""

from __future__ import annotations

import contextlib
import io
import logging
import queue
import signal
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

import msgspec

from server.charts import Charts
from server.clock import FRAME, Clock
from server.comparison import Comparison
from server.guard import open_server
from server.labels import label
from server.lane import Advance, Change, Frame, Lane, Reset
from server.meter import Meter
from server.palette import BRAND, MAX_VARIANTS
from server.panel import Panel
from server.stage import Stage
from server.style import LEFT_WIDTH, RIGHT_WIDTH
from sim.mesh import build_mesh
from sim.scene import Scene, SceneError, load_scene, scene_files
from sim.settings import FIELDS, Settings

READ_EVERY = 0.2
"""Wall time [s] between two updates of labels, tables and plots."""

NOTE_FOR = 8.0
"""Wall time [s] for which the page says why something was refused."""

_log = logging.getLogger(__name__)


def build_world(scene: Scene, settings: Settings) -> Any:
    """The real simulation of a scene."""
    import sim

    return sim.Simulation(msgspec.structs.replace(scene, settings=settings))


def compile_kernels(scene: Scene, progress: Callable[[int, int, str], None]) -> None:
    """Compile every kernel that a scene needs, reporting each one."""
    from sim.warmup import warm_up

    warm_up(scene, progress=progress)


class Lab:
    """One bench, shared by everyone who connects: all see the same cloths and move the same controls.

    Args:
        scene: Name or path of the scene to open.
        host: Address to listen on.
        port: Port to listen on; the next free one is taken where it is not free.
        build: Makes a simulation of a scene with some settings.
        prepare: Compiles what a scene needs, reporting (done, total, name of the next).

    Raises:
        SceneError: if the scene cannot be used; nothing has been started then.
    """

    def __init__(
        self,
        scene: str = "drape",
        host: str = "127.0.0.1",
        port: int = 8080,
        build: Callable[[Scene, Settings], Any] = build_world,
        prepare: Callable[[Scene, Callable[[int, int, str], None]], None] = compile_kernels,
    ):
        self._scene = load_scene(scene)
        self._mesh = build_mesh(self._scene)
        self._build, self._prepare = build, prepare
        self._scenes = {path.stem: str(path) for path in scene_files()} | {self._scene.name: str(scene)}
        self._comparison = Comparison.of_scene(self._scene)
        self._clock = Clock()
        self._inbox: queue.SimpleQueue = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._compiling = threading.Lock()
        self._playing, self._steps_asked = True, 0
        self._lanes: list[Lane] = []
        self._meters: list[Meter] = []
        self._finished: list[Frame] = []
        self._shown: list[Frame] = []
        self._published = self._read = self._charted = 0.0
        self._openings = 0
        self._waiting, self._note, self._noted = "", "", 0.0
        self._host = host
        self._server, guard = open_server(host, port)
        guard.on_refusal = lambda line: self.post(self._say, line)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND[:3])
        self._panel = Panel(self._server, guard, self, list(self._scenes), self._scene.name)
        self._charts = Charts(self._server)
        self._stage = Stage(self._server)
        self._server.on_client_connect(self._welcome)
        self._thread = threading.Thread(target=self._run, name="muslin lab", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is, with the port that was really taken."""
        host = "localhost" if self._host in ("0.0.0.0", "::") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    @property
    def comparison(self) -> Comparison:
        """The present settings of all variants."""
        return self._comparison

    @property
    def frames(self) -> list[Frame]:
        """Each variant's newest frame; empty while kernels compile."""
        return [lane.frame for lane in self._lanes]

    def start(self) -> None:
        """Show the still and start to prepare; returns at once."""
        self.post(self._open)
        self._thread.start()

    def stop(self) -> None:
        """End all threads and the server. A step that is being made is waited for, but not for long."""
        self._stopping.set()
        self.post(lambda: None)
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        for lane in self._lanes:
            lane.stop()
        for lane in self._lanes:
            lane.join(timeout=2)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def post(self, action: Callable, *args: Any) -> None:
        """Have the lab's thread call `action(*args)` soon. Any thread may post."""
        self._inbox.put((action, args))

    # The loop: do what was posted, take in finished frames, start the next, show the finished ones meanwhile.

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._act()
                self._collect()
                self._advance()
                self._publish()
            except Exception:  # a mistake in one part of the page must not stop the clock
                _log.exception("the page could not do what it was asked")

    def _act(self) -> None:
        """Do all that was posted; with nothing posted, wait until the next frame is due."""
        timeout = max(self._clock.wait(), 1e-3) if self._wants_frame() else READ_EVERY
        with contextlib.suppress(queue.Empty):
            action, args = self._inbox.get(timeout=timeout)
            action(*args)
            while not self._inbox.empty():
                action, args = self._inbox.get()
                action(*args)

    def _wants_frame(self) -> bool:
        """Whether there is a frame to be started now or soon: a bench that nobody looks at stands still."""
        if not self._lanes or any(lane.busy for lane in self._lanes):
            return False
        if all(lane.frame.refused for lane in self._lanes):
            return False
        return self._steps_asked > 0 or (self._playing and bool(self._server.get_clients()))

    def _collect(self) -> None:
        """Take in the frames once all variants have made theirs."""
        if self._lanes and not any(lane.busy for lane in self._lanes):
            self._finished = self.frames
            for meter, frame in zip(self._meters, self._finished, strict=True):
                meter.add(frame)

    def _advance(self) -> None:
        """Start the next frame if it is due."""
        if not self._wants_frame():
            if not any(lane.busy for lane in self._lanes):
                self._clock.hold()
            return
        longest = max(lane.step_length for lane in self._lanes)
        if self._steps_asked:
            self._steps_asked -= 1
            seconds = self._clock.single_step(longest)
        elif self._clock.wait() > 0:
            return
        else:
            seconds = self._clock.next_frame(longest)
        for lane in self._lanes:
            lane.send(Advance(seconds))

    def _publish(self) -> None:
        """Show what is finished, FRAME apart at least, and numbers less often; nothing if nobody looks."""
        if not self._server.get_clients():
            return
        now = perf_counter()
        changed = (
            any(a is not b for a, b in zip(self._finished, self._shown, strict=False)) or not self._shown
        )
        if self._finished and changed and now >= self._published + 0.9 * FRAME:
            self._stage.show(self._finished)
            self._shown, self._published = self._finished, now
        if now >= self._read + READ_EVERY:
            self._read = now
            self._show_numbers(now)

    def _show_numbers(self, now: float) -> None:
        meters = [meter.read() for meter in self._meters]
        for i, meter in enumerate(meters):
            waiting = self._waiting or (self._lanes[i].waiting if self._lanes else "")
            self._stage.label(i, *label(self._comparison.name(i), meter, waiting, self._behind(meter)))
        time = max((meter.latest.time for meter in meters), default=0.0)  # finished; the clock may be ahead
        self._charts.add(time, meters, moved=time != self._charted)
        self._charted = time
        if now > self._noted + NOTE_FOR:
            self._note = ""
        self._show_status()

    def _behind(self, meter: Meter) -> float:
        """Simulated time [s] between a variant and the foremost, beyond what different time steps make."""
        behind = max(m.latest.time for m in self._meters) - meter.latest.time
        return (
            behind
            if behind > 2 * max((lane.step_length for lane in self._lanes), default=0.0) + 1e-6
            else 0.0
        )

    def _show_status(self) -> None:
        ready = bool(self._lanes)
        factor = self._clock.real_time_factor if self._playing else None
        self._panel.show_status(
            self._playing, self._clock.time if ready else None, factor, self._note or self._waiting
        )

    # What the page can ask for. Values have been checked by the guard.

    def play(self) -> None:
        """Let time run."""
        self._playing = True
        self._show_status()

    def pause(self) -> None:
        """Stop time."""
        self._playing, self._steps_asked = False, 0
        self._show_status()

    def toggle(self) -> None:
        """Pause or play."""
        (self.pause if self._playing else self.play)()

    def step(self) -> None:
        """Pause, and make one time step in every variant."""
        self._playing, self._steps_asked = False, min(self._steps_asked + 1, 10)
        self._show_status()

    def reset(self) -> None:
        """Start again, with the present settings."""
        for i, lane in enumerate(self._lanes):
            lane.send(Reset(self._comparison.settings(i)))
        self._meters = [Meter() for _ in self._meters]
        self._clock.reset()
        self._charts.clear()

    def set_speed(self, speed: float) -> None:
        """Simulated time per wall time."""
        self._clock.speed = speed
        self._clock.hold()

    def show_lines(self, visible: bool) -> None:
        """Draw the cloth's triangles, or not."""
        self._stage.show_lines(visible)
        self._panel.show_lines(visible)
        self._shown = []

    def frame_view(self, client: Any) -> None:
        """Put one client's camera where it sees everything."""
        self._stage.frame_view(client)

    def set_shared(self, name: str, value: Any) -> None:
        """Change a setting of all variants."""
        if name == self._comparison.by:
            return
        self._comparison = self._comparison.with_shared(name, value)
        self._panel.show_relevance(self._comparison)
        for i in range(len(self._lanes)):
            self._change(i, name, value)

    def set_own(self, index: int, value: Any) -> None:
        """Change the compared setting of one variant."""
        if index >= len(self._comparison.values):
            return
        self._comparison = self._comparison.with_value(index, value)
        self._panel.show_relevance(self._comparison)
        self._name_charts()
        if self._lanes:
            self._change(index, self._comparison.by, value)

    def _change(self, index: int, name: str, value: Any) -> None:
        lane = self._lanes[index]
        if lane.ready:
            lane.send(Change({name: value}))
        else:  # it could not even start with the settings before
            lane.send(Reset(self._comparison.settings(index)))

    def compare_by(self, by: str) -> None:
        """Have the variants differ in another setting; starts again."""
        if by != self._comparison.by:
            self._comparison = self._comparison.compared_by(by)
            self._open()

    def change_count(self, more: int) -> None:
        """Add or leave out variants at the end; starts again."""
        count = min(max(self._comparison.count + more, 2), MAX_VARIANTS)
        if self._comparison.by and count != self._comparison.count:
            self._comparison = self._comparison.with_count(count)
            self._open()

    def open_scene(self, name: str) -> None:
        """Open another scene."""
        try:
            scene = load_scene(self._scenes[name])
            mesh = build_mesh(scene)
        except SceneError as error:
            self._say(str(error))
            self._panel.show_scene(self._scene)
            return
        self._scene, self._mesh, self._comparison = scene, mesh, Comparison.of_scene(scene)
        self._open()

    # Opening a scene: its still at once, then kernels in a thread, then one lane per variant.

    def _open(self) -> None:
        for lane in self._lanes:
            lane.stop()
        names = self._names()
        self._openings += 1
        self._lanes, self._finished, self._shown = [], [], []
        self._meters = [Meter() for _ in names]
        self._clock.reset()
        self._stage.set_up(self._scene, self._mesh, names)
        self._name_charts()
        self._charts.clear()
        self._panel.show_scene(self._scene)
        self._panel.show_comparison(self._comparison)
        self._wait_for("preparing")
        arguments = (self._openings, self._scene, self._comparison)
        threading.Thread(target=self._compile, args=arguments, name="muslin compiler", daemon=True).start()

    def _compile(self, opening: int, scene: Scene, comparison: Comparison) -> None:
        """In a thread of its own: compile what every variant needs, one after the other."""

        def progress(done: int, total: int, name: str) -> None:
            self.post(self._show_progress, opening, done, total, name)

        # Which kernels there are depends on the spring kind alone; a second pass would only count again.
        variants = {s.bend: s for s in map(comparison.settings, range(comparison.count))}
        try:
            for settings in variants.values():
                with self._compiling:
                    if opening == self._openings and not self._stopping.is_set():
                        self._prepare(msgspec.structs.replace(scene, settings=settings), progress)
        except Exception as error:  # shown on the page, and again by the lane that cannot start
            _log.exception("kernels could not be compiled")
            self.post(self._say, f"kernels could not be compiled: {error}")
        self.post(self._launch, opening)

    def _show_progress(self, opening: int, done: int, total: int, name: str) -> None:
        if opening == self._openings and not self._lanes:
            number = min(done + 1, total)
            self._wait_for(f"compiling {number} of {total} kernels, {name}", done / max(total, 1))

    def _wait_for(self, what: str, share: float | None = 0.0) -> None:
        self._waiting = what
        self._panel.show_progress(share if what else None)
        self._read = 0.0
        self._show_status()

    def _launch(self, opening: int) -> None:
        if opening != self._openings:
            return
        self._wait_for("")
        scene = self._scene
        self._lanes = [
            Lane(lambda settings: self._build(scene, settings), self._comparison.settings(i), self._wake)
            for i in range(self._comparison.count)
        ]
        for lane in self._lanes:
            lane.start()

    def _wake(self) -> None:
        self.post(lambda: None)

    def _names(self) -> list[str]:
        return [self._comparison.name(i) for i in range(self._comparison.count)]

    def _name_charts(self) -> None:
        by, indices = self._comparison.by, range(self._comparison.count)
        self._charts.name(FIELDS[by].label if by else "", [self._comparison.short_name(i) for i in indices])

    def _say(self, line: str) -> None:
        self._note, self._noted = line, perf_counter()
        self._show_status()

    def _welcome(self, client: Any) -> None:
        self.post(self._stage.frame_view, client, LEFT_WIDTH + RIGHT_WIDTH)


def run_lab(
    scene: str = "drape", host: str = "127.0.0.1", port: int = 8080, open_browser: bool = True
) -> None:
    """Run the lab until Ctrl-C or SIGTERM.

    Args:
        scene: Name or path of the scene to open.
        host: Address to listen on; anything but a loopback address lets others in, without a password.
        port: Port to listen on; the next free one is taken, and printed, where it is not free.
        open_browser: Open the page in the default browser.

    Raises:
        SceneError: if the scene cannot be used.
        ValueError: if nothing can listen at that address.
    """
    done = threading.Event()
    lab = Lab(scene, host, port)
    with _on_signal(signal.SIGTERM, done.set):
        try:
            lab.start()
            sys.stdout.write(f"Muslin is at {lab.url}   (Ctrl-C ends it)\n")
            sys.stdout.flush()
            if open_browser:
                webbrowser.open(lab.url)
            while not done.wait(0.5):  # in short waits, since Windows delivers no Ctrl-C within one
                pass
        except KeyboardInterrupt:
            sys.stdout.write("\n")
        finally:
            lab.stop()


@contextlib.contextmanager
def _on_signal(number: int, action: Callable[[], None]) -> Iterator[None]:
    """While in force, a signal does `action`; only the main thread can have it so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, lambda *_: action())
    try:
        yield
    finally:
        signal.signal(number, before)
