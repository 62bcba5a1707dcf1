"""The nouns of deepfracture: frozen, validated values that every room shares. numpy only.

Frames. A `Shape` lives in its *body frame*: the longest side of its box is 2, the box is centred
on the origin, and one unit is one metre. `Shape.to_user` leads back to the file's own coordinates.
Quaternions are (w, x, y, z). Everything is SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

RESOLUTIONS = (32, 64, 128, 256)


class BadInput(ValueError):
    """A file or value that cannot be used. The message is one line: which, what is wrong, what to do."""

    status: ClassVar[int] = 2
    """With which the program ends."""


class NoSolution(RuntimeError):
    """A computation that came to no result. The message is one line: which, and why."""

    status: ClassVar[int] = 1
    """With which the program ends."""


def _array(name: str, value: ArrayLike, dtype: type, shape: tuple[int | None, ...]) -> NDArray:
    """`value` as a read-only contiguous array of `shape` (None: any length)."""
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.ndim != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        want = ", ".join("n" if n is None else str(n) for n in shape)
        raise BadInput(f"{name} must have shape ({want}), got {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise BadInput(f"{name} must be finite, got NaN or infinite values")
    array = array.view()
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh."""

    vertices: Floats
    """Positions [m], shape (n, 3)."""
    faces: Ints
    """Vertex indices, counter-clockwise seen from outside, shape (m, 3)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _array("vertices", self.vertices, float, (None, 3)))
        object.__setattr__(self, "faces", _array("faces", self.faces, np.int64, (None, 3)))
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise BadInput(f"faces must index {len(self.vertices)} vertices, got {self.faces.max()}")

    @property
    def triangles(self) -> Floats:
        """Corner positions, shape (m, 3, 3)."""
        return self.vertices[self.faces]

    @property
    def bounds(self) -> Floats:
        """Lower and upper corner of the box, shape (2, 3)."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def area_vectors(self) -> Floats:
        """Outward normals times face area, shape (m, 3)."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return 0.5 * np.cross(b - a, c - a)

    @property
    def volume(self) -> float:
        """Enclosed volume [m^3], by the divergence theorem."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)

    def moved(self, scale: float, offset: ArrayLike) -> Mesh:
        return Mesh(self.vertices * scale + np.asarray(offset, float), self.faces)


@dataclass(frozen=True, eq=False)
class Finish:
    """What part of a surface is painted with: one material of the user's file."""

    name: str = ""
    """As in the file; empty: it has none."""
    colour: tuple[int, int, int] | None = None
    """sRGB, 0..255; None: nobody said."""
    texture: bytes | None = None
    """A whole PNG or JPEG file that `Appearance.uv` looks up, repeated beyond its edges; takes the colour's place."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """How the m faces of a mesh look: what each corner has, and what each face is painted with."""

    finish: Labels
    """For each face its index in `finishes`, shape (m,)."""
    finishes: tuple[Finish, ...] = (Finish(),)
    normals: Floats32 | None = None
    """Outward unit normals of the corners, shape (m, 3, 3); None: by the creases of the mesh."""
    uv: Floats32 | None = None
    """Texture coordinates of the corners, v upward, shape (m, 3, 2)."""
    colours: NDArray[np.uint8] | None = None
    """sRGB and opacity of the corners, 0..255, which tint the finish, shape (m, 3, 4)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "finish", _array("finish", self.finish, np.int32, (None,)))
        m = len(self.finish)
        for name, dtype, width in (("normals", np.float32, 3), ("uv", np.float32, 2), ("colours", np.uint8, 4)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _array(name, getattr(self, name), dtype, (m, 3, width)))
        if m and not 0 <= self.finish.min() <= self.finish.max() < len(self.finishes):
            raise BadInput(f"finish must index {len(self.finishes)} finishes, got {self.finish.max()}")


