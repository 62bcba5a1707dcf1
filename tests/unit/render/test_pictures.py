"""Camera, rasteriser, stills and film."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.render import before_hit_after, exploded, write_film
from deepfracture.render.camera import frame_action, frame_points
from deepfracture.render.film import film_frames
from deepfracture.render.renderer import RecordingRenderer
from deepfracture.types import Appearance, Recording

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "recordings.py"))
painted = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))


@pytest.fixture(scope="module")
def recording():
    return tools["broken_octahedron"]()


def on_screen(camera, points, aspect):
    """-1 .. 1 across the picture where it is seen."""
    x, y, z = camera.axes @ (points - camera.position).T
    slope = np.tan(np.radians(camera.field / 2))
    return np.stack([x / -z / slope / aspect, y / -z / slope], axis=1)


@pytest.mark.parametrize("aspect", [0.5, 1.6])
def test_the_camera_sees_every_point_and_no_more_than_it_must(aspect):
    points = np.random.default_rng(1).normal(size=(50, 3)) * [3, 1, 2] + [5, 0, 1]
    seen = on_screen(frame_points(points, aspect, azimuth=30.0), points, aspect)
    assert 0.85 < np.abs(seen).max() < 1.0


def reddish(picture):
    red, _, blue = np.moveaxis(picture.astype(int), -1, 0)
    return red - blue > 40


def test_bodies_are_drawn_where_the_camera_projects_them(recording):
    camera = frame_action(recording, 1.6)
    renderer = RecordingRenderer(recording, camera, size=(160, 100), samples=2)
    rows, columns = np.nonzero(reddish(renderer.picture(0)))
    seen = on_screen(camera, recording.tracks[1].mesh.moved(1.0, [0, 0, 2]).vertices, 1.6)
    box = np.array([80 * (1 + seen[:, 0]), 50 * (1 - seen[:, 1])])
    assert np.abs([columns.min(), rows.min()] - box.min(axis=1)).max() < 2
    assert np.abs([columns.max(), rows.max()] - box.max(axis=1)).max() < 2


def test_the_floor_is_darker_in_a_shadow(recording):
    camera = frame_action(recording, 1.6)
    renderer = RecordingRenderer(recording, camera, size=(160, 100), samples=1)
    picture = renderer.picture(60)
    floor = picture[~reddish(picture)].mean(axis=-1)
    assert floor.max() > 230
    assert (floor < 190).sum() > 50


def test_pictures_repeat_to_the_byte_and_change_when_things_move(recording):
    camera = frame_action(recording, 1.6)
    first, second = (RecordingRenderer(recording, camera, size=(80, 48), samples=2) for _ in range(2))
    assert (first.picture(20) == second.picture(20)).all()
    assert reddish(first.picture(20)).sum() > 100
    assert (first.picture(20) != first.picture(30)).any(axis=-1).sum() > 100


def test_a_film_shows_the_recording_in_real_time(recording, tmp_path):
    import imageio_ffmpeg

    count = write_film(recording, tmp_path / "a.mp4", size=(96, 64))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert count == frames == 61
    assert seconds == pytest.approx(61 / 30, abs=0.05)
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    meta = next(reader)
    assert (meta["codec"], meta["size"]) == ("h264", (96, 64))
    shown = np.frombuffer(next(reader), np.uint8).reshape(64, 96, 3)
    reader.close()
    assert reddish(shown).any()


def test_a_film_picks_the_recordings_nearest_frames(recording):
    assert film_frames(recording, 30) == list(range(61))
    assert film_frames(recording, 10) == list(range(0, 61, 3))


def test_stills(recording, tmp_path):
    exploded(tools["halves"](), tmp_path / "exploded.png", size=(80, 60))
    picture = np.array(Image.open(tmp_path / "exploded.png"))
    assert picture.shape == (60, 80, 3) and reddish(picture).sum() > 300
    before_hit_after(recording, tmp_path / "strip.png", size=(64, 48))
    strip = np.array(Image.open(tmp_path / "strip.png"))
    assert strip.shape == (48, 3 * 64 + 2 * 6, 3)
    assert not (strip[:, :64] == strip[:, -64:]).all()


def test_a_recording_without_floor_or_break(recording, tmp_path):
    whole = Recording(recording.frame_time, recording.tracks[1:2])
    before_hit_after(whole, tmp_path / "strip.png", size=(64, 48))
    strip = np.array(Image.open(tmp_path / "strip.png"))
    assert reddish(strip[:, :64]).sum() > 300
    plain = (strip[:, :64] == strip[0, 0]).all(axis=-1)
    assert (plain | reddish(strip[:, :64])).mean() > 0.95  # no floor, no shadow: the rest are edges


def shares(path):
    """Of the picture: how much is red, green (less blue), turquoise."""
    red, green, blue = np.moveaxis(np.array(Image.open(path)).astype(int), -1, 0)
    return np.array(
        [
            (red > 2 * green + 20),
            (green > 2 * red + 20) & (green > 2 * blue),
            (green > 2 * red + 20) & (blue > green / 2),
        ]
    ).mean(axis=(1, 2))


def test_pictures_show_the_paint(tmp_path):
    shape, fragments = painted["broken_cube"](tmp_path)
    exploded(fragments, tmp_path / "plain.png", size=(120, 90))
    exploded(fragments, tmp_path / "painted.png", shape=shape, size=(120, 90))
    assert shares(tmp_path / "plain.png")[1:].max() < 0.01
    red, green, turquoise = shares(tmp_path / "painted.png")
    assert min(red, green, turquoise) > 0.03
    # The texture's upper half is turquoise: so are the upper parts of the upright sides.
    rows = np.array(Image.open(tmp_path / "painted.png")).astype(int)
    upper, lower = (
        np.nonzero(kind)[0].mean()
        for kind in (
            rows[..., 2] > 2 * rows[..., 0] + 20,
            (rows[..., 1] > 2 * rows[..., 0] + 20) & (rows[..., 1] > 2 * rows[..., 2]),
        )
    )
    assert upper < lower
    before_hit_after(painted["filmed"](shape, fragments), tmp_path / "strip.png", size=(64, 48))
    assert shares(tmp_path / "strip.png").min() > 0.02


def test_vertex_colours_are_interpolated(tmp_path):
    """A side of two triangles, white at its upper corners and black at its lower ones, has every grey between."""
    shape, fragments = painted["broken_cube"](tmp_path)
    grey = np.full((12, 3, 4), 255, np.uint8)
    grey[..., :3] = np.where(shape.mesh.triangles[..., 2:] > 0, 255, 0)
    recording = painted["filmed"](replace(shape, appearance=Appearance(np.zeros(12, int), colours=grey)), fragments)
    renderer = RecordingRenderer(recording, frame_action(recording, 1.0), size=(128, 128), samples=2)
    for frame in (0, 2):
        column = renderer.picture(frame)[:, 64].astype(int)
        dark = np.flatnonzero(column.max(axis=1) < 100)
        side = column[dark[0] - 12 : dark[0] + 12]
        assert (np.diff(side, axis=0) <= 3).all() and np.abs(np.diff(side, axis=0)).max() < 25
        assert all(len(np.unique(channel)) > 15 for channel in side.T)
