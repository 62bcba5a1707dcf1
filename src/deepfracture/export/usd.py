"""Universal Scene Description: to be played as recorded, or simulated on from the break."""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# pxr is compiled and says nothing of its types.

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepfracture._version import __version__
from deepfracture.export.names import body_names
from deepfracture.export.usd_looks import Looks
from deepfracture.geometry.rotations import continuous_quats, quat_between, quats_from_matrices, rotation_matrices
from deepfracture.recording.motion import break_frame, keys, pivot, pivot_positions, similarity
from deepfracture.recording.surface import track_surfaces
from deepfracture.runtime.extras import require
from deepfracture.runtime.files import atomic_file, atomic_folder
from deepfracture.types import BadInput, ContactMaterial, Floats, Recording, Rigid, Track

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

SUFFIXES = (".usdc", ".usda", ".usd", ".usdz")
ROOT = "/deepfracture"
FIXED = ("floor", "block")
"""Kinds of bodies that never move."""
JUST = 1e-3
"""Frames before it comes that a body is still away: scales are drawn out between samples, visibility is not."""
UPRIGHT_TOL = 1e-6
"""Cosine of the angle by which an axis may miss the vertical and count as up."""
EPOCH = 315619200
"""2 January 1980: no zip file is older, wherever on earth."""


def write_usd(
    recording: Recording,
    path: str | os.PathLike,
    *,
    gravity: float = 9.81,
    contact_material: ContactMaterial = ContactMaterial(),  # noqa: B008 - it cannot change
    metres_per_unit: float = 1.0,
) -> None:
    """Write every body with its motion, its looks and its physics, in the user's coordinates.

    .usdc and .usd are binary, .usda is text, .usdz is one package; textures of the former lie in a folder beside
    them, NAME_textures. The root prim has a variant set, `motion`:

    - `recorded`: poses sampled at the recording's frames, one time code a frame. A body is visible, and collides,
      while it exists, so the whole vanishes when its fragments appear; its mesh has no size before and after, for
      programs that read no visibility, as Blender. Bodies are kinematic: a simulation moves them as recorded, and
      they push what else there is.
    - `simulated`: the frame of the first break, dynamic: the bodies that exist then, with their velocities.

    A body is an Xform (fragments: fragment_000 ...) about its centre of mass, whose axes are those of the stage at the
    break; so velocities read the same in its own space and in the world's. Under it lie the mesh, with a subset for
    each material of the user's file and one for the crack surface ("inner"), and as guides the convex hulls that we
    collide with ourselves. A track without `rigid` is its own convex hull, and its mass is left to the simulation.
    Colliders have physics materials such that PhysX, which takes the mean of the two that touch, comes to `touch`.

    Up is the stage's z where it is the user's, else y; the user's coordinates are turned only if up is neither there,
    and then as in `write_glb`.

    Args:
        recording: What happened.
        path: Where to; see above for its suffix.
        gravity: Downwards [m/s^2], in the world of the recording.
        contact_material: Friction and restitution of its contacts.
        metres_per_unit: How long a unit of the user's coordinates is. As in glTF, a metre if nobody says. It only
            labels the file: the body that was simulated is two metres long, and gravity and velocities are such that
            it moves in the user's coordinates as it did then.

    Raises BadInput if the suffix is another one, or where usd-core is not installed."""
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise BadInput(f"{path}: a USD file ends in {', '.join(SUFFIXES)}")
    require("pxr.Usd", extra="usd", to="write USD")
    package = path.suffix == ".usdz"
    folder = "textures" if package else f"{path.stem}_textures"
    stage = _stage(recording, metres_per_unit)
    looks = Looks(stage, f"{ROOT}/_materials", folder)
    _fill(stage, looks, recording, gravity, contact_material)
    if package:
        _write_package(stage, looks.textures, folder, path)
        return
    if looks.textures:
        with atomic_folder(path.parent / folder) as temporary:
            _write_textures(looks.textures, temporary)
    with atomic_file(path) as temporary:
        stage.GetRootLayer().Export(str(temporary))


def _write_textures(textures: dict[str, bytes], folder: Path) -> None:
    for name, data in textures.items():
        (folder / name).write_bytes(data)


def _write_package(stage: Usd.Stage, textures: dict[str, bytes], folder: str, path: Path) -> None:
    from pxr import Sdf, UsdUtils

    with atomic_file(path) as temporary:
        source = temporary.parent / "packed" / f"{path.stem}.usdc"
        (source.parent / folder).mkdir(parents=True)
        _write_textures(textures, source.parent / folder)
        stage.GetRootLayer().Export(str(source))
        for file in source.parent.rglob("*"):
            os.utime(file, (EPOCH, EPOCH))  # which the package keeps: the same recording is to give the same bytes
        UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(source)), str(temporary))


