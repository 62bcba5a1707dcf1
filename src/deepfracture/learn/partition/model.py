"""The trained partition network and its file. Prediction needs no torch."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from deepfracture.learn.checkpoint import check, pack_distance, read, unpack_distance, write
from deepfracture.learn.codes import encode_impulses
from deepfracture.learn.inference import NEAREST, UNQUANTISED, Inference
from deepfracture.learn.model import Model
from deepfracture.learn.normaliser import Normaliser
from deepfracture.learn.partition import network
from deepfracture.learn.partition.config import PartitionConfig
from deepfracture.learn.partition.field import SplineDomain, decode_logits
from deepfracture.learn.partition.selector import ImpulseKernel, MinimumRiskSelector
from deepfracture.runtime.parallel import parallel_matmul, single_threaded_blas
from deepfracture.types import BadInput, Floats32, Grid, Ints, Shape, Volume

FORMAT = 2
KIND = "model"
BAND = 0.3
"""Distance [m] outside up to which the distance to the surface is exact: segmentation and `matches_shape` need no
more."""


@dataclass(frozen=True, eq=False)
class PartitionModel(Model):
    """A trained model: a code partitions the shape into fragments."""

    config: PartitionConfig
    domain: SplineDomain
    weights: dict[str, Floats32]
    """See `network.shapes`."""
    selector: MinimumRiskSelector
    """The training patterns, and which of them suits an impact."""

    @property
    def description(self) -> str:
        return "model"

    @property
    def inference(self) -> Inference:
        return Inference()

    @property
    def ablations(self) -> dict[str, Inference]:
        return {
            "nearest code": Inference(NEAREST),
            "nearest impulse": Inference(NEAREST, random=False),
            "no quantisation": Inference(UNQUANTISED),
            "no random code": Inference(random=False),
        }

    @property
    def channels(self) -> int:
        """Most fragments with a channel of their own."""
        return self.weights["head.bias"].size // self.config.basis

    @property
    def weakest_impulse(self) -> float:
        return float(self.selector.impulses[:, 0, 6].min() + 1) / 2 * self.normaliser.max_impulse

    @cached_property
    def codebook(self) -> Floats32:
        return np.concatenate([self.encode(self.selector.impulses), self.selector.segment], axis=1)

    @cached_property
    def node_features(self) -> Floats32:
        """The Fourier features at the nodes of the lattice, as spline coefficients, shape (nodes, basis)."""
        gain = self.domain.lattice.gain(self.weights["waves.vector"])
        nodes = self.domain.nodes.astype(np.float32)
        return network.fourier_features(self.weights, nodes, np) * gain.astype(np.float32)

    def at(self, shape: Shape, resolution: int) -> PartitionModel:
        """The same model for GS-SDFs of another resolution: it has learned functions of the position.

        Args:
            shape: The shape that it was trained on, for the distance to the surface; outside it is exact up to BAND
                and no larger than that, which saves most of the time.

        The distances take seconds at high resolutions, so the result lives as long as this model and the shape.
        """
        models = self._resampled.setdefault(shape, {})
        if resolution not in models:
            models[resolution] = replace(self, domain=_domain(shape, Grid(resolution)))
        return models[resolution]

    @cached_property
    def _resampled(self) -> WeakKeyDictionary[Shape, dict[int, PartitionModel]]:
        """This model at other resolutions."""
        return WeakKeyDictionary()

    def encode(self, impulses: Floats32) -> Floats32:
        return encode_impulses(self.weights, impulses)

    def rank_by_risk(self, impulses: Floats32, random: Floats32, bandwidth: float) -> Ints:
        return self.selector(impulses, random, bandwidth=bandwidth)

    def decode(self, code: Floats32) -> Volume:
        with single_threaded_blas():
            matrix = network.mixing_matrices(self.weights, code[None], np)[0]
        return decode_logits(self.domain, parallel_matmul(self.node_features, matrix))

    def save(self, path: Path) -> None:
        """Store the model, its large matrices as float16."""
        arrays = {name: _stored(name, value) for name, value in self.weights.items()}
        grid, selector = self.domain.grid, self.selector
        metadata = {
            "format": FORMAT,
            "shape": self.shape_name,
            "resolution": grid.resolution,
            "config": asdict(self.config),
            "channels": self.channels,
            "max_impulse": self.normaliser.max_impulse,
            "similarity": asdict(selector.kernel),
            "about": self.metadata,
        }
        patterns = {
            "rows": selector.impulses,
            "segment": selector.segment,
            "apart": selector.pairwise.astype(np.float16),
            "surface": pack_distance(self.domain.surface, grid),
        }
        write(path, KIND, {**arrays, **patterns}, metadata)


def load_partition_model(path: Path | str) -> PartitionModel:
    """Read a model and check all of it before use.

    Raises:
        BadInput: In one line, what is missing, damaged, or of another format.
    """
    path = Path(path)
    arrays, metadata = read(path, KIND)
    if metadata.get("format") != FORMAT:
        raise BadInput(f"{path}: model format {metadata.get('format')}, this program reads {FORMAT}; train it again")
    try:
        config, grid = PartitionConfig(**metadata["config"]), Grid(metadata["resolution"])
        normaliser = Normaliser(float(metadata["max_impulse"]), config.features)
        name, channels, about = str(metadata["shape"]), int(metadata["channels"]), dict(metadata["about"])
        surface = unpack_distance(arrays["surface"], grid)
        kernel = ImpulseKernel(**metadata["similarity"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{path}: not a model of deepfracture, or damaged ({error}); train it again") from error
    sizes = network.shapes(config, channels)
    n = max(len(arrays.get("rows", ())), 1)
    patterns = {"rows": (n, config.features, 7), "segment": (n, config.segment_size), "apart": (n, n)}
    check(path, arrays, {**sizes, **patterns})
    weights = {key: arrays[key].astype(np.float32) for key in sizes}
    impulses, segment, pairwise = (arrays[key].astype(np.float32) for key in patterns)
    selector = MinimumRiskSelector(impulses, segment, pairwise, kernel)
    return PartitionModel(name, config, normaliser, SplineDomain.of(grid, surface), about, weights, selector)


def _domain(shape: Shape, grid: Grid) -> SplineDomain:
    from deepfracture.geometry import signed_distance_lattice

    surface = signed_distance_lattice(shape.mesh, grid.to_world([0, 0, 0]), grid.spacing, grid.shape, outside=BAND)
    return SplineDomain.of(grid, surface)


def _stored(name: str, value: Floats32) -> np.ndarray:
    return value.astype(np.float16) if name in ("head.weight", "first.weight", "second.weight") else value
