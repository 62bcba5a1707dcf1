"""pix2pix in three dimensions (Isola et al. 2017): from an impulse drawn into voxels to the GS-SDF.

The condition holds the shape's distance field and, for each impulse, a Gaussian around the contact point scaled by the
magnitude, and the direction in that Gaussian. An encoder-decoder with skips reads it at half the resolution; the last
upsampling gives blocks of 2^3 voxels as channels (pixel shuffle, Shi et al. 2016). The noise joins as
channels at the bottom. The discriminator classifies overlapping patches of field and condition (PatchGAN).
"""

from __future__ import annotations

from itertools import pairwise

import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn.published.config import PublishedConfig
from deepfracture.types import Floats32, Grid

CHANNELS = 32
DEEPEST = 4
"""Voxels along each axis at the bottom."""
SIGMA = 0.25
"""Standard deviation of the Gaussian around a contact point [m]."""
BLOCK = 8
"""Voxels in a block of the last upsampling."""


class Pix2Pix(nn.Module):
    """Codes of J^norm and noise, shape (b, features * 7 + segment_size), to a GS-SDF [m], shape (b, r, r, r)."""

    surface: Tensor
    centres: Tensor

    def __init__(self, config: PublishedConfig, surface: Floats32) -> None:
        super().__init__()
        assert config.resolutions is not None
        self.features, self.noise = config.features, config.segment_size
        n, half = max(4, round(CHANNELS * config.width)), config.resolutions[-1] // 2
        self.register_buffer("surface", half_resolution(torch.tensor(surface)[None])[0], persistent=False)
        centres = torch.as_tensor(Grid(2 * half).centres(), dtype=torch.float32).movedim(-1, 0)
        self.register_buffer("centres", half_resolution(centres), persistent=False)
        depth = (half // DEEPEST).bit_length() - 1
        sizes = [n * min(2**level, 8) for level in range(depth + 1)]
        self.enter = _block(1 + 4 * config.features, n, stride=1, normalise=False)
        self.down = nn.ModuleList([_block(a, b, stride=2) for a, b in pairwise(sizes)])
        self.bottom = _block(sizes[-1] + config.segment_size, sizes[-1], stride=1, normalise=False)
        self.up = nn.ModuleList([_block(a + b, b, stride=1) for a, b in zip(sizes[:0:-1], sizes[-2::-1], strict=True)])
        self.leave = nn.Conv3d(n, BLOCK, 3, padding=1)

    def condition(self, codes: Tensor) -> Tensor:
        """The impact as voxels, shape (b, 1 + 4 * features, r / 2, r / 2, r / 2)."""
        channels = [self.surface.expand(len(codes), 1, *self.surface.shape)]
        for row in codes[:, : 7 * self.features].split(7, dim=1):
            position, impulse = row[:, :3, None, None, None], row[:, 3:, None, None, None]
            gaussian = torch.exp(-((self.centres - position) ** 2).sum(dim=1, keepdim=True) / (2 * SIGMA**2))
            strength = (impulse[:, 3:] + 1) / 2  # from [-1, 1]: no impulse leaves no trace
            channels += [gaussian * strength, gaussian * impulse[:, :3] * (strength > 0)]
        return torch.cat(channels, dim=1)

    def forward(self, codes: Tensor) -> Tensor:
        x = self.enter(self.condition(codes).contiguous(memory_format=torch.channels_last_3d))
        skips = []
        for down in self.down:
            skips.append(x)
            x = down(x)
        noise = codes[:, -self.noise :, None, None, None].expand(-1, -1, *x.shape[2:])
        x = self.bottom(torch.cat([x, noise.to(x.dtype)], dim=1))
        for up, skip in zip(self.up, reversed(skips), strict=True):
            x = up(torch.cat([nn.functional.interpolate(x, scale_factor=2.0), skip], dim=1))
        return torch.tanh(depth_to_space(self.leave(x))).float()


class Discriminator(nn.Module):
    """Conditions and fields to a logit per patch, positive for real ones, shape (b, patches)."""

    def __init__(self, config: PublishedConfig) -> None:
        super().__init__()
        n = max(4, round(CHANNELS * config.width))
        self.layers = nn.Sequential(
            nn.Conv3d(1 + 4 * config.features + BLOCK, n, 4, 2, 1),
            nn.LeakyReLU(0.2),
            _block(n, 2 * n, stride=2),
            nn.Conv3d(2 * n, 1, 3, 1, 1),
        )

    def forward(self, condition: Tensor, field: Tensor) -> Tensor:
        return self.layers(torch.cat([condition, space_to_depth(field)], dim=1)).flatten(1).float()


def depth_to_space(blocks: Tensor) -> Tensor:
    """Blocks of voxels as channels, shape (b, 8, n, n, n), to voxels, shape (b, 2n, 2n, 2n)."""
    b, _, n = blocks.shape[:3]
    return blocks.reshape(b, 2, 2, 2, n, n, n).permute(0, 4, 1, 5, 2, 6, 3).reshape(b, 2 * n, 2 * n, 2 * n)


def space_to_depth(field: Tensor) -> Tensor:
    """The inverse of `depth_to_space`."""
    b, n = len(field), field.shape[-1] // 2
    return field.reshape(b, n, 2, n, 2, n, 2).permute(0, 2, 4, 6, 1, 3, 5).reshape(b, BLOCK, n, n, n)


def half_resolution(field: Tensor) -> Tensor:
    """Means of blocks of 2^3 voxels, the field at the centres of half the resolution: shape (b, n, n, n)."""
    return nn.functional.avg_pool3d(field[:, None], 2)[:, 0]


def _block(inputs: int, outputs: int, *, stride: int, normalise: bool = True) -> nn.Sequential:
    """Normalisation removes what is constant over the grid, so there is none where magnitude or noise enters."""
    convolution = nn.Conv3d(inputs, outputs, 4 if stride == 2 else 3, stride, 1, bias=not normalise)
    norms = [nn.InstanceNorm3d(outputs, affine=True)] if normalise else []
    return nn.Sequential(convolution, *norms, nn.LeakyReLU(0.2))
