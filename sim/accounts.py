"""What kinds of energy and entries of the ledger there are, by name, and what each one means in words.

Needs no numba: pages and tables have these words before anything is simulated.
"""

from __future__ import annotations

from sim.springs import BENDING, STRETCH

ENERGIES = {
    "kinetic": "Of motion.",
    "gravity": "Of height; zero at the origin.",
}
"""Kinds of energy that are not stored in springs."""

DISSIPATED = {
    "damping": "Taken by the damping of the springs, which γ sets.",
    "friction": "Taken by friction.",
    "contact": "Taken by impacts.",
    "strain limiting": "Taken where edges were kept from being too long.",
    "linearisation": "Taken, or put in, as steps take forces for linear; more Newton iterations lessen it.",
    "integrator": "Taken, or put in, by the time step itself; shorter steps lessen it.",
    "sleep": "Of motion, when cloth fell asleep.",
}

INJECTED = {
    "settings": "Put in by changes of settings.",
    "wind": "Work of the air.",
    "obstacles": "Put in by obstacles that move.",
    "switched springs": "Put in as springs began or ceased to act.",
    "wrong springs": "Put in by springs that are wrong on purpose.",
}


def meaning(energy: str) -> str:
    """What a kind of energy is; KeyError for one that is neither of ENERGIES nor of a kind of spring."""
    if energy in ENERGIES:
        return ENERGIES[energy]
    return f"Stored in {energy} springs: {(STRETCH | BENDING)[energy].summary}."
