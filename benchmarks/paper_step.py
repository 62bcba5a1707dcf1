"""What one step of training and one prediction of the paper's full network cost on this machine.

    python benchmarks/paper_step.py [--resolution 128] [--width 1] [--device auto] [--steps 2]

The network has 47 million weights at r = 128. Random fields serve: the cost does not depend on what is learned.
"""

from __future__ import annotations

import argparse
import logging
import time

import numpy as np
import torch  # noqa: TID253  (a program, not a room)

from deepfracture.learn.distributed import pick_device
from deepfracture.learn.published import preset
from deepfracture.learn.published.model import build, prepared
from deepfracture.learn.published.train_step import faster_precision
from deepfracture.runtime.memory import peak_mb
from deepfracture.runtime.progress import log


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--width", type=float, default=1.0)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--steps", type=int, default=2)
    asked = parser.parse_args()
    device = pick_device(asked.device)
    precision = faster_precision(device)
    config = preset("paper", width=asked.width).at(asked.resolution)
    network = prepared(build(config, np.zeros(0, np.float32)), device)
    optimiser = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], lr=3e-3, fused=True)
    code = torch.randn(1, config.code_size, device=device)
    truth = torch.rand((1, *(asked.resolution,) * 3), device=device)
    log.info(
        "r = %d, %.2f M weights, %s, %s, %d threads",
        asked.resolution, sum(p.numel() for p in network.parameters()) / 1e6, device, precision,
        torch.get_num_threads(),
    )  # fmt: skip
    for step in range(asked.steps):
        start = time.perf_counter()
        with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
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
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    main()
