"""USD says what the recording says, as a film and as the start of a simulation."""

import pickle
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfracture.export import write_usd
from deepfracture.export.names import body_names
from deepfracture.geometry.rotations import rotation_matrices
from deepfracture.recording.motion import break_frame, pivot_positions, pose
from deepfracture.types import BadInput, Rigid, Track
from deepfracture.world import Block, Floor, Placed, Scene

WHY = "usd-core is not installed: pip install 'deepfracture[usd]'"
Usd, UsdGeom, UsdPhysics, UsdShade, UsdValidation = (
    pytest.importorskip(f"pxr.{name}", reason=WHY)
    for name in ("Usd", "UsdGeom", "UsdPhysics", "UsdShade", "UsdValidation")
)
TOOLS = Path(__file__).parents[2] / "tools"
tools = runpy.run_path(str(TOOLS / "recordings.py"))
painted = runpy.run_path(str(TOOLS / "painted.py"))
HIT = tools["HIT"]


def weighed(recording):
    """The recording with masses, hulls and velocities; halves lie off centre and their axes are not principal."""
    turned = np.array([[2.0, 0.5, 0.2], [0.5, 3.0, 0.1], [0.2, 0.1, 4.0]])
    tracks = []
    for track in recording.tracks:
        if track.kind == "floor":
            tracks.append(track)
            continue
        n = len(track.positions)
        velocities = np.arange(3 * n, dtype=float).reshape(n, 3)
        hulls = () if track.kind == "ball" else (track.mesh.vertices, 0.5 * track.mesh.vertices)
        centre = np.zeros(3) if track.kind == "ball" else np.array([0.1, 0.02, -0.03])
        rigid = Rigid(2.5, centre, turned, velocities, 0.1 * velocities[::-1], hulls)
        tracks.append(replace(track, rigid=rigid))
    return replace(recording, tracks=tuple(tracks))


@pytest.fixture
def recording():
    return weighed(tools["broken_octahedron"]())


def opened(recording, path, motion="recorded", **options):
    write_usd(recording, path, **options)
    stage = Usd.Stage.Open(str(path))
    stage.SetEditTarget(stage.GetSessionLayer())
    stage.GetDefaultPrim().GetVariantSet("motion").SetVariantSelection(motion)
    return stage


def mesh_of(stage, name):
    return UsdGeom.Mesh(stage.GetPrimAtPath(f"/deepfracture/{name}/{name}_mesh"))


def corners(stage, name, time):
    """Vertices in the stage, shape (n, 3)."""
    mesh = mesh_of(stage, name)
    matrix = np.array(mesh.ComputeLocalToWorldTransform(time))
    points = np.array(mesh.GetPointsAttr().Get())
    return points @ matrix[:3, :3] + matrix[3, :3]


def recorded(track, frame, user=None):
    where = track.mesh.vertices @ pose(track, frame)[:3, :3].T + pose(track, frame)[:3, 3]
    return where if user is None else where @ user[:3, :3].T + user[:3, 3]


