"""Mesh files: what is read, what is refused and how, what repair does."""

import io
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepfracture.geometry import builtin, closest_points, load_shape, mesh_defects, read_mesh, read_triangles
from deepfracture.geometry.repair import repair
from deepfracture.geometry.solids import box
from deepfracture.types import BadInput, Mesh, Shape

DATA = Path(__file__).parents[4] / "shared" / "data"
CUBE = box((1, 1, 1), 0.5)
painted = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "painted.py"))
DICE = Mesh(
    painted["CORNERS"] / 2,
    np.array([[a, b, c] for i, j, k, m in painted["SIDES"] for a, b, c in ((i, j, k), (i, k, m))]),
)
"""Twelve triangles; its sides are 1."""


def write_obj(path, mesh, faces=None):
    faces = mesh.faces if faces is None else faces
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*p) for p in mesh.vertices]
    lines += ["f {} {} {}".format(*(f + 1)) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def joined(*meshes):
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=True)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def refusal(path, **options):
    with pytest.raises(BadInput) as caught:
        load_shape(str(path), **options)
    message = str(caught.value)
    assert "\n" not in message and Path(path).name in message
    return message


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb", "off"])
def test_every_format_comes_back_the_same(tmp_path, kind):
    import trimesh

    mesh = builtin("letter_a").mesh
    path = tmp_path / f"letter.{kind}"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    read = read_mesh(path)
    assert (len(read.vertices), len(read.faces)) == (len(mesh.vertices), len(mesh.faces))
    assert read.volume == pytest.approx(mesh.volume, rel=1e-6)


def test_corners_split_at_texture_seams_are_merged(tmp_path):
    # Every corner of every face its own vertex with its own texture coordinate and normal.
    corners = CUBE.triangles.reshape(-1, 3)
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*p) for p in corners]
    lines += [f"vt {n / len(corners):.6f} {n % 7 / 7:.6f}" for n in range(len(corners))]
    lines += ["vn 0 0 1"]
    for n in range(0, len(corners), 3):
        lines.append("f " + " ".join(f"{k + 1}/{k + 1}/1" for k in (n, n + 1, n + 2)))
    path = tmp_path / "seams.obj"
    path.write_text("\n".join(lines))
    read = read_mesh(path)
    assert (len(read.vertices), len(read.faces)) == (len(CUBE.vertices), len(CUBE.faces))


def test_nodes_of_a_scene_are_put_in_place(tmp_path):
    import trimesh

    scene = trimesh.Scene()
    part = trimesh.Trimesh(CUBE.vertices, CUBE.faces, process=False)
    place = np.diag([2.0, 3.0, 4.0, 1.0])
    place[:3, 3] = 10, 20, 30
    scene.add_geometry(part, transform=place)
    scene.export(tmp_path / "scene.glb")
    read = read_mesh(tmp_path / "scene.glb")
    np.testing.assert_allclose(read.bounds, [[9, 18.5, 28], [11, 21.5, 32]], atol=1e-5)
    assert read.volume == pytest.approx(24)


def test_units_are_kept(tmp_path):
    path = write_obj(tmp_path / "part.obj", builtin("mug").mesh.moved(37.0, (100, -20, 3)))
    shape = load_shape(str(path))
    assert shape.name == "part"
    np.testing.assert_allclose(np.ptp(shape.mesh.bounds, axis=0).max(), 2)
    np.testing.assert_allclose(shape.to_user(shape.mesh.vertices), read_mesh(path).vertices, atol=1e-9)


def test_inside_out_and_mixed_faces_are_turned_outward(tmp_path):
    faces = CUBE.faces[:, ::-1].copy()
    assert read_mesh(write_obj(tmp_path / "out.obj", CUBE, faces)).volume == pytest.approx(1)
    faces[::3] = faces[::3, ::-1]
    assert read_mesh(write_obj(tmp_path / "mixed.obj", CUBE, faces)).volume == pytest.approx(1)


