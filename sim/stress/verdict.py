"""What the runs of a case come to: the worst of each figure, and what to type to see it again."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sim.stress import Case, Figure

if TYPE_CHECKING:
    from sim.stress.probe import Outcome


@dataclass
class Verdict:
    """The outcomes of a case's runs.

    Attributes:
        case: The case.
        runs: How many outcomes there are to come.
        outcomes: Those that are there, by seed.
        kept: Files that were kept of failures.
    """

    case: Case
    runs: int
    outcomes: list[Outcome] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Take in an outcome."""
        self.outcomes.append(outcome)
        self.outcomes.sort(key=lambda known: known.task.seed)

    @property
    def complete(self) -> bool:
        """Whether all runs are done."""
        return len(self.outcomes) == self.runs

    @property
    def passed(self) -> bool:
        """Whether all runs are done and none failed."""
        return self.complete and not self.failures

    @property
    def failures(self) -> list[Outcome]:
        """Of the runs that failed."""
        return [outcome for outcome in self.outcomes if not outcome.passed]

    @property
    def figures(self) -> list[Figure]:
        """Each figure at its worst over all runs, in the order in which they were measured."""
        worst: dict[str, Figure] = {}
        for figure in (figure for outcome in self.outcomes for figure in outcome.figures):
            known = worst.get(figure.what)
            if known is None or _badness(figure) > _badness(known):
                worst[figure.what] = figure
        return list(worst.values())

    @property
    def worst(self) -> Figure | None:
        """The figure that is farthest beyond its mark, or nearest to it."""
        return max((f for f in self.figures if f.mark is not None), key=lambda f: f.share, default=None)

    @property
    def troubles(self) -> list[str]:
        """Why runs went no farther, each reason once."""
        return list(dict.fromkeys(outcome.trouble for outcome in self.outcomes if outcome.trouble))

    @property
    def seconds(self) -> float:
        """That all runs took [s]."""
        return sum(outcome.seconds for outcome in self.outcomes)

    @property
    def steps(self) -> int:
        """Of all runs."""
        return sum(outcome.steps for outcome in self.outcomes)

    @property
    def auditor(self) -> str:
        """Who judged intersections; "" where nobody had to."""
        return next((outcome.auditor for outcome in self.outcomes if outcome.auditor), "")

    @property
    def shown(self) -> Outcome | None:
        """The outcome to look at: the first that failed, or the first."""
        return next(iter(self.failures), next(iter(self.outcomes), None))

    @property
    def command(self) -> str:
        """What to type for the same again: of a failure, for the first run that failed."""
        words = ["muslin", "stress", "--case", self.case.name]
        if self.outcomes:
            first = self.failures[0] if self.failures else self.outcomes[0]
            words += ["--seed", str(first.task.seed), "--runs", str(1 if self.failures else self.runs)]
        return shlex.join(words)

    def builtins(self) -> dict[str, Any]:
        """The same as plain data; what is no number is None."""
        worst = self.worst
        return {
            "name": self.case.name,
            "passed": self.passed,
            "figure": None if worst is None else _number(worst.value),
            "mark": None if worst is None else worst.mark,
            "command": self.command,
            "title": self.case.title,
            "about": self.case.about,
            "theme": self.case.theme,
            "figures": [_plain(figure) for figure in self.figures],
            "troubles": self.troubles,
            "runs": len(self.outcomes),
            "failed_seeds": [outcome.task.seed for outcome in self.failures],
            "seconds": round(self.seconds, 3),
            "steps": self.steps,
            "auditor": self.auditor,
            "kept": self.kept,
        }


def _badness(figure: Figure) -> float:
    return figure.value if figure.mark is None else figure.share


def _plain(figure: Figure) -> dict[str, Any]:
    return {
        "what": figure.what,
        "value": _number(figure.value),
        "mark": figure.mark,
        "rule": "reported" if figure.mark is None else "at least" if figure.least else "at most",
        "unit": figure.unit,
        "passed": figure.passed,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