def complaints(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 30
    return [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd", "usdz"])
@pytest.mark.parametrize("motion", ["recorded", "simulated"])
def test_the_thirty_validators_find_nothing(recording, tmp_path, suffix, motion):
    assert complaints(opened(recording, tmp_path / f"a.{suffix}", motion)) == []


@pytest.mark.parametrize("suffix", ["usdc", "usdz"])
def test_nor_with_textures_colours_and_materials(tmp_path, suffix):
    shape, fragments = painted["broken_cube"](tmp_path)
    assert complaints(opened(painted["filmed"](shape, fragments), tmp_path / f"a.{suffix}")) == []
    colours = np.random.default_rng(1).integers(0, 256, (12, 3, 4))
    tinted = replace(shape, appearance=replace(shape.appearance, colours=colours))
    assert complaints(opened(painted["filmed"](tinted, fragments), tmp_path / f"b.{suffix}")) == []


def test_the_validators_do_find_errors(recording, tmp_path):
    write_usd(recording, tmp_path / "a.usda")
    text = (tmp_path / "a.usda").read_text()
    (tmp_path / "a.usda").write_text(text.replace("int[] indices = [0, 1, 2, 3]", "int[] indices = [0, 1, 2, 5]"))
    assert complaints(Usd.Stage.Open(str(tmp_path / "a.usda")))


@pytest.mark.parametrize("frame", [15, 22, 37, 60])
def test_fragments_are_where_the_recording_says(recording, tmp_path, frame):
    stage = opened(recording, tmp_path / "a.usdc")
    for k, track in enumerate(t for t in recording.tracks if t.kind == "fragment"):
        assert np.abs(corners(stage, f"fragment_{k:03d}", frame) - recorded(track, frame)).max() < 1e-5


def test_between_frames_the_centre_of_mass_flies_straight(recording, tmp_path):
    stage = opened(recording, tmp_path / "a.usdc")
    track = recording.tracks[-1]
    centre = [pose(track, k)[:3, :3] @ track.rigid.centre + pose(track, k)[:3, 3] for k in (20, 21)]
    matrix = np.array(UsdGeom.Xformable(stage.GetPrimAtPath("/deepfracture/fragment_001")).GetLocalTransformation(20.5))
    assert np.allclose(matrix[3, :3], np.mean(centre, axis=0), atol=1e-6)


def test_bodies_are_seen_and_met_only_while_they_exist(recording, tmp_path):
    stage = opened(recording, tmp_path / "a.usdc")
    for name, there in (("octahedron", lambda f: f < HIT), ("fragment_000", lambda f: f >= HIT)):
        prim = UsdGeom.Imageable(stage.GetPrimAtPath(f"/deepfracture/{name}"))
        hull = UsdPhysics.CollisionAPI(stage.GetPrimAtPath(f"/deepfracture/{name}/hull_00"))
        for frame in (0, HIT - 1, HIT - 0.5, HIT, HIT + 0.5, 60):
            assert (prim.ComputeVisibility(frame) == "inherited") == there(frame), (name, frame)
            assert hull.GetCollisionEnabledAttr().Get(frame) == there(frame)
            size = np.ptp(corners(stage, name, frame), axis=0).max()
            assert (size > 0.5) == there(frame), (name, frame, size)
    assert prim.ComputeVisibility(1000) == "inherited"  # it stays when the clip is longer than the recording


def test_users_coordinates_and_units_come_back(tmp_path):
    # a y-up file in centimetres
    user = np.array([[100, 0, 0, 5], [0, 0, 100, 6], [0, -100, 0, 7], [0, 0, 0, 1]], float)
    recording = weighed(tools["broken_octahedron"](user))
    stage = opened(recording, tmp_path / "a.usdc", metres_per_unit=0.01, gravity=3.0)
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert np.abs(corners(stage, "fragment_001", 30) - recorded(recording.tracks[-1], 30, user)).max() < 1e-3
    scene = UsdPhysics.Scene(stage.GetPrimAtPath("/deepfracture/physics"))
    assert np.allclose(scene.GetGravityDirectionAttr().Get(), (0, -1, 0))
    assert scene.GetGravityMagnitudeAttr().Get() == pytest.approx(300)


def test_an_odd_up_is_turned_to_y(tmp_path):
    user = np.array([[0, 0, 1, 5], [0, 1, 0, 6], [-1, 0, 0, 7], [0, 0, 0, 1]], float)  # x is up
    stage = opened(tools["broken_octahedron"](user), tmp_path / "a.usdc")
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    fall = corners(stage, "octahedron", 0).mean(axis=0) - corners(stage, "octahedron", 10).mean(axis=0)
    assert np.allclose(fall, (0, 0.1, 0), atol=1e-6)


def test_timing(recording, tmp_path):
    stage = opened(recording, tmp_path / "a.usdc")
    assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (30, 30)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 60)


def test_simulating_starts_at_the_break(recording, tmp_path):
    stage = opened(recording, tmp_path / "a.usdc", "simulated")
    assert not stage.GetPrimAtPath("/deepfracture/octahedron").IsActive()
    for name, track in zip(("ball", "fragment_000", "fragment_001"), recording.tracks[2:], strict=True):
        prim = stage.GetPrimAtPath(f"/deepfracture/{name}")
        body = UsdPhysics.RigidBodyAPI(prim)
        k = HIT - track.start
        assert not body.GetKinematicEnabledAttr().Get()
        assert np.allclose(body.GetVelocityAttr().Get(), track.rigid.velocities[k])
        assert np.allclose(body.GetAngularVelocityAttr().Get(), np.degrees(track.rigid.angular_velocities[k]))
        assert not UsdGeom.Xformable(prim).TransformMightBeTimeVarying()
        # local space and stage are parallel, so it does not matter in which of them a program reads velocities
        assert np.allclose(np.array(UsdGeom.Xformable(prim).GetLocalTransformation())[:3, :3], np.eye(3), atol=1e-9)
        assert np.abs(corners(stage, name, 0) - recorded(track, HIT)).max() < 1e-5
    floor = stage.GetPrimAtPath("/deepfracture/floor")
    assert not floor.HasAPI(UsdPhysics.RigidBodyAPI)
    assert floor.GetChild("floor_mesh").HasAPI(UsdPhysics.CollisionAPI)


def test_masses_are_those_of_the_fragments(tmp_path):
    user = np.diag([10.0, 10.0, 10.0, 1.0])
    recording = weighed(tools["broken_octahedron"](user))
    stage = opened(recording, tmp_path / "a.usdc", "simulated")
    track = recording.tracks[-1]
    mass = UsdPhysics.MassAPI(stage.GetPrimAtPath("/deepfracture/fragment_001"))
    assert mass.GetMassAttr().Get() == 2.5
    assert np.allclose(mass.GetCenterOfMassAttr().Get(), 0)
    w, (x, y, z) = mass.GetPrincipalAxesAttr().Get().GetReal(), mass.GetPrincipalAxesAttr().Get().GetImaginary()
    turn = pose(replace(track, start=0, positions=np.zeros((1, 3)), quats_wxyz=np.array([[w, x, y, z]]), rigid=None), 0)
    there = turn[:3, :3] @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn[:3, :3].T
    still = pose(track, HIT)[:3, :3]
    assert np.allclose(there, 100 * still @ track.rigid.inertia @ still.T, atol=1e-3)


def test_collision_shapes_are_our_hulls(recording, tmp_path):
    stage = opened(recording, tmp_path / "a.usdc", "simulated")
    body = stage.GetPrimAtPath("/deepfracture/fragment_000")
    hulls = [UsdGeom.Mesh(child) for child in body.GetChildren() if child.GetName().startswith("hull")]
    track = recording.tracks[3]
    for hull, points in zip(hulls, track.rigid.hulls, strict=True):
        assert UsdPhysics.MeshCollisionAPI(hull).GetApproximationAttr().Get() == "convexHull"
        assert hull.ComputePurpose() == "guide"
        there = np.array(hull.GetPointsAttr().Get()) + np.array(
            UsdGeom.Xformable(body).GetLocalTransformation().ExtractTranslation()
        )
        turned = points @ pose(track, HIT)[:3, :3].T + pose(track, HIT)[:3, 3]
        assert all(np.linalg.norm(turned - point, axis=1).min() < 1e-5 for point in there)
        faces = np.array(hull.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        a, b, c = np.moveaxis(there[faces], 1, 0)
        assert np.einsum("ni,ni->", a - there.mean(0), np.cross(b - there.mean(0), c - there.mean(0))) > 0
    assert not UsdPhysics.CollisionAPI(mesh_of(stage, "fragment_000").GetPrim())
    ball = UsdPhysics.MeshCollisionAPI(mesh_of(stage, "ball").GetPrim())
    assert ball.GetApproximationAttr().Get() == "boundingSphere"


def test_the_users_materials_outside_and_one_more_inside(tmp_path):
    shape, fragments = painted["broken_cube"](tmp_path)
    stage = opened(painted["filmed"](shape, fragments), tmp_path / "a.usda")
    seen = set()
    for k, piece in enumerate(fragments):
        mesh = mesh_of(stage, f"fragment_{k:03d}")
        points = np.array(mesh.GetPointsAttr().Get())
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        assert len(faces) == len(piece.mesh.faces) and len(points) == len(np.unique(piece.mesh.faces))
        edges = {(a, b) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True)}
        assert {(b, a) for a, b in edges} == edges  # closed
        normals = np.array(mesh.GetNormalsAttr().Get()).reshape(-1, 3, 3)
        uv = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get()).reshape(-1, 3, 2)
        for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
            material = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0].GetPrim().GetName()
            own = np.array(subset.GetIndicesAttr().Get())
            seen.add((subset.GetPrim().GetName(), material))
            if material != "inner":
                middles = points[faces[own]].mean(axis=1)
                assert np.abs(np.abs(middles).max(axis=1) - 1).max() < 1e-5  # on a side of the cube
                expected = painted["expected_uv"](points[faces[own]].reshape(-1, 3), normals[own].reshape(-1, 3))
                assert np.abs(uv[own].reshape(-1, 2) - expected).max() < 1e-4
    assert seen == {("glaze", "glaze"), ("wax", "wax"), ("inner", "inner")}
    picture = stage.GetPrimAtPath("/deepfracture/_materials/glaze/texture").GetAttribute("inputs:file").Get()
    assert Path(picture.resolvedPath).read_bytes() == shape.appearance.finishes[0].texture
    wax = UsdShade.Shader(stage.GetPrimAtPath("/deepfracture/_materials/wax/surface"))
    assert np.allclose(wax.GetInput("diffuseColor").Get(), (1, 0, 0))


