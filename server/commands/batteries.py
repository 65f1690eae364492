"""`muslin stress` and `bench`: what Muslin itself stands, and what its steps cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import arg

from server.commands.options import Files, Inline, Texts
from sim.bench import SECONDS, SIZES, STEPS


@dataclass(kw_only=True)
class Stress:
    """Run the battery of hard cases: what each measured, held against its mark."""

    short: bool = False
    """The cases that take minutes, with a few seeds each; this is what happens anyway."""
    full: bool = False
    """All cases with all their seeds, within an hour."""
    case: Annotated[Texts, arg(metavar="NAME ...")] = ()
    """Only these cases, or themes: numerics, contact, sweep; C2 means all whose names begin with C2-."""
    seed: int = 0
    """Of the first run of each case; those of the others follow."""
    runs: int | None = None
    """Runs of each case; a case knows how many it needs if left out."""
    jobs: int | None = None
    """Processes, one thread each; as many as there are cores if left out."""
    keep: Annotated[str | None, arg(metavar="FOLDER")] = None
    """Keep scene, settings and state of what fails."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Run on the workers of a Dask scheduler, such as tcp://10.0.0.1:8786 (the extra `cluster`)."""
    files: Inline[Files] = field(default_factory=Files)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.stress import run_stress

        if self.short and self.full:
            raise ValueError("--short: expected only one of --short and --full, got both")
        how = self.full, self.seed, self.runs, self.jobs
        return run_stress(self.case, *how, self.files.json, self.files.html, self.keep, self.cluster)


@dataclass(kw_only=True)
class Bench:
    """Measure what a step costs and how exact it is, and what other simulators of cloth need for the same."""

    sizes: Annotated[tuple[int, ...], arg(metavar="VERTICES ...")] = SIZES
    """Vertices of the square sheets; square numbers."""
    threads: Annotated[tuple[int, ...], arg(metavar="THREADS ...")] = ()
    """Processor threads; 1, and 2 where there are as many cores, if none is given."""
    steps: int = STEPS
    """Steps of Muslin for each sheet."""
    seconds: float = SECONDS
    """Time for each case of a peer [s]; accuracies and Muslin's own steps get more."""
    peers: bool = False
    """Measure other simulators, too: those of the extra `peers` that are installed."""
    contact: bool = False
    """In place of all that, drape the sheets with each response and each detection."""
    scenes: Annotated[Texts, arg(metavar="SCENE ...")] = ()
    """In place of sheets, step these scenes with effects forced on, as they are, and as their audit would."""
    cold: bool = False
    """Of scenes, measure the cold start, too, each with all kernels compiled anew."""
    markdown: Annotated[str | None, arg(metavar="FILE.md")] = None
    """Write the tables as Markdown, with hardware, versions, date and command."""
    files: Inline[Files] = field(default_factory=Files)

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.benchmark import run_bench, run_contact, run_scenes

        files = {"json": self.files.json, "html": self.files.html, "markdown": self.markdown}
        if sum(map(bool, (self.contact, self.scenes, self.peers))) > 1:
            raise ValueError("--contact, --scenes, --peers: expected one of them, got several")
        if self.scenes:
            return run_scenes(self.scenes, self.steps, self.cold, **files)
        if self.contact:
            return run_contact(self.sizes, self.threads or None, self.steps, **files)
        return run_bench(self.sizes, self.threads or None, self.steps, self.seconds, self.peers, **files)
