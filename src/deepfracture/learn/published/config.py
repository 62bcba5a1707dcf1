"""Size and training settings of a network that predicts the GS-SDF itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

from deepfracture.learn.options import PRESETS
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

PAPER, MLP, PIX2PIX = PUBLISHED = PRESETS[1:]
PRECISIONS = ("auto", "float32", "bfloat16")
HEADS = (32, 64, 128, 256)
"""Resolutions that the paper's decoder has an output for."""


@dataclass(frozen=True)
class PublishedConfig:
    """Sizes (stored with the weights) and training. The defaults are the paper's (sections 5.2 and 5.4)."""

    preset: str = PAPER
    """paper: latent code to voxels. mlp: latent code and position to distance. pix2pix: voxels to voxels."""
    width: float = 1.0
    """Channels, relative to the preset's."""
    features: int = 1
    """N_features: impulses of a collision that are encoded, strongest first."""
    resolutions: tuple[int, ...] | None = None
    """Resolutions that the paper's network learns together from one code; that of the data alone if None."""
    impulse_size: int = 128
    """Length of the latent code of each impulse."""
    segment_size: int = 8
    """Length of the segment code and of the random code."""
    space: int = 200
    """N_space: most codes in the embedding space, sampled after each epoch."""
    batch: int = 1
    """Patterns in a step, over all processes."""
    points: int = 4000
    """Random voxels in a step of the mlp."""
    learning_rate: float = 3e-3
    """Before `late_from`."""
    late_rate: float = 5e-5
    """From `late_from` on."""
    late_from: float = 0.4
    """Fraction of the training after which the late rate holds."""
    ridge_weight: float = 0.0
    """Extra weight of the squared error on cracks, falling to zero two voxels away; 0: the paper's L2."""
    segment_code: bool = True
    """Whether each pattern learns a code of its own; if not, a random one is drawn in each step (ablation)."""
    precision: str = "auto"
    """float32, bfloat16 (autocast), or auto: the faster one on the training device, by measurement."""
    compile: bool = False
    """Compile the network with torch.compile: worth its minutes on a GPU."""

    def __post_init__(self) -> None:
        if self.preset not in PUBLISHED:
            raise BadInput(
                f"preset must be one of {', '.join(PUBLISHED)}, got {self.preset!r}"
                f"{did_you_mean(self.preset, PUBLISHED)}"
            )
        for name in ("width", "impulse_size", "segment_size", "space", "batch", "points", "learning_rate", "late_rate"):
            if not getattr(self, name) > 0:
                raise BadInput(f"{name} must be positive, got {getattr(self, name)}")
        if self.features not in (1, 2):
            raise BadInput(f"features must be 1 or 2, got {self.features}")
        if not 0 <= self.late_from <= 1 or self.ridge_weight < 0:
            raise BadInput(
                f"late_from must lie in [0, 1] and ridge_weight not below 0, got {self.late_from}, {self.ridge_weight}"
            )
        if self.precision not in PRECISIONS:
            raise BadInput(f"precision must be one of {', '.join(PRECISIONS)}, got {self.precision!r}")
        if self.resolutions is not None:
            object.__setattr__(self, "resolutions", tuple(sorted(set(self.resolutions))))
            if not self.resolutions or not set(self.resolutions) <= set(HEADS):
                raise BadInput(f"resolutions must be some of {HEADS}, got {self.resolutions}")

    @property
    def learns_codes(self) -> bool:
        """Whether the segment codes are parameters."""
        return self.segment_code and self.preset != PIX2PIX

    @property
    def condition_size(self) -> int:
        """Length of the part of a code that the impact decides: SIREN codes, or the seven numbers of each impulse."""
        return self.features * (7 if self.preset == PIX2PIX else self.impulse_size)

    @property
    def code_size(self) -> int:
        """Length of a code: impulses, then segment."""
        return self.condition_size + self.segment_size

    def at(self, resolution: int) -> PublishedConfig:
        """The same with explicit resolutions, for data at `resolution`.

        Raises:
            BadInput: A resolution that the data do not have, or that the preset has no output for."""
        wanted = self.resolutions or (resolution,)
        if max(wanted) != resolution:
            raise BadInput(f"resolutions {wanted} must end at that of the data set, {resolution}")
        if self.preset != PAPER and len(wanted) > 1:
            raise BadInput(f"preset {self.preset} learns one resolution, got {wanted}")
        return replace(self, resolutions=wanted)


def preset(name: str, *, width: float = 1.0, features: int = 1) -> PublishedConfig:
    """The training settings of a preset's own publication, as far as they suit these data.

    Raises:
        BadInput: There is no such preset, or the width or features make no sense."""
    if name == MLP:  # Park et al. 2019, with the paper's step late in the training
        return PublishedConfig(MLP, width, features, batch=4, points=2000, learning_rate=1e-3, late_from=0.7)
    if name == PIX2PIX:  # Isola et al. 2017: Adam at 2e-4 and batches of one
        return PublishedConfig(PIX2PIX, width, features, learning_rate=2e-4, late_from=0.8, segment_code=False)
    return PublishedConfig(name, width, features)
