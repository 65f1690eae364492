"""Where compiled kernels are kept."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("before", ["", "import numba; "])
def test_kernels_are_kept_by_the_state_of_the_sources_whoever_imports_numba_first(before, tmp_path):
    """Beside its file a kernel would outlive an edit of the helpers that it calls."""
    clean = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    homes = {"XDG_CACHE_HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path), "HOME": str(tmp_path)}
    asks = f"{before}import sim.contact.broad as broad; print(broad.fit.stats.cache_path)"
    found = subprocess.run(
        [sys.executable, "-c", asks], env=clean | homes, capture_output=True, text=True, check=True
    )
    assert found.stdout.startswith(str(tmp_path))


def test_kernels_are_kept_among_temporary_files_where_there_is_no_other_place(tmp_path):
    """As in a container whose user has no home, and cannot write to what was installed."""
    (tmp_path / "file").touch()
    nowhere = str(tmp_path / "file" / "below")
    clean = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    homes = dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"), nowhere)
    asks = "import sim.contact.broad as broad; print(broad.fit.stats.cache_path)"
    found = subprocess.run(
        [sys.executable, "-c", asks],
        env=clean | homes | {"TMPDIR": str(tmp_path), "TMP": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.startswith(str(tmp_path / "muslin-"))
