"""What tests do with the page in a real browser, as a hand would."""

from tests.browser import errors_of

PATIENCE = 120_000
"""Milliseconds that a browser without a graphics card may take over anything."""


def visit(page, lab, url=""):
    """Open the lab's page, and note every error that it reports."""
    page.set_default_timeout(PATIENCE)
    page.errors = errors_of(page)
    page.goto(url or lab.url)


def row(page, label):
    """The control with a label: its row in the dock."""
    return page.locator("label", has_text=label).locator(
        "xpath=ancestor::div[contains(@class,'Flex-root')][1]"
    )


def pick(page, label, option):
    row(page, label).locator("input:not([type=hidden])").first.click()
    page.get_by_role("option", name=option, exact=True).click()


def settings(lab, name):
    return [getattr(frame.settings, name) for frame in lab.frames if frame.settings]


def drag_by_keys(page, label, key, times):
    slider = row(page, label).get_by_role("slider")
    slider.focus()
    for _ in range(times):
        page.keyboard.press(key)
