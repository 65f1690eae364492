"""The page: the dock of controls, the cloths, the charts, and how often each is written anew."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

from server.access import Access, own_address
from server.bench import Bench
from server.charts import MEASURE, Charts
from server.clock import FRAME
from server.comparison import Comparison
from server.guard import PROJECTOR, open_server
from server.history import History
from server.labels import label
from server.lane import Frame
from server.palette import BRAND
from server.panel import Panel
from server.prober import Reading
from server.projector import Projector
from server.stage import Stage
from server.style import MOST_BESIDE, WATCHING
from sim.mesh import Mesh
from sim.scene import Scene
from sim.settings import FIELDS

if TYPE_CHECKING:
    from server.lab import Lab

READ_EVERY = 0.2
"""Wall time [s] between two updates of labels, tables and plots."""

NOTE_FOR = 8.0
"""Wall time [s] for which the page says why something was refused."""


class Page:
    """Serves the page and keeps it to what the bench has made. All but `url` is for the lab's thread.

    Args:
        lab: Does what clients ask for.
        host: Address to listen on.
        port: Port to listen on; the next free one is taken where it is not free.
        scenes: Names of the scenes that can be opened.
        scene: Name of the one to begin with.
        access: Whom to let in.

    Raises:
        ValueError: if nothing can listen there.
    """

    def __init__(self, lab: Lab, host: str, port: int, scenes: list[str], scene: str, access: Access):
        self._host, self.access = host, access
        self.server, guard = open_server(host, port, access)
        guard.on_refusal = lambda line: lab.post(lab.say, line)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND[:3])
        self.panel = Panel(self.server, guard, lab, scenes, scene)
        self.charts = Charts(self.server)
        self.panel.act(self.charts.measure, (MEASURE,), lambda _: lab.measure_damping())
        self.charts.budget.connect(self.panel, guard, lab)
        self.stage = Stage(self.server, lambda client: guard.on_phone(client.client_id))
        self.projector = Projector()
        self._shown: list[Frame] = []
        self._pinned = False
        self._published = self._read = self._charted = 0.0
        self._waiting, self._note, self._noted = "", "", 0.0

        @self.server.on_client_connect
        def _(client: Any) -> None:
            if not guard.may_act(client.client_id):
                client.gui.add_html(WATCHING, order=-1.0)

            @client.camera.on_update  # before it is framed, or a shape that comes in between would go unheard
            async def _(_: Any) -> None:
                if self.stage.is_outgrown(client):
                    lab.post(self.stage.frame_view, client)

            lab.post(self.stage.frame_view, client)
            if guard.came_to(client.client_id) == PROJECTOR:
                lab.post(self.project, client)

    @property
    def url(self) -> str:
        """Where the page is, with the port that was really taken, without any token."""
        host = own_address() if self._host in ("0.0.0.0", "::", "") else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    @property
    def watched(self) -> bool:
        """Whether anybody looks."""
        return bool(self.server.get_clients())

    def stop(self) -> None:
        """End the server, without viser's farewell on the terminal."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def set_up(self, scene: Scene, mesh: Mesh, comparison: Comparison) -> None:
        """Show the still of a scene, and controls for its variants."""
        self._shown = []
        self._pinned = bool(len(mesh.pinned))
        self.stage.set_up(scene, mesh, [comparison.name(i) for i in range(comparison.count)])
        self.name_charts(comparison)
        self.charts.clear()
        self.charts.show_damping(())
        self.panel.show_scene(scene)
        self.panel.show_comparison(comparison)

    def project(self, client: Any) -> None:
        """Bring one client's page into projector mode, or out of it."""
        self.stage.project(client, self.projector.toggle(client))

    def name_charts(self, comparison: Comparison) -> None:
        """Call the variants in charts by what sets them apart."""
        names = [comparison.short_name(i) for i in range(comparison.count)]
        self.charts.name(FIELDS[comparison.by].label if comparison.by else "", names)

    def publish(
        self, bench: Bench, comparison: Comparison, history: History, readings: Sequence[Reading]
    ) -> None:
        """Show what is finished, FRAME apart at least, and numbers less often; nothing if nobody looks."""
        if not self.watched:
            return
        now, frames = perf_counter(), bench.finished
        changed = any(a is not b for a, b in zip(frames, self._shown, strict=False)) or not self._shown
        if frames and changed and now >= self._published + 0.9 * FRAME:
            self.stage.show(frames)
            self._shown, self._published = frames, now
        if now >= self._read + READ_EVERY:
            self._read = now
            for meter, reading in zip(bench.meters, readings, strict=False):
                meter.reading = reading
            self._show_numbers(bench, comparison, now)
            self.panel.rescue.show(comparison, bench.finished, history.last(comparison))

    def _show_numbers(self, bench: Bench, comparison: Comparison, now: float) -> None:
        meters = [meter.read() for meter in bench.meters]
        for i, meter in enumerate(meters):
            # The dock says how far it is: a label that changes has a browser draw the whole scene anew, which
            # takes from the compiler where no GPU does it.
            waiting = f"{self._waiting.split()[0]} …" if self._waiting else bench.waiting(i)
            remark = comparison.remark(i)
            self.stage.label(i, *label(comparison.name(i), meter, waiting, bench.behind(i), remark))
        self.charts.show_momentum(self._keeps_momentum(comparison))
        time = max((meter.latest.time for meter in meters), default=0.0)  # finished; the clock may be ahead
        self.charts.add(time, meters, moved=time != self._charted)
        self._charted = time
        self.projector.show(self.charts.picture, beside=comparison.count <= MOST_BESIDE)
        if now > self._noted + NOTE_FOR:
            self._note = ""
        self.show_status(bench)

    def _keeps_momentum(self, comparison: Comparison) -> bool:
        """Whether nothing holds or pulls the cloth in any variant, so that momentum may not change."""
        variants = map(comparison.settings, range(comparison.count))
        return not self._pinned and not any(any(settings.gravity) for settings in variants)

    def show_status(self, bench: Bench) -> None:
        """Say how time runs, and what is waited for or went wrong."""
        time = bench.clock.time if bench.ready else None
        factor = bench.clock.real_time_factor if bench.playing else None
        crowd = len(self.server.get_clients())
        self.panel.show_status(bench.playing, time, factor, self._note or self._waiting, crowd)

    def wait_for(self, what: str, share: float = 0.0) -> None:
        """Say what all variants wait for, and which share of it is done; an empty text ends the wait."""
        self._waiting = what
        if not what:
            self.stage.cast_shadows()
        self.panel.show_progress(share if what else None)
        self._read = 0.0

    def note(self, line: str) -> None:
        """Say for a while what went wrong."""
        self._note, self._noted = line, perf_counter()

    def show_lines(self, visible: bool) -> None:
        """Draw the cloth's triangles, or not."""
        self.stage.show_lines(visible)
        self.panel.show_lines(visible)
        self._shown = []
