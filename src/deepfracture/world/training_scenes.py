"""The scenes of training data: one or two steel balls hit one shape in empty space.

    single      a ball from anywhere towards the centre                  (paper, section 4.1)
    dual        two balls from anywhere towards anywhere on the surface  (supplement, dual collision)
    strength    always one direction and point, the speed varies         (supplement, impulse strength)
    points      always one direction, the point varies                   (supplement, collision scenes)
    shear       a ball beside the edge of a block that the shape lies on (supplement, near-shearing)

What a whole data set shares is drawn from its seed, the rest from the generator of one collision. There is no gravity
and no floor: only the impulses of the hit count.
"""

from __future__ import annotations

import numpy as np

from deepfracture.geometry.convex.hulls import shape_hulls
from deepfracture.geometry.rotations import quat_from_matrix, quat_multiply, rotation_matrix
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Floats, Mesh, Shape
from deepfracture.world.scene import STEEL, Ball, Block, Placed, Scene, as_vector

KINDS = ("single", "dual", "strength", "points", "shear")
RADIUS = 0.2
"""Of the balls [m]."""
DISTANCE = 2.5
"""From the centre of the shape at which balls start [m]."""
DURATION = 1.0
"""[s]"""
MIN_BALL_ANGLE = np.radians(45.0)
"""Between the starts of two balls: nearer ones would collide with each other before the shape."""
BLOCK_EDGE = (-0.6, 0.2)
"""Range of the first block's edge along the shape's longest axis [m]; the shape reaches from -1 to 1 ..."""
GAP = (0.4, 0.6)
"""... range of the gap between the blocks [m] ..."""
EDGE_DISTANCE = (0.03, 0.15)
"""... and range of the ball's distance from the first block's edge, over the gap [m]."""
DROP_HEIGHT = 0.3
"""Height of the ball's start above the shape [m]."""
MIN_UPWARD_NORMAL = 0.7
"""Least z of the surface normal where a ball should come down, if there is such a place."""
SURFACE_SAMPLES = 4096
"""Surface points from which the one to be struck is drawn."""


def draw_scene(
    kind: str, shape: Shape, rng: np.random.Generator, *, material: str, speed: tuple[float, float], seed: int
) -> Scene:
    """A random scene of one kind; `seed` is that of the data set, `speed` the range of ball speeds [m/s].

    BadInput: no such kind, or a shape so large that balls would start inside it."""
    if kind not in KINDS:
        raise BadInput(f"scene must be one of {', '.join(KINDS)}, got {kind!r}{did_you_mean(kind, KINDS)}")
    if kind == "single":
        return single_ball_scene(shape.name, shape, rng, material=material, speed=speed)
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
        balls = (_ball(_silhouette_point(shape.mesh, direction, rng), direction, float(rng.uniform(*speed))),)
    return Scene((Placed(shape.name, material),), balls, gravity=0.0, duration=DURATION)


