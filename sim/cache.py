"""Where compiled kernels are kept.

Numba notices that a kernel's own file has changed, but not the file of a helper that it calls. So each
state of the core's sources has a cache folder of its own, in the user's cache directory, which also serves
installations that cannot be written to. Users without one, as in many containers, have a folder among
temporary files. NUMBA_CACHE_DIR, where set, is left alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

KEPT = 3
"""Cache folders of earlier sources that are kept."""


def cache_home() -> Path:
    """The folder that holds one cache folder per state of the sources."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "muslin" / "kernels"


def temporary_home() -> Path:
    """The same among temporary files, for who cannot write to the other.

    Raises:
        OSError: where it is not this user's: what is in a cache is run.
    """
    user = getattr(os, "getuid", int)()
    folder = Path(tempfile.gettempdir()) / f"muslin-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.lstat().st_uid != user:
        raise PermissionError(folder)
    return folder


def choose_cache() -> None:
    """Point Numba at the cache folder of these sources; must run before Numba is imported."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    for home in (cache_home, temporary_home):
        with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: there is no home
            folder = home() / digest.hexdigest()[:16]
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            os.environ["NUMBA_CACHE_DIR"] = str(folder)
            _prune(folder)
            return


def _prune(current: Path) -> None:
    with contextlib.suppress(OSError):  # another process may do the same just now
        current.touch()
        folders = sorted(current.parent.iterdir(), key=lambda f: f.stat().st_mtime, reverse=True)
        for old in [f for f in folders if f != current][KEPT:]:
            shutil.rmtree(old, ignore_errors=True)
