"""A bending kind from outside the package, for studies that must find it by themselves."""

from pathlib import Path

import pytest

from sim.springs import BENDING, SpringKind


@pytest.fixture
def outside_kind(monkeypatch):
    """Registers the kind of tests/half_sine.py, and gives its name."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent))
    kind = SpringKind("half_sine", "half the sine", "hinges", (0, 1, 2, 3), "bending", memory=1)
    monkeypatch.setitem(BENDING, "half sine", kind)
    return "half sine"