def test_doubled_and_degenerate_faces_and_loose_vertices_are_dropped(tmp_path):
    faces = np.concatenate([CUBE.faces, CUBE.faces[:3], [[0, 0, 1]]])
    mesh = Mesh(np.concatenate([CUBE.vertices, [[9, 9, 9]]]), CUBE.faces)
    read = read_mesh(write_obj(tmp_path / "dirty.obj", mesh, faces))
    assert (len(read.vertices), len(read.faces)) == (len(CUBE.vertices), len(CUBE.faces))


def test_bodies_that_touch_in_a_point_are_two(tmp_path):
    low, high = CUBE, CUBE.moved(1.0, (1, 1, 1))
    message = refusal(write_obj(tmp_path / "tips.obj", joined(low, high)))
    assert "2 separate closed bodies" in message


def test_a_void_inside_is_part_of_one_body(tmp_path):
    void = CUBE.moved(0.5, (0, 0, 0))
    hollow = joined(CUBE, Mesh(void.vertices, void.faces[:, ::-1]))
    assert read_mesh(write_obj(tmp_path / "hollow.obj", hollow)).volume == pytest.approx(1 - 1 / 8)


def test_open_meshes_are_refused_with_counts(tmp_path):
    path = write_obj(tmp_path / "open.obj", CUBE, CUBE.faces[1:])
    assert refusal(path).endswith("open.obj: 1 open shell, 3 boundary edges; try --repair")


def test_edges_with_many_faces_are_refused(tmp_path):
    path = write_obj(tmp_path / "book.obj", joined(CUBE, CUBE.moved(1.0, (0, 1, 1))))
    assert "2 edges shared by more than two faces; try --repair" in refusal(path)


def test_several_bodies_are_counted(tmp_path):
    path = write_obj(tmp_path / "three.obj", joined(*(CUBE.moved(1.0, (3 * n, 0, 0)) for n in range(3))))
    assert "3 separate closed bodies" in refusal(path)
    assert "3 separate bodies" in refusal(path, repair=True)


@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("empty.obj", "", "empty"),
        ("letter.obj", "Dear reader,\nthis is not a mesh.\n", "no triangles found; is it really an OBJ file"),
        ("nan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN or infinite"),
        ("inf.obj", "v 0 0 0\nv 1 0 inf\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN or infinite"),
        ("short.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "not a readable OBJ file"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 2\n", "no triangle"),
        ("text.ply", "hello\n", "not a readable PLY file"),
        ("text.glb", "hello\n", "not a readable GLB file"),
        ("text.stl", "hello\n", "STL file"),
        ("text.off", "hello\n", "not a readable OFF file"),
        ("mesh.xyz", "hello\n", "unknown kind of file '.xyz'; known are .obj"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, name, content, says, repair):
    path = tmp_path / name
    path.write_text(content)
    assert says in refusal(path, repair=repair)


def test_missing_files_folders_and_flat_meshes(tmp_path):
    assert "no such file" in refusal(tmp_path / "nowhere.obj")
    assert "folder" in refusal(tmp_path)
    flat = Mesh(CUBE.vertices * [1, 1, 0], CUBE.faces)
    assert refusal(write_obj(tmp_path / "flat.obj", flat))
    # Closed but thinner than it is meaningful.
    thin = Mesh(CUBE.vertices * [1, 1, 1e-10], CUBE.faces)
    assert refusal(write_obj(tmp_path / "thin.obj", thin))


def test_repair_caps_a_hole_and_keeps_every_other_face(tmp_path):
    mesh = builtin("base").mesh
    near = np.linalg.norm(mesh.triangles.mean(axis=1) - [0.6, 0.0, 0.0], axis=1) < 0.15
    assert near.any()
    shape = load_shape(str(write_obj(tmp_path / "holed.obj", mesh, mesh.faces[~near])), repair=True)
    assert mesh_defects(shape.mesh).closed
    assert shape.mesh.volume == pytest.approx(mesh.volume, rel=0.002)
    assert closest_points(shape.mesh, mesh.triangles[~near].mean(axis=1)).distance.max() < 1e-6


def test_repair_unites_overlapping_shells(tmp_path):
    both = joined(CUBE, CUBE.moved(1.0, (0.5, 0.3, 0.2)))
    shape = load_shape(str(write_obj(tmp_path / "two.obj", both)), repair=True)
    assert mesh_defects(shape.mesh).closed and mesh_defects(shape.mesh).shells == 1
    assert shape.mesh.volume * shape.scale**3 == pytest.approx(2 - 0.5 * 0.7 * 0.8)


