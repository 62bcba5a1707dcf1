"""The controls of one tab, at the right edge of its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfracture.fracture import MATERIALS
from deepfracture.geometry.rotations import rotation_matrix
from deepfracture.play.guard import limit_uploads, number
from deepfracture.play.library import KINDS, Entry, Library, too_large
from deepfracture.play.session import Readout, Setup, Shot
from deepfracture.play.telling import Timing, breaker_html, readout_html, status_html
from deepfracture.render.camera import frame_points
from deepfracture.types import BadInput
from deepfracture.world import GRAVITY, UPRIGHT, Pose

if TYPE_CHECKING:
    from viser import ClientHandle, GuiButtonGroupHandle, GuiEvent, GuiSliderHandle, GuiUploadButtonHandle
    from viser._messages import HotkeyKey

    from deepfracture.play.player import Player

PACES = {"real time": 1.0, "1/2": 0.5, "1/5": 0.2, "1/10": 0.1, "1/30": 1 / 30}
"""How fast time goes."""
PAUSE, GO_ON, REPLAY, RESET = "Pause", "Go on", "Replay", "Reset"
SAVED = {"glb": "GLB", "usd": "USD", "film": "Film", "scene": "Scene"}
"""What can be saved, as the buttons have it."""
AZIMUTH, ELEVATION, ASPECT = -60.0, 18.0, 1.2
"""Where the camera stands at first [degrees], and the shape of a page beside its panel."""
AROUND = 2.0
"""Free space around the shape, for its pieces."""
DROP = """<img alt="" style="display:none"
src="data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="
onload="if(!window.dfDrop){window.dfDrop=1;document.addEventListener('dragover',e=>e.preventDefault());
document.addEventListener('drop',e=>{e.preventDefault();const i=document.querySelector('input[type=file]');
if(i&&e.dataTransfer.files.length){i.files=e.dataTransfer.files;
i.dispatchEvent(new Event('change',{bubbles:true}))}})}">"""
"""Hands a file that is dropped anywhere on the page to the upload button: viser has no drop zone of its own."""


