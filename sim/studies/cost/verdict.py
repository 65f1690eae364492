"""What a person should do: one sentence, and settings to paste."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import tomli_w
from msgspec import to_builtins

from sim.settings import Settings, differing
from sim.studies.cost.front import cheapest
from sim.studies.cost.measures import UNITS
from sim.studies.cost.plan import SOLVED
from sim.studies.cost.report import Run, Source, Verdict

FRAME = 1 / 60
"""[s]."""

DEEPER = 1e-4
"""A run that ends deeper inside an obstacle than the chosen one, by more than this [m], is not
recommended."""

ENERGY = 10.0
"""Nor is one whose energy is more wrong than that of the chosen one, and than so many times the target."""


def verdict(
    chosen: Run, runs: Sequence[Run], sources: Sequence[Source], target: float, where: str = "on this scene"
) -> Verdict:
    """The cheapest run that meets `target`, or the one that comes nearest to it.

    Args:
        chosen: What is paid now; one of `runs`.
        runs: To choose from.
        sources: Of the error of the chosen run.
        target: Relative error.
        where: What errors are told of, in words.
    """
    energy = max(chosen.error_energy, ENERGY * target)
    fit = [run for run in runs if run.deepest <= chosen.deepest + DEEPER and run.error_energy <= energy]
    found = cheapest([run.ms for run in fit], [run.error for run in fit], target)
    best = fit[found] if found is not None else min(fit, key=lambda run: (run.error, run.ms))
    changed = to_builtins(best.changed)
    return Verdict(
        target=target,
        sentence=_sentence(chosen, best, target, found is not None, where),
        dominates=dominant(sources),
        settings=changed,
        toml=_toml(best, target, found is not None),
        ms=best.ms,
        error=best.error,
        pays=chosen.ms / best.ms,
    )


def _sentence(chosen: Run, best: Run, target: float, met: bool, where: str) -> str:
    if not met:
        reached = f"the nearest, {percent(best.error)}, is"
        begin = f"Nothing that was tried reaches {percent(target)} {where}; {reached}"
    else:
        begin = f"For {percent(target)} error {where} the cheapest setting is"
    cost = f"{best.ms * FRAME:.3g} ms per frame, {1e3 / best.ms:.2g} × real time"
    if best is chosen:
        return f"{begin} the one you have: {cost}, with an error of {percent(best.error)}."
    now = f"you now pay {chosen.ms / best.ms:.2g} × that for {percent(chosen.error)}"
    return f"{begin} {in_words(best.changed)}: {cost}; {now}."


def dominant(sources: Sequence[Source]) -> str:
    """Which source of error is largest, in a sentence."""
    known = sorted(((s.change, s) for s in sources if s.change is not None), key=lambda p: -p[0])
    if not known:
        return "No source of error could be told."
    (most, first), *others = known
    many = first.source.endswith("iterations")
    words = (
        f"At the chosen settings the {first.source} {'dominate' if many else 'dominates'}: "
        f"turned from {first.what} {'they move' if many else 'it moves'} the cloth"
    )
    words += f" by {percent(most)}"
    words += "".join(f", the {s.source} by {percent(change)}" for change, s in others) + "."
    mesh = next((s for s in sources if s.source == "mesh" and s.observables), None)
    if mesh is None:
        return words
    rest = {
        name: max((abs(s.observables.get(name, 0.0)) for s in sources if s is not mesh), default=0.0)
        for name in mesh.observables
    }
    name = max(rest, key=lambda n: abs(mesh.observables[n]) / max(rest[n], 1e-12))
    moved, other = abs(mesh.observables[name]), rest[name]
    than = "more than any of these" if moved > other else "no more than one of these"
    return (
        f"{words} A mesh twice as fine moves the {name} by {moved:.2g} {UNITS[name]}, {than} ({other:.2g})."
    )


def percent(part: float) -> str:
    """A part as people say it."""
    return f"{100.0 * part:.2g} %"


def in_words(settings: dict[str, Any]) -> str:
    """Settings as `name = value, …`."""
    return ", ".join(f"{name} = {value_in_words(name, value)}" for name, value in settings.items())


def value_in_words(name: str, value: Any) -> str:
    """A value; a time step as a part of a second."""
    if name == "dt":
        part = Fraction(value).limit_denominator(100_000)
        return f"{part} s" if part.numerator == 1 else f"{1e3 * value:.3g} ms"
    return f"{value:.2g}" if isinstance(value, float) else str(value)


def _toml(best: Run, target: float, met: bool) -> str:
    """All settings of a run that are not the default.

    TOML has no two tables of one name, so they replace the scene's, and those that were overridden go along.
    """
    reach = f"for {percent(target)} error" if met else f"nearest to {percent(target)} error"
    head = f"# {reach}: {percent(best.error)} at {best.ms * FRAME:.3g} ms per frame; in place of [settings]\n"
    return head + tomli_w.dumps({"settings": to_builtins(differing(Settings(), best.settings))})


def notes(runs: Sequence[Run], contact: bool, repeats: int, sources: Sequence[Source]) -> list[str]:
    """What a reader must know to read a report right.

    Args:
        runs: That were made.
        contact: Whether the cloth was seen to touch anything.
        repeats: Timed runs that were planned of each.
        sources: Of the error of the chosen run.
    """
    found = [
        "All runs start from the same state and simulate the same cloth; errors are mass-weighted distances "
        "from the reference as part of the cloth's diagonal, the largest up to the horizon.",
        f"On curves named “{SOLVED}” equations are solved so well that all error is the time step's; on "
        "curves named after an integrator alone, Newton iterations are as chosen, and the tolerance goes "
        "with the step squared.",
        "The reference is known to a tenth of the smallest error plotted, or the study would have "
        "been refused.",
        "Not recommended are settings that let cloth deeper into an obstacle than the chosen ones do, or "
        f"whose energy is more wrong than theirs and than {ENERGY:.0f} times the target.",
    ]
    if not any(source.source == "mesh" for source in sources):
        found.append(
            "What the mesh itself is wrong by is not told: cloth with links, with masses given one by one, "
            "or with a quarter of the vertices that can be simulated, is not made twice as fine here."
        )
    stood_in = max((run.stood_in for run in runs), default=0.0)
    if contact and stood_in > 0.0:
        found.append(
            "Cloth touches something here: a step that feels a contact is one of backward Euler whatever the "
            f"integrator (up to {stood_in:.0%} of the steps), so no method is of more than first order from "
            "there on."
        )
    if (fewest := min(len(run.ms_repeats) for run in runs)) < repeats:
        found.append(
            f"Time was up before all repeats: some runs were timed less often, down to {fewest} of {repeats}."
        )
    return found
