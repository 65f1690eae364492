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

OVERFLOW = """() => [document.documentElement, ...document.querySelectorAll(".scroll")]
    .map(box => box.scrollWidth - box.clientWidth)"""


def overflow(path, width):
    """By how much [CSS px] a page of a file is wider than a window, and the tables in it than their boxes."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=WITHOUT_GPU)
        phone = {"is_mobile": True, "has_touch": True} if width < 500 else {}
        page = browser.new_page(viewport={"width": width, "height": 900}, **phone)
        page.goto(path.as_uri())
        beyond, *tables = page.evaluate(OVERFLOW)
        browser.close()
    return beyond, tables
