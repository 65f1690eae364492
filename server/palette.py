"""The colours: Okabe and Ito's for variants, the same wherever a variant is seen; warm greys for the rest."""

from __future__ import annotations

from typing import NamedTuple


class Rgb(NamedTuple):
    """A colour, 0 to 255 per channel."""

    red: int
    green: int
    blue: int

    @property
    def css(self) -> str:
        """As `#rrggbb`."""
        return f"#{self.red:02x}{self.green:02x}{self.blue:02x}"

    def toward(self, other: Rgb, share: float) -> Rgb:
        """This colour mixed with a share (0 to 1) of another."""
        return Rgb(*(round(a + (b - a) * share) for a, b in zip(self, other, strict=True)))


WHITE, BLACK = Rgb(255, 255, 255), Rgb(0, 0, 0)
INK = Rgb(52, 48, 44)
GROUND = Rgb(226, 221, 213)
STONE = Rgb(176, 168, 158)
BRAND = Rgb(112, 92, 74)

VARIANTS = (Rgb(230, 159, 0), Rgb(86, 180, 233), Rgb(0, 158, 115), Rgb(204, 121, 167))
"""Orange, sky blue, bluish green, reddish purple (Okabe and Ito, 2008): safe for colour-blind eyes."""

MAX_VARIANTS = len(VARIANTS)


def shades(color: Rgb, count: int) -> list[Rgb]:
    """`count` tones of one colour from dark to light, for the parts of one variant's cost."""
    dark, light = color.toward(BLACK, 0.45), color.toward(WHITE, 0.7)
    return [dark.toward(light, i / max(count - 1, 1)) for i in range(count)]
