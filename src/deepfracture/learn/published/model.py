"""A trained network that predicts the GS-SDF itself, and its file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn.checkpoint import check, pack_distance, read, unpack_distance, write
from deepfracture.learn.codes import encode_impulses, siren_shapes
from deepfracture.learn.domain import VoxelDomain
from deepfracture.learn.inference import NEAREST, UNQUANTISED, Inference
from deepfracture.learn.model import Model
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.published.config import MLP, PAPER, PIX2PIX, PublishedConfig
from deepfracture.learn.published.mlp import CoordinateMLP
from deepfracture.learn.published.paper import PaperDecoder
from deepfracture.learn.published.pix2pix import Pix2Pix
from deepfracture.types import BadInput, Floats32, Grid, Impact, Volume

FORMAT = 1
KIND = "field model"
LEAST_DISTANCE = 0.01
"""Voxels by which the field is positive at least inside the shape, so that each voxel there belongs to a fragment."""
CHUNK = 1 << 14
"""Positions that the coordinate network evaluates at once."""
WIDEST = 64
"""Greatest width of a network that is built."""


@dataclass(frozen=True, eq=False)
class PublishedModel(Model):
    """A network of one of the publications. Its predictions stand, even of one piece."""

    config: PublishedConfig
    siren: Mapping[str, Floats32]
    """The frozen sine layer, see `codes.siren_shapes`; empty for pix2pix, which reads the impulses as they are."""
    network: nn.Module
    codes: Floats32
    """See `codebook`, shape (N_space, code_size)."""

    @property
    def description(self) -> str:
        return f"{self.config.preset} model"

    @property
    def inference(self) -> Inference:
        return Inference(UNQUANTISED if self.config.preset == PIX2PIX else NEAREST)

    @property
    def ablations(self) -> dict[str, Inference]:
        return {"no quantisation": Inference(UNQUANTISED), "no segment code": Inference(NEAREST, random=False)}

    @property
    def codebook(self) -> Floats32:
        return self.codes

    @property
    def weight_count(self) -> int:
        """How many numbers the network holds."""
        return sum(parameter.numel() for parameter in self.network.parameters())

    def encode(self, impulses: Floats32) -> Floats32:
        return encode(self.siren, impulses)

    def predictions(
        self, impact: Impact, rng: np.random.Generator, inference: Inference | None = None
    ) -> Iterator[Volume]:
        yield next(super().predictions(impact, rng, inference))

    def decode(self, code: Floats32, resolution: int | None = None) -> Volume:
        """The GS-SDF of one code, shape (code_size,), at one of the resolutions learned, the finest by default.

        Outside the shape it is the shape's own distance, as far as that is stored: there is nothing to predict.

        Raises:
            BadInput: The resolution was not learned."""
        known = self.config.resolutions
        assert known is not None
        resolution = resolution or known[-1]
        if resolution not in known:
            raise BadInput(f"resolution must be one of those learned, {known}, got {resolution}")
        grid, surface = Grid(resolution), _block_means(self.domain.surface, resolution)
        found = np.maximum(self._field(code, known.index(resolution)), LEAST_DISTANCE * grid.spacing)
        return Volume(grid, np.where(surface > 0, found, surface).astype(np.float32))

    @torch.no_grad()
    def _field(self, code: Floats32, level: int) -> Floats32:
        """The network's output on the whole grid, at the resolution number `level`."""
        device = next(self.network.parameters()).device
        codes = torch.from_numpy(np.asarray(code, np.float32))[None].to(device)
        if isinstance(self.network, CoordinateMLP):
            points = torch.from_numpy(self.domain.points.astype(np.float32)).to(device)
            values = self.domain.surface.copy()
            values[self.domain.voxels] = torch.cat([self.network(codes, part)[0] for part in points.split(CHUNK)]).cpu()
            return values
        fields = self.network(codes)
        field = fields if isinstance(fields, Tensor) else fields[level]
        return field[0].cpu().numpy()

    def save(self, path: Path) -> None:
        """Store the model, its network as float16."""
        weights = {f"network.{name}": value.cpu().numpy() for name, value in self.network.state_dict().items()}
        metadata = {
            "format": FORMAT,
            "shape": self.shape_name,
            "resolution": self.domain.grid.resolution,
            "config": asdict(self.config),
            "max_impulse": self.normaliser.max_impulse,
            "about": self.metadata,
        }
        arrays = {name: value.astype(np.float16) for name, value in weights.items()}
        surface = pack_distance(self.domain.surface, self.domain.grid)
        write(path, KIND, {**arrays, **self.siren, "codebook": self.codebook, "surface": surface}, metadata)


