"""How a trained model chooses the code that it decodes."""

from __future__ import annotations

from dataclasses import dataclass

from deepfracture.types import BadInput

MINIMUM_RISK, NEAREST, UNQUANTISED = SELECTIONS = ("minimum risk", "nearest", "unquantised")
BANDWIDTH = 2.0
"""Standard deviation of the Gaussian kernel over segment codes."""


@dataclass(frozen=True)
class Inference:
    """Settings of a prediction. Each model's own are `Model.inference`."""

    selection: str = MINIMUM_RISK
    """minimum risk: the code of least expected distance (`partition.selector`). nearest: the code of the codebook
    nearest to [impulse, random] (paper, section 4.2.7). unquantised: [impulse, random] itself."""
    random: bool = True
    """Whether Z_random takes part; if not, it is zero, and `nearest` compares impulse codes alone."""
    bandwidth: float = BANDWIDTH
    """Of minimum risk: smaller values make random codes matter more, so that draws vary more."""

    def __post_init__(self) -> None:
        if self.selection not in SELECTIONS or not self.bandwidth > 0:
            raise BadInput(
                f"selection must be one of {', '.join(SELECTIONS)} and bandwidth positive, "
                f"got {self.selection}, {self.bandwidth}"
            )
