"""What the page of `deepfracture play` costs, seen from the other end of its connection, as a browser would.

python benchmarks/play.py --what latency stream memory
"""

from __future__ import annotations

import asyncio
import statistics
import sys
import threading
import time
from pathlib import Path

import numpy as np
from common import start

from deepfracture.learn import embedded_model
from deepfracture.play import Options, page
from deepfracture.types import BadInput

SHAPES = ("pot", "mug", "base", "bunny")
SHOTS = 6
EYE = np.array([3.0, -6.0, 2.2])
"""Where the player stands."""


class Tab:
    """Everything that a browser's tab says and hears, without the browser."""

    def __init__(self, url: str) -> None:
        self.heard: list[tuple[float, dict]] = []
        """Messages but for meshes' arrays, with when they came."""
        self._loop = asyncio.new_event_loop()
        self._open = threading.Event()
        threading.Thread(target=self._loop.run_until_complete, args=(self._listen(url),), daemon=True).start()
        self._open.wait()

    async def _listen(self, url: str) -> None:
        import msgspec
        import viser
        import websockets
        import zstandard

        protocol = [f"viser-v{viser.__version__}"]
        address = url.replace("http", "ws")
        async with websockets.connect(address, subprotocols=protocol, max_size=None, compression=None) as self._socket:
            self._send_now(
                type="ViewerCameraMessage", wxyz=(1, 0, 0, 0), position=tuple(EYE.tolist()), fov=0.6, near=0.1, far=99,
                image_height=600, image_width=800, look_at=(0, 0, 1), up_direction=(0, 0, 1),
            )  # fmt: skip
            self._open.set()
            async for data in self._socket:  # until the page is closed
                packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
                window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
                now = time.perf_counter()
                self.heard += [(now, message) for message in window["messages"]]

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


def stream() -> None:
    """How often the pieces of a body of many are moved while they fly."""
    with page(Options("plate", port=0)) as url:
        tab = Tab(url)
        tab.ready()
        since = len(tab.heard)
        tab.press("Breaker", value="voronoi")
        tab.ready(since)
        goals = np.array([[0.0, 0.0, 0.05], [0.5, 0.3, 0.05], [-0.6, 0.2, 0.05], [0.1, -0.6, 0.05]])
        for goal in goals:
            since = len(tab.heard)
            tab.click(goal)
            time.sleep(6.0)
        began = len(tab.heard)
        tab.press("Replay")
        time.sleep(5.0)
        names = {m["name"] for _, m in tab.heard[began:] if m["type"] == "SetPositionMessage"}
        per = dict.fromkeys(names, 0)
        for _, message in tab.heard[began:]:
            if message["type"] == "SetPositionMessage":
                per[message["name"]] += 1
        say(f"{len(names)} bodies moved; the busiest {max(per.values()) / 5:.0f} times a second, "
            f"{sum(per.values()) / 5:.0f} poses a second in all")  # fmt: skip


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
                tab.heard[:] = [(at, m) for at, m in tab.heard if m["type"].startswith("Gui") and "props" in m]


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def play(what: tuple[str, ...] = ("latency", "stream", "memory")) -> None:
    """Measure the page of `deepfracture play`.

    Args:
        what: any of latency, stream and memory.
    """
    jobs = {"latency": latency, "stream": stream, "memory": memory}
    if unknown := [name for name in what if name not in jobs]:
        raise BadInput(f"what must be any of {', '.join(jobs)}, got {unknown[0]!r}")
    for name in what:
        jobs[name]()


if __name__ == "__main__":
    start(play)