def test_names_say_which_fragment(recording, tmp_path):
    def renamed(track, name):
        return replace(track, name=name)

    first, *rest, one, two = recording.tracks
    again = [renamed(one, "shape0.004.011"), renamed(two, "shape0.012")]
    stage = opened(replace(recording, tracks=(renamed(first, "3 floors"), *rest, *again)), tmp_path / "a.usdc")
    names = {prim.GetName() for prim in stage.GetDefaultPrim().GetChildren()}
    assert {"_3_floors", "fragment_004_011", "fragment_012"} <= names


def test_an_unbroken_recording_simulates_from_its_beginning(recording, tmp_path):
    tracks = tuple(t for t in recording.tracks if t.kind in ("floor", "ball"))
    stage = opened(replace(recording, tracks=tracks), tmp_path / "a.usdc", "simulated")
    assert np.abs(corners(stage, "ball", 0) - recorded(tracks[1], 0)).max() < 1e-5


def test_the_same_recording_gives_the_same_text(recording, tmp_path):
    write_usd(recording, tmp_path / "a.usda")
    write_usd(pickle.loads(pickle.dumps(recording)), tmp_path / "b.usda")
    assert (tmp_path / "a.usda").read_bytes() == (tmp_path / "b.usda").read_bytes()


def test_bad_values_get_one_line(recording, tmp_path):
    with pytest.raises(BadInput, match=r"a\.fbx: a USD file ends in \.usdc"):
        write_usd(recording, tmp_path / "a.fbx")
    with pytest.raises(BadInput, match="metres_per_unit must be positive"):
        write_usd(recording, tmp_path / "a.usdc", metres_per_unit=0)
    assert not list(tmp_path.iterdir())
    with pytest.raises(BadInput, match="velocities must be those of the track's 61 frames"):
        wrong = Rigid(1.0, np.zeros(3), np.eye(3), np.zeros((2, 3)), np.zeros((2, 3)))
        Track("a", "ball", tools["octahedron"](), None, 0, np.zeros((61, 3)), np.zeros((61, 4)), rigid=wrong)


