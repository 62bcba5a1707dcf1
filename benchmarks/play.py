"""Tables of docs/guide/play.md: cost of the page of `deepfracture play`, measured by a client in place of a browser.

python benchmarks/play.py --what latency stream page load crowd memory
"""

from __future__ import annotations

import asyncio
import logging
import os
import statistics
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from harness import ROOT, start

from deepfracture.learn import embedded_model
from deepfracture.play import Options, page
from deepfracture.types import BadInput

SHAPES = ("pot", "mug", "base", "bunny")
SHOTS = 6
EYE = np.array([3.0, -6.0, 2.2])
"""Where the player stands."""
CELLS = 140
"""Into which a stroke breaks the pot whose pieces are counted."""
CLIENTS = 20
ROUNDS = 3
"""Clicks of each client under load."""
CROWDS, LEAVING = 15, 5
"""Rounds of clients that come and go, and how many go after each."""
SECONDS = 5.0
"""For which a stream is watched."""


def hear(data: bytes | str, heard: list[tuple[float, dict]]) -> None:
    """Add the messages of a frame on the wire, with the time."""
    import msgspec
    import zstandard

    if isinstance(data, bytes):
        packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
        window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
        now = time.perf_counter()
        heard += [(now, message) for message in window["messages"]]


class Tab:
    """Everything that a browser's tab says and hears, without the browser."""

    def __init__(self, url: str, *, deaf: bool = False) -> None:
        """`deaf`: it speaks, but never takes in what the server says."""
        self._deaf = deaf
        self.heard: list[tuple[float, dict]] = []
        """Messages but for meshes' arrays, with when they came."""
        self._loop = asyncio.new_event_loop()
        self._open = threading.Event()
        threading.Thread(target=self._loop.run_until_complete, args=(self._listen(url),), daemon=True).start()
        self._open.wait()

    async def _listen(self, url: str) -> None:
        import viser
        import websockets

        protocol = [f"viser-v{viser.__version__}"]
        address = url.replace("http", "ws")
        async with websockets.connect(address, subprotocols=protocol, max_size=None, compression=None) as self._socket:
            self._send_now(
                type="ViewerCameraMessage", wxyz=(1, 0, 0, 0), position=tuple(EYE.tolist()), fov=0.6, near=0.1, far=99,
                image_height=600, image_width=800, look_at=(0, 0, 1), up_direction=(0, 0, 1),
            )  # fmt: skip
            self._open.set()
            if self._deaf:
                self._socket.transport.pause_reading()
                await asyncio.Event().wait()
            async for data in self._socket:  # until the page is closed
                hear(data, self.heard)

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._socket.close(), self._loop)

    def _send_now(self, **message: object) -> None:
        import msgspec

        asyncio.run_coroutine_threadsafe(self._socket.send(msgspec.msgpack.encode(message)), self._loop)

    def click(self, goal: np.ndarray) -> float:
        """Click on a point of the world; when."""
        way = goal - EYE
        self._send_now(
            type="ScenePointerMessage", event_type="click", ray_origin=tuple(EYE.tolist()),
            ray_direction=tuple((way / np.linalg.norm(way)).tolist()), screen_pos=((0.5, 0.5),), modifier=None,
        )  # fmt: skip
        return time.perf_counter()

    def press(self, label: str, **value: object) -> None:
        """Press a button of a group, or set a control."""
        for _, message in self.heard:
            props = message.get("props", {})
            if label in (props.get("options") or ()) and message["type"] == "GuiButtonGroupMessage":
                self._send_now(type="GuiUpdateMessage", uuid=message["uuid"], updates={"value": label})
                return
            if props.get("label") == label:
                self._send_now(type="GuiUpdateMessage", uuid=message["uuid"], updates=value)
                return
        raise LookupError(label)

    def forget(self) -> None:
        """What was heard, but the controls."""
        self.heard[:] = [(at, m) for at, m in self.heard if m["type"].startswith("Gui") and "props" in m]

    def wait(self, since: int, found, patience: float = 120.0) -> float:
        """When the first message after the first `since` came for which `found(message)` is true."""
        end = time.perf_counter() + patience
        while time.perf_counter() < end:
            for at, message in self.heard[since:]:
                if found(message):
                    return at
            time.sleep(0.002)
        raise TimeoutError

    def ready(self, since: int = 0) -> None:
        """Until the world stands that was asked for."""
        self.wait(since, lambda m: "Click the object" in str(m.get("updates", "")))
        time.sleep(0.5)


