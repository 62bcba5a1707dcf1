"""The network, written once for numpy (prediction) and torch (training).

Encoder: one frozen sine layer (SIREN) per impulse, and the segment code beside it.

Decoder: the code makes, through two layers, a matrix that composes one smooth function a channel from a
basis of random waves over the body. A voxel belongs to the channel whose function is greatest there, so
the boundaries between fragments are closed and smooth by construction, whatever the network has learned
or forgotten; a regressed distance field has no such guarantee, and where its ridges fade fragments merge.
The waves are a kernel machine's (Rahimi & Recht 2007), a matrix of the code a hypernetwork's (Ha 2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepfracture.learn.partition.config import Config
from deepfracture.types import Floats32

OMEGA = 30.0
"""Frequency of the sine layer (Sitzmann et al. 2020)."""
FROZEN = ("siren.weight", "siren.bias", "waves.vector", "waves.phase")
"""Weights that stay as they were drawn: E is never back-propagated through (paper, section 4.2.6)."""

Weights = Mapping[str, Any]
"""Arrays of numpy or torch by name; `shapes` lists them."""


def shapes(config: Config, channels: int) -> dict[str, tuple[int, ...]]:
    """The shape of every weight."""
    hidden, outputs = config.hidden, config.basis * channels
    return {
        "siren.weight": (7, config.impulse_size),
        "siren.bias": (config.impulse_size,),
        "waves.vector": (3, config.basis),
        "waves.phase": (config.basis,),
        "first.weight": (config.code_size, hidden),
        "first.bias": (hidden,),
        "second.weight": (hidden, hidden),
        "second.bias": (hidden,),
        "head.weight": (hidden, outputs),
        "head.bias": (outputs,),
    }


def draw_weights(config: Config, channels: int, rng: np.random.Generator) -> dict[str, Floats32]:
    """Random weights to start from."""
    weights: dict[str, np.ndarray] = {name: np.zeros(shape) for name, shape in shapes(config, channels).items()}
    weights["siren.weight"] = rng.uniform(-1 / 7, 1 / 7, weights["siren.weight"].shape)
    weights["siren.bias"] = rng.uniform(-1, 1, weights["siren.bias"].shape) / np.sqrt(7)
    scale = config.wavelength * np.exp(config.wave_spread * rng.normal(size=config.basis))
    weights["waves.vector"] = rng.normal(size=(3, config.basis)) / scale
    weights["waves.phase"] = rng.uniform(0, 2 * np.pi, config.basis)
    for name, gain in (("first", 1.0), ("second", 1.0), ("head", 0.3)):
        fan_in, fan_out = weights[f"{name}.weight"].shape
        weights[f"{name}.weight"] = gain * rng.normal(size=(fan_in, fan_out)) / np.sqrt(fan_in)
    return {name: value.astype(np.float32) for name, value in weights.items()}


def encode_impulses(weights: Weights, impulses: Any, lib: Any) -> Any:
    """Latent impulse codes, shape (n, features * impulse_size), of rows J^norm, shape (n, features, 7)."""
    waves = lib.sin(OMEGA * (impulses @ weights["siren.weight"] + weights["siren.bias"]))
    return waves.reshape(len(impulses), -1)


def basis(weights: Weights, points: Any, lib: Any) -> Any:
    """The waves at positions [m] of shape (n, 3): shape (n, basis)."""
    return lib.sin(points @ weights["waves.vector"] + weights["waves.phase"])


def compose(weights: Weights, codes: Any, lib: Any) -> Any:
    """What each code makes of the waves: shape (n, basis, channels), to be multiplied by `basis`."""
    hidden = _silu(codes @ weights["first.weight"] + weights["first.bias"], lib)
    hidden = _silu(hidden @ weights["second.weight"] + weights["second.bias"], lib)
    out = hidden @ weights["head.weight"] + weights["head.bias"]
    return out.reshape(len(codes), weights["waves.vector"].shape[1], -1)


def _silu(x: Any, lib: Any) -> Any:
    return 0.5 * x * (1 + lib.tanh(0.5 * x))
