"""What a model remembers of its training patterns, against what encoding and segmenting lose by themselves.

A low L2 says little: it is the small ridges between fragments that decide whether the flood finds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deepfracture.carve import encode, segment
from deepfracture.compare import variation_of_information
from deepfracture.learn.partition.field import Body
from deepfracture.types import Floats32, FracturePattern, Volume


@dataclass(frozen=True)
class Recall:
    """Training patterns against their decoded selves."""

    counts: tuple[tuple[int, int, int], ...]
    """Fragments of each pattern: true, of its exact GS-SDF segmented, of the decoded one segmented."""
    ceiling: float
    """Mean variation of information between truth and the segmented exact field [bits]."""
    bits: float
    """The same for the decoded field [bits]."""
    error: float
    """Mean squared error of the decoded GS-SDF, the paper's L2 [m^2]."""

    @property
    def count_error(self) -> float:
        """Mean relative error of the decoded fragment count."""
        return float(np.mean([abs(decoded - true) / true for true, _, decoded in self.counts]))


@dataclass(frozen=True, eq=False)
class Probe:
    """A training pattern that is watched."""

    index: int
    """Its code in the codebook."""
    pattern: FracturePattern
    exact: Volume
    count: int
    """Fragments of the exact field, segmented."""
    ceiling: float

    @staticmethod
    def of(index: int, pattern: FracturePattern, body: Body) -> Probe:
        exact = encode(pattern, body.surface)
        found = segment(exact)
        return Probe(index, pattern, exact, found.count, _apart(pattern, found))


class Decoder(Protocol):
    """A trained network."""

    def decode(self, code: Floats32) -> Volume: ...


def recall(model: Decoder, codes: Floats32, probes: list[Probe]) -> Recall:
    """Decode and segment the probes' codes."""
    counts, bits, errors = [], [], []
    for probe in probes:
        decoded = model.decode(codes[probe.index])
        found = segment(decoded)
        counts.append((probe.pattern.count, probe.count, found.count))
        bits.append(_apart(probe.pattern, found))
        errors.append(float(((decoded.values - probe.exact.values) ** 2).mean()))
    ceiling = float(np.mean([probe.ceiling for probe in probes]))
    return Recall(tuple(counts), ceiling, float(np.mean(bits)), float(np.mean(errors)))


def _apart(truth: FracturePattern, found: FracturePattern) -> float:
    return variation_of_information(truth.labels, found.labels, truth.labels > 0)
