"""A trained network that predicts the GS-SDF itself, and its file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn import fit
from deepfracture.learn.checkpoint import check, pack_distance, read, unpack_distance, write
from deepfracture.learn.codebook import nearest_first
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.partition.field import Body
from deepfracture.learn.published.codes import encode, siren_shapes
from deepfracture.learn.published.config import MLP, PAPER, PIX2PIX, FieldConfig
from deepfracture.learn.published.mlp import CoordinateMLP
from deepfracture.learn.published.paper import PaperDecoder
from deepfracture.learn.published.pix2pix import Pix2Pix
from deepfracture.types import BadInput, Floats32, Grid, Impact, Shape, Volume

FORMAT = 1
KIND = "field model"
LEAST = 0.01
"""Voxels by which the field is positive at least inside the shape, so that a voxel there belongs somewhere."""
CHUNK = 1 << 14
"""Positions that the coordinate network answers at once."""


@dataclass(frozen=True, eq=False)
class FieldModel:
    """A trained generative model of one shape."""

    shape_name: str
    config: FieldConfig
    normaliser: Normaliser
    body: Body
    siren: dict[str, Floats32]
    """The frozen sine layer, see `codes.siren_shapes`."""
    network: nn.Module
    codebook: Floats32
    """The embedding space, shape (N_space, code_size)."""
    about: dict[str, Any]
    """How it was trained: command, seed, loss, counts."""
    quantised: bool = True
    """Whether a prediction takes the nearest code of the embedding space, or its own."""
    segment_code: bool = True
    """Whether the random code takes part in a prediction; else zeros, and the impulse alone is compared."""

    @property
    def surface(self) -> Floats32:
        """Signed distance to the shape's surface [m], + inside, shape (r, r, r)."""
        return self.body.surface

    @property
    def weights(self) -> int:
        """How many numbers the network holds."""
        return sum(parameter.numel() for parameter in self.network.parameters())

    def variant(self, *, quantised: bool = True, segment_code: bool = True) -> FieldModel:
        """The same network predicting otherwise (the paper's ablation)."""
        return replace(self, quantised=quantised, segment_code=segment_code)

    def fits(self, shape: Shape) -> bool:
        """Whether `shape` is the one that the model was trained on, however it is tessellated."""
        return fit.fits(self.body, shape)

    def predict(self, impact: Impact, rng: np.random.Generator) -> Volume:
        """A fracture pattern under `impact` (paper, section 4.2.7): `rng` draws Z_random, so that the same impact
        can break the shape in several ways."""
        return next(self.predictions(impact, rng))

    def predictions(self, impact: Impact, rng: np.random.Generator) -> Iterator[Volume]:
        """The answer of `predict`, and what to fall back on when it does not serve: the next codes in order."""
        rows = self.normaliser(impact).astype(np.float32)
        impulse = encode(self.siren, rows[None])[0]
        random = rng.standard_normal(self.config.segment_size, np.float32)
        if not self.segment_code:
            random = np.zeros_like(random)
        code = np.concatenate([impulse, random])
        if not self.quantised:
            yield self.decode(code)
            return
        compared = self.config.code_size if self.segment_code else len(impulse)
        for index in nearest_first(self.codebook[:, :compared], code[:compared]):
            yield self.decode(self.codebook[index])

    def decode(self, code: Floats32, resolution: int | None = None) -> Volume:
        """The GS-SDF of one code, shape (code_size,), at any of the resolutions learned, the finest by default.

        Outside the shape it is the shape's own distance, as far as that is stored: there is nothing to predict.

        Raises:
            BadInput: The resolution was not learned."""
        known = self.config.resolutions
        assert known is not None
        resolution = resolution or known[-1]
        if resolution not in known:
            raise BadInput(f"resolution must be one of those learned, {known}, got {resolution}")
        grid, surface = Grid(resolution), _coarser(self.body.surface, resolution)
        values = np.where(surface > 0, np.maximum(self._field(code, resolution), LEAST * grid.spacing), surface)
        return Volume(grid, values.astype(np.float32))

    @torch.no_grad()
    def _field(self, code: Floats32, resolution: int) -> Floats32:
        """What the network says, on the whole grid."""
        device = next(self.network.parameters()).device
        codes = torch.from_numpy(np.asarray(code, np.float32))[None].to(device)
        if isinstance(self.network, CoordinateMLP):
            points = torch.from_numpy(self.body.points.astype(np.float32)).to(device)
            values = self.body.surface.copy()
            values[self.body.voxels] = torch.cat([self.network(codes, part)[0] for part in points.split(CHUNK)]).cpu()
            return values
        fields = self.network(codes)
        if isinstance(fields, Tensor):
            return fields[0].cpu().numpy()
        assert self.config.resolutions is not None
        return fields[self.config.resolutions.index(resolution)][0].cpu().numpy()


