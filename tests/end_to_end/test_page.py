"""The page opens from disk in a browser, without network, and plays."""

import io
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.export import write_page

tools = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "recordings.py"))
browser_tools = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "browser.py"))
PATIENCE = browser_tools["PATIENCE"]


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """The playing page, with what it asked for and what it complained about."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright for Python")
    file = tmp_path_factory.mktemp("page") / "page.html"
    write_page(tools["broken_octahedron"](), file)
    with sync_api.sync_playwright() as playwright:
        browser = browser_tools["start_browser"](playwright)
        page = browser.new_page(viewport={"width": 400, "height": 300})
        page.set_default_timeout(PATIENCE)
        asked, errors = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(file.as_uri() + browser_tools["COARSE"])
        page.wait_for_selector("canvas")
        yield page, asked, errors
        browser.close()


def clock(page):
    return page.locator("input").first


def picture_at(page, seconds):
    """The canvas, stopped at a time.

    The clock stops when it is set, but for a turn that was due and comes late: on a busy machine that turn leads
    seconds on. So it is set until it stays."""
    for _ in range(10):
        clock(page).fill(f"{seconds}")
        browser_tools["drawn"](page)
        page.wait_for_timeout(300)
        if clock(page).input_value() == f"{seconds}":
            break
    else:
        pytest.fail(f"the clock does not stay at {seconds} s, but goes to {clock(page).input_value()}")
    browser_tools["close_notices"](page)
    shot = page.screenshot(clip={"x": 0, "y": 0, "width": 400, "height": 250}, timeout=PATIENCE)
    return np.array(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def clay(picture):
    """Pixels that show a body's original or crack surface."""
    return picture[..., 0] - picture[..., 2] > 40


@pytest.mark.browser
def test_the_page_plays_by_itself(opened):
    page, _, _ = opened
    before = clock(page).input_value()
    page.wait_for_function(f"document.querySelector('input').value != '{before}'")


@pytest.mark.browser
def test_fragments_move(opened):
    page, _, _ = opened
    whole, early, late = (picture_at(page, seconds) for seconds in (0.2, 0.7, 1.4))
    columns = [np.flatnonzero(clay(picture).any(axis=0)) for picture in (whole, early, late)]
    assert all(len(found) > 40 for found in columns)
    widths = [int(np.ptp(found)) for found in columns]
    assert widths[0] + 10 < widths[1] < widths[2] - 10  # the halves fly apart
    there = clay(early) | clay(late)
    assert (np.abs(early - late).max(axis=-1) > 30)[there].mean() > 0.3


@pytest.mark.browser
def test_the_page_asks_for_nothing_and_complains_of_nothing(opened):
    _, asked, errors = opened
    assert errors == []
    assert asked and all(url.startswith(("file:", "data:", "blob:")) for url in asked)
