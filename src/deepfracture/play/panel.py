"""The controls of one tab, at the right edge of its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from deepfracture.fracture import MATERIALS
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.play.library import Entry, Library
from deepfracture.play.readout import Timing, breaker_html, readout_html, status_html
from deepfracture.play.security import clamped_number, limit_uploads
from deepfracture.play.session import Readout, Setup, Shot
from deepfracture.play.uploads import UPLOAD_SUFFIXES, too_large
from deepfracture.render.camera import frame_points
from deepfracture.types import BadInput
from deepfracture.world import GRAVITY, UPRIGHT, Pose

if TYPE_CHECKING:
    from viser import ClientHandle, GuiButtonGroupHandle, GuiEvent, GuiSliderHandle, GuiUploadButtonHandle
    from viser._messages import HotkeyKey

PACES = {"real time": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/30": 1 / 30}
"""Time of the world over real time."""
PAUSE, RESUME, REPLAY, RESET = "Pause", "Resume", "Replay", "Reset"
SAVED = {"glb": "GLB", "usd": "USD", "film": "Film", "scene": "Scene"}
"""Labels of the buttons that save a file, by kind of file."""
AZIMUTH, ELEVATION, ASPECT = -60.0, 18.0, 1.2
"""Initial view [degrees], and width over height of the page beside its panel."""
MARGIN = 2.0
"""Size of the initial view over that of the shape: the rest is space for its pieces."""
DROP = """<img alt="" style="display:none"
src="data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="
onload="if(!window.dfDrop){window.dfDrop=1;document.addEventListener('dragover',e=>e.preventDefault());
document.addEventListener('drop',e=>{e.preventDefault();const i=document.querySelector('input[type=file]');
if(i&&e.dataTransfer.files.length){i.files=e.dataTransfer.files;
i.dispatchEvent(new Event('change',{bubbles:true}))}})}">"""
"""Passes a file dropped anywhere on the page to the upload button: viser has no drop zone of its own."""


class Actions(Protocol):
    """What the controls do; all but `request` run in the thread of the world."""

    def request(self, kind: str, action: Callable[[], None]) -> None: ...
    def pause(self, paused: bool) -> None: ...
    def go_to(self, seconds: float) -> None: ...
    def replay(self) -> None: ...
    def reset(self) -> None: ...
    def upload(self, name: str, content: bytes) -> None: ...
    def save(self, kind: str) -> None: ...


