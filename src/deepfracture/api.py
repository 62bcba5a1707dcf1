"""The Python interface: everything that the command line does, in a few functions over the same nouns.

    import numpy as np
    import deepfracture as df

    pot = df.load("pot")
    breaker = df.breaker("learned", pot, material="plaster")
    blow = df.hit(pot, point=(1, 0, 0.3), direction=(-1, 0, 0), impulse=2500, speed=10)
    fragments = breaker(pot, blow, np.random.default_rng(0))
    df.save(fragments, "pieces", shape=pot)

    outcome = df.throw(pot, breaker, speed=12)
    df.save(outcome, "pot.glb")

Every function raises `BadInput`, one line that says what is wrong and what to do, for a value or file that cannot be
used. SI everywhere. A shape lives in its body frame, two metres long; `Shape.to_body` and `Shape.to_user` lead there
from the coordinates of its file, and back.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from deepfracture.breakers import REFRACTURING, BreakerOptions, make_breaker
from deepfracture.breakers.options import RENAMED
from deepfracture.dataset.options import SimulateOptions
from deepfracture.fracture import critical_stress
from deepfracture.fracture import material as preset_material
from deepfracture.geometry import closest_points, load_shape
from deepfracture.learn.options import TrainOptions
from deepfracture.runtime.options import with_changes
from deepfracture.types import BadInput, Breaker, Floats, Fragments, Impact, Material, Recording, Shape
from deepfracture.world import UPRIGHT, Collision, Outcome, Scene, save_scene
from deepfracture.world import simulate as run_world
from deepfracture.world import throw_scene as built_scene

if TYPE_CHECKING:
    from deepfracture.dataset import Dataset
    from deepfracture.learn.report import TrainingReport

PathLike: TypeAlias = "str | os.PathLike[str]"
DOWNWARD = 0.15
"""A ball with a heading falls so far for each metre along [m], before gravity."""
ON_SURFACE = 0.01
"""A ray may start this far below the surface and still hit it there [m]."""
EDGE = 1e-9
"""Barycentric tolerance: a ray through an edge meets one of its faces."""


def load(name: PathLike, *, repair: bool = False) -> Shape:
    """A shape from a mesh file (OBJ, STL, PLY, GLB, GLTF, OFF), or a built-in one by its name.

    Args:
        name: The file, or one of `BUILTIN`.
        repair: Close what is open, turn what is inside out, join shells that overlap.

    Returns:
        The shape in its body frame: longest side of its box 2, centred, with the looks that the file gives it.

    Raises:
        BadInput: There is no such file or shape, or the mesh is not the closed surface of one body.

    Examples:
        >>> statue = df.load("statue.obj", repair=True)
        >>> statue.scale, statue.centre     # leads back to the file's own coordinates, as `statue.to_user` does
    """
    return load_shape(str(name), repair=repair)


def breaker(
    name: str,
    shape: Shape,
    options: BreakerOptions | None = None,
    *,
    material: str | Material = "plaster",
    **changes: Any,
) -> Breaker:
    """A way for `shape` to break: call it with the shape, an `Impact` and a generator.

    Args:
        name: One of `BREAKERS`: learned, physical, voronoi, nearest, cvd or random.
        shape: What it is to break; a `learned` one knows no other.
        options: What it is made from, and how finely it breaks; the default ones if not given.
        material: One of `MATERIALS`, or a `Material` of your own.
        changes: Fields of `BreakerOptions` by name: model, dataset, resolution, roughness, max_faces.

    Returns:
        A `Breaker`: fragments in the body frame, or None where the impact breaks nothing.

    Raises:
        BadInput: No such breaker, material or option; no model or data set for the shape.

    Examples:
        >>> breaker = df.breaker("physical", statue, material="stone", resolution=128)
        >>> fragments = breaker(statue, blow, np.random.default_rng(0))
    """
    options = with_changes(options or BreakerOptions(), changes, renamed=RENAMED)
    return make_breaker(name, shape, _material(material), options)


def hit(
    shape: Shape,
    point: ArrayLike,
    direction: ArrayLike | None = None,
    *,
    impulse: float | ArrayLike,
    speed: float,
    radius: float = 0.2,
) -> Impact:
    """A blow on the surface of `shape`: along a ray, or straight in at the nearest place.

    Args:
        shape: What is hit.
        point: Body frame [m], shape (3,), or (k, 3) for k blows at once. From a file's coordinates: `shape.to_body`.
        direction: Of the impulse on the body, body frame, any length, same shape as `point`: the blow falls where the
            ray from `point` first enters the shape. By default it falls at the place nearest to `point`, straight
            into the surface.
        impulse: [N s], one, or k of them. A steel ball of 0.2 m gives a plaster pot some 280 times its speed.
        speed: Of what strikes, at the contact [m/s]; with the radius it makes the blow short or long.
        radius: Of what strikes [m].

    Returns:
        An `Impact`, strongest blow first.

    Raises:
        BadInput: The ray misses, or a value is no number, or not positive.

    Examples:
        >>> blow = df.hit(pot, (1, 0, 0.3), impulse=2500, speed=10)
        >>> blow = df.hit(statue, statue.to_body(point_in_the_file), (0, 0, -1), impulse=2500, speed=10)
    """
    points = _rows("point", point)
    if direction is None:
        near = closest_points(shape.mesh, points)
        places, normals = near.points, _normals(shape, near.faces)
        along = -normals
    else:
        along = _rows("direction", direction)
        lengths = np.linalg.norm(along, axis=1, keepdims=True)
        if along.shape != points.shape or not (lengths > 0).all():
            raise BadInput(f"direction must be one for each point and not zero, got {direction}")
        along = along / lengths
        struck = [_entry(shape, p, d) for p, d in zip(points, along, strict=True)]
        places, normals = np.array([place for place, _ in struck]), _normals(shape, [face for _, face in struck])
    sizes = np.atleast_1d(np.asarray(impulse, float))
    if sizes.shape != (len(points),):
        raise BadInput(f"impulse must be one for each of {len(points)} points, got {impulse}")
    order = np.argsort(-sizes, kind="stable")
    return Impact(places[order], along[order], sizes[order], normals[order], speed, radius)


def stress(shape: Shape, impact: Impact, material: str | Material) -> float:
    """The paper's sigma_1 = I d.n / (A Δt) [Pa] under the strongest blow: the shape holds unless it exceeds the
    material's `strength`.

    Examples:
        >>> df.stress(pot, blow, "plaster") / df.material("plaster").strength
    """
    area = float(np.linalg.norm(shape.mesh.area_vectors, axis=1).sum())
    return critical_stress(impact, _material(material), area)


def throw(
    shape: Shape,
    breaker: Breaker,
    *,
    speed: float = 9.0,
    radius: float = 0.2,
    heading: float | None = None,
    up: str = "z",
    material: str | Material | None = None,
    engine: str = "rapier",
    seed: int = 0,
) -> Outcome:
    """Throw a steel ball at the standing shape and follow all pieces until they lie still.

    `run(throw_scene(shape, ...), breaker)`: the same motion as `deepfracture shatter` with the same options.

    Args:
        shape: What stands on the floor.
        breaker: From `breaker`, or your own: any function of (Shape, Impact, Generator).
        speed: At which the ball is launched, 4 m away [m/s].
        radius: Of the ball [m].
        heading: Where it comes from, degrees around the vertical; by default drawn from the seed.
        up: Axis of the file that points up: x, y or z.
        material: For the mass; by default what the breaker was made for.
        engine: rapier or bullet.
        seed: Of what is drawn. The same seed, the same motion.

    Returns:
        An `Outcome`: `recording`, all `collisions`, and `breaks`, those that broke something (none: it held).

    Raises:
        BadInput: A value out of its range, or no material is known.

    Examples:
        >>> outcome = df.throw(pot, breaker, speed=12)
        >>> [len(collision.fragments) for collision in outcome.breaks]
    """
    made_of = getattr(breaker, "material", None) if material is None else _material(material)
    if not isinstance(made_of, Material):
        raise BadInput("material must be given: this breaker does not say what it was made for")
    scene = throw_scene(
        shape, speed=speed, radius=radius, heading=heading, up=up, material=made_of.name, engine=engine, seed=seed
    )
    return run(scene, breaker, shapes=[shape], materials={made_of.name: made_of})


def throw_scene(
    shape: Shape,
    *,
    name: str | None = None,
    repair: bool = False,
    speed: float = 9.0,
    radius: float = 0.2,
    heading: float | None = None,
    up: str = "z",
    material: str = "plaster",
    engine: str = "rapier",
    seed: int = 0,
) -> Scene:
    """The scene of `throw`, as data: to change with `dataclasses.replace`, to `save`, to `run`.

    Args:
        shape: What stands on the floor.
        name: What the scene calls it: a built-in name or its file. By default the shape's own name.
        repair: Whether its file has to be repaired by whoever loads the scene.
        speed: At which the ball is launched, 4 m away [m/s].
        radius: Of the ball [m].
        heading: Where it comes from, degrees around the vertical; by default drawn from the seed.
        up: Axis of the file that points up: x, y or z.
        material: Name of a material.
        engine: rapier or bullet.
        seed: Of what is drawn.

    Raises:
        BadInput: A value out of its range.

    Examples:
        >>> scene = dataclasses.replace(df.throw_scene(pot), gravity=1.62)    # on the moon
    """
    if up not in UPRIGHT:
        raise BadInput(f"up must be x, y or z, got {up!r}")
    if not speed > 0 or not radius > 0:
        raise BadInput(f"speed and radius must be positive, got {speed} and {radius}")
    direction = None
    if heading is not None:
        azimuth = np.radians(heading)
        direction = np.array([-np.cos(azimuth), -np.sin(azimuth), -DOWNWARD])
    scene = built_scene(
        name or shape.name, shape, np.random.default_rng([seed, 1]), material=material, direction=direction,
        speed=speed, radius=radius, quat_wxyz=UPRIGHT[up], engine=engine, seed=seed,
    )  # fmt: skip
    return replace(scene, shapes=tuple(replace(placed, repair=repair) for placed in scene.shapes))


def run(
    scene: Scene,
    breaker: Breaker | str | None = None,
    *,
    shapes: Sequence[Shape] | None = None,
    materials: Mapping[str, Material] | None = None,
    rng: np.random.Generator | None = None,
    options: BreakerOptions | None = None,
    **changes: Any,
) -> Outcome:
    """Run a scene until everything lies still or its duration is over.

    Args:
        scene: From `load_scene`, `throw_scene`, or built by hand.
        breaker: One for all shapes, or a name, from which one is made for each; by default the scene's own, and
            `learned` where it names none.
        shapes: The scene's shapes, in order; by default they are loaded by their names.
        materials: The scene's materials by name; by default presets.
        rng: Draws how things break; by default that of the scene's seed.
        options: Of a breaker that is made from a name.
        changes: Fields of `BreakerOptions` by name, as in `breaker`.

    Raises:
        BadInput: A shape, material or breaker that is not there, or does not fit the scene.

    Examples:
        >>> outcome = df.run(df.load_scene("examples/scenes/dual.toml"), "physical")
    """
    if shapes is None:
        shapes = [load_shape(placed.shape, repair=placed.repair) for placed in scene.shapes]
    if len(shapes) != len(scene.shapes):
        raise BadInput(f"shapes must be the scene's {len(scene.shapes)}, got {len(shapes)}")
    if materials is None:
        materials = {placed.material: preset_material(placed.material) for placed in scene.shapes}
    unknown = [placed.material for placed in scene.shapes if placed.material not in materials]
    if unknown:
        raise BadInput(f"materials lacks {unknown[0]!r}, which the scene names; it has {', '.join(materials)}")
    options = with_changes(options or BreakerOptions(), changes, renamed=RENAMED)
    chosen = breaker or scene.breaker or "learned"
    if isinstance(chosen, str):
        chosen = scene_breaker(chosen, scene, shapes, materials, options)
    elif options.model is not None or options.dataset is not None:
        raise BadInput("model and dataset go with the name of a breaker; this one is made already")
    rng = rng or np.random.default_rng(scene.seed)
    return run_world(scene, shapes, chosen, rng, materials=materials)


def scene_breaker(
    name: str, scene: Scene, shapes: Sequence[Shape], materials: Mapping[str, Material], options: BreakerOptions
) -> Breaker:
    """One breaker that knows every shape of a scene, and their fragments; arguments as in `run` and `breaker`."""
    if scene.refracture and name not in REFRACTURING:
        raise BadInput(f"breaker {name!r} breaks no fragments again; with refracture use {', '.join(REFRACTURING)}")
    known = {
        shape: make_breaker(name, shape, materials[placed.material], options)
        for placed, shape in zip(scene.shapes, shapes, strict=True)
    }

    def any_shape(shape: Shape, impact: Impact, rng: np.random.Generator) -> Fragments | None:
        return known[shape.whole or shape](shape, impact, rng)

    return any_shape


def save(
    thing: Outcome | Recording | Collision | Fragments | Scene | None,
    path: PathLike,
    *,
    shape: Shape | None = None,
    **options: Any,
) -> Path:
    """Write a result; the suffix says as what. A file or folder appears whole or not at all.

    - An `Outcome` or `Recording`: .glb, .usd (.usda, .usdc, .usdz), .html (a page that plays it), .mp4, .png (before
      the hit, just after it, and at the end), or a folder (no suffix) with an OBJ file for every 24th of a second.
    - `Fragments`, with the `shape` that they are of, or a `Collision`, which knows it: a folder (no suffix) of closed
      meshes in the coordinates of the shape's file, or .png (exploded view).
    - A `Scene`: .toml or .json, as `load_scene` and `deepfracture shatter --scene` read it.

    Args:
        thing: What to write.
        path: Where to; folders on the way are made.
        shape: What fragments are of.
        options: Of the writer, for what is not a scene: size (.mp4, .png), rate (.mp4, folder), kind (obj or ply,
            folder), gravity (.usd, if it is not the Earth's), factor, azimuth, elevation (.png of fragments).

    Returns:
        The path.

    Raises:
        BadInput: The suffix does not fit, `shape` is missing, or there is nothing to save because nothing broke.

    Examples:
        >>> df.save(outcome, "pot.glb")
        >>> df.save(outcome, "pot.mp4", size=(1280, 720))
        >>> df.save(outcome.breaks[0], "pieces")
    """
    from deepfracture.export import format_for

    path = Path(path)
    if isinstance(thing, Collision):
        thing, shape = thing.fragments, thing.shape
    if thing is None:
        raise BadInput(f"{path}: nothing broke, so there are no fragments to save; hit harder (see stress)")
    if isinstance(thing, Scene):
        path.parent.mkdir(parents=True, exist_ok=True)
        save_scene(thing, path)
    elif isinstance(thing, Fragments):
        if shape is None:
            raise BadInput(f"{path}: shape must be given with fragments: it knows the coordinates of the file")
        format_for(path, Fragments).write(thing, path, shape=shape, **options)
    elif isinstance(thing, Outcome | Recording):
        recording = thing.recording if isinstance(thing, Outcome) else thing
        format_for(path, Recording).write(recording, path, **options)
    else:
        raise BadInput(f"{path}: an outcome, recording, collision, fragments or scene can be saved, got {type(thing)}")
    return path


def simulate(
    shape: Shape,
    out: PathLike,
    options: SimulateOptions | None = None,
    *,
    material: str | Material = "plaster",
    **changes: Any,
) -> Dataset:
    """Simulate collisions from all sides: the data that a model learns from. Call again to resume.

    Worker processes start afresh: a program that calls this does so under `if __name__ == "__main__":`.

    Args:
        shape: What is hit.
        out: Folder of the data set, or s3://BUCKET/PREFIX; what it holds already is kept.
        options: Which collisions, and on what; the default ones if not given.
        material: One of `MATERIALS`, or your own.
        changes: Fields of `SimulateOptions` by name.

    Raises:
        BadInput: A value makes no sense, or the folder was made with other settings.

    Examples:
        >>> data = df.simulate(statue, "data/statue", collisions=240, speed=(8, 30))
    """
    from deepfracture.dataset import simulate_collisions

    options = with_changes(options or SimulateOptions(), changes)
    return simulate_collisions(shape, _material(material), Path(out), options)


def train(dataset: Dataset | PathLike, out: PathLike, options: TrainOptions | None = None, **changes: Any) -> Path:
    """Train the generative model on simulated collisions. Needs torch. Call again to resume.

    Args:
        dataset: From `simulate`, or its folder.
        out: Run folder, with the curve and a card beside the weights.
        options: What to train, for how long and where; the default ones if not given.
        changes: Fields of `TrainOptions` by name.

    Returns:
        The finished weights, for `breaker("learned", shape, model=...)`.

    Raises:
        BadInput: A value makes no sense, or the data set holds no pattern.

    Examples:
        >>> model = df.train(data, "runs/statue", minutes=8)
        >>> breaker = df.breaker("learned", statue, model=model)
    """
    return train_with_card(dataset, out, with_changes(options or TrainOptions(), changes)).path


def train_with_card(dataset: Dataset | PathLike, out: PathLike, options: TrainOptions) -> TrainingReport:
    """What `train` does; returns the weights' path together with what a reader wants to know of the run."""
    from deepfracture.dataset import Dataset, open_dataset
    from deepfracture.learn import train as run
    from deepfracture.learn.presets import with_default_epochs

    data = dataset if isinstance(dataset, Dataset) else open_dataset(Path(dataset))
    return run(data, Path(out), with_default_epochs(options))


def _material(given: str | Material) -> Material:
    return given if isinstance(given, Material) else preset_material(given)


def _rows(name: str, value: ArrayLike) -> Floats:
    """One vector or several, shape (k, 3)."""
    rows = np.atleast_2d(np.asarray(value, float))
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise BadInput(f"{name} must be three finite numbers, or rows of them, got {value}")
    return rows


def _normals(shape: Shape, faces: ArrayLike) -> Floats:
    """Outward unit normals, shape (k, 3)."""
    areas = shape.mesh.area_vectors[np.asarray(faces, int)]
    return areas / np.linalg.norm(areas, axis=1, keepdims=True)


def _entry(shape: Shape, point: Floats, direction: Floats) -> tuple[Floats, int]:
    """Where a ray first enters the shape, and through which face (Möller and Trumbore 1997)."""
    a, b, c = np.moveaxis(shape.mesh.triangles, 1, 0)
    side = np.cross(direction, c - a)
    facing = ((b - a) * side).sum(axis=1)  # positive where the ray goes against the normal
    start = point - ON_SURFACE * direction - a
    turned = np.cross(start, b - a)
    scale = np.where(facing > 0, facing, np.inf)  # a face that the ray only grazes or leaves by is not met
    u, v = (start * side).sum(axis=1) / scale, turned @ direction / scale
    away = ((c - a) * turned).sum(axis=1) / scale
    met = (facing > 0) & (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1 + EDGE) & (away >= 0)
    away = np.where(met, away, np.inf)
    face = int(np.argmin(away))
    if not np.isfinite(away[face]):
        raise BadInput(
            f"the ray from point {_short(point)} along direction {_short(direction)} does not enter {shape.name}; "
            "aim at it from outside, or leave direction out to hit the nearest place"
        )
    return point + (away[face] - ON_SURFACE) * direction, face


def _short(vector: Floats) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in vector) + ")"
