"""Mesh files: what is read, what is refused and how, what repair does."""

from pathlib import Path

import numpy as np
import pytest

from deepfracture.geometry import builtin, closest, faults, load_shape, read_mesh, read_triangles
from deepfracture.geometry.solids import box
from deepfracture.types import BadInput, Mesh

DATA = Path(__file__).parents[3] / "shared" / "data"
CUBE = box((1, 1, 1), 0.5)


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
    assert faults(shape.mesh).closed
    assert shape.mesh.volume == pytest.approx(mesh.volume, rel=0.002)
    assert closest(shape.mesh, mesh.triangles[~near].mean(axis=1)).distance.max() < 1e-6


def test_repair_unites_overlapping_shells(tmp_path):
    both = joined(CUBE, CUBE.moved(1.0, (0.5, 0.3, 0.2)))
    shape = load_shape(str(write_obj(tmp_path / "two.obj", both)), repair=True)
    assert faults(shape.mesh).closed and faults(shape.mesh).shells == 1
    assert shape.mesh.volume * shape.scale**3 == pytest.approx(2 - 0.5 * 0.7 * 0.8)


def test_repair_wraps_what_has_edges_with_many_faces(tmp_path):
    # Two rooms with a wall between them, and a gap along an edge: one solid comes out.
    wall = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    inner = Mesh(wall, np.array([[0, 1, 2], [0, 2, 3]]))
    rooms = joined(box((1, 1, 1), 1.0), inner.moved(0.9, (0, 0, 0)), inner.moved(0.9, (0, 0, 0.2)))
    crowded = Mesh(rooms.vertices, np.concatenate([rooms.faces, [[8, 9, 12]]]))
    shape = load_shape(str(write_obj(tmp_path / "rooms.obj", crowded)), repair=True)
    assert faults(shape.mesh).closed and faults(shape.mesh).shells == 1
    assert shape.mesh.volume * shape.scale**3 == pytest.approx(1, rel=0.02)


def test_repair_leaves_good_meshes_alone(tmp_path):
    mesh = builtin("letter_a").mesh
    path = write_obj(tmp_path / "good.obj", mesh)
    np.testing.assert_array_equal(load_shape(str(path), repair=True).mesh.vertices, load_shape(str(path)).mesh.vertices)


@pytest.mark.skipif(not (DATA / "teapot.obj").exists(), reason="the shared meshes are not here")
class TestRealMeshes:
    def test_open_ones_are_refused(self):
        message = refusal(DATA / "teapot.obj")
        assert "4 open shells, 160 boundary edges; try --repair" in message
        assert "3 open shells, 44 boundary edges" in refusal(DATA / "suzanne.obj")

    @pytest.mark.parametrize("name", ["squirrel", "bunny_oded", "spot", "cheburashka", "cow"])
    def test_closed_ones_are_taken(self, name):
        shape = load_shape(str(DATA / f"{name}.obj"))
        assert faults(shape.mesh).closed and shape.mesh.volume > 0

    @pytest.mark.parametrize(("name", "largest"), [("teapot", 1e-9), ("suzanne", 0.016)])
    def test_repair_makes_a_solid_with_the_same_outside(self, name, largest):
        from deepfracture.geometry import signed_distance_points

        shape = load_shape(str(DATA / f"{name}.obj"), repair=True)
        assert faults(shape.mesh).closed and faults(shape.mesh).shells == 1
        raw = read_triangles(DATA / f"{name}.obj")
        given = (raw.vertices - shape.centre) / shape.scale
        # Nothing of the input sticks out by more than a voxel, and what is outside lies on the input.
        assert signed_distance_points(shape.mesh, given).min() > -largest
        areas = np.linalg.norm(shape.mesh.area_vectors, axis=1)
        off = closest(Mesh(given, raw.faces), shape.mesh.triangles.mean(axis=1)).distance
        assert areas[off < 0.01].sum() > 0.98 * areas.sum()
        # A solid, not a thin double wall.
        assert signed_distance_points(shape.mesh, [[0.0, 0.0, 0.0]])[0] > 0.2
