"""Inference: impulse and random code to the nearest code known, and that to a GS-SDF. Needs no torch."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.learn import network
from deepfracture.learn.checkpoint import check, pack_distance, read, unpack_distance, write
from deepfracture.learn.codebook import quantise
from deepfracture.learn.field import Body, volume_of
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.settings import Config
from deepfracture.types import BadInput, Floats32, Grid, Impact, Shape, Volume

FORMAT = 1
KIND = "model"
SAME_SURFACE = 0.5
"""Voxels by which distances to the surface of one shape may differ: another tessellation, stored precision."""
SHIPPED = Path(__file__).parent / "models"


@dataclass(frozen=True, eq=False)
class Model:
    """A trained generative model of one shape."""

    shape_name: str
    config: Config
    normaliser: Normaliser
    body: Body
    weights: dict[str, Floats32]
    """See `network.shapes`."""
    codebook: Floats32
    """Latent codes of the training patterns, impulse then segment, shape (n, code_size)."""
    about: dict[str, Any]
    """How it was trained: command, seed, loss, counts."""

    @property
    def channels(self) -> int:
        return self.weights["head.bias"].size // self.config.basis

    @cached_property
    def waves(self) -> Floats32:
        """The basis at every voxel inside, shape (voxels, basis)."""
        return network.basis(self.weights, self.body.points.astype(np.float32), np)

    def fits(self, shape: Shape) -> bool:
        """Whether `shape` is the one that the model was trained on, however it is tessellated: the
        distances to its surface are those that the model stores."""
        from deepfracture.geometry import signed_distance_points

        grid = self.body.grid
        voxels = np.argwhere(np.abs(self.body.surface) < 4 * grid.spacing)[:: max(1, self.body.surface.size // 10**5)]
        known = self.body.surface[tuple(voxels.T)]
        found = signed_distance_points(shape.mesh, grid.to_world(voxels))
        return bool(np.percentile(np.abs(found - known), 99) < SAME_SURFACE * grid.spacing)

    def decode(self, code: Floats32) -> Volume:
        """The GS-SDF of one latent code, shape (code_size,)."""
        return volume_of(self.body, self.waves @ network.compose(self.weights, code[None], np)[0])


def predict(model: Model, impact: Impact, rng: np.random.Generator) -> Volume:
    """A fracture pattern under `impact` (paper, section 4.2.7): `rng` draws Z_random, so that the same impact
    can break the shape in several ways."""
    rows = model.normaliser(impact).astype(np.float32)
    impulse = network.encode_impulses(model.weights, rows[None], np)[0]
    random = rng.standard_normal(model.config.segment_size, np.float32)
    return model.decode(model.codebook[quantise(model.codebook, np.concatenate([impulse, random]))])


def save_model(path: Path, model: Model) -> None:
    """Store a model, its large matrices as float16."""
    arrays = {name: _small(name, value) for name, value in model.weights.items()}
    grid = model.body.grid
    facts = {
        "format": FORMAT,
        "shape": model.shape_name,
        "resolution": grid.resolution,
        "config": asdict(model.config),
        "channels": model.channels,
        "max_impulse": model.normaliser.max_impulse,
        "about": model.about,
    }
    write(
        path,
        KIND,
        {**arrays, "codebook": model.codebook, "surface": pack_distance(model.body.surface, grid)},
        facts,
    )


def load_model(path: Path | str) -> Model:
    """Read a model and check all of it before use.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format.
    """
    path = Path(path)
    arrays, facts = read(path, KIND)
    if facts.get("format") != FORMAT:
        raise BadInput(f"{path}: model format {facts.get('format')}, this program reads {FORMAT}; train it again")
    try:
        config, grid = Config(**facts["config"]), Grid(facts["resolution"])
        normaliser = Normaliser(float(facts["max_impulse"]), config.features)
        name, channels, about = str(facts["shape"]), int(facts["channels"]), dict(facts["about"])
        surface = unpack_distance(arrays["surface"], grid)
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{path}: not a model of deepfracture, or damaged ({error}); train it again") from error
    sizes = network.shapes(config, channels)
    codes = len(arrays.get("codebook", ()))
    check(path, arrays, {**sizes, "codebook": (max(codes, 1), config.code_size)})
    weights = {key: arrays[key].astype(np.float32) for key in sizes}
    return Model(
        name,
        config,
        normaliser,
        Body.of(grid, surface),
        weights,
        arrays["codebook"].astype(np.float32),
        about,
    )


def embedded_model(shape_name: str) -> Path | None:
    """The shipped weights for a built-in shape, if there are any."""
    path = SHIPPED / f"{shape_name}.safetensors"
    return path if path.is_file() else None


def _small(name: str, value: Floats32) -> np.ndarray:
    return value.astype(np.float16) if name in ("head.weight", "first.weight", "second.weight") else value