@pytest.fixture(scope="module")
def shattered():
    """A bar that a ball broke in a real world."""
    from deepfracture.breakers import BreakerOptions, make_breaker
    from deepfracture.fracture import material
    from deepfracture.geometry import builtin
    from deepfracture.world import simulate, throw_scene

    bar, plaster = builtin("bar"), material("plaster")
    scene = throw_scene("bar", bar, np.random.default_rng(1), material="plaster", speed=18.0)
    breaker = make_breaker("voronoi", bar, plaster, BreakerOptions(resolution=32))
    outcome = simulate(
        replace(scene, duration=0.8), [bar], breaker, np.random.default_rng(1), materials={"plaster": plaster}
    )
    return outcome.recording


def touch(stage, name):
    """Friction and restitution of a body's colliders, which all have the same."""
    found = set()
    for prim in Usd.PrimRange(stage.GetPrimAtPath(f"/deepfracture/{name}")):
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
            physics = UsdPhysics.MaterialAPI(material.GetPrim())
            assert physics.GetStaticFrictionAttr().Get() == physics.GetDynamicFrictionAttr().Get()
            found.add((physics.GetDynamicFrictionAttr().Get(), physics.GetRestitutionAttr().Get()))
    assert len(found) == 1
    return np.array(found.pop())


