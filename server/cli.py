"""The `muslin` command: the lab in a browser, and headless runs and checks of scenes.

Heavy packages (numba, trimesh, viser) are imported by the commands that need them, so that help, checks and
lists answer at once. What goes wrong is one line on standard error and a non-zero exit code.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys

import tyro
from tyro.conf import FlagCreatePairsOff

import sim
from server.commands.batteries import Bench, Stress
from server.commands.lab import Lab
from server.commands.scenes import Check, Run, Scenes
from server.commands.speech import complain, say
from server.commands.studies import Audit, Compare, Cost, Study

COMMANDS = {
    "lab": Lab,
    "run": Run,
    "check": Check,
    "scenes": Scenes,
    "cost": Cost,
    "compare": Compare,
    "audit": Audit,
    "stress": Stress,
    "study": Study,
    "bench": Bench,
}

DESCRIPTION = """Try cloth simulation methods side by side.

`muslin` opens the lab in a browser, and takes the options of `muslin lab`."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit code: 0, 1 for what went wrong, 2 for a wrong call."""
    arguments = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):  # γ and ≥ must not end the command on a terminal without them
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if arguments[:1] == ["--version"]:
        say(f"muslin {sim.__version__}")
        return 0
    try:
        return _parse(arguments)()
    except (ValueError, OSError) as error:
        complain(error)
        return 1
    except KeyboardInterrupt:
        complain("ended by Ctrl-C")
        return 130


def _parse(arguments: list[str]):
    """The command that the arguments mean; SystemExit after help, or after one line on what is wrong."""
    first = arguments[0] if arguments else "lab"
    if first not in COMMANDS and first not in ("-h", "--help"):
        if not first.startswith("-"):
            complain(f"{first}: no such command; expected one of {', '.join(COMMANDS)}")
            raise SystemExit(2)
        first = "lab"
        arguments = ["lab", *arguments]
    arguments = arguments or ["lab"]
    problem = io.StringIO()
    try:
        with contextlib.redirect_stderr(problem):
            return tyro.cli(
                Lab | Run | Check | Scenes | Cost | Compare | Audit | Stress | Study | Bench,
                prog="muslin",
                description=DESCRIPTION,
                args=arguments,
                config=(FlagCreatePairsOff,),
            )
    except SystemExit as ending:
        if ending.code:
            complain(f"{first}: {_first_line(problem.getvalue())}; see muslin {first} --help")
        raise


def _first_line(box: str) -> str:
    """The message in a box that tyro drew: what stands between the title and the first rule after it."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", box)
    message: list[str] = []
    for line in text.splitlines()[1:]:
        words = line.strip("│| ")
        if not set(words) <= set("─-╭╮╰╯+"):
            message.append(words)
        elif message:
            break
    return " ".join(message) or "wrong call"
