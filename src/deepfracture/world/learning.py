"""The scenes that learning data come from: a steel ball or two meet one shape in empty space.

    single      a ball from anywhere towards the centre                  (paper, section 4.1)
    dual        two balls from anywhere towards anywhere on the surface  (supplement, dual collision)
    strength    always one direction and point, the speed varies         (supplement, impulse strength)
    points      always one direction, the point varies                   (supplement, collision scenes)
    shear       a ball beside the edge of a block that the shape lies on (supplement, near-shearing)

What is the same in a whole data set is drawn from the seed of the set, the rest from the generator of one
collision. There is no gravity and no floor: only the impulses of the hit count.
"""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.convex.hulls import whole_hulls
from deepfracture.geometry.rotations import quat_from_matrix, quat_multiply, rotation_matrix
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Floats, Mesh, Shape
from deepfracture.world.scene import STEEL, Ball, Block, Placed, Scene, Vector

KINDS = ("single", "dual", "strength", "points", "shear")
RADIUS = 0.2
"""Of the balls [m]."""
DISTANCE = 2.5
"""From the centre of the shape at which balls start [m]."""
DURATION = 1.0
"""[s]"""
APART = np.radians(45.0)
"""Least angle between the starts of two balls: nearer ones would meet each other before the shape."""
EDGE = (-0.6, 0.2)
"""Where the first block may end, along the shape's longest axis [m]; the shape reaches from -1 to 1 ..."""
GAP = (0.4, 0.6)
"""... how far from there the second begins [m] ..."""
BESIDE = (0.03, 0.15)
"""... and how far from the first one's edge, over the gap, the ball comes down [m]."""
DROP = 0.3
"""Height above the shape from which it comes [m]."""
UPWARD = 0.7
"""Least z of the surface's normal where a ball should come down."""
SAMPLES = 4096
"""Points of the surface among which one to be struck is looked for."""


def draw_scene(
    kind: str, shape: Shape, rng: np.random.Generator, *, material: str, speed: tuple[float, float], seed: int
) -> Scene:
    """A random scene of one kind; `seed` is that of the data set, `speed` the slowest and fastest ball [m/s].

    BadInput if there is no such kind, or if balls do not start outside the shape."""
    if kind not in KINDS:
        raise BadInput(f"scene must be one of {', '.join(KINDS)}, got {kind!r}{did_you_mean(kind, KINDS)}")
    if kind == "single":
        return learning_scene(shape.name, shape, rng, material=material, speed=speed)
    _check_outside(shape, RADIUS, DISTANCE)
    common = np.random.default_rng([seed, KINDS.index(kind)])
    if kind == "shear":
        return _shear(shape, rng, material, speed)
    if kind == "dual":
        balls = _two_balls(shape.mesh, rng, speed)
    elif kind == "strength":
        point, normal = _surface_points(shape.mesh, common, 1)
        balls = (_ball(point[0], -normal[0], float(rng.uniform(*speed))),)
    else:
        direction = _direction(common)
        balls = (_ball(_seen_point(shape.mesh, direction, rng), direction, float(rng.uniform(*speed))),)
    return Scene((Placed(shape.name, material),), balls, gravity=0.0, duration=DURATION)


def learning_scene(
    name: str,
    shape: Shape,
    rng: np.random.Generator,
    *,
    material: str,
    speed: tuple[float, float] = (5.0, 30.0),
    radius: float = RADIUS,
    distance: float = DISTANCE,
    jitter: float = 0.0,
    engine: str = "rapier",
    seed: int = 0,
) -> Scene:
    """The scene of the paper's data: no gravity, no floor, and a ball from a random point of a sphere of
    radius `distance` [m] towards the centre (off it by up to `jitter` [m]) at a random speed [m/s]."""
    _check_outside(shape, radius, distance)
    outwards = _direction(rng)
    goal = jitter * rng.uniform(-1, 1, 3)
    velocity = goal - distance * outwards
    velocity *= rng.uniform(*speed) / np.linalg.norm(velocity)
    ball = Ball(radius, STEEL, _tuple(distance * outwards), _tuple(velocity))
    return Scene((Placed(name, material),), (ball,), gravity=0.0, duration=DURATION, engine=engine, seed=seed)


def _two_balls(mesh: Mesh, rng: np.random.Generator, speed: tuple[float, float]) -> tuple[Ball, ...]:
    """Two balls with random starts, goals and speeds. The faster one waits, so that they arrive together:
    were the first to push the shape away, the second would miss it."""
    first = _direction(rng)
    second = _direction(rng)
    while first @ second > np.cos(APART):
        second = _direction(rng)
    starts = DISTANCE * np.stack([first, second])
    ways = _surface_points(mesh, rng, 2)[0] - starts
    lengths, speeds = np.linalg.norm(ways, axis=1), rng.uniform(*speed, 2)
    velocities = ways * (speeds / lengths)[:, None]
    delays = (lengths / speeds).max() - lengths / speeds
    return tuple(
        Ball(RADIUS, STEEL, _tuple(start), _tuple(velocity), delay=float(delay))
        for start, velocity, delay in zip(starts, velocities, delays, strict=True)
    )


def _ball(point: Floats, direction: Floats, speed: float) -> Ball:
    """A ball whose centre flies through a point, from the sphere on which balls start."""
    along = float(point @ direction)
    back = along + np.sqrt(along**2 + DISTANCE**2 - point @ point)
    return Ball(RADIUS, STEEL, _tuple(point - back * direction), _tuple(speed * direction))


