"""The processes of one training: a single one, or several started by torchrun."""

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
class DistributedContext:
    """This process among all."""

    device: torch.device
    rank: int = 0
    size: int = 1

    @property
    def is_main(self) -> bool:
        """Whether this process writes the files."""
        return self.rank == 0

    def shard(self, batch: Tensor) -> tuple[Tensor, Tensor]:
        """This process's part of a batch of sample numbers, and the weight of each in the mean over the losses of all
        processes. Processes beyond the last sample repeat it without weight."""
        each = -(-len(batch) // self.size)
        slots = torch.arange(self.rank * each, (self.rank + 1) * each)
        weights = (slots < len(batch)).float() * self.size / len(batch)
        return batch[slots.clamp(max=len(batch) - 1)], weights

    def wrap(self, module: nn.Module) -> nn.Module:
        """The module, with gradients that are the mean over all processes."""
        if self.size == 1:
            return module
        device_ids = [self.device.index] if self.device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(module, device_ids=device_ids)

    def broadcast(self, values: list[float]) -> list[float]:
        """The main process's values, in every process."""
        if self.size == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.broadcast(shared, 0)
        return shared.tolist()

    def mean(self, value: float) -> float:
        """Over all processes."""
        if self.size == 1:
            return value
        shared = torch.tensor(value, dtype=torch.float64, device=self.device)
        dist.all_reduce(shared)
        return float(shared) / self.size


@contextmanager
def init_distributed(device: torch.device) -> Iterator[DistributedContext]:
    """The process group that torchrun's environment describes, or this process alone."""
    size = _number("WORLD_SIZE", 1)
    if size == 1:
        yield DistributedContext(device)
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield DistributedContext(device, dist.get_rank(), size)
    finally:
        dist.destroy_process_group()


def refuse_distributed() -> None:
    """For a training that takes one process minutes.

    Raises:
        BadInput: torchrun has started several."""
    if _number("WORLD_SIZE", 1) > 1:
        raise BadInput("preset waves trains in one process, in minutes: leave torchrun out, or choose --preset paper")


def pick_device(name: str) -> torch.device:
    """A usable torch device; "auto": this process's GPU if there is one, otherwise the CPU.

    Raises:
        BadInput: There is no such device on this machine."""
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


def _number(name: str, default: int) -> int:
    value = os.environ.get(name, str(default))
    if not value.isdigit():
        raise BadInput(f"{name} must be a whole number, as torchrun sets it, got {value!r}")
    return int(value)
