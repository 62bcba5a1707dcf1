"""A player: the tab of a browser, the world in it, and the thread that runs it."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.play.breaker_cache import BreakerCache
from deepfracture.play.library import Entry, Library
from deepfracture.play.panel import Panel
from deepfracture.play.readout import Timing
from deepfracture.play.requests import Click, Requests
from deepfracture.play.saving import make_file
from deepfracture.play.scene_nodes import ClientScene
from deepfracture.play.security import is_valid_ray
from deepfracture.play.session import Session, Setup, warm_up
from deepfracture.play.uploads import read_upload
from deepfracture.runtime.files import explain_write_error
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, NoSolution

if TYPE_CHECKING:
    from viser import ClientHandle

MANY_BODIES = 40
"""With more bodies than this poses are sent 30 times a second instead of 60."""
STEP_BUDGET = 0.03
"""Longest that the world is stepped between two updates [s]: if that is too little for real time, time slows down."""
MAX_UPDATE_INTERVAL = 0.1
"""Real time between two updates for which the world catches up [s]."""
SETTLING_FRAMES = 45
"""Frames in which a shape comes to rest on the floor, a millimetre below, before it is shown; one that topples is
seen to topple."""
MESSAGE_WINDOW = 4096
"""Messages that viser may send together: the update of 500 bodies is one, not several."""
JOIN_TIMEOUT = 3.0
"""Longest wait for the thread of a tab that closes [s]."""
PANEL_PERIOD = 0.2
"""Between two updates of the time slider [s]."""


class Player:
    """Everything of one tab. Requests come from threads of viser; the world has a thread of its own."""

    def __init__(
        self, client: ClientHandle, library: Library, breakers: BreakerCache, folder: Path, *, upload_limit: int
    ) -> None:
        self._client, self._library, self._breakers, self._folder = client, library, breakers, folder
        self._limit = upload_limit
        self._requests = Requests()
        self._saving = False
        self._uploads = 0
        self._cursor, self._playing, self._live = 0.0, True, True
        """The frame that is shown, whether time goes on, and whether the frame is the present."""
        self._last_update = self._last_panel_update = self._due = 0.0
        self.timing = Timing()
        self._entry = library.entry(library.first)
        self._scene = ClientScene(client.scene)
        client._websock_connection.get_message_buffer().max_window_size = MESSAGE_WINDOW
        self._panel = Panel(client, self, library, self._entry, upload_limit=upload_limit)
        self._session: Session | None = None
        self._thread = threading.Thread(target=self._run, name=f"player {client.client_id}", daemon=True)
        self._thread.start()

    # From any thread.

    def click(self, origin: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Throw a ball along a ray; an invalid ray, which the page never sends, is ignored."""
        if is_valid_ray(origin, direction):
            self._requests.add_click(origin, direction)

    def request(self, kind: str, action: Callable[[], None]) -> None:
        """Run an action in the world's thread, instead of an earlier one of that kind that still waits."""
        self._requests.add(kind, action)

    def stop(self) -> None:
        """End the thread when the tab has closed. Does not wait for a break that is being computed."""
        self._requests.stop()
        self._thread.join(JOIN_TIMEOUT)

    # Actions, in the world's thread.

    def pause(self, paused: bool) -> None:
        self._playing = not paused
        self._panel.paused(paused)

    def go_to(self, seconds: float) -> None:
        """Pause at a time of the recording [s]."""
        session = self._world
        self.pause(True)
        self._cursor = min(seconds * session.frame_rate, session.frames - 1.0)
        self._live = self._cursor >= session.frames - 1

    def replay(self) -> None:
        """Play the recording from the start."""
        self._cursor, self._live = 0.0, False
        self.pause(False)

    def reset(self) -> None:
        """Start a new world with the settings of the panel."""
        entry = self._entry if self._panel.shape == self._entry.label else self._library.entry(self._panel.shape)
        self._panel.offer(entry)
        self._start(entry)

    def upload(self, name: str, content: bytes) -> None:
        """Start a world with an uploaded mesh."""
        self._panel.status(f"Reading {name} …")
        self._uploads += 1
        folder = self._folder / f"upload_{self._uploads}"
        try:
            entry = read_upload(content, name, folder, limit=self._limit)
        except BadInput:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._panel.add(entry)
        self._start(entry)
        if self._entry is entry and entry.repairs:
            self._panel.notify("Mesh repaired", entry.repairs)

    def save(self, kind: str) -> None:
        """Make a file of the recording or the scene in a thread of its own, and send it to the browser."""
        if self._saving:
            self._panel.notify("Still saving", "One file at a time.")
            return
        self._saving = True
        recording, scene, entry = self._world.recording(), self._world.scene(), self._entry
        done = self._panel.show_progress(f"Saving {kind} …")

        def work() -> None:
            try:
                name, content = make_file(kind, recording, scene, entry)
                self._client.send_file_download(name, content, save_immediately=True)
            except (BadInput, RuntimeError) as problem:
                self._panel.show_error(str(problem))
            except OSError as problem:  # such as a full disk
                self._panel.show_error(explain_write_error(problem) or str(problem))
            finally:
                self._saving = False
                done()

        threading.Thread(target=work, name=f"saving for {self._client.client_id}", daemon=True).start()

    # The world's thread.

    @property
    def _world(self) -> Session:
        assert self._session is not None
        return self._session

    def _run(self) -> None:
        try:
            self._report_errors(lambda: self._start(self._entry))
            while self._requests.wait(self._due if self._moves else None):
                actions, clicks = self._requests.take()
                for action in actions:
                    self._report_errors(action)
                for click in clicks:
                    self._report_errors(lambda click=click: self._shoot(click))
                if self._session is not None:
                    self._report_errors(self._update)
        finally:
            if self._session is not None:
                self._session.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            self._breakers.release_memory()

    def _report_errors(self, action: Callable[[], None]) -> None:
        """Run an action and show its errors on the page; unexpected ones go to the log, too."""
        try:
            action()
        except BadInput as problem:
            self._panel.show_error(str(problem))
        except NoSolution as problem:  # the fracture of this hit failed, so the world cannot go on
            self._panel.show_error(f"{problem}. Reset to continue.")
            self._playing = False
        except Exception as fault:  # the tab must get an answer whatever happens in its world
            if self._requests.stopped:
                return
            log.exception("play: %s", fault)
            self._panel.show_error(f"Internal error: {fault}; see the terminal. Reset to continue.")
            self._playing = False

    @property
    def _moves(self) -> bool:
        if self._session is None or not self._playing:
            return False
        return not self._session.at_rest or self._cursor < self._session.frames - 1

    @property
    def _period(self) -> float:
        return 1 / 30 if len(self._scene) > MANY_BODIES else 1 / 60

    def _start(self, entry: Entry) -> None:
        """Start a world with a shape and the settings of the panel."""
        setup = self._panel.setup(entry)
        self._panel.status("Loading the breaker …")
        self._breakers.once((entry.source, setup.breaker, setup.material), lambda: self._warm_up(entry, setup))
        if self._session is None:
            self._session = Session(self._breakers, entry, setup)
        else:
            self._session.reset(entry, setup)
        new = entry is not self._entry or not len(self._scene)
        self._entry = entry
        for _ in range(SETTLING_FRAMES):
            if not self._session.step():
                break
        with self._client.atomic():
            self._scene.clear()
            self._scene.show(self._session.at(self._session.frames - 1))
        self._client.flush()
        self._cursor, self._live = self._session.frames - 1.0, True
        self.timing = Timing()
        self.pause(False)
        self._panel.readout(None, self.timing, entry)
        self._panel.status("")
        self._breakers.release_memory()
        if new:
            self._panel.look_at(self._session.at(0)[0])

    def _warm_up(self, entry: Entry, setup: Setup) -> None:
        if setup.breaker == "physical":  # prepares the solver, which takes longest; a break would take still longer
            self._breakers.breaker(entry, setup.breaker, setup.material)
        else:
            warm_up(self._breakers, entry, setup)

    def _shoot(self, click: Click) -> None:
        session = self._world
        if not self._live:
            self._cursor, self._live = session.frames - 1.0, True
            self.pause(False)
            self._panel.notify("Back to the present", "Click again to throw a ball.")
            return
        if session.full:
            raise BadInput(session.full)
        ball = session.shoot(np.array(click.origin), np.array(click.direction), self._panel.shot)
        if ball is None:
            raise BadInput("no room for the ball: zoom out a little")
        if not self._playing:
            self.pause(False)
        self.timing = Timing(click=click.time, thrown=time.perf_counter())
        self._cursor = max(self._cursor, session.frames - 1.0)
        self._last_update = time.perf_counter()
        self._panel.readout(None, self.timing, self._entry, flying=True)

    def _update(self) -> None:
        """Step the world up to the present and show it."""
        session, now = self._world, time.perf_counter()
        passed, self._last_update = min(now - self._last_update, MAX_UPDATE_INTERVAL), now
        self._due = max(self._due + self._period, now)  # a late update does not delay the following ones
        if self._playing:
            self._cursor += passed * session.frame_rate * self._panel.pace
        if self._live:
            while session.frames - 1 < self._cursor and not session.at_rest and not self._requests.stopped:
                broken = self.timing.broke
                self._step()
                if self.timing.broke is not broken:
                    self._cursor = session.frames - 1.0
                if time.perf_counter() - now > STEP_BUDGET:
                    self._cursor = min(self._cursor, session.frames - 1.0)
        self._cursor = min(self._cursor, session.frames - 1.0)
        self._live |= self._cursor >= session.frames - 1
        self._show()

    def _step(self) -> None:
        session, start = self._world, time.perf_counter()
        session.step()
        found = session.readout()
        if self.timing.broke is None and found is not None and found.fragments:
            self.timing = replace(
                self.timing, struck=start, broke=time.perf_counter(), frame=session.frames - 1,
                milliseconds=found.milliseconds,
            )  # fmt: skip
            session.step()  # so that the fragments have moved when they are first shown

    def _show(self) -> None:
        session = self._world
        poses = session.at(self._cursor)
        with self._client.atomic():
            self._scene.show(poses)
        self._client.flush()
        now = time.perf_counter()
        timing = self.timing
        if timing.broke is not None and timing.moving is None and self._cursor > timing.frame:
            self.timing = replace(timing, moving=now)
            self._panel.readout(session.readout(), self.timing, self._entry)
            self._last_panel_update = 0.0
        if now - self._last_panel_update > PANEL_PERIOD or not self._moves:
            self._last_panel_update = now
            self._panel.show_time(self._cursor / session.frame_rate, (session.frames - 1) / session.frame_rate)
            if session.at_rest:
                self._panel.readout(session.readout(), self.timing, self._entry)