def single_ball_scene(
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
    """The scene of the paper's data: no gravity, no floor, and a ball from a random point of a sphere of radius
    `distance` [m] towards the centre (off it by up to `jitter` [m]) at a random speed [m/s]."""
    _check_outside(shape, radius, distance)
    outwards = _direction(rng)
    target = jitter * rng.uniform(-1, 1, 3)
    velocity = target - distance * outwards
    velocity *= rng.uniform(*speed) / np.linalg.norm(velocity)
    ball = Ball(radius, STEEL, as_vector(distance * outwards), as_vector(velocity))
    return Scene((Placed(name, material),), (ball,), gravity=0.0, duration=DURATION, engine=engine, seed=seed)


def _two_balls(mesh: Mesh, rng: np.random.Generator, speed: tuple[float, float]) -> tuple[Ball, ...]:
    """Two balls with random starts, targets and speeds. The faster one is delayed so that they arrive together: if the
    first pushed the shape away, the second would miss it."""
    first = _direction(rng)
    second = _direction(rng)
    while first @ second > np.cos(MIN_BALL_ANGLE):
        second = _direction(rng)
    starts = DISTANCE * np.stack([first, second])
    paths = _surface_points(mesh, rng, 2)[0] - starts
    lengths, speeds = np.linalg.norm(paths, axis=1), rng.uniform(*speed, 2)
    velocities = paths * (speeds / lengths)[:, None]
    delays = (lengths / speeds).max() - lengths / speeds
    return tuple(
        Ball(RADIUS, STEEL, as_vector(start), as_vector(velocity), delay=float(delay))
        for start, velocity, delay in zip(starts, velocities, delays, strict=True)
    )


def _ball(point: Floats, direction: Floats, speed: float) -> Ball:
    """A ball whose centre flies through a point, starting on the sphere of radius `DISTANCE`."""
    along = float(point @ direction)
    back = along + np.sqrt(along**2 + DISTANCE**2 - point @ point)
    return Ball(RADIUS, STEEL, as_vector(point - back * direction), as_vector(speed * direction))


def _shear(shape: Shape, rng: np.random.Generator, material: str, speed: tuple[float, float]) -> Scene:
    """The shape lies across two fixed blocks, its longest axis along x, on one of four sides, either way round; the
    ball comes straight down over the gap, so near to the edge of the first block that the shape is sheared between ball
    and block rather than bent."""
    quat = _lying_quat(shape.mesh, rng)
    turn = rotation_matrix(np.array(quat))
    edge = rng.uniform(*BLOCK_EDGE)
    second = edge + rng.uniform(*GAP)
    strip = edge + np.array(EDGE_DISTANCE)
    points, normals = (values @ turn.T for values in _surface_points(shape.mesh, rng, SURFACE_SAMPLES))
    over_gap = (points[:, 0] > strip[0]) & (points[:, 0] < strip[1]) & (normals[:, 2] > 0)
    if not over_gap.any():
        raise BadInput(f"{shape.name}: no surface for the ball to hit between x = {strip[0]:.2f} and {strip[1]:.2f} m")
    upward = over_gap & (normals[:, 2] > MIN_UPWARD_NORMAL)
    targets = points[upward if upward.any() else over_gap]
    target = targets[rng.integers(len(targets))]
    top = float((shape.mesh.vertices @ turn.T)[:, 2].max())
    start = np.array([target[0], target[1], top + RADIUS + DROP_HEIGHT])
    ball = Ball(RADIUS, STEEL, as_vector(start), (0.0, 0.0, -float(rng.uniform(*speed))))
    blocks = (_support_block(shape.mesh, turn, -1.2, edge), _support_block(shape.mesh, turn, second, 1.2))
    placed = Placed(shape.name, material, quat_wxyz=quat)
    return Scene((placed,), (ball,), gravity=0.0, duration=DURATION, blocks=blocks)


def _lying_quat(mesh: Mesh, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """A random rotation that turns the longest axis of the box to x and another side of it down."""
    half = 0.5**0.5
    to_x = ((1.0, 0.0, 0.0, 0.0), (half, 0.0, 0.0, -half), (half, 0.0, half, 0.0))
    axis = int(np.argmax(np.ptp(mesh.bounds, axis=0)))
    angle = np.pi / 4 * rng.integers(4)
    roll = np.array([np.cos(angle), np.sin(angle), 0.0, 0.0])
    about = np.array([0.0, 0.0, 0.0, 1.0]) if rng.integers(2) else np.array([1.0, 0.0, 0.0, 0.0])
    quat = quat_from_matrix(rotation_matrix(quat_multiply(about, quat_multiply(roll, np.array(to_x[axis])))))
    w, x, y, z = (float(value) for value in quat)
    return w, x, y, z


def _support_block(mesh: Mesh, turn: Floats, low: float, high: float) -> Block:
    """A block from x = `low` to `high` whose top touches the collision hulls of the rotated mesh from below."""
    from scipy.spatial import ConvexHull

    lowest = np.inf
    for points in shape_hulls(mesh).points:
        turned = points @ turn.T
        triangles = turned[ConvexHull(turned, qhull_options="QJ").simplices]
        lowest = min(lowest, _lowest(triangles, low, high))
    depth = 0.5
    return Block((0.5 * (low + high), 0.0, lowest - depth), (0.5 * (high - low), 1.5, depth))


def _lowest(triangles: Floats, low: float, high: float) -> float:
    """Least z of the triangles between two planes across x; infinity where there are none."""
    corners = triangles.reshape(-1, 3)
    heights = [corners[(corners[:, 0] >= low) & (corners[:, 0] <= high), 2]]
    first, last = corners, np.roll(triangles, -1, axis=1).reshape(-1, 3)
    for plane in (low, high):
        across = (first[:, 0] < plane) != (last[:, 0] < plane)
        a, b = first[across], last[across]
        t = (plane - a[:, 0]) / (b[:, 0] - a[:, 0])
        heights.append(a[:, 2] + t * (b[:, 2] - a[:, 2]))
    return float(min((values.min() for values in heights if len(values)), default=np.inf))


def _surface_points(mesh: Mesh, rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Points uniform over the surface and the outward normals there, shape (n, 3) each."""
    area = mesh.area_vectors
    size = np.linalg.norm(area, axis=1)
    face = rng.choice(len(size), n, p=size / size.sum())
    u, v = rng.uniform(size=(2, n, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(mesh.triangles[face], 1, 0)
    return a + u * (b - a) + v * (c - a), area[face] / size[face, None]


def _silhouette_point(mesh: Mesh, direction: Floats, rng: np.random.Generator) -> Floats:
    """A point, uniform over the silhouette of the mesh seen along `direction`."""
    side = np.linalg.svd(direction[None])[2][1:]  # two axes across the direction
    flat = mesh.triangles @ side.T
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    while True:  # rejection sampling from the silhouette's bounding box
        point = rng.uniform(low, high)
        if _in_any_triangle(flat, point):
            return point @ side


def _in_any_triangle(flat: Floats, point: Floats) -> bool:
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