def encode(siren: Mapping[str, Floats32], impulses: Floats32) -> Floats32:
    """Z^impulse of rows J^norm, shape (n, features, 7): shape (n, condition_size); the rows themselves without a sine
    layer."""
    return encode_impulses(siren, impulses) if siren else impulses.reshape(len(impulses), -1)


def build(config: PublishedConfig, surface: Floats32) -> nn.Module:
    """The preset's network, with random weights of torch's global generator."""
    if config.preset == PAPER:
        return PaperDecoder(config)
    if config.preset == MLP:
        return CoordinateMLP(config)
    assert config.preset == PIX2PIX
    return Pix2Pix(config, surface)


def load_published_model(path: Path, device: torch.device) -> PublishedModel:
    """Read a model and check all of it before use.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format.
    """
    arrays, metadata = read(path, KIND)
    if metadata.get("format") != FORMAT:
        raise BadInput(f"{path}: model format {metadata.get('format')}, this program reads {FORMAT}; train it again")
    try:
        config, grid = PublishedConfig(**metadata["config"]), Grid(metadata["resolution"])
        config = config.at(grid.resolution)
        normaliser = Normaliser(float(metadata["max_impulse"]), config.features)
        name, about = str(metadata["shape"]), dict(metadata["about"])
        surface = unpack_distance(arrays["surface"], grid)
        with torch.device("meta"):
            wanted = {f"network.{key}": tuple(value.shape) for key, value in _skeleton(config).state_dict().items()}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]  # torch writes whole signatures
        raise BadInput(f"{path}: not a {KIND} of deepfracture, or damaged ({reason}); train it again") from error
    siren_wanted = {} if config.preset == PIX2PIX else siren_shapes(config.impulse_size)
    codes = len(arrays.get("codebook", ()))
    check(path, arrays, {**wanted, **siren_wanted, "codebook": (max(codes, 1), config.code_size)})
    network = build(config, surface)
    network.load_state_dict(
        {key.removeprefix("network."): torch.from_numpy(arrays[key].astype(np.float32)) for key in wanted}
    )
    siren = {key: arrays[key].astype(np.float32) for key in siren_wanted}
    return PublishedModel(
        name, config, normaliser, VoxelDomain(grid, surface), about, siren, to_device(network, device).eval(),
        arrays["codebook"].astype(np.float32),
    )  # fmt: skip


def to_device(network: nn.Module, device: torch.device) -> nn.Module:
    """The network on its device, its kernels in the memory layout in which volumes are convolved fastest."""
    network.to(device)
    for parameter in network.parameters():
        if parameter.ndim == 5:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last_3d)
    return network


def weight_count(config: PublishedConfig, resolution: int) -> int:
    """How many numbers the network of a preset holds, without building it."""
    with torch.device("meta"):
        return sum(parameter.numel() for parameter in _skeleton(config.at(resolution)).parameters())


def _skeleton(config: PublishedConfig) -> nn.Module:
    """The network without numbers, for the shapes of its weights."""
    assert config.resolutions is not None
    finest = config.resolutions[-1]
    if math.isinf(config.width) or config.width > WIDEST:
        raise BadInput(f"width must be at most {WIDEST}, got {config.width}")
    return build(config, np.broadcast_to(np.float32(0), (finest,) * 3))


def _block_means(surface: Floats32, resolution: int) -> Floats32:
    """The distance at the centres of a coarser grid: the mean of the voxels in each of its voxels."""
    step = len(surface) // resolution
    return surface.reshape(resolution, step, resolution, step, resolution, step).mean(axis=(1, 3, 5))
