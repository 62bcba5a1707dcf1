"""The page under load: rubbish, a client that does not read, many who click at once."""

from __future__ import annotations

import ctypes
import gc
import importlib
import sys
import threading
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

from deepfracture.play import Options, breaker_cache, page
from deepfracture.play import server as served
from deepfracture.play.breaker_cache import BreakerCache, FifoSemaphore
from deepfracture.play.player import MESSAGE_WINDOW, Player
from deepfracture.play.security import clamped_number, is_valid_ray

GOAL = np.array([0.0, 0.0, 0.2])


@pytest.fixture(scope="module")
def client():
    """The benchmark's connection, which is a browser's tab without the browser."""
    pytest.importorskip("viser")
    pytest.importorskip("zstandard")
    sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
    try:
        yield importlib.import_module("play")
    finally:
        sys.path.pop(0)


@pytest.fixture(scope="module")
def players():
    """Weak references to all players that there were."""
    found = []

    class Known(Player):
        def __init__(self, *given, **named):
            super().__init__(*given, **named)
            found.append(weakref.ref(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(served, "Player", Known)
        yield found


@pytest.fixture(scope="module")
def url(client, players):
    with page(Options("bar", port=0, most_tabs=6)) as address:
        yield address


@pytest.fixture(scope="module")
def tab(client, url):
    tab = client.Tab(url)
    tab.ready()
    since = len(tab.heard)
    tab.press("Breaker", value="voronoi")
    tab.ready(since)
    return tab


def breaks(client, tab):
    """Whether a click still leads to fragments that move; then all begins anew."""
    since = len(tab.heard)
    tab.click(GOAL)
    tab.wait(since, client.moved_fragment, 30.0)
    since = len(tab.heard)
    tab.press("Reset")
    tab.ready(since)
    return True


def test_rubbish_costs_its_sender_the_connection_and_nobody_else_anything(client, url, tab, caplog):
    said = {name: client.offend(url, rubbish) for name, rubbish in client.RUBBISH.items()}
    harmless = {
        "a message of the server's",
        "NaN",
        "huge numbers",
        "no direction",
        "words for numbers",
        "an endless list",
    }
    assert {name for name, what in said.items() if what == "ignored"} == harmless
    assert all(what.startswith("connection closed") for name, what in said.items() if name not in harmless)
    assert breaks(client, tab)
    lines = [record.getMessage() for record in caplog.records if "invalid message" in record.getMessage()]
    assert len(lines) >= len(said) - len(harmless) - 1  # what is too long is not even read
    assert all(len(record.getMessage()) < 300 for record in caplog.records)


def test_who_does_not_read_holds_up_nobody_and_what_waits_is_bounded(client, url, tab, players):
    before = len(players)
    deaf = client.Tab(url, deaf=True)
    while len(players) == before:
        time.sleep(0.05)
    player = players[-1]()
    buffer = player._client._websock_connection.get_message_buffer()
    time.sleep(1.0)
    waiting = []
    deaf.click(GOAL)
    for _ in range(4):
        assert breaks(client, tab)
        waiting.append(len(buffer.message_from_id))
    bodies = len(player._scene)
    # The last of each kind for each body, not one a frame.
    assert max(waiting) < 12 * bodies + 200 < MESSAGE_WINDOW, waiting
    deaf.close()


def test_a_world_goes_with_its_tab(client, url, tab, players):
    other = client.Tab(url)
    other.ready()
    gone = players[-1]
    other.close()
    end = time.perf_counter() + 20
    while gone() is not None and time.perf_counter() < end:
        time.sleep(0.2)
        gc.collect()
    assert gone() is None
    assert breaks(client, tab)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the C library is not glibc")
def test_what_is_free_goes_back_to_the_system_now_and_then(client, monkeypatch):
    breakers = BreakerCache()

    def freed():
        """Megabytes that go back when a world has left holes."""
        held = [bytes([k % 7 + 1]) * 60_000 for k in range(3000)]
        held = held[::100] + held[-1:]  # between which everything is free
        before = client.resident_mb()
        breakers.release_memory()
        return before - client.resident_mb()

    assert freed() > 100
    with monkeypatch.context() as patch:
        patch.setattr(breaker_cache, "RELEASE_PERIOD", 1e9)
        assert freed() < 20  # so soon it would cost more than it gives
    monkeypatch.setattr(breakers, "_released", 0.0)
    assert freed() > 100


def test_turns_are_given_in_the_order_of_coming():
    turns, order, inside, most = FifoSemaphore(2), [], [], []
    first, second = threading.Event(), threading.Event()
    hold = (first, second)

    def work(k):
        with turns:
            inside.append(k)
            most.append(len(inside))
            if k < 2:
                hold[k].wait(10)
            order.append(k)
            time.sleep(0.01)
            inside.remove(k)

    threads = []
    for k in range(8):
        threads.append(threading.Thread(target=work, args=(k,)))
        threads[-1].start()
        time.sleep(0.02)
    assert sorted(inside) == [0, 1]
    first.set()
    for thread in threads[2:]:
        thread.join(10)
    second.set()
    threads[1].join(10)
    assert order == [0, 2, 3, 4, 5, 6, 7, 1] and max(most) == 2


@pytest.mark.parametrize(
    ("origin", "direction", "fine"),
    [
        ((3.0, -6.0, 2), (0.0, 1.0, 0.0), True),
        ((float("nan"), 0.0, 0.0), (0.0, 1.0, 0.0), False),
        ((1e300, 0.0, 0.0), (0.0, 1.0, 0.0), False),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), False),
        ((0.0, 0.0), (0.0, 1.0), False),
        ("abc", "def", False),
        (None, None, False),
    ],
)
def test_a_ray_is_six_numbers_that_mean_something(origin, direction, fine):
    assert is_valid_ray(origin, direction) is fine


@pytest.mark.parametrize(
    ("said", "meant"),
    [(3, 3.0), (99, 60.0), (-1e308, 1.0), (float("nan"), 14.0), ("9", 14.0), (True, 14.0), ([1], 14.0)],
)
def test_a_slider_stays_within_its_ends_whatever_is_said(said, meant):
    assert clamped_number(said, 1.0, 60.0, 14.0) == meant
