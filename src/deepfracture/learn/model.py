"""What every trained model does: find codes for an impact, and decode them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepfracture.learn.codes import nearest_codes
from deepfracture.learn.domain import VoxelDomain
from deepfracture.learn.inference import MINIMUM_RISK, NEAREST, UNQUANTISED, Inference
from deepfracture.learn.normaliser import Normaliser
from deepfracture.runtime.parallel import single_threaded_blas
from deepfracture.types import BadInput, Floats32, Impact, Ints, Shape, Volume


@dataclass(frozen=True, eq=False)
class Model(ABC):
    """A trained generative model of one shape: impulse and random code to a GS-SDF. `learn.load_model` reads one."""

    shape_name: str
    config: Any
    """Sizes and training settings; `features` and `segment_size` are common to all models."""
    normaliser: Normaliser
    domain: VoxelDomain
    metadata: Mapping[str, Any]
    """How it was trained: command, seed, material, loss, epochs, fragment counts."""

    @property
    @abstractmethod
    def description(self) -> str:
        """The kind of model, in a word or two."""

    @property
    @abstractmethod
    def inference(self) -> Inference:
        """The settings that serve this model best."""

    @property
    @abstractmethod
    def ablations(self) -> dict[str, Inference]:
        """Settings that leave one part of the prediction out, by the name of that part."""

    @property
    @abstractmethod
    def codebook(self) -> Floats32:
        """The embedding space: latent codes of training patterns, impulse then segment, shape (n, code_size)."""

    @property
    def weakest_impulse(self) -> float:
        """Least impulse known to break the shape [N s]; 0 if the model does not store it."""
        return 0.0

    @abstractmethod
    def encode(self, impulses: Floats32) -> Floats32:
        """Z^impulse of rows J^norm, shape (n, features, 7): shape (n, condition_size)."""

    @abstractmethod
    def decode(self, code: Floats32) -> Volume:
        """The GS-SDF of one latent code, shape (code_size,)."""

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write the model as a safetensors file, complete or not at all."""

    def rank_by_risk(self, impulses: Floats32, random: Floats32, bandwidth: float) -> Ints:
        """Indices of the codebook by ascending expected distance to what the impulses may cause.

        Raises:
            BadInput: The model does not store the distances between its training patterns.
        """
        raise BadInput(f"selection {MINIMUM_RISK!r}: a {self.description} has no distances between its patterns")

    def matches_shape(self, shape: Shape) -> bool:
        """Whether `shape` is the one that the model was trained on, however it is tessellated."""
        return self.domain.matches_shape(shape)

    def predict(self, impact: Impact, rng: np.random.Generator, inference: Inference | None = None) -> Volume:
        """A fracture pattern under `impact` as a GS-SDF (paper, section 4.2.7).

        Args:
            rng: Draws Z_random, so that one impact can break the shape in several ways.
            inference: By default the model's own.
        """
        return next(self.predictions(impact, rng, inference))

    def predictions(
        self, impact: Impact, rng: np.random.Generator, inference: Inference | None = None
    ) -> Iterator[Volume]:
        """The result of `predict`, then those of the next codes, for a caller that cannot use the first."""
        with single_threaded_blas():
            codes = self._codes(impact, rng, inference or self.inference)
        for code in codes:
            yield self.decode(code)

    def _codes(self, impact: Impact, rng: np.random.Generator, inference: Inference) -> Iterable[Floats32]:
        """Latent codes for an impact, the best first."""
        impulses = self.normaliser(impact).astype(np.float32)
        random = rng.standard_normal(self.config.segment_size, np.float32) * np.float32(inference.random)
        impulse = self.encode(impulses[None])[0]
        code = np.concatenate([impulse, random])
        if inference.selection == UNQUANTISED:
            return [code]
        if inference.selection == NEAREST:
            compared = slice(None) if inference.random else slice(len(impulse))
            order = nearest_codes(self.codebook[:, compared], code[compared])
        else:
            order = self.rank_by_risk(impulses, random, inference.bandwidth)
        return (self.codebook[index] for index in order)