def test_repair_wraps_what_has_edges_with_many_faces(tmp_path):
    # Two rooms with a wall between them, and a gap along an edge: one solid comes out.
    wall = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    inner = Mesh(wall, np.array([[0, 1, 2], [0, 2, 3]]))
    rooms = joined(box((1, 1, 1), 1.0), inner.moved(0.9, (0, 0, 0)), inner.moved(0.9, (0, 0, 0.2)))
    non_manifold = Mesh(rooms.vertices, np.concatenate([rooms.faces, [[8, 9, 12]]]))
    shape = load_shape(str(write_obj(tmp_path / "rooms.obj", non_manifold)), repair=True)
    assert mesh_defects(shape.mesh).closed and mesh_defects(shape.mesh).shells == 1
    assert shape.mesh.volume * shape.scale**3 == pytest.approx(1, rel=0.02)


def test_repair_refuses_a_heap_of_large_triangles():
    corners = np.random.default_rng(0).random((150_000, 3))
    with pytest.raises(BadInput, match="mess: large triangles overlap"):
        repair(Mesh(corners, np.arange(len(corners)).reshape(-1, 3)), "mess")


def test_repair_leaves_good_meshes_alone(tmp_path):
    mesh = builtin("letter_a").mesh
    path = write_obj(tmp_path / "good.obj", mesh)
    np.testing.assert_array_equal(load_shape(str(path), repair=True).mesh.vertices, load_shape(str(path)).mesh.vertices)


# How a file looks.


def textured(tmp_path, **changes):
    """The painted cube's files, some lines of them changed."""
    path = painted["write_cube"](tmp_path)
    for suffix, pairs in changes.items():
        file = path.with_suffix(f".{suffix}")
        text = file.read_text()
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new, 1)
        file.write_text(text)
    return path


def check_painted_cube(shape):
    """Closed, and at every corner the texture coordinates and normals of its own side."""
    look = shape.appearance
    assert mesh_defects(shape.mesh).closed and len(shape.mesh.vertices) == 8
    flat = shape.mesh.area_vectors
    normals = np.repeat(flat / np.linalg.norm(flat, axis=1, keepdims=True), 3, axis=0)
    places = shape.mesh.triangles.reshape(-1, 3)
    np.testing.assert_allclose(look.uv.reshape(-1, 2), painted["expected_uv"](places, normals), atol=1e-6)
    np.testing.assert_allclose(look.normals.reshape(-1, 3), normals, atol=1e-6)


def test_an_obj_keeps_texture_normals_and_materials_across_its_seams(tmp_path):
    shape = load_shape(str(textured(tmp_path)))
    check_painted_cube(shape)
    glaze, wax = shape.appearance.finishes
    assert (glaze.name, wax.name, wax.colour) == ("glaze", "wax", (255, 0, 0))
    assert glaze.texture == (tmp_path / "tiles.png").read_bytes() and wax.texture is None
    across_x = np.abs(shape.mesh.area_vectors[:, 0]) > 0.1
    np.testing.assert_array_equal(shape.appearance.finish, across_x)


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_gltf_keeps_texture_normals_and_materials(tmp_path, kind):
    import trimesh

    corners = DICE.triangles.reshape(-1, 3)
    flat = np.repeat(DICE.area_vectors * 2, 3, axis=0)
    picture = Image.open(textured(tmp_path).with_name("tiles.png"))
    material = trimesh.visual.material.PBRMaterial(name="glaze", baseColorTexture=picture)
    visual = trimesh.visual.TextureVisuals(uv=painted["expected_uv"](2 * corners, flat), material=material)
    mesh = trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), vertex_normals=flat, visual=visual, process=False)
    scene = trimesh.Scene()
    # Enlarged, mirrored and turned by a quarter: coordinates stay, normals follow.
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    place = np.eye(4)
    place[:3, :3] = 3 * turn
    scene.add_geometry(mesh, transform=place)
    (tmp_path / "out").mkdir()
    scene.export(tmp_path / "out" / f"cube.{kind}")
    shape = load_shape(str(tmp_path / "out" / f"cube.{kind}"))
    (finish,) = shape.appearance.finishes
    assert finish.name == "glaze"
    with Image.open(io.BytesIO(finish.texture)) as read:
        assert (np.asarray(read.convert("RGB")) == np.asarray(picture)).all()
    look = shape.appearance
    back = Mesh(shape.mesh.vertices @ turn, shape.mesh.faces[:, ::-1])
    normals = look.normals[:, ::-1] @ turn.astype(np.float32)
    check_painted_cube(Shape("cube", back, appearance=replace(look, normals=normals, uv=look.uv[:, ::-1])))


