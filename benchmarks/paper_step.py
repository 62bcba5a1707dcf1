"""Cost of a training step and of a prediction of the paper's full network on this machine.

    python benchmarks/paper_step.py [--resolution 128] [--width 1] [--device auto] [--steps 2]

The network has 47 million weights at r = 128. Random fields serve, as the cost does not depend on the data.
"""

from __future__ import annotations

import time

import numpy as np
import torch  # noqa: TID253  (a program, not a room)
from harness import start

from deepfracture.learn.distributed import pick_device
from deepfracture.learn.published.config import preset
from deepfracture.learn.published.model import build, to_device
from deepfracture.learn.published.train_step import faster_precision
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import log


def paper_step(resolution: int = 128, width: float = 1.0, device: str = "auto", steps: int = 2) -> None:
    """Time training steps and a prediction on random fields.

    Args:
        resolution: voxels along each axis.
        width: share of the paper's channels.
        device: as `deepfracture train` takes it.
        steps: training steps.
    """
    log.setLevel("INFO")
    chosen = pick_device(device)
    precision = faster_precision(chosen)
    config = preset("paper", width=width).at(resolution)
    network = to_device(build(config, np.zeros(0, np.float32)), chosen)
    optimiser = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], lr=3e-3, fused=True)
    code = torch.randn(1, config.code_size, device=chosen)
    truth = torch.rand((1, *(resolution,) * 3), device=chosen)
    log.info(
        "r = %d, %.2f M weights, %s, %s, %d threads",
        resolution, sum(p.numel() for p in network.parameters()) / 1e6, chosen, precision,
        torch.get_num_threads(),
    )  # fmt: skip
    for step in range(steps):
        start = time.perf_counter()
        with torch.autocast(chosen.type, torch.bfloat16, enabled=precision == "bfloat16"):
            (field,) = network(code)
        loss = ((field - truth) ** 2).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        log.info("step %d: %.2f s, loss %.4f", step, time.perf_counter() - start, loss.item())
    start = time.perf_counter()
    with torch.no_grad():
        network(code)[0].sum().item()
    log.info("prediction: %.2f s in float32; peak memory %.0f MB", time.perf_counter() - start, peak_mb())


if __name__ == "__main__":
    start(paper_step)
