"""A cube with a texture, in a file as programs write them, and what it breaks into."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from deepfracture.carve import cut
from deepfracture.carve.voronoi import voronoi_pattern
from deepfracture.geometry import load_shape, signed_distance
from deepfracture.types import Fragments, Grid, Recording, Shape, Track

SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
"""Corners of a cube's sides, x the fastest, counter-clockwise from outside; two sides an axis, z first."""
CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
ACROSS = {0: (1, 2), 1: (0, 2), 2: (0, 1)}
"""The coordinates that a side's texture coordinates follow, by the axis that it faces."""


def expected_uv(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Texture coordinates of points (n, 3) on the cube's sides."""
    across = np.array([ACROSS[axis] for axis in np.abs(normals).argmax(axis=1)])
    return (np.take_along_axis(points, across, axis=1) + 1) / 2


def write_cube(folder: Path) -> Path:
    """cube.obj, cube.mtl and tiles.png: `glaze` has the texture, the two last sides, across x, are `wax`, plain red."""
    picture = np.zeros((16, 16, 3), np.uint8)
    picture[..., 1], picture[:8, :, 2] = 200, 200  # green, turquoise in the upper half
    Image.fromarray(picture).save(folder / "tiles.png")
    glaze, wax = "newmtl glaze\nKd 0.8 0.8 0.8\nmap_Kd -s 1 1 1 tiles.png\n", "newmtl wax\nKd 1 0 0\n"
    (folder / "cube.mtl").write_text(glaze + wax)
    lines = ["# a cube", "mtllib cube.mtl", *("v {:g} {:g} {:g}".format(*p) for p in CORNERS), "usemtl glaze"]
    for side, corners in enumerate(SIDES):
        normal = np.zeros(3)
        normal[2 - side // 2] = -1 if side % 2 == 0 else 1
        lines += ["usemtl wax"] if side == 4 else []
        lines += ["vt {:g} {:g}".format(*uv) for uv in expected_uv(CORNERS[list(corners)], np.tile(normal, (4, 1)))]
        lines += ["vn {:g} {:g} {:g}".format(*normal)]
        # Relative indices: the last four texture coordinates and the last normal.
        lines += ["f " + " ".join(f"{c + 1}/{k - 4}/-1" for k, c in enumerate(corners))]
    path = folder / "cube.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def broken_cube(folder: Path) -> tuple[Shape, Fragments]:
    shape = load_shape(str(write_cube(folder)))
    return shape, broken(shape)


def broken(shape: Shape, pieces: int = 5, resolution: int = 32) -> Fragments:
    """Voronoi cells of a shape."""
    grid = Grid(resolution)
    sites = np.random.default_rng(3).uniform(-0.9, 0.9, (pieces, 3))
    return cut(shape, voronoi_pattern(sites, signed_distance(shape.mesh, grid) > 0, grid), density=2000.0)


def filmed(shape: Shape, fragments: Fragments) -> Recording:
    """Two frames whole, four in which the fragments drift apart."""
    still = np.array([[1.0, 0, 0, 0]])
    tracks = [Track(shape.name, "shape", shape.mesh, None, 0, np.zeros((2, 3)), np.repeat(still, 2, 0), shape)]
    for k, piece in enumerate(fragments):
        away = np.linspace(0, 0.5, 4)[:, None] * piece.centre
        turns = np.repeat(still, 4, 0)
        tracks.append(Track(f"{shape.name}.{k}", "fragment", piece.mesh, piece.source, 2, away, turns, shape))
    return Recording(1 / 30, tuple(tracks))