def test_gltf_colours_are_linear_light(tmp_path):
    from deepfracture.export.gltf import surface_glb
    from deepfracture.recording.surface import Surface

    colours = np.random.default_rng(0).integers(0, 256, (8, 4)).astype(np.uint8)
    places = DICE.vertices.astype(np.float32)
    surface = Surface("outer", places, np.float32(places / np.sqrt(0.75)), DICE.faces, np.arange(8), colours=colours)
    (tmp_path / "cube.glb").write_bytes(surface_glb(surface))
    shape = load_shape(str(tmp_path / "cube.glb"))
    corners = shape.mesh.triangles.reshape(-1, 3) / 2
    which = [np.abs(DICE.vertices - corner).sum(axis=1).argmin() for corner in corners]
    read = shape.appearance.colours.reshape(-1, 4).astype(int)
    assert np.abs(read - colours[which]).max() <= 1


@pytest.mark.parametrize("mapped", [True, False])
def test_ply_keeps_vertex_colours_and_coordinates(tmp_path, mapped):
    lines = ["ply", "format ascii 1.0", "element vertex 8"]
    lines += [f"property float {c}" for c in ("xyzst" if mapped else "xyz")] + [
        f"property uchar {c}" for c in ("red", "green", "blue")
    ]
    lines += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    for n, (x, y, z) in enumerate(DICE.vertices):
        spot = f" {x + 2} {y - z}" if mapped else ""
        lines.append(f"{x} {y} {z}{spot} {30 * n} {255 - n} 7")
    lines += [f"3 {a} {b} {c}" for a, b, c in DICE.faces]
    (tmp_path / "cube.ply").write_text("\n".join(lines) + "\n")
    shape = load_shape(str(tmp_path / "cube.ply"))
    x, y, z = np.moveaxis(shape.mesh.triangles / 2, -1, 0)
    if mapped:
        np.testing.assert_allclose(shape.appearance.uv, np.stack([x + 2, y - z], axis=-1), atol=1e-6)
    else:
        assert shape.appearance.uv is None
    which = np.abs(DICE.vertices - shape.mesh.triangles[:, :, None] / 2).sum(axis=-1).argmin(axis=-1)
    want = np.stack([30 * which, 255 - which, 0 * which + 7, 0 * which + 255], axis=-1)
    np.testing.assert_array_equal(shape.appearance.colours, want)


def test_vertex_colours_alone(tmp_path):
    lines = ["v {:g} {:g} {:g} {:g} {:g} 0.5".format(*p, *(p[:2] + 0.5)) for p in DICE.vertices]
    lines += ["f {} {} {}".format(*(f + 1)) for f in DICE.faces]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    look, mesh = load_shape(str(tmp_path / "cube.obj")).appearance, read_mesh(tmp_path / "cube.obj")
    assert (look.normals, look.uv) == (None, None)
    want = np.rint(255 * (mesh.triangles[..., :2] + 0.5))
    np.testing.assert_array_equal(look.colours[..., :2], want)
    assert (look.colours[..., 2] == 128).all() and (look.colours[..., 3] == 255).all()


def test_plain_files_have_no_appearance(tmp_path):
    import trimesh

    trimesh.Trimesh(DICE.vertices, DICE.faces, process=False).export(tmp_path / "cube.stl")
    trimesh.Trimesh(DICE.vertices, DICE.faces, process=False).export(tmp_path / "cube.off")
    assert load_shape(str(write_obj(tmp_path / "cube.obj", DICE))).appearance is None
    assert load_shape(str(tmp_path / "cube.stl")).appearance is None
    assert load_shape(str(tmp_path / "cube.off")).appearance is None


