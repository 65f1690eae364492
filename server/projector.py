"""Projector mode: a page without its docks, of cloths, labels and the chart of error against cost, larger.

Each page is in it or not, whatever others show: a teacher projects one and keeps another with the controls.
viser hides and minimises docks for everybody at once only, so rules of style in a piece of HTML that one
client alone has do it, as others make the sheet on a phone (`server.style`). That piece also has a chart of
its own: the one in the dock is only there while its tab is open.
"""

from __future__ import annotations

import weakref

import viser

from server import style


class Projector:
    """Keeps the pages that are in projector mode. All of it is for the lab's thread."""

    def __init__(self) -> None:
        self._pieces: weakref.WeakKeyDictionary[viser.ClientHandle, viser.GuiHtmlHandle]
        self._pieces = weakref.WeakKeyDictionary()
        self._content = style.projector("", beside=True)

    def toggle(self, client: viser.ClientHandle) -> bool:
        """Bring a client's page into the mode, or out of it again; gives whether it is in it now.

        The piece is hidden and not removed: a browser that meets an update and a removal of one element in
        the same batch reports an error.
        """
        if (piece := self._pieces.get(client)) is None:
            self._pieces[client] = client.gui.add_html(self._content)
            return True
        piece.content, piece.visible = self._content, not piece.visible
        return piece.visible

    def show(self, chart: str, beside: bool) -> None:
        """Show this chart on every page in the mode, beside the cloths or over the ground before them."""
        self._content = style.projector(chart, beside)
        for piece in self._pieces.values():
            if piece.visible and piece.content != self._content:
                piece.content = self._content
