"""What commands say in plain lines."""

import sys


def complain(problem: object) -> None:
    """Say in one line what is wrong."""
    text = " ".join(str(problem).split())
    sys.stderr.write(f"muslin: {text}\n")


def say(text: str) -> None:
    """Print a line."""
    sys.stdout.write(text + "\n")
