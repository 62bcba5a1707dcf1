"""Size and training settings of the partition network."""

from __future__ import annotations

from dataclasses import dataclass, fields

from deepfracture.types import BadInput


@dataclass(frozen=True)
class PartitionConfig:
    """Sizes (stored with the weights) and training."""

    features: int = 1
    """N_features of the paper: impulses of a collision that are encoded, strongest first."""
    impulse_size: int = 128
    """Length of the latent code of each impulse."""
    segment_size: int = 8
    """Length of the segment code."""
    hidden: int = 256
    """Width of the layers that read the code."""
    basis: int = 384
    """Random Fourier features that the decoder composes the fragments of."""
    wavelength: float = 0.13
    """Inverse of the features' median wave number along an axis [m]."""
    wave_spread: float = 0.5
    """Standard deviation of the logarithm of that scale."""
    channels: int = 32
    """Most fragments with a channel of their own; beyond that, fragments far apart share one."""
    batch: int = 8
    """Samples in a step."""
    points: int = 2000
    """Random voxels in a step."""
    learning_rate: float = 3e-3
    """Highest; it falls along a cosine."""
    warm_up: int = 50
    """Steps over which the learning rate rises at first."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) > 0:
                raise BadInput(f"{field.name} must be positive, got {getattr(self, field.name)}")
        if self.features not in (1, 2):
            raise BadInput(f"features must be 1 or 2, got {self.features}")

    @property
    def code_size(self) -> int:
        """Length of a latent code: impulses, then segment."""
        return self.features * self.impulse_size + self.segment_size
