"""The page on which one shoots at things, in a real browser with real clicks."""

import io
import re
import runpy
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.cli.main import main
from deepfracture.play import Options, page, server
from deepfracture.play.player import Player

tools = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "browser.py"))
VIEW = {"width": 1000, "height": 640}
SCENE = (640, 640)
"""Width and height of what the panel does not cover."""
MIDDLE, SKY = (500, 330), (60, 60)
CUBE = """v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"""
READY = "Click the object"


PLAYERS = []
"""Of all tabs, in the order in which they came."""


def known(*given, **named):
    PLAYERS.append(Player(*given, **named))
    return PLAYERS[-1]


@pytest.fixture(scope="module")
def served():
    """A browser, and the address of a page that begins with the pot."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright for Python")
    with (
        pytest.MonkeyPatch.context() as patch,
        page(Options("pot", port=0, upload_limit=1_000_000)) as url,
        sync_api.sync_playwright() as playwright,
    ):
        patch.setattr(server, "Player", known)
        browser = tools["start_browser"](playwright)
        yield browser, url
        browser.close()


@pytest.fixture(scope="module")
def tab(served):
    browser, url = served
    return open_tab(browser, url)


def open_tab(browser, url):
    opened = browser.new_context(viewport=VIEW, accept_downloads=True).new_page()
    opened.set_default_timeout(tools["PATIENCE"])
    opened.goto(f"{url}/{tools['COARSE']}")
    opened.wait_for_selector("canvas", state="attached")  # viser has a hidden one too
    opened.get_by_text(READY).wait_for()
    opened.get_by_text("Nothing hit yet").wait_for()
    opened.wait_for_timeout(1500)
    tools["close_notices"](opened)
    return opened


def said(tab):
    """What the page says of the last shot."""
    return "\n".join(tab.locator(".df").all_inner_texts())


def number(tab, name):
    return float(re.search(rf"{re.escape(name)}\s+([\d,.]+)", said(tab)).group(1).replace(",", ""))


def picture(tab):
    shot = tab.screenshot(clip={"x": 0, "y": 0, "width": SCENE[0], "height": SCENE[1]}, timeout=tools["PATIENCE"])
    return np.array(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def clay(image):
    """Pixels that show an original surface."""
    return (image[..., 0] - image[..., 2] > 60) & (image[..., 0] > 60)


def until_rest(tab):
    """Until the last shot has done what it does: the world itself says so, pictures take long to tell."""
    tab.wait_for_function("() => !document.body.innerText.includes('The ball is on its way')")
    for _ in range(1200):
        if not PLAYERS[0]._moves:
            tab.wait_for_timeout(500)  # for the last picture
            return
        tab.wait_for_timeout(100)
    raise AssertionError("the world never came to rest")


def saved(tab, button, folder):
    """The file that a button hands to the browser."""
    with tab.expect_download() as waiting:
        tab.get_by_role("button", name=button, exact=True).click()
    file = folder / waiting.value.suggested_filename
    waiting.value.save_as(file)
    return file


@pytest.mark.browser
def test_a_miss_says_so_and_breaks_nothing(tab):
    whole = clay(picture(tab)).sum()
    assert whole > 5000
    tab.mouse.click(*SKY)
    tab.get_by_text("Missed.").wait_for()
    assert clay(picture(tab)).sum() > 0.9 * whole


@pytest.mark.browser
def test_a_hit_shatters_it_and_tells_what_happened(tab):
    before = picture(tab)
    tab.mouse.click(*MIDDLE)
    tab.get_by_text("click to first moving fragment").wait_for()
    assert re.search(r"(\d+) fragments", said(tab))
    assert number(tab, "σ₁ / σ₀") > 1 and number(tab, "impulse I") > 100
    assert {"predict", "segment", "cut"} <= set(re.findall(r"– (\w+)", said(tab)))
    until_rest(tab)
    assert np.abs(picture(tab) - before).max(axis=-1).mean() > 5


@pytest.mark.browser
def test_a_piece_can_be_shot_again(tab, monkeypatch):
    panel, sent = PLAYERS[0]._panel, []
    readout = panel.readout
    monkeypatch.setattr(panel, "readout", lambda *a, **k: (readout(*a, **k), sent.append(panel._result.content)))
    first, pieces = said(tab), number(tab, "pieces in the world")
    rows, columns = np.nonzero(clay(picture(tab)))
    near = int(np.argmin((columns - np.median(columns)) ** 2 + (rows - np.median(rows)) ** 2))
    tab.mouse.click(int(columns[near]), int(rows[near]))
    # "The ball is on its way" is sent to the page, but may be gone before a slow browser has drawn it.
    tab.wait_for_function(
        "said => [...document.querySelectorAll('.df')].map(text => text.innerText).join('\\n') !== said", arg=first
    )
    assert "The ball is on its way" in sent[0]
    until_rest(tab)
    assert re.search(r"impulse I", said(tab)) and said(tab) != first
    assert number(tab, "pieces in the world") >= pieces


@pytest.mark.browser
def test_what_is_saved_replays_on_the_command_line(tab, tmp_path):
    files = {button: saved(tab, button, tmp_path) for button in ("Scene", "GLB")}
    assert [file.name for file in files.values()] == ["scene.toml", "deepfracture.glb"]
    main(["shatter", "--scene", str(files["Scene"]), "--out", str(tmp_path / "out"), "--no-film"])
    # every mesh, every pose of every frame
    assert (tmp_path / "out" / "animation.glb").read_bytes() == files["GLB"].read_bytes()


@pytest.mark.browser
def test_the_usd_that_is_saved_has_every_piece_and_moves(tab, tmp_path):
    usd = pytest.importorskip("pxr.Usd", reason="needs the usd extra")
    geometry = pytest.importorskip("pxr.UsdGeom")
    file = saved(tab, "USD", tmp_path)
    assert file.name == "deepfracture.usdc"
    stage = usd.Stage.Open(str(file))
    meshes = [prim for prim in stage.Traverse() if prim.IsA(geometry.Mesh) and "fragment" in str(prim.GetPath())]
    assert len(meshes) >= number(tab, "pieces in the world") > 2
    assert stage.GetEndTimeCode() > stage.GetStartTimeCode()
    cache = geometry.XformCache()
    moved = []
    for mesh in meshes:
        places = []
        for time in (stage.GetStartTimeCode(), stage.GetEndTimeCode()):
            cache.SetTime(time)
            places.append(np.array(cache.GetLocalToWorldTransform(mesh.GetPrim())))
        moved.append(np.abs(places[0] - places[1]).max())
    assert max(moved) > 0.1


@pytest.mark.browser
def test_looking_back_shows_it_whole_and_reset_makes_it_so(tab):
    tab.get_by_role("button", name="Reset", exact=True).click()
    tab.get_by_text("Nothing hit yet").wait_for()
    tab.wait_for_timeout(1000)
    assert clay(picture(tab)).sum() > 5000


@pytest.mark.browser
def test_the_film_that_is_saved_is_one(tab, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the render extra")
    file = saved(tab, "Film", tmp_path)  # of a world that has just begun anew: a short one
    frames, seconds = ffmpeg.count_frames_and_secs(str(file))
    assert file.name == "deepfracture.mp4" and frames > 10 and seconds > 0.2
    reader = ffmpeg.read_frames(str(file))
    width, height = next(reader)["size"]
    first = np.frombuffer(next(reader), np.uint8).reshape(height, width, 3).astype(int)
    assert clay(first).sum() > 1000  # the pot stands in it
    reader.close()


@pytest.mark.browser
def test_two_tabs_are_two_worlds(served, tab):
    other = open_tab(*served)
    before = picture(tab)
    other.mouse.click(*MIDDLE)
    other.get_by_text("click to first moving fragment").wait_for()
    assert "Nothing hit yet" in said(tab)
    assert np.abs(picture(tab) - before).mean() < 1
    other.context.close()


@pytest.mark.browser
def test_broken_and_large_uploads_are_refused_in_one_line(tab):
    mesh = tab.locator("input[type=file]")
    mesh.set_input_files({"name": "junk.obj", "mimeType": "model/obj", "buffer": b"this is not a mesh"})
    tab.get_by_text(re.compile(r"^junk\.obj: .*")).first.wait_for()
    mesh.set_input_files({"name": "large.obj", "mimeType": "model/obj", "buffer": CUBE.encode() * 8000})
    tab.get_by_text(re.compile(r"^large\.obj: 1 MB; at most 1 MB can be uploaded")).wait_for()
    assert "Nothing hit yet" in said(tab) and clay(picture(tab)).sum() > 5000  # the pot still stands
    tools["close_notices"](tab)


@pytest.mark.browser
def test_a_mesh_dropped_onto_the_page_is_mended_and_broken(tab):
    open_cube = CUBE.replace("f 5 6 7 8\n", "")
    files = tab.evaluate_handle(
        "text => { const held = new DataTransfer(); held.items.add(new File([text], 'my cube.obj')); return held }",
        open_cube,
    )
    tab.dispatch_event("canvas", "drop", {"dataTransfer": files})
    tab.get_by_text(re.compile(r"my cube\.obj: repaired .*1 hole capped")).wait_for()
    assert "There is no trained model of my cube.obj" in said(tab) and "deepfracture train" in said(tab)
    tools["close_notices"](tab)
    tab.wait_for_timeout(1000)
    tab.mouse.click(*MIDDLE)
    tab.get_by_text("click to first moving fragment").wait_for()
    assert "stress" in said(tab) and number(tab, "pieces in the world") >= 2


@pytest.mark.browser
def test_nothing_of_the_machine_is_reachable_and_strangers_are_turned_away(served, tab):
    browser, url = served
    for path in ("/../../../../etc/passwd", "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd", "/etc/passwd"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(url + path, timeout=20)
    elsewhere = browser.new_context().new_page()
    elsewhere.route("http://elsewhere.test/", lambda route: route.fulfill(body="<p>hello", content_type="text/html"))
    elsewhere.goto("http://elsewhere.test/")
    import viser
    import viser._messages as messages

    assert messages.ShareUrlRequest  # what would open a tunnel; see the unit test of play.security
    closed = elsewhere.evaluate(
        """([address, protocol]) => new Promise(done => {
            const socket = new WebSocket(address, [protocol]);
            socket.onclose = event => done(event.code);
            setTimeout(() => done('still open'), 15000);
            socket.onopen = () => {};
        })""",
        [url.replace("http", "ws"), f"viser-v{viser.__version__}"],
    )
    assert closed != 1000
    elsewhere.context.close()