def moved_fragment(message: dict) -> bool:
    return message["type"] == "SetPositionMessage" and message["name"].endswith("_fragment")


def latency() -> None:
    """Click to first moving fragment, with the shipped models."""
    for shape in SHAPES:
        assert embedded_model(shape) is not None
        with page(Options(shape, port=0)) as url:
            tab = Tab(url)
            tab.ready()
            taken, cpu = [], []
            for k in range(SHOTS):
                since, spent = len(tab.heard), time.process_time()
                at = tab.click(np.array([0.0, 0.0, 0.7 + 0.05 * k]))
                taken.append(1e3 * (tab.wait(since, moved_fragment) - at))
                cpu.append(1e3 * (time.process_time() - spent))
                since = len(tab.heard)
                tab.press("Reset")
                tab.ready(since)
        say(f"{shape}: click to first moving fragment {min(taken):.0f} ms at best, {statistics.median(taken):.0f} in "
            f"the median of {SHOTS}; processor time {min(cpu):.0f}, {statistics.median(cpu):.0f} ms")  # fmt: skip


@contextmanager
def served(options: Options, cells: int | None = None) -> Iterator[tuple[str, int]]:
    """Address and process of a page. In a process of its own: what listens shall not hold up what speaks.

    With `cells` a first click may break into so many, and there is no weight, so that none ever comes to rest."""
    ours, theirs = get_context("spawn").Pipe()
    child = get_context("spawn").Process(target=_serve, args=(theirs, options, cells), daemon=True)
    child.start()
    assert child.pid is not None
    try:
        yield ours.recv(), child.pid
    finally:
        ours.send("enough")
        child.join(30)


def _serve(pipe: Connection, options: Options, cells: int | None) -> None:
    from deepfracture.breakers import voronoi
    from deepfracture.play import panel

    if cells is not None:
        voronoi.MOST_CELLS, panel.GRAVITY = cells, 0.0
    logging.disable()  # of what strangers send, a line each
    with page(options) as url:
        pipe.send(url)
        pipe.recv()


