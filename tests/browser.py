"""The browser that tests drive: the system's Chromium."""

import contextlib
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


@contextlib.contextmanager
def launched():
    """The browser, for as long as it is needed."""
    from playwright.sync_api import sync_playwright

    assert CHROMIUM, "MUSLIN_REQUIRE_BROWSER=1, but there is no chromium"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=WITHOUT_GPU)
        yield browser
        browser.close()


def errors_of(page):
    """A list of every error that a page reports from now on."""
    errors = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    return errors


def overflow(path, width):
    """By how much [CSS px] a page of a file is wider than a window, and the tables in it than their boxes."""
    with launched() as browser:
        phone = {"is_mobile": True, "has_touch": True} if width < 500 else {}
        page = browser.new_page(viewport={"width": width, "height": 900}, **phone)
        page.goto(path.as_uri())
        beyond, *tables = page.evaluate(OVERFLOW)
    return beyond, tables
