"""The animated GLB says what the recording says."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
import pytest

from deepfracture.export import write_glb
from deepfracture.recording.motion import pose
from deepfracture.types import Recording, Track

tools = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "recordings.py"))
painted = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))
DTYPES = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Reader:
    """Evaluates the animation of a GLB, independently of the writer."""

    def __init__(self, path):
        self.doc = pygltflib.GLTF2.load(str(path))
        self.blob = self.doc.binary_blob()
        self.nodes = {node.name: k for k, node in enumerate(self.doc.nodes)}
        self.parents = {c: k for k, node in enumerate(self.doc.nodes) for c in node.children or []}

    def values(self, index):
        accessor = self.doc.accessors[index]
        view = self.doc.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        flat = np.frombuffer(self.blob, DTYPES[accessor.componentType], accessor.count * width, view.byteOffset)
        return flat.reshape(accessor.count, width)

    def keys(self, node, path):
        animation = self.doc.animations[0]
        for channel in animation.channels:
            if channel.target.node == node and channel.target.path == path:
                sampler = animation.samplers[channel.sampler]
                return self.values(sampler.input)[:, 0], self.values(sampler.output), sampler.interpolation
        return None

    def local(self, node, seconds):
        fixed = self.doc.nodes[node]
        parts = {
            "translation": np.array(fixed.translation or [0, 0, 0], float),
            "rotation": np.array(fixed.rotation or [0, 0, 0, 1], float),
            "scale": np.array(fixed.scale or [1, 1, 1], float),
        }
        for path in parts:
            found = self.keys(node, path)
            if found is not None:
                times, values, how = found
                if how == "STEP":
                    parts[path] = values[max(np.searchsorted(times, seconds + 1e-6, side="right") - 1, 0)]
                else:
                    parts[path] = np.array([np.interp(seconds, times, column) for column in values.T])
        x, y, z, w = parts["rotation"] / np.linalg.norm(parts["rotation"])
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        matrix = np.eye(4)
        matrix[:3, :3] = turn * parts["scale"]
        matrix[:3, 3] = parts["translation"]
        return matrix

    def world(self, name, seconds):
        node = self.nodes[name]
        matrix = self.local(node, seconds)
        while node in self.parents:
            node = self.parents[node]
            matrix = self.local(node, seconds) @ matrix
        return matrix


@pytest.fixture
def recording():
    return tools["broken_octahedron"]()


Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)


@pytest.mark.parametrize("frame", [15, 22, 37, 45, 60])
def test_fragments_are_where_the_recording_says(recording, tmp_path, frame):
    write_glb(recording, tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    for k, track in enumerate(t for t in recording.tracks if t.kind == "fragment"):
        there = reader.world(f"fragment_{k:03d}", frame * recording.frame_time)
        assert np.abs(there - Y_UP @ pose(track, frame)).max() < 1e-5


def test_bodies_are_shown_only_while_they_exist(recording, tmp_path):
    write_glb(recording, tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    for frame in (0, 14, 15, 16, 60):
        seconds = frame * recording.frame_time
        sizes = [np.linalg.det(reader.world(n, seconds)[:3, :3]) for n in ("octahedron", "fragment_000")]
        assert np.allclose(sizes, [frame < 15, frame >= 15], atol=1e-6)


def test_rotations_take_the_short_way_between_keys(recording, tmp_path):
    write_glb(recording, tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    _, quats, _ = reader.keys(reader.nodes["fragment_000"], "rotation")
    assert np.einsum("ni,ni->n", quats[1:], quats[:-1]).min() > 0


def test_bodies_at_rest_need_few_keys(recording, tmp_path):
    write_glb(recording, tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    times, _, _ = reader.keys(reader.nodes["fragment_000"], "translation")
    assert len(times) == 45 - 15 + 2  # the flight, its end, and the last frame
    assert reader.keys(reader.nodes["floor"], "translation") is None


def test_results_come_back_in_the_users_coordinates(tmp_path):
    # a y-up file in centimetres: user up is +y, which is glTF's up already
    user = np.array([[100, 0, 0, 5], [0, 0, 100, 6], [0, -100, 0, 7], [0, 0, 0, 1]], float)
    recording = tools["broken_octahedron"](user)
    write_glb(recording, tmp_path / "a.glb")
    track = recording.tracks[-1]
    there = Reader(tmp_path / "a.glb").world("fragment_001", 30 * recording.frame_time)
    assert np.abs(there - user @ pose(track, 30)).max() < 1e-3  # 1e-5 of 100


def test_crack_surfaces_are_a_primitive_of_their_own(recording, tmp_path):
    write_glb(recording, tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    mesh = reader.doc.meshes[reader.doc.nodes[reader.nodes["fragment_000"]].mesh]
    looks = [reader.doc.materials[p.material].name for p in mesh.primitives]
    counts = [len(reader.values(p.indices)) // 3 for p in mesh.primitives]
    assert (looks, counts) == (["outer", "inner"], [4, 2])
    for primitive in mesh.primitives:
        corners = reader.values(primitive.attributes.POSITION)[reader.values(primitive.indices)[:, 0]]
        a, b, c = np.moveaxis(corners.reshape(-1, 3, 3), 1, 0)
        stored = reader.values(primitive.attributes.NORMAL)[reader.values(primitive.indices)[::3, 0]]
        assert (np.einsum("ni,ni->n", np.cross(b - a, c - a), stored) > 0).all()


def test_the_same_recording_gives_the_same_bytes(tmp_path):
    for name in "ab":
        write_glb(tools["broken_octahedron"](), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_body_that_never_existed_is_left_out(recording, tmp_path):
    none = Track("gone", "shape", recording.tracks[1].mesh, None, 0, np.zeros((0, 3)), np.zeros((0, 4)))
    write_glb(Recording(recording.frame_time, (none, *recording.tracks)), tmp_path / "a.glb")
    write_glb(recording, tmp_path / "b.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_other_readers_open_it(recording, tmp_path):
    import trimesh

    write_glb(recording, tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb")
    assert len(scene.graph.nodes_geometry) >= 5


# What the user's file is painted with.


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cube")
    shape, fragments = painted["broken_cube"](folder)
    write_glb(painted["filmed"](shape, fragments), folder / "a.glb")
    return folder, shape, fragments


def primitives(reader, name):
    """Of a body: material, positions, normals, texture coordinates of the corners."""
    for primitive in reader.doc.meshes[reader.doc.nodes[reader.nodes[name]].mesh].primitives:
        index = reader.values(primitive.indices)[:, 0]
        about = (primitive.attributes.POSITION, primitive.attributes.NORMAL, primitive.attributes.TEXCOORD_0)
        yield reader.doc.materials[primitive.material], *(reader.values(a)[index] for a in about)


def test_fragments_keep_the_texture_where_it_was(cube):
    folder, _, fragments = cube
    reader = Reader(folder / "a.glb")
    seen = set()
    for name in ("cube", *(f"fragment_{k:03d}" for k in range(len(fragments)))):
        for material, places, normals, uv in primitives(reader, name):
            if material.name == "inner":
                continue
            seen.add(material.name)
            assert np.abs(np.abs(normals).max(axis=1) - 1).max() < 1e-6  # the cube's own, also along the cracks
            want = painted["expected_uv"](places, normals)
            assert np.abs(np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1) - want).max() < 1e-5
    assert seen == {"glaze", "wax"}


def test_the_stone_inside_has_a_material_of_its_own(cube):
    folder, _, fragments = cube
    reader = Reader(folder / "a.glb")
    assert sorted(m.name for m in reader.doc.materials) == ["glaze", "inner", "wax"]
    for k, piece in enumerate(fragments):
        inside = [p for p in primitives(reader, f"fragment_{k:03d}") if p[0].name == "inner"]
        ((material, places, _, uv),) = inside
        assert len(places) == 3 * (piece.source < 0).sum()
        assert material.pbrMetallicRoughness.baseColorTexture is None
        # Metres: distances in the plane are never longer than in space, and for most faces hardly shorter.
        flat = np.linalg.norm(np.diff(uv.reshape(-1, 3, 2), axis=1), axis=2)
        space = np.linalg.norm(np.diff(places.reshape(-1, 3, 3), axis=1), axis=2)
        assert (flat <= space + 1e-6).all() and flat.sum() > 0.7 * space.sum()


def test_the_texture_is_stored_once_as_it_was_written(cube):
    folder, _, _ = cube
    reader = Reader(folder / "a.glb")
    (image,) = reader.doc.images
    view = reader.doc.bufferViews[image.bufferView]
    stored = reader.blob[view.byteOffset : view.byteOffset + view.byteLength]
    assert stored == (folder / "tiles.png").read_bytes() and image.mimeType == "image/png"
    colours = {m.name: m.pbrMetallicRoughness for m in reader.doc.materials}
    assert colours["glaze"].baseColorTexture.index == 0 and colours["glaze"].baseColorFactor == [1, 1, 1, 1]
    assert colours["wax"].baseColorTexture is None and colours["wax"].baseColorFactor == [1, 0, 0, 1]


def test_trimesh_finds_texture_and_coordinates(cube):
    import trimesh

    folder, _, fragments = cube
    scene = trimesh.load_scene(folder / "a.glb")
    glazed = [m for m in scene.geometry.values() if m.visual.material.name == "glaze"]
    assert len(glazed) > 2
    for mesh in glazed:
        assert mesh.visual.material.baseColorTexture.size == (16, 16)
        want = painted["expected_uv"](mesh.vertices, mesh.vertex_normals)
        assert np.abs(mesh.visual.uv - want).max() < 1e-5
    inner = [m for m in scene.geometry.values() if m.visual.material.name == "inner"]
    assert len(inner) == len(fragments)
    assert all(m.visual.uv.shape == (len(m.vertices), 2) for m in inner)


def test_colours_tint_the_outside_only_and_are_linear_light(cube, tmp_path):
    _, shape, fragments = cube
    grey = np.full((len(shape.mesh.faces), 3, 4), [188, 188, 188, 255], np.uint8)
    tinted = replace(shape, appearance=replace(shape.appearance, uv=None, colours=grey))
    write_glb(painted["filmed"](tinted, fragments), tmp_path / "a.glb")
    reader = Reader(tmp_path / "a.glb")
    for mesh in reader.doc.meshes[1:]:
        for primitive in mesh.primitives:
            inner = reader.doc.materials[primitive.material].name == "inner"
            assert (primitive.attributes.COLOR_0 is None) == inner
            if not inner:
                light = reader.values(primitive.attributes.COLOR_0) / 65535
                assert np.abs(light - [0.503, 0.503, 0.503, 1]).max() < 1e-3


def test_a_file_can_be_broken_again_from_what_was_written(cube, tmp_path):
    """What we write, we read with the same looks: the whole cube of the first frame."""
    from deepfracture.export.gltf import surface_glb
    from deepfracture.geometry import load_shape
    from deepfracture.recording.surface import surfaces

    _, shape, _ = cube
    glaze = surfaces(shape.mesh, None, whole=shape)[0]
    everything = replace(shape, appearance=replace(shape.appearance, finish=np.zeros(12, int)))
    (whole,) = surfaces(shape.mesh, None, whole=everything)
    assert whole.finish is glaze.finish
    (tmp_path / "cube.glb").write_bytes(surface_glb(whole))
    again = load_shape(str(tmp_path / "cube.glb"))
    flat = np.repeat(again.mesh.area_vectors, 3, axis=0)
    want = painted["expected_uv"](again.mesh.triangles.reshape(-1, 3), flat)
    assert np.abs(again.appearance.uv.reshape(-1, 2) - want).max() < 1e-6
    assert again.appearance.finishes[0].texture == glaze.finish.texture