@dataclass(frozen=True, eq=False)
class Shape:
    """A closed mesh of one body in its body frame: longest side 2, box centred on the origin."""

    name: str
    mesh: Mesh
    scale: float = 1.0
    """User length per body-frame unit."""
    centre: Floats = field(default_factory=lambda: np.zeros(3))
    """Centre of the box in user coordinates, shape (3,)."""
    size: float = 1.0
    """Metres per body-frame unit: 1, except for a fragment that may break again."""
    whole: Shape | None = None
    """What it is a fragment of."""
    appearance: Appearance | None = None
    """How its faces look; None: plain."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", _array("centre", self.centre, float, (3,)))
        if not self.scale > 0 or not self.size > 0:
            raise BadInput(f"scale and size must be positive, got {self.scale} and {self.size}")
        if self.appearance is not None and len(self.appearance.finish) != len(self.mesh.faces):
            have, want = len(self.appearance.finish), len(self.mesh.faces)
            raise BadInput(f"appearance must be that of the mesh's {want} faces, got {have}")

    def to_user(self, points: ArrayLike) -> Floats:
        """Body-frame points in the coordinates of the user's file."""
        return np.asarray(points, float) * self.scale + self.centre

    def to_body(self, points: ArrayLike) -> Floats:
        """Points of the user's file in the body frame: the inverse of `to_user`."""
        return (np.asarray(points, float) - self.centre) / self.scale


@dataclass(frozen=True)
class Material:
    """A brittle material and how much it varies in space."""

    name: str
    young: float
    """Young's modulus [Pa]."""
    poisson: float
    density: float
    """[kg/m^3]"""
    strength: float
    """Tensile strength sigma_0 [Pa]."""
    toughness: float
    """Mode-I fracture toughness K_Ic [Pa sqrt(m)]."""
    compressive_factor: float
    """Compressive over tensile strength."""
    variation_spread: float = 0.25
    """Standard deviation of the logarithm of strength and toughness in space."""
    variation_length: float = 0.2
    """Correlation length of that variation [m]."""
    roughness: float = 0.02
    """Amplitude of the small-scale waviness of crack surfaces [m]."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "poisson":
                if not -1 < value < 0.5:
                    raise BadInput(f"poisson must lie in (-1, 0.5), got {value}")
            elif f.name in ("variation_spread", "roughness"):
                if not 0 <= value < np.inf:
                    raise BadInput(f"{f.name} must be zero or more, got {value}")
            elif f.name != "name" and not 0 < value < np.inf:
                raise BadInput(f"{f.name} must be positive and finite, got {value}")

    @property
    def rayleigh_speed(self) -> float:
        """Speed of Rayleigh surface waves [m/s] (Freund 1990, eq. 2.6: c_R / c_s as a fit in nu)."""
        nu = self.poisson
        shear = self.young / (2 * (1 + nu))
        return float((0.862 + 1.14 * nu) / (1 + nu) * np.sqrt(shear / self.density))


@dataclass(frozen=True, eq=False)
class Impact:
    """The impulses of one collision on one body, strongest first (paper: V = [p d I], J)."""

    position: Floats
    """Contact points [m], body frame, shape (k, 3)."""
    direction: Floats
    """Unit direction of each impulse on the body, body frame, shape (k, 3)."""
    magnitude: Floats
    """Impulses [N s], descending, shape (k,)."""
    normal: Floats
    """Outward unit normal of the body's surface at each contact, body frame, shape (k, 3)."""
    speed: float
    """Closing speed at the strongest contact [m/s]."""
    radius: float
    """Radius of curvature of what struck, at the contact [m]."""

    def __post_init__(self) -> None:
        k = len(np.atleast_1d(self.magnitude))
        for name in ("position", "direction", "normal"):
            object.__setattr__(self, name, _array(name, getattr(self, name), float, (k, 3)))
        object.__setattr__(self, "magnitude", _array("magnitude", np.atleast_1d(self.magnitude), float, (None,)))
        if k == 0 or (self.magnitude <= 0).any() or (np.diff(self.magnitude) > 0).any():
            raise BadInput(f"magnitude must be positive and descending, got {self.magnitude}")
        for name in ("direction", "normal"):
            lengths = np.linalg.norm(getattr(self, name), axis=1)
            if np.abs(lengths - 1).max() > 1e-6:
                raise BadInput(f"{name} must be unit vectors, got lengths {lengths}")
        if not self.speed > 0 or not self.radius > 0:
            raise BadInput(f"speed and radius must be positive, got {self.speed} and {self.radius}")