class Panel:
    """Builds the controls, reads and updates them. Thread-safe."""

    def __init__(
        self, client: ClientHandle, actions: Actions, library: Library, entry: Entry, *, upload_limit: int
    ) -> None:
        self._client, self._actions, self._limit = client, actions, upload_limit
        self._labels = library.labels
        gui = client.gui
        self._status = gui.add_html(status_html("Loading …") + DROP)
        self._object(entry)
        with gui.add_folder("Ball"):
            self._radius = gui.add_slider("Radius [m]", 0.05, 0.5, 0.01, 0.2, hint="Of steel; objects are 2 m long.")
            self._speed = gui.add_slider("Speed [m/s]", 1.0, 60.0, 1.0, 14.0)
        self._time()
        with gui.add_folder("Result"):
            self._result = gui.add_html("")
        self._world()
        with gui.add_folder("Save"):
            self._buttons({label: (lambda kind=kind: actions.save(kind)) for kind, label in SAVED.items()})
        keys: dict[HotkeyKey, tuple[str, Callable[[], None]]] = {
            "space": ("Pause or resume", self._toggle_pause),
            "P": ("Replay", actions.replay),
            "R": ("Reset", actions.reset),
        }
        for key, (label, action) in keys.items():
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda _, label=label, action=action: actions.request(label, action))

    def _toggle_pause(self) -> None:
        self._actions.pause(self._clock.options[0] == PAUSE)

    def _object(self, entry: Entry) -> None:
        gui = self._client.gui
        self._folder = gui.add_folder("Object")
        with self._folder:
            self._shape = gui.add_dropdown("Shape", self._labels, initial_value=entry.label)
            self._breaker = gui.add_dropdown("Breaker", entry.breakers)
            self._material = gui.add_dropdown("Material", tuple(MATERIALS), initial_value="plaster")
            self._up = gui.add_dropdown("Up", tuple(UPRIGHT), initial_value=entry.up, visible=entry.file is not None)
            self._note = gui.add_html("")
        self._upload_button()
        for handle in (self._shape, self._breaker, self._material, self._up):
            self._listen(handle, "reset", self._actions.reset)

    def _time(self) -> None:
        gui, actions = self._client.gui, self._actions
        with gui.add_folder("Time"):
            self._pace = gui.add_dropdown("Pace", tuple(PACES), initial_value="real time")
            self._seconds = gui.add_slider("Time [s]", 0.0, 0.1, 0.01, 0.0)
            self._clock = self._buttons(
                {PAUSE: self._toggle_pause, RESUME: self._toggle_pause, REPLAY: actions.replay, RESET: actions.reset}
            )
            self._clock.options = (PAUSE, REPLAY, RESET)
        self._listen(self._seconds, "time", lambda: actions.go_to(_value(self._seconds, 0.0)))

    def _world(self) -> None:
        gui = self._client.gui
        with gui.add_folder("World", expand_by_default=False):
            self._gravity = gui.add_slider("Gravity [m/s²]", 0.0, 25.0, 0.01, GRAVITY)
            self._seed = gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1)
        for handle in (self._gravity, self._seed):
            self._listen(handle, "reset", self._actions.reset)

    def _upload_button(self) -> None:
        """A button that accepts no file above the limit; replaced after a refusal, because it would wait for ever."""
        with self._folder:
            button = self._client.gui.add_upload_button(
                "Drop a mesh here", mime_type=",".join(UPLOAD_SUFFIXES), hint=f"Or click: {', '.join(UPLOAD_SUFFIXES)}",
                order=self._note._impl.props.order + 0.5,
            )  # fmt: skip
        limit_uploads(self._client, self._limit, self._refused)
        button.on_upload(self._uploaded)
        self._upload = button

    def _uploaded(self, event: GuiEvent[GuiUploadButtonHandle]) -> None:
        file = event.target.value
        self._actions.request("upload", lambda: self._actions.upload(file.name, file.content))

    def _refused(self, name: str, size: int) -> None:
        self._upload.remove()
        self._upload_button()
        self.show_error(too_large(name, size, self._limit))

    def _buttons(self, actions: Mapping[str, Callable[[], None]]) -> GuiButtonGroupHandle:
        """Buttons side by side, each with its action."""
        group = self._client.gui.add_button_group("", tuple(actions))
        group.on_click(lambda event: self._actions.request(event.target.value, actions[event.target.value]))
        return group

    def _listen(self, handle: Any, kind: str, action: Callable[[], None]) -> None:
        """Only to changes from the browser: changes by the server trigger the callback, too."""

        def changed(event: GuiEvent) -> None:
            if event.client_id is not None:
                self._actions.request(kind, action)

        handle.on_update(changed)

    # Values of the controls.

    @property
    def shape(self) -> str:
        """Label of the shape."""
        return str(self._shape.value)

    @property
    def shot(self) -> Shot:
        """The ball."""
        return Shot(_value(self._radius, 0.2), _value(self._speed, 14.0))

    @property
    def pace(self) -> float:
        """Time of the world over real time."""
        return PACES.get(str(self._pace.value), 1.0)

    def setup(self, entry: Entry) -> Setup:
        """The requested settings of the world. BadInput if the shape does not allow them."""
        if self._breaker.value not in entry.breakers:
            raise BadInput(f"breaker {self._breaker.value!r} cannot break {entry.label}")
        return Setup(
            str(self._breaker.value),
            str(self._material.value),
            str(self._up.value),
            _value(self._gravity, GRAVITY),
            int(clamped_number(self._seed.value, 0, 2**31 - 1, 0)),
        )

    # Updates of the page.

    def offer(self, entry: Entry) -> None:
        """Offer the breakers of a shape; select the best one if the former cannot break it."""
        if tuple(self._breaker.options) != entry.breakers:
            self._breaker.options = entry.breakers
            self._breaker.value = entry.breakers[0]
            self._up.value = entry.up
        self._up.visible = entry.file is not None
        self._note.content = breaker_html(entry, self._breaker.value, self._material.value)

    def add(self, entry: Entry) -> None:
        """Add a shape and select it."""
        self._labels = (entry.label, *(label for label in self._labels if label != entry.label))
        self._shape.options = self._labels
        self._shape.value = entry.label
        self._breaker.options = entry.breakers
        self._breaker.value = entry.breakers[0]
        self._up.value = entry.up
        self.offer(entry)

    def status(self, text: str) -> None:
        """Show a status line; "" for the instructions."""
        self._status.content = status_html(text) + DROP

    def notify(self, title: str, text: str) -> None:
        """Show a notification that closes by itself."""
        self._client.add_notification(title, text, auto_close_seconds=8.0, color="blue")

    def show_error(self, text: str) -> None:
        """Show an error in one line for a while."""
        self.status("")
        self._client.add_notification("Error", text, auto_close_seconds=20.0, color="red")

    def show_progress(self, text: str) -> Callable[[], None]:
        """Show a notification until the returned function is called."""
        note = self._client.add_notification(text, "", loading=True, with_close_button=False)
        return note.remove

    def paused(self, paused: bool) -> None:
        self._clock.options = (RESUME if paused else PAUSE, REPLAY, RESET)

    def show_time(self, now: float, end: float) -> None:
        """Set the time slider and its end [s]."""
        end = max(round(end, 2), 0.1)
        if self._seconds.max != end:
            self._seconds.max = end
        now = min(round(now, 2), end)
        if self._seconds.value != now:
            self._seconds.value = now

    def readout(self, found: Readout | None, timing: Timing, entry: Entry, *, flying: bool = False) -> None:
        """Show the result of the last shot, and the breaker."""
        self._result.content = readout_html(found, timing, flying=flying)
        self._note.content = breaker_html(entry, self._breaker.value, self._material.value)

    def look_at(self, pose: Pose) -> None:
        """Point the camera at a body."""
        points = pose.mesh.vertices @ rotation_matrix(pose.quat_wxyz).T + pose.position
        middle = points.mean(axis=0)
        camera = frame_points(middle + MARGIN * (points - middle), ASPECT, azimuth=AZIMUTH, elevation=ELEVATION)
        view = self._client.camera
        with self._client.atomic():
            view.fov = float(np.radians(camera.field))
            view.position = tuple(camera.position)
            view.look_at = tuple(camera.target)


def _value(slider: GuiSliderHandle, default: float) -> float:
    return clamped_number(slider.value, slider.min, slider.max, default)
