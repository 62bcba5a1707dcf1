"""One player: a browser's tab, the world in it, and the thread that keeps it going."""

from __future__ import annotations

import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.play.guard import is_ray
from deepfracture.play.library import Entry, Library, read_upload
from deepfracture.play.look import Stand
from deepfracture.play.panel import Panel
from deepfracture.play.saving import make
from deepfracture.play.session import Session, Setup, rehearse
from deepfracture.play.telling import Timing
from deepfracture.runtime.files import explain_write_error
from deepfracture.runtime.progress import log
from deepfracture.types import BadInput, NoSolution

if TYPE_CHECKING:
    from viser import ClientHandle

MOST_CLICKS = 2
"""Clicks that wait while a break is computed; more are dropped."""
BUSY = 40
"""With more bodies than this poses go out every other time, 30 times a second and not 60."""
BUDGET = 0.03
"""Longest that the world is stepped at a stretch [s]: where that is too little for real time, time goes slower."""
LONGEST_TICK = 0.1
"""Real time that may pass between two pictures without the world standing still meanwhile [s]."""
SETTLING = 45
"""Frames that a shape has to come to rest on the floor, a millimetre below, before it is shown; one that topples is
seen to topple."""
PICTURE = 4096
"""Messages that may go out together: a picture of 500 bodies is one, not several one after another."""
FAREWELL = 3.0
"""Longest that a tab which closes is waited for [s]."""
PANEL_PERIOD = 0.2
"""Between two updates of the slider [s]."""


@dataclass(frozen=True)
class Click:
    """Where someone clicked."""

    origin: tuple[float, float, float]
    direction: tuple[float, float, float]
    at: float
    """`time.perf_counter()`"""