def _stage(recording: Recording, metres_per_unit: float) -> Usd.Stage:
    """An empty stage with its units and times, and the root prim."""
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics

    if not 0 < metres_per_unit < np.inf:
        raise BadInput(f"metres_per_unit must be positive and finite, got {metres_per_unit}")
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().comment = f"deepfracture {__version__}"
    rate = round(1 / recording.frame_time, 6)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(max(recording.frames - 1, 0))
    UsdGeom.SetStageUpAxis(stage, "Z" if _z_is_up(recording) else "Y")
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind("component")
    stage.DefinePrim(Sdf.Path(f"{ROOT}/_materials"), "Scope")
    return stage


def _z_is_up(recording: Recording) -> bool:
    return similarity(recording)[1][2, 2] > 1 - UPRIGHT_TOL


@dataclass(frozen=True, eq=False)
class _Frame:
    """The way from the world to the stage."""

    scale: float
    turn: Floats
    """Rotation, shape (3, 3)."""
    shift: Floats

    @staticmethod
    def of(recording: Recording) -> _Frame:
        scale, turn, shift = similarity(recording)
        if not _z_is_up(recording):
            upright = rotation_matrices(quat_between(turn[:, 2], np.array([0.0, 1.0, 0.0])))
            turn, shift = upright @ turn, upright @ shift
        return _Frame(scale, turn, shift)

    def places(self, positions: Floats) -> Floats:
        return self.scale * positions @ self.turn.T + self.shift


def _fill(
    stage: Usd.Stage, looks: Looks, recording: Recording, gravity: float, contact_material: ContactMaterial
) -> None:
    """Everything under the root."""
    from pxr import Gf, UsdPhysics

    frame, start = _Frame.of(recording), break_frame(recording) or 0
    scene = UsdPhysics.Scene.Define(stage, f"{ROOT}/physics")
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*(-frame.turn[:, 2]).tolist()))
    scene.CreateGravityMagnitudeAttr(gravity * frame.scale)
    root = stage.GetPrimAtPath(ROOT)
    motion = root.GetVariantSets().AddVariantSet("motion")
    bodies = []
    for track, name in zip(recording.tracks, body_names(recording), strict=True):
        if len(track.positions):  # else it broke before the first frame
            bodies.append(_Body(stage, looks, f"{ROOT}/{name}", track, frame, start, recording.frames))
    _roughen(stage, bodies, contact_material)
    moving = [body for body in bodies if body.moves]
    for variant in ("recorded", "simulated"):  # the second takes prims away, so it comes last
        motion.AddVariant(variant)
        motion.SetVariantSelection(variant)
        with motion.GetVariantEditContext():
            for body in moving:
                body.record() if variant == "recorded" else body.release()
    motion.SetVariantSelection("recorded")


def _roughen(stage: Usd.Stage, bodies: Sequence[_Body], contact_material: ContactMaterial) -> None:
    """A physics material for every collider, one for all that have the same coefficients."""
    from pxr import UsdPhysics, UsdShade

    made: dict[float, UsdShade.Material] = {}
    for body in bodies:
        friction = contact_material.friction
        if body.track.name in contact_material.fixed_friction:
            friction = max(2 * contact_material.fixed_friction[body.track.name] - contact_material.friction, 0.0)
        if friction not in made:
            made[friction] = UsdShade.Material.Define(stage, f"{ROOT}/_materials/touch_{len(made)}")
            physics = UsdPhysics.MaterialAPI.Apply(made[friction].GetPrim())
            physics.CreateStaticFrictionAttr(friction)
            physics.CreateDynamicFrictionAttr(friction)
            physics.CreateRestitutionAttr(contact_material.restitution)
        for collider in body.colliders:
            binding = UsdShade.MaterialBindingAPI.Apply(collider.GetPrim())
            binding.Bind(made[friction], UsdShade.Tokens.weakerThanDescendants, "physics")


