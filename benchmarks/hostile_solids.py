"""Hostile meshes, a few of each class, generated from seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from deepfracture.geometry import builtin
from deepfracture.geometry.solids import box
from deepfracture.types import Floats, Ints

Corners = tuple[Floats, Ints]
"""Vertices (n, 3) and faces (m, 3), checked by nobody."""
Case = tuple[str, str, Callable[[], Corners]]
"""Class, name, and what makes it."""


def cube(side: float = 1.0, at: tuple[float, float, float] = (0, 0, 0), edge: float = 9.0) -> Corners:
    mesh = box((side, side, side), edge)
    return mesh.vertices + at, mesh.faces


@cache
def _ball(times: int) -> Corners:
    import trimesh

    made = trimesh.creation.icosphere(times)
    return np.array(made.vertices), np.array(made.faces)


def ball(times: int = 3, radius: float = 1.0, at: tuple[float, float, float] = (0, 0, 0)) -> Corners:
    vertices, faces = _ball(times)
    return vertices * radius + at, faces.copy()


def torus(big: float, small: float, n: int = 48, m: int = 24, turns: int = 0) -> Corners:
    """turns: how often the section (an ellipse) turns round on its way."""
    u, v = np.meshgrid(np.arange(n) / n * 2 * np.pi, np.arange(m) / m * 2 * np.pi, indexing="ij")
    x, y = small * np.cos(v), small * (0.4 if turns else 1.0) * np.sin(v)
    x, y = x * np.cos(turns * u) - y * np.sin(turns * u), x * np.sin(turns * u) + y * np.cos(turns * u)
    points = np.stack([(big + x) * np.cos(u), (big + x) * np.sin(u), y], axis=-1).reshape(-1, 3)
    return points, _wrapped(n, m)


def _wrapped(n: int, m: int, flip: bool = False) -> Ints:
    """Faces of an n by m lattice whose ends meet; flip: the second axis runs backwards where the first closes."""
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    nexti, nextj = (i + 1) % n, (j + 1) % m
    across = np.where(flip & (i == n - 1), (-j) % m, j)
    acrossj = np.where(flip & (i == n - 1), (-nextj) % m, nextj)
    a, b, c, d = i * m + j, nexti * m + across, nexti * m + acrossj, i * m + nextj
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def tube(path: Floats, radius: float, m: int = 12) -> Corners:
    """A closed tube round a closed curve (n, 3)."""
    along = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, [0.31, 0.17, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    angle = np.arange(m) / m * 2 * np.pi
    points = path[:, None] + radius * (np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None])
    return points.reshape(-1, 3), _wrapped(len(path), m)


def klein() -> Corners:
    """The figure-of-eight Klein bottle: closed, crosses itself, has no inside."""
    n, m = 48, 24
    u, v = np.meshgrid(np.arange(n) / n * 2 * np.pi, np.arange(m) / m * 2 * np.pi, indexing="ij")
    r = 1 + np.cos(u / 2) * np.sin(v) * 0.5 - np.sin(u / 2) * np.sin(2 * v) * 0.5
    z = np.sin(u / 2) * np.sin(v) * 0.5 + np.cos(u / 2) * np.sin(2 * v) * 0.5
    return np.stack([r * np.cos(u), r * np.sin(u), z], -1).reshape(-1, 3), _wrapped(n, m, flip=True)


def named(name: str) -> Corners:
    mesh = builtin(name).mesh
    return np.array(mesh.vertices), np.array(mesh.faces)


def joined(*parts: Corners) -> Corners:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [own + start for (_, own), start in zip(parts, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def turned(part: Corners, which: slice | Ints = slice(None)) -> Corners:
    vertices, faces = part[0], part[1].copy()
    faces[which] = faces[which][:, ::-1]
    return vertices, faces


def without(part: Corners, which: slice | Ints) -> Corners:
    return part[0], np.delete(part[1], which, axis=0)


def scaled(
    part: Corners, by: float | tuple[float, float, float], at: float | tuple[float, float, float] = 0
) -> Corners:
    return part[0] * np.asarray(by, float) + np.asarray(at, float), part[1]


def noisy(part: Corners, size: float, seed: int = 0) -> Corners:
    return part[0] + np.random.default_rng(seed).normal(size=part[0].shape) * size, part[1]


def soup(part: Corners, noise: float = 0.0) -> Corners:
    """Every corner a vertex of its own."""
    points = part[0][part[1]].reshape(-1, 3)
    points = points + np.random.default_rng(1).normal(size=points.shape) * noise
    return points, np.arange(len(points)).reshape(-1, 3)


def some(part: Corners, share: float, seed: int = 0) -> Ints:
    count = max(1, int(share * len(part[1])))
    return np.sort(np.random.default_rng(seed).choice(len(part[1]), count, replace=False))


def sheet(n: int = 8) -> Corners:
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    quads = np.array([(i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1)
                      for i in range(n - 1) for j in range(n - 1)])  # fmt: skip
    return np.stack([x, y, 0.1 * np.sin(3 * x)], -1).reshape(-1, 3), np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


def moebius(n: int = 40) -> Corners:
    u = np.arange(n) / n * 2 * np.pi
    rim = [np.stack([(1 + w * np.cos(u / 2)) * np.cos(u), (1 + w * np.cos(u / 2)) * np.sin(u), w * np.sin(u / 2)], -1)
           for w in (-0.3, 0.3)]  # fmt: skip
    i = np.arange(n)
    after = (i + 1) % n
    a, b = i, i + n
    c, d = np.where(after == 0, n, after), np.where(after == 0, 0, after + n)
    return np.concatenate(rim), np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])


def opened() -> Iterator[Case]:
    kind = "open"
    for name in ("mug", "letter_a", "pot"):
        yield kind, f"{name}, one face missing", lambda name=name: without(named(name), slice(7, 8))
        yield kind, f"{name}, a twentieth of the faces missing", lambda n=name: without(named(n), some(named(n), 0.05))
        yield kind, f"{name}, half of the faces missing", lambda n=name: without(named(n), some(named(n), 0.5))
    yield kind, "cube without a lid", lambda: without(cube(), slice(0, 2))
    yield kind, "half a ball", lambda: (ball()[0], ball()[1][ball()[0][ball()[1]].mean(1)[:, 2] > 0])
    yield kind, "ball cut in bands", lambda: (ball()[0], ball()[1][np.sin(14 * ball()[0][ball()[1]].mean(1)[:, 2]) > 0])
    yield kind, "one triangle", lambda: (np.eye(3), np.array([[0, 1, 2]]))
    yield kind, "sheet", sheet
    yield kind, "Moebius strip", moebius
    yield kind, "pot split by cracks of 1e-4", lambda: soup(named("pot"), 1e-4)
    yield kind, "pot split by cracks of 1e-3", lambda: soup(named("pot"), 1e-3)
    yield kind, "triangles at random places", lambda: (
        np.random.default_rng(5).random((900, 3)), np.arange(900).reshape(-1, 3))  # fmt: skip
    yield kind, "two sheets, 1e-3 apart", lambda: joined(sheet(), scaled(sheet(), 1, (0, 0, 1e-3)))


def flipped() -> Iterator[Case]:
    kind = "flipped"
    for name in ("mug", "letter_a", "base"):
        yield kind, f"{name} inside out", lambda n=name: turned(named(n))
        yield kind, f"{name}, one face turned", lambda n=name: turned(named(n), slice(3, 4))
        yield kind, f"{name}, half of the faces turned", lambda n=name: turned(named(n), some(named(n), 0.5))
    yield kind, "hollow ball, the void facing as the outside", lambda: joined(ball(), ball(3, 0.5))
    yield kind, "hollow ball inside out", lambda: joined(turned(ball()), ball(3, 0.5))
    yield kind, "Klein bottle", klein


def doubled() -> Iterator[Case]:
    kind = "doubled"
    for name in ("mug", "bar"):
        yield kind, f"{name}, every face twice", lambda n=name: (named(n)[0], np.concatenate([named(n)[1]] * 2))
        yield (
            kind,
            f"{name}, every face and its back",
            lambda n=name: (named(n)[0], np.concatenate([named(n)[1], named(n)[1][:, ::-1]])),
        )
        for shift in (0.0, 1e-9, 1e-5, 1e-3):
            yield (
                kind,
                f"{name} twice, {shift:g} apart",
                lambda n=name, s=shift: joined(named(n), scaled(named(n), 1, s)),
            )
    yield kind, "ten copies of a cube", lambda: joined(*[cube()] * 10)
    yield kind, "every vertex ten times", lambda: (np.repeat(named("mug")[0], 10, 0), named("mug")[1] * 10)
    yield kind, "every corner its own vertex", lambda: soup(named("mug"))
    yield kind, "every corner its own vertex, 1e-9 off", lambda: soup(named("mug"), 1e-9)


def crossing() -> Iterator[Case]:
    kind = "crosses itself"
    yield kind, "two cubes", lambda: joined(cube(), cube(1, (0.5, 0.3, 0.2)))
    yield kind, "two cubes that share a plane", lambda: joined(cube(), cube(1, (0.5, 0, 0)))
    yield kind, "two cubes, corner in face", lambda: joined(cube(), cube(1, (0.5, 0.5, 0.5)))
    yield kind, "fifty balls in a heap", lambda: joined(
        *[ball(2, 0.5, tuple(p)) for p in np.random.default_rng(2).random((50, 3))])  # fmt: skip
    yield kind, "spindle torus", lambda: torus(0.5, 0.8)
    yield kind, "horn torus", lambda: torus(0.5, 0.5)
    yield kind, "twisted torus", lambda: torus(1.0, 0.4, turns=5)
    for size in (0.002, 0.02, 0.05, 0.2, 1.0):
        yield kind, f"ball with noise of {size:g}", lambda s=size: noisy(ball(4), s)
    for size in (0.01, 0.05):
        yield kind, f"mug with noise of {size:g}", lambda s=size: noisy(named("mug"), s)
    yield kind, "cube twisted into a bow tie", _bow_tie
    yield kind, "spike through the other side", _spike
    yield kind, "dent through the other side", lambda: _spike(-3.0)
    yield kind, "fold", _fold
    angle = np.arange(200) / 200 * 2 * np.pi
    eight = np.stack([np.sin(angle), np.sin(2 * angle) / 2, 0.02 * np.cos(angle)], -1)
    yield kind, "tube in the form of an eight", lambda: tube(eight, 0.12)
    knot = np.stack(
        [np.sin(angle) + 2 * np.sin(2 * angle), np.cos(angle) - 2 * np.cos(2 * angle), -np.sin(3 * angle)], -1
    )
    yield kind, "knot", lambda: tube(knot / 3, 0.15)
    yield kind, "knot too thick for its loops", lambda: tube(knot / 3, 0.4)
    yield kind, "vertices shuffled", lambda: (np.random.default_rng(3).permutation(ball(2)[0]), ball(2)[1])
    yield kind, "star with points through each other", lambda: (
        ball()[0] * (1 + 1.5 * np.sin(9 * ball()[0][:, :1]) * np.sin(8 * ball()[0][:, 1:2])), ball()[1])  # fmt: skip


def _bow_tie() -> Corners:
    vertices, faces = cube(2, edge=0.25)
    angle = np.pi * (vertices[:, 2] + 1) / 2
    x, y = vertices[:, 0] * np.cos(angle), vertices[:, 1]
    return np.stack([x, y, vertices[:, 2]], -1), faces


def _spike(reach: float = -2.5) -> Corners:
    vertices, faces = ball(4)
    top = np.argmax(vertices[:, 2])
    vertices[top, 2] = reach
    return vertices, faces


def _fold() -> Corners:
    vertices, faces = cube(2, edge=0.2)
    bump = np.exp(-((vertices[:, 0] / 0.3) ** 2) - (vertices[:, 1] / 0.3) ** 2) * (vertices[:, 2] > 0.9)
    vertices = vertices.copy()
    vertices[:, 0] += 1.6 * bump
    return vertices, faces


def crowded() -> Iterator[Case]:
    kind = "non-manifold edges"
    yield kind, "two cubes with a common edge", lambda: joined(cube(), cube(1, (0, 1, 1)))
    yield kind, "two cubes with a common face", lambda: joined(cube(), cube(1, (0, 0, 1)))
    yield kind, "eight cubes", lambda: joined(*[cube(1, (i, j, k)) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    yield kind, "chequered cubes", lambda: joined(
        *[cube(1, at) for at in np.argwhere(np.indices((3, 3, 3)).sum(axis=0) % 2 == 0).tolist()])  # fmt: skip
    yield kind, "cube with a fin", lambda: (
        np.concatenate([cube()[0], [[0, 0, 2]]]), np.concatenate([cube()[1], [[0, 7, 8]]]))  # fmt: skip
    yield kind, "cube with a wall inside", _walled
    yield kind, "book of ten pages", lambda: (
        np.concatenate([[[0, 0, 0], [0, 0, 1]], *[[[np.cos(a), np.sin(a), 0], [np.cos(a), np.sin(a), 1]]
                                                  for a in np.arange(10) * 0.6]]),
        np.concatenate([[[0, 1, 3 + 2 * n], [0, 3 + 2 * n, 2 + 2 * n]] for n in range(10)]))  # fmt: skip
    yield kind, "mug, fins on ten edges", lambda: (
        np.concatenate([named("mug")[0], [[0, 0, 3]]]),
        np.concatenate([named("mug")[1], np.insert(named("mug")[1][:10, :2], 2, len(named("mug")[0]), 1)]))  # fmt: skip
    kind = "non-manifold vertices"
    yield kind, "two cubes with a common corner", lambda: joined(cube(), cube(1, (1, 1, 1)))
    yield kind, "two tetrahedra tip to tip", lambda: (
        np.array([[0, 0, 0], [1, 0, 1], [-1, 1, 1], [-1, -1, 1], [1, 0, -1], [-1, 1, -1], [-1, -1, -1.0]]),
        np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3], [0, 4, 5], [0, 5, 6], [0, 6, 4], [4, 6, 5]]))  # fmt: skip
    yield kind, "ball pinched at its poles", _pinched
    yield kind, "hollow cube whose void touches the outside", _touching_void
    yield kind, "one vertex for all faces", lambda: (ball(2)[0] * 0 + 1, ball(2)[1])


def _walled() -> Corners:
    wall = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    return joined(cube(1, edge=0.5), (wall, np.array([[0, 1, 2], [0, 2, 3]])))


def _pinched() -> Corners:
    vertices, faces = ball(4)
    top, bottom = np.argmax(vertices[:, 2]), np.argmin(vertices[:, 2])
    vertices[[top, bottom]] = 0
    return vertices, np.where(faces == bottom, top, faces)


def _touching_void() -> Corners:
    return joined(cube(2), turned(cube(1, (0.5, 0.5, 0.5))))


def flat() -> Iterator[Case]:
    kind = "zero-area faces"
    yield kind, "cube, a face that is an edge", lambda: (cube()[0], np.concatenate([cube()[1], [[0, 1, 1]]]))
    yield kind, "cube, a face that is a point", lambda: (cube()[0], np.concatenate([cube()[1], [[2, 2, 2]]]))
    yield kind, "mug, middles of edges as vertices of one side only", lambda: _split_edges(named("mug"), shared=False)
    yield kind, "mug, faces flat on their edges", lambda: _split_edges(named("mug"), shared=True)
    yield kind, "mug squeezed to a plane", lambda: scaled(named("mug"), (1, 1, 0))
    yield kind, "mug squeezed to a line", lambda: scaled(named("mug"), (1, 0, 0))
    yield kind, "mug squeezed to a point", lambda: scaled(named("mug"), 0)
    yield kind, "all faces the same triangle", lambda: (np.eye(3), np.array([[0, 1, 2], [0, 2, 1]] * 50))
    yield kind, "needles of 1e-9", lambda: _needled(1e-9)
    yield kind, "needles of 1e-6", lambda: _needled(1e-6)
    yield kind, "needles of 1e-3", lambda: _needled(1e-3)
    yield kind, "pillow of two triangles", lambda: (np.eye(3), np.array([[0, 1, 2], [0, 2, 1]]))


def _split_edges(part: Corners, shared: bool) -> Corners:
    """Some faces halved across an edge; shared: what opens there is closed by a face without area."""
    vertices, faces = part[0].tolist(), part[1].tolist()
    for n in range(0, len(part[1]), 37):
        a, b, c = faces[n]
        middle = len(vertices)
        vertices.append(((part[0][a] + part[0][b]) / 2).tolist())
        faces[n] = [a, middle, c]
        faces += [[middle, b, c], *([[a, b, middle]] if shared else [])]
    return np.array(vertices), np.array(faces)


def _needled(width: float) -> Corners:
    vertices, faces = named("pot")[0].tolist(), named("pot")[1].tolist()
    for n in range(0, len(faces), 53):
        a, b, c = faces[n]
        foot, tip = (np.array(vertices[a]) + vertices[b]) / 2, np.array(vertices[c])
        point = len(vertices)
        vertices.append((foot + width * (tip - foot)).tolist())
        faces[n] = [a, b, point]
        faces += [[b, c, point], [c, a, point]]
    return np.array(vertices), np.array(faces)


def wild_numbers() -> Iterator[Case]:
    kind = "NaN and infinite"
    for what, value in (("NaN", np.nan), ("infinity", np.inf), ("minus infinity", -np.inf)):
        yield kind, f"one coordinate {what}", lambda v=value: _put(named("mug"), v, slice(5, 6))
        yield kind, f"all coordinates {what}", lambda v=value: _put(named("mug"), v, slice(None))
        yield kind, f"{what} in a vertex that no face uses", lambda v=value: (
            np.concatenate([cube()[0], [[v, 0, 0]]]), cube()[1])  # fmt: skip
    yield kind, "one coordinate 1e308", lambda: _put(named("mug"), 1e308, slice(5, 6))
    yield kind, "one coordinate 1e30", lambda: _put(named("mug"), 1e30, slice(5, 6))
    yield kind, "one vertex 1e6 away", lambda: _put(named("mug"), 1e6, slice(5, 6))


def _put(part: Corners, value: float, where: slice) -> Corners:
    vertices = part[0].copy()
    vertices[where, 1] = value
    return vertices, part[1]


def nested() -> Iterator[Case]:
    kind = "nested shells"
    yield kind, "hollow ball", lambda: joined(ball(), turned(ball(3, 0.5)))
    yield kind, "ball in a hollow ball", lambda: joined(ball(), turned(ball(3, 0.7)), ball(3, 0.4))
    yield kind, "four shells", lambda: joined(ball(), turned(ball(3, 0.8)), ball(3, 0.6), turned(ball(3, 0.4)))
    yield kind, "twenty shells facing out", lambda: joined(*[ball(2, 1 - n / 25) for n in range(20)])
    spots = [tuple(p) for p in np.stack(np.meshgrid(*[np.linspace(-0.7, 0.7, 5)] * 3), -1).reshape(-1, 3)]
    yield kind, "cube with 125 bubbles", lambda: joined(cube(2), *[turned(ball(1, 0.1, at)) for at in spots])
    yield kind, "cube with 125 balls inside", lambda: joined(cube(2), *[ball(1, 0.1, at) for at in spots])
    yield kind, "void that reaches through the outside", lambda: joined(ball(), turned(ball(3, 0.6, (0.6, 0, 0))))
    yield kind, "void larger than the outside", lambda: joined(ball(), turned(ball(3, 1.5)))
    yield kind, "void 1e-4 below the outside", lambda: joined(ball(), turned(ball(3, 1 - 1e-4)))


def units() -> Iterator[Case]:
    kind = "odd units"
    for power in (-300, -150, -30, -9, -6, 6, 9, 30, 150, 300):
        yield kind, f"mug, 1e{power} long", lambda p=power: scaled(named("mug"), float(f"1e{p}"))
    for far in (1e3, 1e6, 1e9, 1e15, 1e17):
        yield kind, f"mug, {far:g} from the origin", lambda f=far: scaled(named("mug"), 1, f)
    yield kind, "mug, a thousand times as tall", lambda: scaled(named("mug"), (1, 1, 1e3))
    yield kind, "mug, a million times as wide", lambda: scaled(named("mug"), (1e6, 1, 1))


def many() -> Iterator[Case]:
    kind = "many faces"
    yield kind, "ball of 1.3 million faces", lambda: ball(8)
    yield kind, "rough ball of 330 thousand faces", lambda: noisy(ball(7), 0.0005)
    yield kind, "rough ball of 330 thousand faces that cross", lambda: noisy(ball(7), 0.01)
    yield kind, "soup of 330 thousand faces", lambda: soup(ball(7))
    yield kind, "ball of 330 thousand faces, one missing", lambda: without(ball(7), slice(9, 10))
    yield kind, "200 thousand triangles at random places", lambda: (
        np.random.default_rng(5).random((600_000, 3)), np.arange(600_000).reshape(-1, 3))  # fmt: skip
    yield kind, "fan of 20 thousand faces", _fan
    yield kind, "a million vertices that no face uses", lambda: (
        np.concatenate([cube()[0], np.random.default_rng(0).random((1_000_000, 3))]), cube()[1])  # fmt: skip


def _fan(n: int = 10_000) -> Corners:
    angle = np.arange(n) / n * 2 * np.pi
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    i = np.arange(n)
    up, down = np.full(n, n), np.full(n, n + 1)
    faces = np.concatenate([np.stack([i, (i + 1) % n, up], -1), np.stack([(i + 1) % n, i, down], -1)])
    return np.concatenate([rim, [[0, 0, 0.5], [0, 0, -0.5]]]), faces


def thin() -> Iterator[Case]:
    kind = "thin"
    for height in (0.0625, 0.02, 2e-3, 1e-4, 1e-6, 1e-9):
        yield kind, f"plate {height:g} high", lambda h=height: scaled(cube(2, edge=0.5), (1, 1, h / 2))
    for width in (0.0625, 0.02, 1e-3, 1e-6):
        yield kind, f"rod {width:g} wide", lambda w=width: scaled(cube(2, edge=0.1), (w / 2, w / 2, 1))
    for wall in (0.06, 0.01, 1e-3):
        yield kind, f"hollow ball with a wall of {wall:g}", lambda w=wall: joined(ball(4), turned(ball(4, 1 - w)))
    yield kind, "wire in loops", lambda: tube(np.stack([
        np.sin(np.arange(600) / 600 * 2 * np.pi) * (2 + np.cos(np.arange(600) / 600 * 40 * np.pi)),
        np.cos(np.arange(600) / 600 * 2 * np.pi) * (2 + np.cos(np.arange(600) / 600 * 40 * np.pi)),
        np.sin(np.arange(600) / 600 * 40 * np.pi)], -1), 0.03, 6)  # fmt: skip
    yield kind, "wedge with an edge of no width", lambda: (
        np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0.3], [1, -1, 0.3]], float),
        np.array([[0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4], [3, 4, 5], [3, 5, 2], [0, 4, 3], [1, 2, 5]]))  # fmt: skip
    yield kind, "spiky ball", lambda: (
        ball(3)[0] * np.where(np.arange(len(ball(3)[0])) % 9 == 0, 2.0, 1.0)[:, None], ball(3)[1])  # fmt: skip


def bodies() -> Iterator[Case]:
    kind = "many bodies"
    for count in (2, 10, 1000):
        yield kind, f"{count} cubes in a row", lambda n=count: joined(*[cube(1, (2 * i, 0, 0)) for i in range(n)])
    yield kind, "cube and a crumb", lambda: joined(cube(), cube(0.01, (2, 0, 0)))
    yield kind, "cube and a sheet", lambda: joined(cube(), sheet())
    yield kind, "cube and a sheet far off", lambda: joined(cube(), scaled(sheet(), 1, (5, 0, 0)))
    yield kind, "cube in a box of sheets", lambda: joined(cube(), without(cube(3), slice(0, 2)))
    yield kind, "two rings in each other", lambda: joined(
        torus(1, 0.2), (torus(1, 0.2)[0][:, [0, 2, 1]] + [1, 0, 0], torus(1, 0.2)[1][:, ::-1]))  # fmt: skip
    yield kind, "cubes that overlap in a row", lambda: joined(*[cube(1, (0.7 * i, 0.01 * i, 0)) for i in range(40)])


def small() -> Iterator[Case]:
    kind = "few faces"
    tetrahedron = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    sides = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    yield kind, "tetrahedron", lambda: (tetrahedron, sides)
    yield kind, "tetrahedron, one side missing", lambda: (tetrahedron, sides[1:])
    yield kind, "octahedron", lambda: (
        np.concatenate([np.eye(3), -np.eye(3)]),
        np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]))  # fmt: skip
    yield kind, "cube", cube
    yield kind, "no faces", lambda: (np.eye(3), np.zeros((0, 3), np.int64))
    yield kind, "nothing", lambda: (np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    yield kind, "face of a vertex that is not there", lambda: (cube()[0], np.concatenate([cube()[1], [[0, 1, 99]]]))
    yield kind, "face of vertex -1", lambda: (cube()[0], np.concatenate([cube()[1], [[0, 1, -1]]]))


def solids() -> Iterator[Case]:
    """Every case."""
    for family in (
        opened,
        flipped,
        doubled,
        crossing,
        crowded,
        flat,
        wild_numbers,
        nested,
        units,
        many,
        thin,
        bodies,
        small,
    ):
        yield from family()
