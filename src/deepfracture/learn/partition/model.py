"""Inference: impulse and random code to a code of the embedding space, and that to a GS-SDF. Needs no torch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from deepfracture.learn import fit
from deepfracture.learn.checkpoint import check, pack_distance, read, unpack_distance, write
from deepfracture.learn.codebook import nearest_first
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.partition import network
from deepfracture.learn.partition.config import Config
from deepfracture.learn.partition.field import Body, volume_of
from deepfracture.learn.partition.selector import VARIETY, Choice, Similarity
from deepfracture.runtime.parallel import parallel_matmul, single_threaded_blas
from deepfracture.types import BadInput, Floats32, Grid, Impact, Shape, Volume

FORMAT = 2
KIND = "model"
REACH = 0.3
"""Distance [m] outside up to which the surface's distance matters: `segment` and `fits` look no farther."""
SHIPPED = Path(__file__).parents[1] / "models"


@dataclass(frozen=True, eq=False)
class Model:
    """A trained generative model of one shape."""

    shape_name: str
    config: Config
    normaliser: Normaliser
    body: Body
    weights: dict[str, Floats32]
    """See `network.shapes`."""
    choice: Choice
    """The training patterns: which of them answers an impact."""
    about: dict[str, Any]
    """How it was trained: command, seed, loss, counts."""

    @property
    def channels(self) -> int:
        return self.weights["head.bias"].size // self.config.basis

    @cached_property
    def codebook(self) -> Floats32:
        """The embedding space: latent codes of the training patterns, impulse then segment, shape (n, code_size)."""
        impulse = network.encode_impulses(self.weights, self.choice.rows, np)
        return np.concatenate([impulse, self.choice.segment], axis=1)

    @cached_property
    def waves(self) -> Floats32:
        """The basis at the nodes of the body's lattice, as coefficients of splines, shape (nodes, basis)."""
        gain = self.body.lattice.gain(self.weights["waves.vector"])
        return network.basis(self.weights, self.body.nodes.astype(np.float32), np) * gain.astype(np.float32)

    def at(self, shape: Shape, resolution: int) -> Model:
        """The same model for GS-SDFs of another resolution: what it has learned are functions of the place.

        Args:
            shape: The shape that it was trained on, for the distance to the surface; outside it is exact up
                to REACH and no larger than that, which saves most of the time.

        The distances take seconds at high resolutions, so the model is kept as long as this one and the shape live.
        """
        models = self._elsewhere.setdefault(shape, {})
        if resolution not in models:
            models[resolution] = replace(self, body=_body(shape, Grid(resolution)))
        return models[resolution]

    @cached_property
    def _elsewhere(self) -> WeakKeyDictionary[Shape, dict[int, Model]]:
        """This model at other resolutions."""
        return WeakKeyDictionary()

    def fits(self, shape: Shape) -> bool:
        """Whether `shape` is the one that the model was trained on, however it is tessellated."""
        return fit.fits(self.body, shape)

    def decode(self, code: Floats32) -> Volume:
        """The GS-SDF of one latent code, shape (code_size,)."""
        with single_threaded_blas():
            matrix = network.compose(self.weights, code[None], np)[0]
        return volume_of(self.body, parallel_matmul(self.waves, matrix))


def _body(shape: Shape, grid: Grid) -> Body:
    from deepfracture.geometry import signed_distance_lattice

    surface = signed_distance_lattice(shape.mesh, grid.to_world([0, 0, 0]), grid.spacing, grid.shape, outside=REACH)
    return Body.of(grid, surface)


@dataclass(frozen=True)
class Way:
    """How a code is found and decoded; `OURS` is the best that we know, `AS_PUBLISHED` the paper's."""

    rule: str = "typical"
    """typical: see `choice`. nearest: the code nearest to [impulse, random]. free: that code itself."""
    random: bool = True
    """Whether Z_random takes part; else zeros, and with `nearest` the impulse alone is compared."""
    variety: float = VARIETY
    """See `Choice`; smaller makes draws differ more."""

    def __post_init__(self) -> None:
        if self.rule not in RULES or not self.variety > 0:
            raise BadInput(
                f"rule must be one of {', '.join(RULES)} and variety positive, got {self.rule}, {self.variety}"
            )


RULES = ("typical", "nearest", "free")
OURS = Way()
AS_PUBLISHED = Way(rule="nearest")
"""Section 4.2.7 of the paper."""


def predict(model: Model, impact: Impact, rng: np.random.Generator, way: Way = OURS) -> Volume:
    """A fracture pattern under `impact`: `rng` draws Z_random, so that one impact can break the shape in several
    ways (paper, section 4.2.7)."""
    return next(predictions(model, impact, rng, way))


def predictions(model: Model, impact: Impact, rng: np.random.Generator, way: Way = OURS) -> Iterator[Volume]:
    """The answer of `predict`, and what to fall back on when it does not serve: the next codes in order."""
    with single_threaded_blas():
        codes = _codes(model, impact, rng, way)
    for code in codes:
        yield model.decode(code)


def _codes(model: Model, impact: Impact, rng: np.random.Generator, way: Way) -> Iterable[Floats32]:
    """The latent codes that answer an impact, the best first."""
    rows = model.normaliser(impact).astype(np.float32)
    random = rng.standard_normal(model.config.segment_size, np.float32) * np.float32(way.random)
    impulse = network.encode_impulses(model.weights, rows[None], np)[0]
    code = np.concatenate([impulse, random])
    if way.rule == "free":
        return [code]
    if way.rule == "typical":
        order = model.choice(rows, random, variety=way.variety)
    else:
        compared = slice(None) if way.random else slice(len(impulse))
        order = nearest_first(model.codebook[:, compared], code[compared])
    return (model.codebook[index] for index in order)


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
        "similarity": asdict(model.choice.similarity),
        "about": model.about,
    }
    choice = model.choice
    codes = {"rows": choice.rows, "segment": choice.segment, "apart": choice.apart.astype(np.float16)}
    write(path, KIND, {**arrays, **codes, "surface": pack_distance(model.body.surface, grid)}, facts)


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
        similarity = Similarity(**facts["similarity"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{path}: not a model of deepfracture, or damaged ({error}); train it again") from error
    sizes = network.shapes(config, channels)
    n = max(len(arrays.get("rows", ())), 1)
    codes = {"rows": (n, config.features, 7), "segment": (n, config.segment_size), "apart": (n, n)}
    check(path, arrays, {**sizes, **codes})
    weights = {key: arrays[key].astype(np.float32) for key in sizes}
    taught, segment, apart = (arrays[key].astype(np.float32) for key in codes)
    choice = Choice(taught, segment, apart, similarity)
    return Model(name, config, normaliser, Body.of(grid, surface), weights, choice, about)


def embedded_model(shape_name: str) -> Path | None:
    """The shipped weights for a built-in shape, if there are any."""
    path = SHIPPED / f"{shape_name}.safetensors"
    return path if path.is_file() else None


def _small(name: str, value: Floats32) -> np.ndarray:
    return value.astype(np.float16) if name in ("head.weight", "first.weight", "second.weight") else value
