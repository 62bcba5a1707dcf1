"""The partition network, written once for numpy (prediction) and torch (training).

Encoder: one frozen sine layer per impulse (`codes`), and the segment code beside it.

Decoder: a hypernetwork (Ha et al. 2017) of two layers turns the code into a matrix, which composes one smooth function
per channel from random Fourier features of the position (Rahimi and Recht 2007: sin(w x + b) with random w and b spans
the functions of a kernel machine). A voxel belongs to the channel whose function is greatest there, so the boundaries
between fragments are closed and smooth by construction, however well the network has learned; a regressed distance
field has no such guarantee, and where its ridges fade fragments merge.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepfracture.learn.codes import draw_siren, siren_shapes
from deepfracture.learn.partition.config import PartitionConfig
from deepfracture.types import Floats32

FROZEN = ("siren.weight", "siren.bias", "waves.vector", "waves.phase")
"""Weights that stay as drawn: the encoder and the Fourier features."""

Weights = Mapping[str, Any]
"""Arrays of numpy or torch by name; `shapes` lists them."""


def shapes(config: PartitionConfig, channels: int) -> dict[str, tuple[int, ...]]:
    """The shape of every weight."""
    hidden, outputs = config.hidden, config.basis * channels
    return {
        **siren_shapes(config.impulse_size),
        "waves.vector": (3, config.basis),
        "waves.phase": (config.basis,),
        "first.weight": (config.code_size, hidden),
        "first.bias": (hidden,),
        "second.weight": (hidden, hidden),
        "second.bias": (hidden,),
        "head.weight": (hidden, outputs),
        "head.bias": (outputs,),
    }


def draw_weights(config: PartitionConfig, channels: int, rng: np.random.Generator) -> dict[str, Floats32]:
    """Initial weights."""
    weights: dict[str, np.ndarray] = {name: np.zeros(shape) for name, shape in shapes(config, channels).items()}
    weights |= draw_siren(config.impulse_size, rng)
    scale = config.wavelength * np.exp(config.wave_spread * rng.normal(size=config.basis))
    weights["waves.vector"] = rng.normal(size=(3, config.basis)) / scale
    weights["waves.phase"] = rng.uniform(0, 2 * np.pi, config.basis)
    for name, gain in (("first", 1.0), ("second", 1.0), ("head", 0.3)):
        fan_in, fan_out = weights[f"{name}.weight"].shape
        weights[f"{name}.weight"] = gain * rng.normal(size=(fan_in, fan_out)) / np.sqrt(fan_in)
    return {name: value.astype(np.float32) for name, value in weights.items()}


def fourier_features(weights: Weights, points: Any, xp: Any) -> Any:
    """Random Fourier features of positions [m], shape (n, 3): shape (n, basis)."""
    return xp.sin(points @ weights["waves.vector"] + weights["waves.phase"])


def mixing_matrices(weights: Weights, codes: Any, xp: Any) -> Any:
    """From each code the matrix that turns Fourier features into logits: shape (n, basis, channels)."""
    hidden = _silu(codes @ weights["first.weight"] + weights["first.bias"], xp)
    hidden = _silu(hidden @ weights["second.weight"] + weights["second.bias"], xp)
    out = hidden @ weights["head.weight"] + weights["head.bias"]
    return out.reshape(len(codes), weights["waves.vector"].shape[1], -1)


def _silu(x: Any, xp: Any) -> Any:
    """x / (1 + exp(-x)) (Elfwing et al. 2018), without overflow."""
    return 0.5 * x * (1 + xp.tanh(0.5 * x))
