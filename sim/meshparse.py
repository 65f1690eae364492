"""Other people's readers of mesh files, held to a time and a memory.

Trimesh reads many formats well, but promises nothing of what it does with a broken or hostile file. So a
file that is large enough to matter is read in a process of its own, which is ended when it takes too long and
gets no more memory than it may have. It takes about a second to start, which is what importing trimesh takes
anywhere. This file is also the program of that process, and imports nothing of `sim`.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys

import numpy as np

HARMLESS = 100_000
"""Bytes that are read in this process: a hundredth of the most, in a time that may grow as their square."""

SECONDS = 30.0
"""For a process that reads; good files of the most bytes take a few."""

MEMORY = 2**30
"""Bytes of data that it may have, on Linux; it starts with about a tenth, and good files double that."""

Arrays = tuple[np.ndarray, np.ndarray]


def parse(data: bytes, kind: str) -> Arrays:
    """(n, 3) float64 vertices and (m, 3) faces of a mesh, of a `kind` of file that trimesh knows."""
    import trimesh

    # No resolver and no materials: nothing but these bytes is looked at, on disk or elsewhere.
    mesh = trimesh.load_mesh(
        io.BytesIO(data),
        file_type=kind,
        process=False,
        maintain_order=True,
        skip_materials=True,
        fix_texture=False,
        resolver=None,
    )
    return np.array(mesh.vertices, dtype=float), np.array(mesh.faces)


def parse_apart(data: bytes, kind: str) -> Arrays:
    """The same by a process of its own; ValueError where it fails, or takes too much of time or memory."""
    command = [sys.executable, "-P", __file__, kind]
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # whose threads would each set memory aside
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, timeout=SECONDS, env=alone, check=False
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it takes longer than {SECONDS:g} s") from None
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").splitlines()
        raise ValueError(lines[-1] if lines else "its reader broke off")
    arrays = io.BytesIO(done.stdout)
    return np.load(arrays), np.load(arrays)


def main() -> int:
    """Read a mesh from stdin and write its two arrays to stdout, or one line to stderr."""
    try:
        import resource  # which Windows does not have

        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    except (ImportError, ValueError, OSError):
        pass  # where there is no such limit, time is the bound
    out = sys.stdout.buffer
    sys.stdout = sys.stderr  # what a reader prints is none of the answer
    try:
        for array in parse(sys.stdin.buffer.read(), sys.argv[1]):
            np.save(out, array)
    except MemoryError:
        sys.stderr.write(f"it takes more memory than {MEMORY // 2**20} MB\n")
        return 1
    except Exception as error:
        sys.stderr.write((" ".join(str(error).split()) or type(error).__name__) + "\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