class Player:
    """Everything of one tab. The browser's wishes come from viser's threads; the world lives in one of its own."""

    def __init__(self, client: ClientHandle, library: Library, folder: Path, *, upload_limit: int) -> None:
        self._client, self._library, self._folder = client, library, folder
        self._limit = upload_limit
        self._wake = threading.Condition()
        self._wishes: dict[str, Callable[[], None]] = {}
        """The last wish of each kind: there is never more than one."""
        self._clicks: deque[Click] = deque()
        self._stopped = False
        self._saving = False
        self._uploads = 0
        self._cursor, self._playing, self._present = 0.0, True, True
        self._last = self._told = self._due = 0.0
        self.timing = Timing()
        self._entry = library.entry(library.first)
        self._stand = Stand(client.scene)
        client._websock_connection.get_message_buffer().max_window_size = PICTURE
        self._panel = Panel(client, self, library, self._entry, upload_limit=upload_limit)
        self._session: Session | None = None
        self._thread = threading.Thread(target=self._run, name=f"player {client.client_id}", daemon=True)
        self._thread.start()

    # What the browser wishes, from any thread.

    def click(self, origin: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Shoot along a ray; what is none comes from no page of ours."""
        if not is_ray(origin, direction):
            return
        with self._wake:
            if len(self._clicks) < MOST_CLICKS:
                self._clicks.append(Click(origin, direction, time.perf_counter()))
                self._wake.notify()

    def wish(self, kind: str, action: Callable[[], None]) -> None:
        """Do that in the world's thread, in the place of an earlier wish of that kind which still waits."""
        with self._wake:
            self._wishes[kind] = action
            self._wake.notify()

    def stop(self) -> None:
        """The tab is gone. Returns when the thread has ended, or soon: a break that is being computed goes on until it
        is done, and nobody sees it."""
        with self._wake:
            self._stopped = True
            self._wake.notify()
        self._thread.join(FAREWELL)

    # Wishes, in the world's thread.

    def pause(self, paused: bool) -> None:
        self._playing = not paused
        self._panel.paused(paused)

    def go_to(self, seconds: float) -> None:
        """Look back at a moment."""
        session = self._world
        self.pause(True)
        self._cursor = min(seconds * session.frame_rate, session.frames - 1.0)
        self._present = self._cursor >= session.frames - 1

    def replay(self) -> None:
        """Show all from the start."""
        self._cursor, self._present = 0.0, False
        self.pause(False)

    def reset(self) -> None:
        """The world anew, as the panel has it."""
        entry = self._entry if self._panel.shape == self._entry.label else self._library.entry(self._panel.shape)
        self._panel.offer(entry)
        self._settle(entry)

    def upload(self, name: str, content: bytes) -> None:
        """Break a mesh of the player's own."""
        self._panel.status(f"Reading {name} …")
        self._uploads += 1
        folder = self._folder / f"upload_{self._uploads}"
        try:
            entry = read_upload(content, name, folder, limit=self._limit)
        except BadInput:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._panel.add(entry)
        self._settle(entry)
        if self._entry is entry and entry.mended:
            self._panel.tell("Mended", entry.mended)

    def save(self, kind: str) -> None:
        """Make a file of what has happened and hand it to the browser, beside the world's thread."""
        if self._saving:
            self._panel.tell("Still saving", "One file at a time.")
            return
        self._saving = True
        recording, scene, entry = self._world.recording(), self._world.scene(), self._entry
        done = self._panel.working(f"Saving {kind} …")

        def work() -> None:
            try:
                name, content = make(kind, recording, scene, entry)
                self._client.send_file_download(name, content, save_immediately=True)
            except (BadInput, RuntimeError) as problem:
                self._panel.complain(str(problem))
            except OSError as problem:  # a full disk: the page stays, and says so
                self._panel.complain(explain_write_error(problem) or str(problem))
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
            self._guarded(lambda: self._settle(self._entry))
            while self._wait():
                with self._wake:
                    wishes, clicks = list(self._wishes.values()), list(self._clicks)
                    self._wishes.clear()
                    self._clicks.clear()
                for wish in wishes:
                    self._guarded(wish)
                for click in clicks:
                    self._guarded(lambda click=click: self._shoot(click))
                if self._session is not None:
                    self._guarded(self._tick)
        finally:
            if self._session is not None:
                self._session.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            self._library.tidy()

    def _guarded(self, job: Callable[[], None]) -> None:
        """What is wrong with a wish is said on the page; what is wrong with the program in the terminal too."""
        try:
            job()
        except BadInput as problem:
            self._panel.complain(str(problem))
        except NoSolution as problem:  # of this shape as it was hit: its world cannot go on
            self._panel.complain(f"{problem}. Reset to go on.")
            self._playing = False
        except Exception as fault:  # one world's fault must not leave its tab without an answer
            if self._stopped:
                return
            log.exception("play: %s", fault)
            self._panel.complain(f"this should not happen: {fault}; the terminal has more. Reset to go on.")
            self._playing = False

    def _wait(self) -> bool:
        """Until there is something to do. False when the tab is gone."""
        with self._wake:
            while not (self._stopped or self._wishes or self._clicks):
                left = self._due - time.perf_counter() if self._moves else None
                if left is not None and left <= 0:
                    break
                self._wake.wait(left)
            return not self._stopped

    @property
    def _moves(self) -> bool:
        if self._session is None or not self._playing:
            return False
        return not self._session.at_rest or self._cursor < self._session.frames - 1

    @property
    def _period(self) -> float:
        return 1 / 30 if len(self._stand) > BUSY else 1 / 60

    def _settle(self, entry: Entry) -> None:
        """A world with that shape and what the panel says."""
        setup = self._panel.setup(entry)
        self._panel.status("Getting ready: loading what breaks it …")
        self._library.once((entry.source, setup.breaker, setup.material), lambda: self._rehearse(entry, setup))
        if self._session is None:
            self._session = Session(self._library, entry, setup)
        else:
            self._session.reset(entry, setup)
        new = entry is not self._entry or not len(self._stand)
        self._entry = entry
        for _ in range(SETTLING):
            if not self._session.step():
                break
        with self._client.atomic():
            self._stand.clear()
            self._stand.show(self._session.at(self._session.frames - 1))
        self._client.flush()
        self._cursor, self._present = self._session.frames - 1.0, True
        self.timing = Timing()
        self.pause(False)
        self._panel.readout(None, self.timing, entry)
        self._panel.status("")
        self._library.tidy()
        if new:
            self._panel.look_at(self._session.at(0)[0])

    def _rehearse(self, entry: Entry, setup: Setup) -> None:
        if setup.breaker == "physical":  # what takes long is the solver, which is ready now; a break would be more
            self._library.breaker(entry, setup.breaker, setup.material)
        else:
            rehearse(self._library, entry, setup)

    def _shoot(self, click: Click) -> None:
        session = self._world
        if not self._present:
            self._cursor, self._present = session.frames - 1.0, True
            self.pause(False)
            self._panel.tell("Back to now", "Click again to shoot.")
            return
        if session.full:
            raise BadInput(session.full)
        ball = session.shoot(np.array(click.origin), np.array(click.direction), self._panel.shot)
        if ball is None:
            raise BadInput("no room for the ball: zoom out a little")
        if not self._playing:
            self.pause(False)
        self.timing = Timing(click=click.at, thrown=time.perf_counter())
        self._cursor = max(self._cursor, session.frames - 1.0)
        self._last = time.perf_counter()
        self._panel.readout(None, self.timing, self._entry, flying=True)

    def _tick(self) -> None:
        """Time goes on: step the world as far as it must be, and show it."""
        session, now = self._world, time.perf_counter()
        passed, self._last = min(now - self._last, LONGEST_TICK), now
        self._due = max(self._due + self._period, now)  # a late picture does not delay those after it
        if self._playing:
            self._cursor += passed * session.frame_rate * self._panel.pace
        if self._present:
            while session.frames - 1 < self._cursor and not session.at_rest and not self._stopped:
                broken = self.timing.broke
                self._step()
                if self.timing.broke is not broken:
                    self._cursor = session.frames - 1.0
                if time.perf_counter() - now > BUDGET:
                    self._cursor = min(self._cursor, session.frames - 1.0)
        self._cursor = min(self._cursor, session.frames - 1.0)
        self._present |= self._cursor >= session.frames - 1
        self._show()

    def _step(self) -> None:
        session, began = self._world, time.perf_counter()
        session.step()
        found = session.readout()
        if self.timing.broke is None and found is not None and found.fragments:
            self.timing = replace(
                self.timing, struck=began, broke=time.perf_counter(), frame=session.frames - 1,
                milliseconds=found.milliseconds,
            )  # fmt: skip
            session.step()  # so that they have moved when they are first seen

    def _show(self) -> None:
        session = self._world
        poses = session.at(self._cursor)
        with self._client.atomic():
            self._stand.show(poses)
        self._client.flush()
        now = time.perf_counter()
        timing = self.timing
        if timing.broke is not None and timing.moving is None and self._cursor > timing.frame:
            self.timing = replace(timing, moving=now)
            self._panel.readout(session.readout(), self.timing, self._entry)
            self._told = 0.0
        if now - self._told > PANEL_PERIOD or not self._moves:
            self._told = now
            self._panel.moment(self._cursor / session.frame_rate, (session.frames - 1) / session.frame_rate)
            if session.at_rest:
                self._panel.readout(session.readout(), self.timing, self._entry)