def test_the_mean_of_two_physics_materials_is_how_the_bodies_touched(recording, tmp_path):
    scene = Scene((Placed("bar", "plaster"),), floor=Floor(friction=0.7), friction=0.4, restitution=0.3)
    stage = opened(recording, tmp_path / "a.usda", "simulated", contact_material=scene.contact_material)
    names = dict(zip([track.kind for track in recording.tracks], body_names(recording), strict=True))
    piece, ball, floor = (touch(stage, names[kind]) for kind in ("fragment", "ball", "floor"))
    np.testing.assert_allclose((piece + ball) / 2, [0.4, 0.3], atol=1e-6)
    np.testing.assert_allclose((piece + floor) / 2, [0.7, 0.3], atol=1e-6)
    look, _ = UsdShade.MaterialBindingAPI(mesh_of(stage, names["ball"])).ComputeBoundMaterial()
    assert not look.GetPrim().HasAPI(UsdPhysics.MaterialAPI)


def test_a_scene_says_how_its_bodies_touch():
    blocks = (Block((0, 0, 0), (1, 1, 1), friction=0.1), Block((0, 0, 0), (1, 1, 1), friction=0.9))
    contact = Scene(
        (Placed("bar", "plaster"),), floor=Floor(friction=0.7), blocks=blocks, friction=0.4, restitution=0.3
    ).contact_material
    assert (contact.friction, contact.restitution) == (0.4, 0.3)
    assert contact.fixed_friction == {"floor": 0.7, "block0": 0.1, "block1": 0.9}


def started(stage):
    """What an engine makes of the file: the engine, and the number of each body in it."""
    from deepfracture.geometry import MassProperties
    from deepfracture.types import ContactMaterial
    from deepfracture.world.engine import BodyState
    from deepfracture.world.engines import open_engine

    scale = UsdPhysics.Scene(stage.GetPrimAtPath("/deepfracture/physics")).GetGravityMagnitudeAttr().Get() / 9.81
    engine, bodies = open_engine("rapier", gravity=9.81 * scale, contact=ContactMaterial(0.5, 0.2)), {}
    engine.add_floor(float(corners(stage, "floor", 0)[:, 2].max()), 0.6)
    for prim in stage.GetDefaultPrim().GetChildren():
        if not prim.HasAPI(UsdPhysics.RigidBodyAPI):
            continue
        body, mass = UsdPhysics.RigidBodyAPI(prim), UsdPhysics.MassAPI(prim)
        quat = mass.GetPrincipalAxesAttr().Get()
        turn = rotation_matrices(np.array([quat.GetReal(), *quat.GetImaginary()]))
        inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
        place = np.array(UsdGeom.Xformable(prim).GetLocalTransformation().ExtractTranslation())
        spin = np.radians(np.array(body.GetAngularVelocityAttr().Get()))
        motion = BodyState(place, np.array([1.0, 0, 0, 0]), np.array(body.GetVelocityAttr().Get(), float), spin)
        hulls = [np.array(UsdGeom.Mesh(c).GetPointsAttr().Get(), float) for c in prim.GetChildren() if "hull" in str(c)]
        own = MassProperties(mass.GetMassAttr().Get(), np.zeros(3), inertia)
        if hulls:
            bodies[prim.GetName()] = engine.add_body(hulls, own, motion)
        else:
            radius = np.ptp(corners(stage, prim.GetName(), 0), axis=0).max() / 2
            bodies[prim.GetName()] = engine.add_ball(radius, own.mass, motion)
    engine.prefer_stacking()
    return engine, bodies


@pytest.mark.slow
def test_a_simulation_that_reads_the_file_goes_on_as_the_recording_does(shattered, tmp_path):
    stage = opened(shattered, tmp_path / "a.usdc", "simulated")
    engine, bodies = started(stage)
    first, later, user = break_frame(shattered), 2, shattered.user_from_world
    for _ in range(later * 4):
        engine.step(1 / 240)
    off, moved = [], []
    for name, track in zip(body_names(shattered), shattered.tracks, strict=True):
        if name in bodies:
            before, after = (
                user[:3, :3] @ pivot_positions(track)[frame - track.start] + user[:3, 3]
                for frame in (first, first + later)
            )
            off.append(np.linalg.norm(engine.state(bodies[name]).position - after))
            moved.append(np.linalg.norm(after - before))
    engine.close()
    assert len(bodies) > 10 and np.mean(moved) > 0.05
    assert np.mean(off) < 0.3 * np.mean(moved)  # the engine has forgotten what pushed what: pieces part ways
