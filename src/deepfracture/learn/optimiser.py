"""Adam's state in checkpoints."""

from __future__ import annotations

from collections.abc import Mapping

import torch  # noqa: TID253  (the room of torch)
from numpy.typing import NDArray
from torch import Tensor  # noqa: TID253


def adam_state(optimiser: torch.optim.Adam, parameters: Mapping[str, Tensor]) -> dict[str, NDArray]:
    """The moments and step counts of `parameters`, as adam.NAME.KEY."""
    return {
        f"adam.{name}.{key}": value.cpu().numpy()
        for name, parameter in parameters.items()
        for key, value in optimiser.state[parameter].items()
    }


def load_adam_state(
    optimiser: torch.optim.Adam, parameters: Mapping[str, Tensor], arrays: Mapping[str, NDArray]
) -> None:
    """The inverse of `adam_state`: each tensor on the device and in the memory layout of its parameter.

    Raises:
        KeyError: An array is missing.
        RuntimeError: An array has another shape than its parameter."""
    for name, parameter in parameters.items():
        state = optimiser.state[parameter] = {}
        for key in ("step", "exp_avg", "exp_avg_sq"):
            stored = torch.from_numpy(arrays[f"adam.{name}.{key}"])
            if key == "step":
                state[key] = stored.to(parameter.device)
            else:
                state[key] = torch.zeros_like(parameter, memory_format=torch.preserve_format).copy_(stored)