def _shear(shape: Shape, rng: np.random.Generator, material: str, speed: tuple[float, float]) -> Scene:
    """The shape lies across two fixed blocks, its longest axis along x, on one of four sides, either way
    round; the ball comes straight down over the gap, so near to the edge of the first block that the shape is
    sheared between ball and block rather than bent."""
    quat = _lying(shape.mesh, rng)
    turn = rotation_matrix(np.array(quat))
    edge = rng.uniform(*EDGE)
    second = edge + rng.uniform(*GAP)
    over = edge + np.array(BESIDE)
    points, normals = (values @ turn.T for values in _surface_points(shape.mesh, rng, SAMPLES))
    there = (points[:, 0] > over[0]) & (points[:, 0] < over[1]) & (normals[:, 2] > 0)
    if not there.any():
        raise BadInput(f"{shape.name}: no surface to come down on between x = {over[0]:.2f} and {over[1]:.2f} m")
    level = there & (normals[:, 2] > UPWARD)
    goals = points[level if level.any() else there]
    goal = goals[rng.integers(len(goals))]
    top = float((shape.mesh.vertices @ turn.T)[:, 2].max())
    start = np.array([goal[0], goal[1], top + RADIUS + DROP])
    ball = Ball(RADIUS, STEEL, _tuple(start), (0.0, 0.0, -float(rng.uniform(*speed))))
    blocks = (_support(shape.mesh, turn, -1.2, edge), _support(shape.mesh, turn, second, 1.2))
    placed = Placed(shape.name, material, quat_wxyz=quat)
    return Scene((placed,), (ball,), gravity=0.0, duration=DURATION, blocks=blocks)


def _lying(mesh: Mesh, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """A rotation that brings the longest axis of the box to x and one of its other sides down."""
    half = 0.5**0.5
    to_x = ((1.0, 0.0, 0.0, 0.0), (half, 0.0, 0.0, -half), (half, 0.0, half, 0.0))
    axis = int(np.argmax(np.ptp(mesh.bounds, axis=0)))
    angle = np.pi / 4 * rng.integers(4)
    roll = np.array([np.cos(angle), np.sin(angle), 0.0, 0.0])
    about = np.array([0.0, 0.0, 0.0, 1.0]) if rng.integers(2) else np.array([1.0, 0.0, 0.0, 0.0])
    quat = quat_from_matrix(rotation_matrix(quat_multiply(about, quat_multiply(roll, np.array(to_x[axis])))))
    w, x, y, z = (float(value) for value in quat)
    return w, x, y, z


def _support(mesh: Mesh, turn: Floats, low: float, high: float) -> Block:
    """A block from x = `low` to `high` whose top touches the turned mesh from below, as the engine has it."""
    from scipy.spatial import ConvexHull

    lowest = np.inf
    for points in whole_hulls(mesh).points:
        turned = points @ turn.T
        triangles = turned[ConvexHull(turned, qhull_options="QJ").simplices]
        lowest = min(lowest, _lowest(triangles, low, high))
    depth = 0.5
    return Block((0.5 * (low + high), 0.0, lowest - depth), (0.5 * (high - low), 1.5, depth))


def _lowest(triangles: Floats, low: float, high: float) -> float:
    """Least z of triangles between two planes across x; infinity if they have nothing there."""
    corners = triangles.reshape(-1, 3)
    heights = [corners[(corners[:, 0] >= low) & (corners[:, 0] <= high), 2]]
    first, last = corners, np.roll(triangles, -1, axis=1).reshape(-1, 3)
    for plane in (low, high):
        across = (first[:, 0] < plane) != (last[:, 0] < plane)
        a, b = first[across], last[across]
        share = (plane - a[:, 0]) / (b[:, 0] - a[:, 0])
        heights.append(a[:, 2] + share * (b[:, 2] - a[:, 2]))
    return float(min((values.min() for values in heights if len(values)), default=np.inf))


def _surface_points(mesh: Mesh, rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Points uniform over the surface, and its outward normals there, each of shape (n, 3)."""
    area = mesh.area_vectors
    size = np.linalg.norm(area, axis=1)
    face = rng.choice(len(size), n, p=size / size.sum())
    u, v = rng.uniform(size=(2, n, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(mesh.triangles[face], 1, 0)
    return a + u * (b - a) + v * (c - a), area[face] / size[face, None]


def _seen_point(mesh: Mesh, direction: Floats, rng: np.random.Generator) -> Floats:
    """A point of a line along `direction`, uniform over the silhouette of the mesh that is seen so."""
    side = np.linalg.svd(direction[None])[2][1:]  # two axes across the direction
    flat = mesh.triangles @ side.T
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    while True:  # at least as often as the silhouette's share of its box
        point = rng.uniform(low, high)
        if _covered(flat, point):
            return point @ side


def _covered(flat: Floats, point: Floats) -> bool:
    """Whether a point of the plane lies in any of the triangles, shape (n, 3, 2)."""
    edge, to = np.roll(flat, -1, axis=1) - flat, point - flat
    side = edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0]
    return bool(((side >= 0).all(axis=1) | (side <= 0).all(axis=1)).any())


def _direction(rng: np.random.Generator) -> Floats:
    """A uniform unit vector."""
    vector = rng.normal(size=3)
    vector /= np.linalg.norm(vector)
    return vector


def _check_outside(shape: Shape, radius: float, distance: float) -> None:
    reach = float(np.linalg.norm(shape.mesh.vertices, axis=1).max()) + radius
    if distance <= reach:
        raise BadInput(f"distance must be more than {reach:.2f} m to start outside {shape.name}, got {distance}")


def _tuple(vector: Floats) -> Vector:
    x, y, z = (float(value) for value in vector)
    return x, y, z
