"""DeepSDF's autodecoder (Park et al. 2019): eight layers from a code and a position to a distance.

A batch shares its positions, and a linear layer of [code, position] is the sum of one of the code and one of the
position: the code's part is computed once per sample.
"""

from __future__ import annotations

import torch  # noqa: TID253  (the room of torch)
from torch import Tensor, nn  # noqa: TID253

from deepfracture.learn.published.config import PublishedConfig

WIDTH = 512
LAYERS = 8
SKIP = 4
"""Layer that code and position enter again."""


class CoordinateMLP(nn.Module):
    """Codes, shape (b, code_size), and positions [m], shape (p, 3), to distances [m], shape (b, p)."""

    def __init__(self, config: PublishedConfig) -> None:
        super().__init__()
        width = max(8, round(WIDTH * config.width))
        self.of_code = nn.ModuleList([nn.Linear(config.code_size, width) for _ in range(2)])
        self.of_position = nn.ModuleList([nn.Linear(3, width, bias=False) for _ in range(2)])
        self.hidden = nn.ModuleList([nn.Linear(width, width) for _ in range(LAYERS - 2)])
        self.last = nn.Linear(width, 1)
        for layer in self.hidden:
            nn.init.kaiming_normal_(layer.get_parameter("weight"), nonlinearity="relu")

    def forward(self, codes: Tensor, points: Tensor) -> Tensor:
        x = torch.relu(self._input(0, codes, points))
        for number, layer in enumerate(self.hidden, 1):
            x = layer(x)  # (b, p, width)
            if number == SKIP:
                x = x + self._input(1, codes, points)
            x = torch.relu(x)
        return torch.tanh(self.last(x)[..., 0]).float()

    def _input(self, number: int, codes: Tensor, points: Tensor) -> Tensor:
        return self.of_code[number](codes)[:, None] + self.of_position[number](points)[None]