@dataclass(frozen=True)
class Grid:
    """r^3 voxels that tile [-1, 1]^3. It alone turns indices into positions and back."""

    resolution: int

    def __post_init__(self) -> None:
        if self.resolution not in RESOLUTIONS:
            raise BadInput(f"resolution must be one of {RESOLUTIONS}, got {self.resolution}")

    @property
    def spacing(self) -> float:
        return 2.0 / self.resolution

    @property
    def shape(self) -> tuple[int, int, int]:
        return (self.resolution, self.resolution, self.resolution)

    def to_world(self, index: ArrayLike) -> Floats:
        """Body-frame position of voxel centres (or of fractional indices)."""
        return (np.asarray(index, float) + 0.5) * self.spacing - 1.0

    def to_index(self, position: ArrayLike) -> Floats:
        """Fractional index of body-frame positions: the inverse of `to_world`."""
        return (np.asarray(position, float) + 1.0) / self.spacing - 0.5

    def centres(self) -> Floats:
        """All voxel centres, shape (r, r, r, 3)."""
        axis = self.to_world(np.arange(self.resolution))
        return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


@dataclass(frozen=True, eq=False)
class FracturePattern:
    """Which fragment each voxel belongs to, with the sub-voxel position of the cracks between them."""

    grid: Grid
    labels: Labels
    """Fragment 1..n of each voxel, 0 outside the shape, shape (r, r, r)."""
    distance: Floats32
    """Unsigned distance [m] from each voxel centre inside to the nearest crack surface, shape (r, r, r).
    On a grid edge between two labels the crack crosses at d_a / (d_a + d_b) of the way from a to b."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", _array("labels", self.labels, np.int32, self.grid.shape))
        object.__setattr__(self, "distance", _array("distance", self.distance, np.float32, self.grid.shape))
        if self.labels.min() < 0:
            raise BadInput(f"labels must be zero or more, got {self.labels.min()}")
        if self.distance.min() < 0:
            raise BadInput(f"distance must be zero or more, got {self.distance.min()}")

    @property
    def count(self) -> int:
        """Number of fragments."""
        return len(np.unique(self.labels[self.labels > 0]))


@dataclass(frozen=True, eq=False)
class Volume:
    """A GS-SDF (paper, eq. 4): distance to the nearest fragment boundary inside, minus the
    distance to the original surface outside."""

    grid: Grid
    values: Floats32
    """[m], shape (r, r, r)."""
    cuts: NDArray[np.uint8] | None = None
    """Bits 1, 2, 4: a crack parts the voxel from the next one along x, y, z, shape (r, r, r). None: not known,
    as in the paper; what is parted then follows from the values, with some loss."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _array("values", self.values, np.float32, self.grid.shape))
        if self.cuts is not None:
            object.__setattr__(self, "cuts", _array("cuts", self.cuts, np.uint8, self.grid.shape))