def processor_seconds(process: int) -> float:
    """Time of the processor that a process has had."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def stream() -> None:
    """How often each of more than a hundred pieces is moved, as they fly and in the replay."""
    with served(Options("pot", port=0), CELLS) as (url, process):
        tab = Tab(url)
        tab.ready()
        since = len(tab.heard)
        tab.press("Breaker", value="voronoi")
        tab.ready(since)
        tab.click(np.array([0.0, 0.0, 1.0]))
        time.sleep(2.0)
        watch("bare connection", process, tab.heard, lambda: tab.press("Replay"), time.sleep)


def watch(
    name: str, process: int, heard: list[tuple[float, dict]], replay: Callable[[], None], sleep: Callable[[float], None]
) -> None:
    """Say how often bodies are moved while the world runs, and then in the replay."""
    for what in ("live", "replay"):
        if what == "replay":
            replay()
            sleep(1.0)
        began, since, spent = len(heard), time.perf_counter(), processor_seconds(process)
        sleep(SECONDS)
        share = (processor_seconds(process) - spent) / (time.perf_counter() - since)
        say(f"{name}, {what}: {rates(heard[began:])}; the server took {share:.0%} of one core")


def web_page() -> None:
    """The same in a real browser on this machine, whose software renderer wants both cores."""
    from playwright.sync_api import sync_playwright

    sys.path.insert(0, str(ROOT / "tests" / "tools"))
    from browser import close_notices, start_browser

    heard: list[tuple[float, dict]] = []
    with served(Options("pot", port=0), CELLS) as (url, process), sync_playwright() as playwright:
        browser = start_browser(playwright)
        tab = browser.new_context(viewport={"width": 1000, "height": 640}).new_page()
        tab.set_default_timeout(120_000)
        tab.on("websocket", lambda socket: socket.on("framereceived", lambda data: hear(data, heard)))
        tab.goto(url)
        tab.wait_for_selector("canvas", state="attached")
        tab.get_by_text("Nothing hit yet").wait_for()
        tab.wait_for_timeout(2000)
        close_notices(tab)
        tab.get_by_label("Breaker").first.click()
        tab.get_by_role("option", name="voronoi").click()
        tab.wait_for_timeout(5000)
        tab.mouse.click(500, 330)
        tab.get_by_text("click to first moving fragment").wait_for()
        tab.wait_for_timeout(2000)
        tab.evaluate("() => { window.drawn = 0; const f = () => { window.drawn++; requestAnimationFrame(f) }; f() }")
        since = time.perf_counter()
        replay = tab.get_by_role("button", name="Replay", exact=True)
        watch("page in Chromium", process, heard, replay.click, lambda seconds: tab.wait_for_timeout(1000 * seconds))
        drawn = tab.evaluate("() => window.drawn") / (time.perf_counter() - since)
        say(f"page in Chromium: {drawn:.0f} pictures a second by its software renderer")
        browser.close()


def rates(heard: Sequence[tuple[float, dict]]) -> str:
    """How many bodies were moved how often."""
    times: dict[str, list[float]] = {}
    for at, message in heard:
        if message["type"] == "SetPositionMessage":
            times.setdefault(message["name"], []).append(at)
    each = sorted((len(t) - 1) / (t[-1] - t[0]) for t in times.values() if len(t) > 2 and t[-1] - t[0] > SECONDS / 2)
    if not each:
        return f"{len(times)} bodies moved, none of them for long"
    return (f"{len(each)} bodies moving all the time, each {statistics.median(each):.1f} times a second in the median "
            f"({each[0]:.1f} to {each[-1]:.1f})")  # fmt: skip


def load() -> None:
    """Twenty clients that click at once, again and again; then rubbish, and one who does not read."""
    with served(Options("pot", port=0, most_tabs=CLIENTS + 4)) as (url, process):
        began = resident_mb(process)
        tabs = [Tab(url) for _ in range(CLIENTS)]
        for tab in tabs:
            tab.ready()
        say(f"{CLIENTS} tabs: {began:.0f} MB before, {resident_mb(process):.0f} MB with all of them ready")
        for turn in range(ROUNDS):
            say(f"all click at once, round {turn + 1}: {_spread(_round(tabs))}")
        say(f"{resident_mb(process):.0f} MB after {CLIENTS * ROUNDS} breaks")
        alone = tabs[0]
        for tab in tabs[1:]:
            tab.close()
        time.sleep(3.0)
        say(f"{resident_mb(process):.0f} MB when all but one have gone; that one: {_spread(_round([alone]))}")
        for name, rubbish in RUBBISH.items():
            said = offend(url, rubbish)
            say(f"{name}: {said}; another tab: {_spread(_round([alone]))}")
        before = resident_mb(process)
        deaf = Tab(url, deaf=True)
        time.sleep(2.0)
        for _ in range(5):
            deaf.click(np.array([0.0, 0.0, 1.0]))
            time.sleep(1.0)
        time.sleep(10.0)
        grown = resident_mb(process) - before
        say(f"a tab that clicks but does not read for 17 s: {grown:+.0f} MB; another tab: {_spread(_round([alone]))}")


def crowd() -> None:
    """Twenty clients that come and go, three hundred breaks: memory after every twenty."""
    with served(Options("pot", port=0, most_tabs=2 * CLIENTS)) as (url, process):
        began = resident_mb(process)
        tabs = [Tab(url) for _ in range(CLIENTS)]
        for tab in tabs:
            tab.ready()
        held = [began, resident_mb(process)]
        for _ in range(CROWDS):
            _round(tabs)
            for tab in tabs[:LEAVING]:
                tab.close()
            tabs = tabs[LEAVING:] + [Tab(url) for _ in range(LEAVING)]
            for tab in tabs[-LEAVING:]:
                tab.ready()
            for tab in tabs:
                tab.forget()
            held.append(resident_mb(process))
            say(f"{CLIENTS * (len(held) - 2)} breaks: {held[-1]:.0f} MB")
        for tab in tabs:
            tab.close()
        time.sleep(5.0)
        say(f"before, with {CLIENTS} tabs, after every {CLIENTS} breaks: {' '.join(f'{one:.0f}' for one in held)} MB; "
            f"{resident_mb(process):.0f} MB when all have gone")  # fmt: skip


def _round(tabs: Sequence[Tab]) -> list[float]:
    """Every tab clicks; milliseconds until each sees a fragment move. Then all begin anew."""
    since = [len(tab.heard) for tab in tabs]
    at = [tab.click(np.array([0.0, 0.0, 0.9])) for tab in tabs]
    taken = [1e3 * (tab.wait(n, moved_fragment) - t) for tab, n, t in zip(tabs, since, at, strict=True)]
    since = [len(tab.heard) for tab in tabs]
    for tab in tabs:
        tab.press("Reset")
    for tab, n in zip(tabs, since, strict=True):
        tab.ready(n)
    return taken


def _spread(taken: Sequence[float]) -> str:
    if len(taken) == 1:
        return f"{taken[0]:.0f} ms from click to moving fragment"
    first, last = min(taken), max(taken)
    return f"{first:.0f} / {statistics.median(taken):.0f} / {last:.0f} ms, first / median / last to see it break"


def offend(url: str, rubbish: bytes | str) -> str:
    """Send something that no page sends; what came of the connection."""
    import viser
    import websockets

    async def send() -> str:
        async with websockets.connect(
            url.replace("http", "ws"), subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None, compression=None,
        ) as socket:  # fmt: skip
            await socket.send(rubbish)
            end = time.perf_counter() + 2.0
            try:
                while time.perf_counter() < end:
                    await asyncio.wait_for(socket.recv(), 2.0)
            except websockets.ConnectionClosed as closed:
                return f"connection closed ({closed.rcvd.code if closed.rcvd else 'cut'})"
            except TimeoutError:
                pass
            return "ignored"

    return asyncio.run(send())


def _message(**fields: object) -> bytes:
    import msgspec

    return msgspec.msgpack.encode(fields)


def _ray(origin: object, direction: object) -> bytes:
    return _message(
        type="ScenePointerMessage", event_type="click", ray_origin=origin, ray_direction=direction,
        screen_pos=((0.5, 0.5),), modifier=None,
    )  # fmt: skip


RUBBISH: dict[str, bytes | str] = {
    "text": "hello",
    "random bytes": bytes(range(256)) * 40,
    "nothing": b"",
    "a number": b"\x07",
    "no type": _message(position=(1, 2, 3)),
    "an unknown type": _message(type="NoSuchMessage"),
    "a message of the server's": _message(type="RemoveSceneNodeMessage", name="/world1"),
    "fields that are missing": _message(type="ScenePointerMessage"),
    "NaN": _ray((float("nan"),) * 3, (0.0, 1.0, 0.0)),
    "huge numbers": _ray((1e308,) * 3, (1e308,) * 3),
    "no direction": _ray((3.0, -6.0, 2.0), (0.0, 0.0, 0.0)),
    "words for numbers": _ray("here", {"there": 1}),
    "an endless list": _ray(tuple(range(100_000)), (0.0, 1.0, 0.0)),
    "three megabytes": b"\x00" * 3_000_000,
    "nesting": b"\x91" * 100_000,
}
"""What no page sends."""


def memory(shots: int = 100) -> None:
    """Resident memory after many shots, with a reset after every fifth."""
    with page(Options("pot", port=0)) as url:
        tab = Tab(url)
        tab.ready()
        for k in range(shots + 1):
            if k % 20 == 0:
                say(f"{k} shots: {resident_mb():.0f} MB")
            since = len(tab.heard)
            tab.click(np.array([0.1 * (k % 3) - 0.1, 0.0, 0.3 + 0.15 * (k % 5)]))
            tab.wait(since, lambda m: m["type"] == "SetPositionMessage")
            time.sleep(1.0)
            if k % 5 == 4:
                since = len(tab.heard)
                tab.press("Reset")
                tab.ready(since)
                tab.forget()


def resident_mb(process: int | str = "self") -> float:
    """Memory of a process now."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def play(what: tuple[str, ...] = ("latency", "stream", "page", "load", "crowd", "memory")) -> None:
    """Measure the page of `deepfracture play`.

    Args:
        what: any of latency, stream, page, load, crowd and memory.
    """
    jobs = {"latency": latency, "stream": stream, "page": web_page, "load": load, "crowd": crowd, "memory": memory}
    if unknown := [name for name in what if name not in jobs]:
        raise BadInput(f"what must be any of {', '.join(jobs)}, got {unknown[0]!r}")
    for name in what:
        jobs[name]()


if __name__ == "__main__":
    start(play)
