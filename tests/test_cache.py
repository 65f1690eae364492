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
