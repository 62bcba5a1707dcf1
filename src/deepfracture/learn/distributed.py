"""The processes of one training: alone, or started together by torchrun."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch  # noqa: TID253  (the room of torch)
import torch.distributed as dist  # noqa: TID253
from torch import Tensor, nn  # noqa: TID253

from deepfracture.types import BadInput


@dataclass(frozen=True)
class Team:
    """This process among all."""

    rank: int = 0
    size: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process writes the files."""
        return self.rank == 0

    def part(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """This process's share of the patterns of a step, and what each weighs in the mean that the
        processes make of their losses. Processes beyond the last pattern repeat it without weight."""
        each = -(-len(chosen) // self.size)
        slots = torch.arange(self.rank * each, (self.rank + 1) * each)
        weights = (slots < len(chosen)).float() * self.size / len(chosen)
        return chosen[slots.clamp(max=len(chosen) - 1)], weights

    def wrap(self, module: nn.Module, device: torch.device) -> nn.Module:
        """The module, with gradients that are the mean over all processes."""
        if self.size == 1:
            return module
        device_ids = [device.index] if device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(module, device_ids=device_ids)

    def agree(self, values: list[float], device: torch.device) -> list[float]:
        """The first process's values, in every process."""
        if self.size == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64, device=device)
        dist.broadcast(shared, 0)
        return shared.tolist()

    def mean(self, value: float, device: torch.device) -> float:
        if self.size == 1:
            return value
        shared = torch.tensor(value, dtype=torch.float64, device=device)
        dist.all_reduce(shared)
        return float(shared) / self.size


@contextmanager
def assemble(device: torch.device) -> Iterator[Team]:
    """The team that torchrun's environment tells of, else this process alone."""
    size = _number("WORLD_SIZE", 1)
    if size == 1:
        yield Team()
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Team(dist.get_rank(), size)
    finally:
        dist.destroy_process_group()


def refuse_team() -> None:
    """For a training that one process does in minutes.

    Raises:
        BadInput: torchrun has started several."""
    if _number("WORLD_SIZE", 1) > 1:
        raise BadInput("preset waves trains in one process, in minutes: leave torchrun out, or choose --preset paper")


def pick_device(name: str) -> torch.device:
    """A usable torch device; "auto": this process's GPU if there is one, else the CPU.

    Raises:
        BadInput: There is no such device here."""
    if name in ("auto", "cuda") and torch.cuda.is_available():
        name = f"cuda:{_number('LOCAL_RANK', 0)}"
    elif name == "auto":
        name = "cpu"
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise BadInput(f"device {name!r}: not usable here ({str(error).splitlines()[0]})") from error
    return device


def _number(name: str, otherwise: int) -> int:
    value = os.environ.get(name, str(otherwise))
    if not value.isdigit():
        raise BadInput(f"{name} must be a whole number, as torchrun sets it, got {value!r}")
    return int(value)
