"""One self-contained page that plays a recording: opens from disk, needs no network."""

from __future__ import annotations

import io
import os
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.export.viser_scene import add_floor, add_surface
from deepfracture.geometry.rotations import continuous_quats
from deepfracture.recording.motion import KEY_TOL, exists, floor_height
from deepfracture.recording.surface import track_surfaces
from deepfracture.render.camera import frame_action
from deepfracture.runtime.extras import require
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import track as progress
from deepfracture.types import Recording, Track

if TYPE_CHECKING:
    from viser import FrameHandle, SceneApi, ViserServer

PAGE_RATE = 60
"""Most poses a second that the page holds."""
PAUSE = 1.5
"""Seconds that the end stands still before the page starts again."""


def write_page(recording: Recording, path: str | os.PathLike) -> None:
    """Write a page that plays the recording again and again; the viewer's own bar pauses and rewinds.

    Opens a local port while it runs: viser's scene lives in its server."""
    require("viser", extra="play", to="write a page")
    import viser

    with redirect_stdout(io.StringIO()):  # viser prints an address, at which nothing is to be seen
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            bodies = _build(server, recording)
            html = _recorded(server, recording, bodies)
        finally:
            server.stop()
    with atomic_file(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _build(server: ViserServer, recording: Recording) -> list[tuple[Track, FrameHandle]]:
    """Camera, floor and one frame with its surfaces for each body.

    The lights are the viewer's own: it goes back to them whenever it starts again, and a change of
    lights makes it compile its shaders anew."""
    scene = server.scene
    scene.set_up_direction("+z")
    camera = frame_action(recording, 1.6)
    server.initial_camera.position = tuple(camera.position)
    server.initial_camera.look_at = tuple(camera.target)
    server.initial_camera.fov = float(np.radians(camera.field))
    height = floor_height(recording)
    if height is not None:
        add_floor(scene, height)
    tracks = [track for track in recording.tracks if track.kind != "floor" and len(track.positions)]
    return [(track, _body(scene, track, f"/{k:03d}_{track.kind}")) for k, track in enumerate(tracks)]


def _body(scene: SceneApi, track: Track, name: str) -> FrameHandle:
    frame = scene.add_frame(
        name,
        show_axes=False,
        position=tuple(track.positions[0]),
        wxyz=tuple(track.quats_wxyz[0]),
        visible=exists(track, 0),
    )
    for k, surface in enumerate(track_surfaces(track)):
        add_surface(scene, surface, f"{name}/{k}_{surface.look}")
    return frame


def _recorded(server: ViserServer, recording: Recording, bodies: list[tuple[Track, FrameHandle]]) -> str:
    """Play the recording into viser's serializer: a message for each body that moved."""
    serializer = server.get_scene_serializer()
    stride = max(1, round(1 / (PAGE_RATE * recording.frame_time)))
    quats = [continuous_quats(track.quats_wxyz) for track, _ in bodies]
    for frame in progress(range(0, recording.frames, stride), name="page"):
        for (track, handle), turns in zip(bodies, quats, strict=True):
            if handle.visible != exists(track, frame):
                handle.visible = exists(track, frame)
            if exists(track, frame):
                _move(handle, track.positions[frame - track.start], turns[frame - track.start])
        serializer.insert_sleep(stride * recording.frame_time)
    serializer.insert_sleep(PAUSE)
    return serializer.as_html()


def _move(handle: FrameHandle, position: np.ndarray, quat_wxyz: np.ndarray) -> None:
    if np.abs(handle.position - position).max() > KEY_TOL:
        handle.position = position
    if np.abs(handle.wxyz - quat_wxyz).max() > KEY_TOL:
        handle.wxyz = quat_wxyz
