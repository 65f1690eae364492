"""What a page says of read-outs among the effects of a step: those that are made beside it, and those off."""

from __future__ import annotations

from typing import Any, NamedTuple

from server.meter import Meter
from sim.effects import EFFECTS, Cost, cost, why_off
from sim.settings import READ_OUTS


class ReadOut(NamedTuple):
    """What is said of one, and what it took of the time of steps so far, as a part; None while it is off."""

    words: str
    share: float | None = None

    def cost(self, name: str, report: Any) -> Cost:
        """Of the step that a report is of."""
        if self.share is None:
            return cost(name, self.words, report)
        took = self.share * report.ms.get("total", 0.0)
        return Cost(took, False, "on average over all steps so far, beside them")


def read_outs(meter: Meter) -> dict[str, ReadOut]:
    """Of a variant, by name; the ledger is kept in the step, which tells of it while it is not off."""
    settings, found = meter.latest.settings, {}
    if settings is None:
        return found
    if meter.latest.counting is not None:
        how = "after every frame" if settings.crossings == "on" else "now and then"
        found["crossings"] = ReadOut(f"ran: counted {how}", meter.latest.counting)
    found["local_error"] = ReadOut(_of_error(meter), meter.reading.share)
    return found | {name: ReadOut(why_off(EFFECTS[name])) for name in READ_OUTS if meter.is_off(name)}


def _of_error(meter: Meter) -> str:
    reading = meter.reading
    if reading.found is not None:
        return f"ran: last at {reading.time:.1f} s"
    if reading.why_not:
        return f"skipped: {reading.why_not}"
    return "ran: being measured" if reading.measuring else "skipped: cloth stands still"
