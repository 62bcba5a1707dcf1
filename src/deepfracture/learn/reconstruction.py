"""How well a model reconstructs its training patterns, against what encoding and segmentation lose by themselves.

A low L2 says little: the low ridges between fragments decide whether the watershed finds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deepfracture.carve import encode, segment
from deepfracture.compare import variation_of_information
from deepfracture.types import Floats32, FracturePattern, Volume


@dataclass(frozen=True)
class Reconstruction:
    """Training patterns against their decoded codes."""

    counts: tuple[tuple[int, int, int], ...]
    """Fragments of each pattern: true, of its exact GS-SDF segmented, of the decoded one segmented."""
    ceiling: float
    """Mean variation of information between truth and the segmented exact field [bits]: the best to be reached."""
    bits: float
    """The same for the decoded field [bits]."""
    error: float
    """Mean squared error of the decoded GS-SDF, the paper's L2 [m^2]."""

    @property
    def count_error(self) -> float:
        """Mean relative error of the decoded fragment count."""
        return float(np.mean([abs(decoded - true) / true for true, _, decoded in self.counts]))


@dataclass(frozen=True, eq=False)
class MonitoredSample:
    """A training pattern whose reconstruction is measured during training."""

    index: int
    """Of its code in the codebook."""
    pattern: FracturePattern
    exact: Volume
    count: int
    """Fragments of the exact field, segmented."""
    ceiling: float

    @staticmethod
    def of(index: int, pattern: FracturePattern, surface: Floats32, *, cuts: bool) -> MonitoredSample:
        """A pattern and its exact field.

        Args:
            surface: Signed distance to the shape's surface [m], shape (r, r, r).
            cuts: Whether the model predicts `Volume.cuts` beside distances."""
        exact = encode(pattern, surface, cuts=cuts)
        found = segment(exact)
        return MonitoredSample(index, pattern, exact, found.count, _partition_distance(pattern, found))


class Decoder(Protocol):
    """A trained network."""

    def decode(self, code: Floats32) -> Volume: ...


def reconstruct(model: Decoder, codes: Floats32, samples: list[MonitoredSample]) -> Reconstruction:
    """Decode and segment the samples' codes; `codes` holds one for every training pattern."""
    counts, bits, errors = [], [], []
    for sample in samples:
        decoded = model.decode(codes[sample.index])
        found = segment(decoded)
        counts.append((sample.pattern.count, sample.count, found.count))
        bits.append(_partition_distance(sample.pattern, found))
        errors.append(float(((decoded.values - sample.exact.values) ** 2).mean()))
    ceiling = float(np.mean([sample.ceiling for sample in samples]))
    return Reconstruction(tuple(counts), ceiling, float(np.mean(bits)), float(np.mean(errors)))


def _partition_distance(truth: FracturePattern, found: FracturePattern) -> float:
    return variation_of_information(truth.labels, found.labels, truth.labels > 0)