def build(config: FieldConfig, surface: Floats32) -> nn.Module:
    """The preset's network, with random weights of torch's global generator."""
    if config.preset == PAPER:
        return PaperDecoder(config)
    if config.preset == MLP:
        return CoordinateMLP(config)
    assert config.preset == PIX2PIX
    return Pix2Pix(config, surface)


def save_field_model(path: Path, model: FieldModel) -> None:
    """Store a model, its network as float16."""
    grid = model.body.grid
    weights = {f"network.{name}": value.cpu().numpy() for name, value in model.network.state_dict().items()}
    facts = {
        "format": FORMAT,
        "shape": model.shape_name,
        "resolution": grid.resolution,
        "config": asdict(model.config),
        "max_impulse": model.normaliser.max_impulse,
        "about": model.about,
    }
    arrays = {name: value.astype(np.float16) for name, value in weights.items()}
    surface = pack_distance(model.body.surface, grid)
    write(path, KIND, {**arrays, **model.siren, "codebook": model.codebook, "surface": surface}, facts)


def load_field_model(path: Path, device: torch.device) -> FieldModel:
    """Read a model and check all of it before use.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format.
    """
    arrays, facts = read(path, KIND)
    if facts.get("format") != FORMAT:
        raise BadInput(f"{path}: model format {facts.get('format')}, this program reads {FORMAT}; train it again")
    try:
        config, grid = FieldConfig(**facts["config"]), Grid(facts["resolution"])
        config = config.at(grid.resolution)
        normaliser = Normaliser(float(facts["max_impulse"]), config.features)
        name, about = str(facts["shape"]), dict(facts["about"])
        surface = unpack_distance(arrays["surface"], grid)
        with torch.device("meta"):
            wanted = {f"network.{key}": tuple(value.shape) for key, value in _skeleton(config).state_dict().items()}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]  # torch writes whole signatures
        raise BadInput(f"{path}: not a {KIND} of deepfracture, or damaged ({reason}); train it again") from error
    codes = len(arrays.get("codebook", ()))
    check(path, arrays, {**wanted, **siren_shapes(config), "codebook": (max(codes, 1), config.code_size)})
    network = build(config, surface)
    network.load_state_dict(
        {key.removeprefix("network."): torch.from_numpy(arrays[key].astype(np.float32)) for key in wanted}
    )
    siren = {key: arrays[key].astype(np.float32) for key in siren_shapes(config)}
    codebook = arrays["codebook"].astype(np.float32)
    return FieldModel(
        name, config, normaliser, Body.of(grid, surface), siren, prepared(network, device).eval(), codebook, about,
        quantised=config.preset != PIX2PIX,
    )  # fmt: skip


def prepared(network: nn.Module, device: torch.device) -> nn.Module:
    """The network on its device, its kernels in the memory layout in which volumes are convolved fastest."""
    network.to(device)
    for parameter in network.parameters():
        if parameter.ndim == 5:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last_3d)
    return network


def weight_count(config: FieldConfig, resolution: int) -> int:
    """How many numbers the network of a preset holds, without making it."""
    with torch.device("meta"):
        return sum(parameter.numel() for parameter in _skeleton(config.at(resolution)).parameters())


def _skeleton(config: FieldConfig) -> nn.Module:
    """The network without numbers, for the shapes of its weights."""
    assert config.resolutions is not None
    finest = config.resolutions[-1]
    if math.isinf(config.width) or config.width > 64:
        raise BadInput(f"width must be at most 64, got {config.width}")
    return build(config, np.broadcast_to(np.float32(0), (finest,) * 3))


def _coarser(surface: Floats32, resolution: int) -> Floats32:
    """The distance at the centres of a coarser grid: the mean of the voxels in each of its voxels."""
    step = len(surface) // resolution
    return surface.reshape(resolution, step, resolution, step, resolution, step).mean(axis=(1, 3, 5))