def test_normals_of_an_inside_out_file_are_turned_outward(tmp_path):
    path = textured(tmp_path)
    lines = path.read_text().splitlines()
    for k, line in enumerate(lines):
        words = line.split()
        if words[0] == "f":
            lines[k] = " ".join(["f", *words[:0:-1]])
        if words[0] == "vn":
            lines[k] = "vn " + " ".join(str(-float(w)) for w in words[1:])
    path.write_text("\n".join(lines))
    check_painted_cube(load_shape(str(path)))


SECRET = "root:x:0:0:root:/root:/bin/sh"


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "../secret.mtl", "deep/../../secret.mtl", "link.mtl"]
)
def test_materials_outside_the_files_folder_are_not_read(tmp_path, caplog, monkeypatch, name):
    """Not even through a link. The mesh itself is good and is read."""
    (tmp_path / "secret.mtl").write_text(f"newmtl glaze\nKd 0 0 1\n# {SECRET}\n")
    inside = tmp_path / "model" / "deep"
    inside.mkdir(parents=True)
    (inside.parent / "link.mtl").symlink_to(tmp_path / "secret.mtl")
    path = textured(inside.parent, obj=[("mtllib cube.mtl", f"mtllib {name}")])
    opened, read_bytes = [], Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda file: opened.append(file.resolve()) or read_bytes(file))
    with caplog.at_level("WARNING", logger="deepfracture"):
        shape = load_shape(str(path))
    assert opened == [path]
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 1 and "outside its folder and is not read" in said[0] and "\n" not in said[0]
    assert all(finish.colour is None and finish.texture is None for finish in shape.appearance.finishes)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("map_Kd ../secret.png", "outside its folder"),
        ("map_Kd missing.png", "missing"),
        ("map_Kd -s 2 2 cube.obj", "not a picture"),
        ("map_Kd torn.png", "not a picture"),
        ("Kd red green blue", "is no colour"),
        ("map_Kd " + 5000 * "x", "cannot be read"),
    ],
)
def test_bad_materials_cost_a_line_in_the_log_and_the_texture(tmp_path, caplog, line, says):
    (tmp_path / "model").mkdir()
    Image.new("RGB", (8, 8)).save(tmp_path / "secret.png")
    path = textured(tmp_path / "model", mtl=[("map_Kd -s 1 1 1 tiles.png", line)])
    whole = (path.parent / "tiles.png").read_bytes()
    (path.parent / "torn.png").write_bytes(whole[: len(whole) // 2])
    with caplog.at_level("WARNING", logger="deepfracture"):
        shape = load_shape(str(path))
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 1 and says in said[0] and "\n" not in said[0] and len(said[0]) < 400
    assert shape.appearance.finishes[0].texture is None


def test_a_gltf_file_cannot_name_pictures_elsewhere_either(tmp_path):
    import json

    Image.new("RGB", (8, 8), (1, 2, 3)).save(tmp_path / "secret.png")
    (tmp_path / "model").mkdir()
    Image.new("RGB", (8, 8), (4, 5, 6)).save(tmp_path / "model" / "a picture.png")
    corners = DICE.triangles.reshape(-1, 3).astype("<f4")
    data = corners.tobytes() + np.zeros((36, 2), "<f4").tobytes()
    (tmp_path / "model" / "cube.bin").write_bytes(data)
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 432}, {"buffer": 0, "byteOffset": 432, "byteLength": 288}]
    accessors = [
        {"bufferView": k, "componentType": 5126, "count": 36, "type": kind} for k, kind in enumerate(("VEC3", "VEC2"))
    ]
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "buffers": [{"uri": "cube.bin", "byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    for uri, found in (("a%20picture.png", True), ("../secret.png", False), (str(tmp_path / "secret.png"), False)):
        path = tmp_path / "model" / "cube.gltf"
        path.write_text(json.dumps(document | {"images": [{"uri": uri}]}))
        (finish,) = load_shape(str(path)).appearance.finishes
        assert (finish.texture is not None) == found


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            [("f 1/-4/-1", "f 1/99/-1")],
            "not a readable OBJ file (line 17: texture coordinate 99 of 24; export it again)",
        ),
        ([("f 1/-4/-1", "f 1/-5/-1")], "line 17: texture coordinate -5 of 24"),
        ([("f 1/-4/-1", "f 1/0/-1")], "line 17: texture coordinate 0 of 24"),
        ([("f 1/-4/-1", "f 1/1/7")], "line 17: normal 7 of 6"),
        ([("f 1/-4/-1", "f 9/1/1")], "line 17: vertex 9 of 8"),
        ([("f 1/-4/-1", "f 1/x/-1")], "line 17: face corner '1/x/-1'"),
        ([("f 1/-4/-1", "f /1/1")], "line 17: face corner '/1/1'"),
        ([("vt 0 0", "vt zero 0")], "line 12: a texture coordinate of 2 numbers is expected"),
        ([("vn 0 0 -1", "vn 0 0")], "line 16: a normal of 3 numbers is expected"),
        ([("v -1 -1 -1", "v -1 -1")], "line 3: a vertex of 3 numbers is expected"),
        ([("vt 0 0", "vt nan 0")], "uv must be finite, got NaN or infinite values; export it again"),
        ([("vn 0 0 -1", "vn 0 0 inf")], "normals must be finite"),
    ],
)
def test_bad_corners_are_refused_in_one_line(tmp_path, change, says):
    assert says in refusal(textured(tmp_path, obj=change))


