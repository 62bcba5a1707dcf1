"""From an impact to the part of a latent code that it decides."""

from __future__ import annotations

import numpy as np

from deepfracture.learn.partition.network import OMEGA
from deepfracture.learn.published.config import PIX2PIX, FieldConfig
from deepfracture.types import Floats32


def siren_shapes(config: FieldConfig) -> dict[str, tuple[int, ...]]:
    """The frozen sine layer's weights; none where the network reads the impulses as they are."""
    if config.preset == PIX2PIX:
        return {}
    return {"siren.weight": (7, config.impulse_size), "siren.bias": (config.impulse_size,)}


def draw_siren(config: FieldConfig, rng: np.random.Generator) -> dict[str, Floats32]:
    """A sine layer's first weights (Sitzmann et al. 2020), which stay (paper, section 4.2.6)."""
    drawn = {name: rng.uniform(-1, 1, shape) for name, shape in siren_shapes(config).items()}
    scales = {"siren.weight": 1 / 7, "siren.bias": 1 / np.sqrt(7)}
    return {name: (scales[name] * value).astype(np.float32) for name, value in drawn.items()}


def encode(siren: dict[str, Floats32], rows: Floats32) -> Floats32:
    """Z^impulse of rows J^norm, shape (n, features, 7): shape (n, condition_size), the impulses' codes in turn."""
    if siren:
        rows = np.sin(OMEGA * (rows @ siren["siren.weight"] + siren["siren.bias"]))
    return rows.reshape(len(rows), -1).astype(np.float32)
