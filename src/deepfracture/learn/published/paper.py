"""The paper's code-to-voxel autodecoder: a linear layer to a coarse grid, then transposed convolutions.

After 3D-GAN (Wu et al. 2016): 8n, 4n, 2n, n channels, kernels of 4 and strides of 2, n = 64. At
r = 128 with a code of 136 numbers these are the 47 million weights (188 MB) that the paper reports.

The paper's batch normalisation with batches of one is instance normalisation: each sample has its own statistics, in
training and in prediction alike, so that several processes learn what one learns.
"""

from __future__ import annotations

import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn.published.config import PublishedConfig

CHANNELS = 64
TRUNK = 128
"""Finest resolution that the linear layer's grid grows with; 256 takes one more upsampling."""


class PaperDecoder(nn.Module):
    """Codes, shape (b, code_size), to a GS-SDF [m] a resolution, coarse to fine, shapes (b, r, r, r)."""

    def __init__(self, config: PublishedConfig) -> None:
        super().__init__()
        assert config.resolutions is not None
        n = max(2, round(CHANNELS * config.width))
        self.resolutions = config.resolutions
        self.trunk = min(TRUNK, self.resolutions[-1])
        self.base = self.trunk // 16
        self.first = nn.Linear(config.code_size, 8 * n * self.base**3)
        self.doublings = nn.ModuleList([_upsampling(8 * n, 4 * n), _upsampling(4 * n, 2 * n), _upsampling(2 * n, n)])
        self.taps = [min(resolution, self.trunk) // 2 for resolution in self.resolutions]
        self.heads = nn.ModuleList()
        for resolution, tap in zip(self.resolutions, self.taps, strict=True):
            channels = n * self.trunk // (2 * tap)
            finer = [_upsampling(channels, channels // 2)] if resolution > self.trunk else []
            self.heads.append(nn.Sequential(*finer, *_head(channels // 2 if finer else channels)))

    def forward(self, codes: Tensor) -> list[Tensor]:
        x = nn.functional.leaky_relu(self.first(codes), 0.2)
        x = x.view(len(codes), -1, self.base, self.base, self.base)
        x = x.contiguous(memory_format=torch.channels_last_3d)
        fields = []
        for doubling in self.doublings:
            x = doubling(x)  # (b, c, 2n, 2n, 2n)
            for head, tap in zip(self.heads, self.taps, strict=True):
                if tap == x.shape[-1]:
                    fields.append(head(x)[:, 0].float())
        return fields


def _upsampling(inputs: int, outputs: int) -> nn.Sequential:
    up = nn.ConvTranspose3d(inputs, outputs, 4, 2, 1)
    assert up.bias is not None
    up.bias.requires_grad_(False)  # the normalisation subtracts it again: its gradient is rounding noise
    return nn.Sequential(up, nn.InstanceNorm3d(outputs, affine=True), nn.LeakyReLU(0.2))


def _head(inputs: int) -> tuple[nn.Module, nn.Module]:
    return nn.ConvTranspose3d(inputs, 1, 4, 2, 1, bias=False), nn.Tanh()