class _Body:
    """One body: what is the same in every variant is there once it is made."""

    def __init__(
        self, stage: Usd.Stage, looks: Looks, path: str, track: Track, frame: _Frame, start: int, frames: int
    ) -> None:
        from pxr import UsdGeom

        self.track, self.frame = track, frame
        self.alive = track.start <= start < track.stop
        self.still = start - track.start if self.alive else 0
        """The frame of the track in which its axes are those of the stage."""
        self.moves = track.kind not in FIXED
        self.steps = {0: track.start == 0, track.start: True} | ({track.stop: False} if track.stop < frames else {})
        """Whether it is there, from which frame on."""
        turns = frame.turn @ rotation_matrices(continuous_quats(track.quats_wxyz))
        self.axes = turns[self.still]
        self.places = frame.places(pivot_positions(track))
        xform = UsdGeom.Xform.Define(stage, path)
        self.prim = xform.GetPrim()
        self.prim.SetCustomDataByKey("deepfracture:kind", track.kind)
        self.place = xform.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
        self.turn = xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
        self.quats = continuous_quats(quats_from_matrices(turns @ self.axes.T))
        parts = track_surfaces(track)
        mesh = looks.mesh(f"{path}/{self.prim.GetName()}_mesh", parts, self.own, self.axes)
        self.mesh = mesh
        self.colliders = self._colliders(stage, path, mesh)
        if self.moves:
            self._weigh()
        else:
            self._pose(0)

    def own(self, points: NDArray) -> Floats:
        """Points of the mesh frame in the body's own, which has the user's lengths."""
        return self.frame.scale * (points - pivot(self.track)) @ self.axes.T

    def _colliders(self, stage: Usd.Stage, path: str, mesh: UsdGeom.Mesh) -> list[Any]:
        from pxr import UsdGeom

        rigid, kind = self.track.rigid, self.track.kind
        if rigid is None or not rigid.hulls:
            how = "boundingSphere" if kind == "ball" else "none" if kind in FIXED else "convexHull"
            return [_collider(mesh, how)]
        found = []
        for number, points in enumerate(rigid.hulls):
            hull = UsdGeom.Mesh.Define(stage, f"{path}/hull_{number:02d}")
            _convex(hull, self.own(points))
            found.append(_collider(hull, "convexHull"))
        return found

    def _weigh(self) -> None:
        """A rigid body, with its mass where that is known."""
        from pxr import Gf, UsdPhysics

        UsdPhysics.RigidBodyAPI.Apply(self.prim)
        rigid = self.track.rigid
        if rigid is None:
            return
        moments, axes = _principal(rigid, self.axes)
        mass = UsdPhysics.MassAPI.Apply(self.prim)
        mass.CreateMassAttr(rigid.mass)
        mass.CreateCenterOfMassAttr(Gf.Vec3f(0.0))
        mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*(self.frame.scale**2 * moments).tolist()))
        mass.CreatePrincipalAxesAttr(Gf.Quatf(*quats_from_matrices(axes).tolist()))

    def _pose(self, k: int) -> None:
        """It stands where it was in frame `k` of its track."""
        from pxr import Gf

        self.place.Set(Gf.Vec3d(*self.places[k].tolist()))
        self.turn.Set(Gf.Quatd(*self.quats[k].tolist()))

    def record(self) -> None:
        """Moves as recorded, and is there while it existed."""
        from pxr import Gf, UsdPhysics

        body, start = UsdPhysics.RigidBodyAPI(self.prim), self.track.start
        body.CreateKinematicEnabledAttr(True)
        for k in keys(self.places / self.frame.scale).tolist():
            self.place.Set(Gf.Vec3d(*self.places[k].tolist()), start + k)
        for k in keys(self.quats).tolist():
            self.turn.Set(Gf.Quatd(*self.quats[k].tolist()), start + k)
        if len(self.steps) > 1:
            self._come_and_go()

    def _come_and_go(self) -> None:
        """Seen, and met by others, while it existed."""
        from pxr import Gf, UsdGeom

        seen = UsdGeom.Imageable(self.prim).CreateVisibilityAttr()
        size = self.mesh.AddScaleOp(UsdGeom.XformOp.PrecisionFloat)
        enabled = [collider.CreateCollisionEnabledAttr(self.steps[0]) for collider in self.colliders]
        for time, there in self.steps.items():
            seen.Set("inherited" if there else "invisible", time)
            size.Set(Gf.Vec3f(float(there)), time)
            if time > 0:
                size.Set(Gf.Vec3f(float(not there)), time - JUST)
            for attribute in enabled:
                attribute.Set(there, time)

    def release(self) -> None:
        """Free to move from the break on, if it existed then."""
        from pxr import Gf, UsdPhysics

        if not self.alive:
            self.prim.SetActive(False)
            return
        self._pose(self.still)
        body, rigid = UsdPhysics.RigidBodyAPI(self.prim), self.track.rigid
        body.CreateKinematicEnabledAttr(False)
        if rigid is not None:
            velocity = self.frame.scale * self.frame.turn @ rigid.velocities[self.still]
            angular_velocity = np.degrees(self.frame.turn @ rigid.angular_velocities[self.still])
            body.CreateVelocityAttr(Gf.Vec3f(*velocity.tolist()))
            body.CreateAngularVelocityAttr(Gf.Vec3f(*angular_velocity.tolist()))


def _collider(mesh: UsdGeom.Mesh, how: str) -> Any:
    from pxr import UsdPhysics

    collider = UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(how)
    return collider


def _convex(mesh: UsdGeom.Mesh, points: Floats) -> None:
    """The hull of some points, as a guide that no renderer shows."""
    from pxr import UsdGeom, Vt
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points, qhull_options="QJ")
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    used, packed = np.unique(faces, return_inverse=True)
    corners = Vt.Vec3fArray.FromNumpy(points[used].astype(np.float32))
    mesh.CreatePointsAttr(corners)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(packed.ravel().astype(np.int32)))
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(corners))
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePurposeAttr("guide")


def _principal(rigid: Rigid, axes: Floats) -> tuple[Floats, Floats]:
    """Principal moments [kg m^2] and the rotation to the body's own axes from the principal ones, shape (3, 3)."""
    moments, turn = np.linalg.eigh(axes @ rigid.inertia @ axes.T)
    if np.linalg.det(turn) < 0:
        turn[:, 0] *= -1
    return moments, turn