def test_corners_without_coordinates_are_blank(tmp_path):
    shape = load_shape(str(textured(tmp_path, obj=[("f 1/-4/-1", "f 1//")])))
    assert shape.appearance is not None and mesh_defects(shape.mesh).closed
    first = np.flatnonzero(shape.mesh.area_vectors[:, 2] < -0.1)
    corner = np.abs(shape.mesh.triangles[first] - [-1, -1, -1]).max(axis=2) < 1e-9
    assert corner.any() and (shape.appearance.uv[first][corner] == 0).all()
    np.testing.assert_allclose(shape.appearance.normals[first], [[[0, 0, -1]] * 3] * len(first), atol=1e-6)


@pytest.mark.skipif(not (DATA / "teapot.obj").exists(), reason="the shared meshes are not here")
class TestRealMeshes:
    def test_open_ones_are_refused(self):
        message = refusal(DATA / "teapot.obj")
        assert "4 open shells, 160 boundary edges; try --repair" in message
        assert "3 open shells, 44 boundary edges" in refusal(DATA / "suzanne.obj")

    @pytest.mark.parametrize("name", ["squirrel", "bunny_oded", "spot", "cheburashka", "cow"])
    def test_closed_ones_are_taken(self, name):
        shape = load_shape(str(DATA / f"{name}.obj"))
        assert mesh_defects(shape.mesh).closed and shape.mesh.volume > 0

    @pytest.mark.parametrize(("name", "largest"), [("teapot", 1e-9), ("suzanne", 0.016)])
    def test_repair_makes_a_solid_with_the_same_outside(self, name, largest):
        from deepfracture.geometry import signed_distance_points

        shape = load_shape(str(DATA / f"{name}.obj"), repair=True)
        assert mesh_defects(shape.mesh).closed and mesh_defects(shape.mesh).shells == 1
        raw = read_triangles(DATA / f"{name}.obj")
        given = (raw.vertices - shape.centre) / shape.scale
        # Nothing of the input sticks out by more than a voxel, and what is outside lies on the input.
        assert signed_distance_points(shape.mesh, given).min() > -largest
        areas = np.linalg.norm(shape.mesh.area_vectors, axis=1)
        off = closest_points(Mesh(given, raw.faces), shape.mesh.triangles.mean(axis=1)).distance
        assert areas[off < 0.01].sum() > 0.98 * areas.sum()
        # A solid, not a thin double wall.
        assert signed_distance_points(shape.mesh, [[0.0, 0.0, 0.0]])[0] > 0.2
