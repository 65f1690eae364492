"""The browser that tests drive: the system's Chromium."""

import os
import shutil

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None
)
REQUIRED = os.environ.get("MUSLIN_REQUIRE_BROWSER") == "1"
WITHOUT_GPU = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WITHOUT_BROWSER = pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")
