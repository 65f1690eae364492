"""How long a study may be asked to simulate."""

LONGEST = 3600.0
"""Longer than this [s] is most likely a slip of the keyboard; it would fill the memory with states."""


def check_seconds(seconds: float) -> None:
    """Raise ValueError, in the words of the command line, for a time [s] that no study can take."""
    if not 0.0 < seconds <= LONGEST:
        raise ValueError(f"--seconds: expected > 0 and ≤ {LONGEST:g}, got {seconds:g}")