@dataclass(frozen=True, eq=False)
class Fragment:
    """One closed, 2-manifold piece in the body frame of the shape it broke from."""

    mesh: Mesh
    source: Ints
    """For each face the triangle of the original mesh that it lies in, or -1 on a crack surface, shape (m,)."""
    mass: float
    """[kg]"""
    centre: Floats
    """Centre of mass [m], shape (3,)."""
    inertia: Floats
    """Inertia tensor about the centre of mass, body axes [kg m^2], shape (3, 3)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", _array("source", self.source, np.int64, (len(self.mesh.faces),)))
        object.__setattr__(self, "centre", _array("centre", self.centre, float, (3,)))
        object.__setattr__(self, "inertia", _array("inertia", self.inertia, float, (3, 3)))
        if not self.mass > 0:
            raise BadInput(f"mass must be positive, got {self.mass}")

    @property
    def volume(self) -> float:
        return self.mesh.volume


@dataclass(frozen=True, eq=False)
class Fragments:
    """What one shape broke into."""

    pieces: tuple[Fragment, ...]

    def __len__(self) -> int:
        return len(self.pieces)

    def __iter__(self) -> Iterator[Fragment]:
        return iter(self.pieces)

    @property
    def volume(self) -> float:
        return sum(piece.volume for piece in self.pieces)


class Breaker(Protocol):
    """The one seam between the world and whatever knows how things break.

    Returns None when the collision does not break the shape. A fragment that may break again comes as a
    shape with a `size` of its own and an impact scaled to it (`world.refracture`)."""

    def __call__(self, shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None: ...


@dataclass(frozen=True, eq=False)
class Rigid:
    """What another engine needs to take a body over from a recording, at any of its n frames."""

    mass: float
    """[kg]"""
    centre: Floats
    """Centre of mass in the mesh frame [m], shape (3,)."""
    inertia: Floats
    """About the centre of mass, axes of the mesh frame [kg m^2], shape (3, 3)."""
    velocities: Floats
    """Of the centre of mass in the world [m/s], shape (n, 3)."""
    angular_velocities: Floats
    """In the world [rad/s], shape (n, 3)."""
    hulls: tuple[Floats, ...] = ()
    """Convex parts that stand for it in collisions: points in the mesh frame, each (k, 3); none for a ball."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", _array("centre", self.centre, float, (3,)))
        object.__setattr__(self, "inertia", _array("inertia", self.inertia, float, (3, 3)))
        object.__setattr__(self, "velocities", _array("velocities", self.velocities, float, (None, 3)))
        shape = (len(self.velocities), 3)
        object.__setattr__(
            self, "angular_velocities", _array("angular_velocities", self.angular_velocities, float, shape)
        )
        if not self.mass > 0:
            raise BadInput(f"mass must be positive, got {self.mass}")


@dataclass(frozen=True, eq=False)
class Track:
    """One body of a recording: its mesh and where it was while it existed."""

    name: str
    kind: str
    """"shape" (whole), "fragment", "ball", "floor" or "block"."""
    mesh: Mesh
    """In the body's own frame; poses carry this frame to the world."""
    source: Ints | None
    """For fragments `Fragment.source`, else None."""
    start: int
    """First frame in which the body exists."""
    positions: Floats
    """Origin of the mesh frame in the world, frames start .. start+n-1, shape (n, 3)."""
    quats_wxyz: Floats
    """Rotation world_from_body, shape (n, 4)."""
    whole: Shape | None = None
    """The shape that it is, or, for fragments, that `source` refers to: it knows how the surface looks."""
    rigid: Rigid | None = None
    """None: it stays where it is, or nobody knows its mass."""

    def __post_init__(self) -> None:
        n = len(self.positions)
        if self.rigid is not None and len(self.rigid.velocities) != n:
            raise BadInput(f"velocities must be those of the track's {n} frames, got {len(self.rigid.velocities)}")
        object.__setattr__(self, "positions", _array("positions", self.positions, float, (n, 3)))
        object.__setattr__(self, "quats_wxyz", _array("quats_wxyz", self.quats_wxyz, float, (n, 4)))
        if self.kind not in ("shape", "fragment", "ball", "floor", "block"):
            raise BadInput(f"kind must be shape, fragment, ball, floor or block, got {self.kind!r}")

    @property
    def stop(self) -> int:
        """One past the last frame in which the body exists."""
        return self.start + len(self.positions)


@dataclass(frozen=True)
class ContactMaterial:
    """Friction and restitution of the contacts in a scene."""

    friction: float = 0.5
    """Coulomb coefficient between two moving bodies."""
    restitution: float = 0.2
    """Separation speed over approach speed, in every contact."""
    fixed_friction: Mapping[str, float] = field(default_factory=lambda: {"floor": 0.6})
    """Coulomb coefficient between them and each fixed body, by the name of its track."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Every body's motion: what export, viewer and evaluate read. World frame: z up, metres."""

    frame_time: float
    """Seconds between frames."""
    tracks: tuple[Track, ...]
    user_from_world: Floats = field(default_factory=lambda: np.eye(4))
    """Similarity (rotation, uniform scale, translation) to the user's coordinates, shape (4, 4)."""

    @property
    def frames(self) -> int:
        return max((track.stop for track in self.tracks), default=0)

    @property
    def duration(self) -> float:
        return max(self.frames - 1, 0) * self.frame_time
