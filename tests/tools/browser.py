"""A headless browser for the tests of pages."""

from __future__ import annotations

import shutil

import pytest

FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PATIENCE = 120_000
"""Milliseconds: a browser without a graphics card draws seconds a picture on a busy machine."""
COARSE = "?fixedDpr=0.5"
"""At the end of a page's address: it draws a quarter of the points, at the same size."""


def start_browser(playwright):
    for name in ("chromium", "chromium-browser", "google-chrome", "chrome"):
        found = shutil.which(name)
        if found:
            return playwright.chromium.launch(executable_path=found, headless=True, args=FLAGS)
    pytest.skip("no Chromium on PATH (Debian: apt-get install chromium)")


def drawn(page, pictures=4):
    """Wait until the page has drawn so many pictures: on a busy machine seconds say nothing of that."""
    page.evaluate(
        "n => new Promise(done => { const f = () => n-- ? requestAnimationFrame(f) : done(); f() })", pictures
    )


def close_notices(page):
    """Take away what the viewer says in front of the scene, such as that there is no graphics card."""
    notices = page.locator(".mantine-Notification-closeButton")
    while notices.count():
        notices.first.click()
        page.wait_for_timeout(300)