class Panel:
    """Builds the controls and says what is on them. Safe to use from any thread."""

    def __init__(
        self, client: ClientHandle, player: Player, library: Library, entry: Entry, *, upload_limit: int
    ) -> None:
        self._client, self._player, self._limit = client, player, upload_limit
        self._own: dict[str, Entry] = {}
        self._labels = library.labels
        gui = client.gui
        self._status = gui.add_html(status_html("Getting ready …") + DROP)
        self._object(entry)
        with gui.add_folder("Ball"):
            self._radius = gui.add_slider("Radius [m]", 0.05, 0.5, 0.01, 0.2, hint="Of steel; objects are 2 m long.")
            self._speed = gui.add_slider("Speed [m/s]", 1.0, 60.0, 1.0, 14.0)
        self._time()
        with gui.add_folder("What happened"):
            self._found = gui.add_html("")
        self._world()
        with gui.add_folder("Save"):
            self._buttons({label: (lambda kind=kind: player.save(kind)) for kind, label in SAVED.items()})
        keys: dict[HotkeyKey, tuple[str, Callable[[], None]]] = {
            "space": ("Pause or go on", self._pause_or_go_on),
            "P": ("Replay", player.replay),
            "R": ("Reset", player.reset),
        }
        for key, (label, action) in keys.items():
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda _, label=label, action=action: player.wish(label, action))

    def _pause_or_go_on(self) -> None:
        self._player.pause(self._clock.options[0] == PAUSE)

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
            self._listen(handle, "reset", self._player.reset)

    def _time(self) -> None:
        gui, player = self._client.gui, self._player
        with gui.add_folder("Time"):
            self._pace = gui.add_dropdown("Pace", tuple(PACES), initial_value="real time")
            self._moment = gui.add_slider("Moment [s]", 0.0, 0.1, 0.01, 0.0)
            self._clock = self._buttons(
                {PAUSE: self._pause_or_go_on, GO_ON: self._pause_or_go_on, REPLAY: player.replay, RESET: player.reset}
            )
            self._clock.options = (PAUSE, REPLAY, RESET)
        self._listen(self._moment, "moment", lambda: player.go_to(_at(self._moment, 0.0)))

    def _world(self) -> None:
        gui = self._client.gui
        with gui.add_folder("World", expand_by_default=False):
            self._gravity = gui.add_slider("Gravity [m/s²]", 0.0, 25.0, 0.01, GRAVITY)
            self._seed = gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1)
        for handle in (self._gravity, self._seed):
            self._listen(handle, "reset", self._player.reset)

    def _upload_button(self) -> None:
        """A button that takes no file above the limit; a new one after each refusal, as it would wait for ever."""
        with self._folder:
            button = self._client.gui.add_upload_button(
                "Your own mesh: drop it here", mime_type=",".join(KINDS), hint=f"Or click: {', '.join(KINDS)}",
                order=self._note._impl.props.order + 0.5,
            )  # fmt: skip
        limit_uploads(self._client, self._limit, self._refused)
        button.on_upload(self._uploaded)
        self._upload = button

    def _uploaded(self, event: GuiEvent[GuiUploadButtonHandle]) -> None:
        file = event.target.value
        self._player.wish("upload", lambda: self._player.upload(file.name, file.content))

    def _refused(self, name: str, size: int) -> None:
        self._upload.remove()
        self._upload_button()
        self.complain(too_large(name, size, self._limit))

    def _buttons(self, actions: Mapping[str, Callable[[], None]]) -> GuiButtonGroupHandle:
        """Buttons side by side, with what each does."""
        group = self._client.gui.add_button_group("", tuple(actions))
        group.on_click(lambda event: self._player.wish(event.target.value, actions[event.target.value]))
        return group

    def _listen(self, handle: Any, kind: str, action: Callable[[], None]) -> None:
        """Only to what the browser changes: what we change ourselves comes by here as well."""

        def changed(event: GuiEvent) -> None:
            if event.client_id is not None:
                self._player.wish(kind, action)

        handle.on_update(changed)

    # What is on the controls.

    @property
    def shape(self) -> str:
        """Label of the shape."""
        return str(self._shape.value)

    @property
    def shot(self) -> Shot:
        """The ball."""
        return Shot(_at(self._radius, 0.2), _at(self._speed, 14.0))

    @property
    def pace(self) -> float:
        """World's time over real time."""
        return PACES.get(str(self._pace.value), 1.0)

    def setup(self, entry: Entry) -> Setup:
        """The world that is asked for; BadInput for what it cannot be."""
        if self._breaker.value not in entry.breakers:
            raise BadInput(f"breaker {self._breaker.value!r} cannot break {entry.label}")
        return Setup(
            str(self._breaker.value),
            str(self._material.value),
            str(self._up.value),
            _at(self._gravity, GRAVITY),
            int(number(self._seed.value, 0, 2**31 - 1, 0)),
        )

    # What the page says.

    def offer(self, entry: Entry) -> None:
        """Let the shape's own breakers be picked; the best one where the former cannot break it."""
        if tuple(self._breaker.options) != entry.breakers:
            self._breaker.options = entry.breakers
            self._breaker.value = entry.breakers[0]
            self._up.value = entry.up
        self._up.visible = entry.file is not None
        self._note.content = breaker_html(entry, self._breaker.value, self._material.value)

    def add(self, entry: Entry) -> None:
        """One more shape, which is picked at once."""
        self._labels = (entry.label, *(label for label in self._labels if label != entry.label))
        self._shape.options = self._labels
        self._shape.value = entry.label
        self._breaker.options = entry.breakers
        self._breaker.value = entry.breakers[0]
        self._up.value = entry.up
        self.offer(entry)

    def status(self, text: str) -> None:
        """What is going on; "" for the instructions."""
        self._status.content = status_html(text) + DROP

    def tell(self, title: str, text: str) -> None:
        """A note that goes away by itself."""
        self._client.add_notification(title, text, auto_close_seconds=8.0, color="blue")

    def complain(self, text: str) -> None:
        """What went wrong, in one line that stays for a while."""
        self.status("")
        self._client.add_notification("Not so", text, auto_close_seconds=20.0, color="red")

    def working(self, text: str) -> Callable[[], None]:
        """A note that stays until what is returned is called."""
        note = self._client.add_notification(text, "", loading=True, with_close_button=False)
        return note.remove

    def paused(self, paused: bool) -> None:
        self._clock.options = (GO_ON if paused else PAUSE, REPLAY, RESET)

    def moment(self, now: float, end: float) -> None:
        """Where the slider stands [s]."""
        end = max(round(end, 2), 0.1)
        if self._moment.max != end:
            self._moment.max = end
        now = min(round(now, 2), end)
        if self._moment.value != now:
            self._moment.value = now

    def readout(self, found: Readout | None, timing: Timing, entry: Entry, *, flying: bool = False) -> None:
        """What the last shot did, and what breaks the shape."""
        self._found.content = readout_html(found, timing, flying=flying)
        self._note.content = breaker_html(entry, self._breaker.value, self._material.value)

    def look_at(self, pose: Pose) -> None:
        """Stand before a body."""
        points = pose.mesh.vertices @ rotation_matrix(pose.quat_wxyz).T + pose.position
        middle = points.mean(axis=0)
        camera = frame_points(middle + AROUND * (points - middle), ASPECT, azimuth=AZIMUTH, elevation=ELEVATION)
        view = self._client.camera
        with self._client.atomic():
            view.fov = float(np.radians(camera.field))
            view.position = tuple(camera.position)
            view.look_at = tuple(camera.target)


def _at(slider: GuiSliderHandle, usual: float) -> float:
    return number(slider.value, slider.min, slider.max, usual)
