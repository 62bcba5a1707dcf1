"""The generative models: impulse and random code to a GS-SDF. Only training and the published networks need torch.

`partition` holds the project's own network, `published` the paper's and its baselines; what all share lies beside them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.learn.options import TrainOptions as TrainOptions
from deepfracture.runtime.extras import require
from deepfracture.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from deepfracture.dataset import Dataset
    from deepfracture.learn.inference import Inference as Inference
    from deepfracture.learn.loading import embedded_model as embedded_model
    from deepfracture.learn.loading import load_model as load_model
    from deepfracture.learn.loading import model_kind as model_kind
    from deepfracture.learn.model import Model as Model
    from deepfracture.learn.normaliser import Normaliser as Normaliser
    from deepfracture.learn.normaliser import normalise_impact as normalise_impact
    from deepfracture.learn.partition.config import PartitionConfig as PartitionConfig
    from deepfracture.learn.partition.model import PartitionModel as PartitionModel
    from deepfracture.learn.partition.model import load_partition_model as load_partition_model
    from deepfracture.learn.published.config import PublishedConfig as PublishedConfig
    from deepfracture.learn.report import TrainingReport

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "inference": ("Inference",),
        "loading": ("embedded_model", "load_model", "model_kind"),
        "model": ("Model",),
        "normaliser": ("Normaliser", "normalise_impact"),
        "partition.config": ("PartitionConfig",),
        "partition.model": ("PartitionModel", "load_partition_model"),
        "published.config": ("PublishedConfig",),
    },
)


def train(
    dataset: Dataset,
    out: Path | str,
    options: TrainOptions,
    *,
    config: PartitionConfig | PublishedConfig | None = None,
    resume: bool = True,
) -> TrainingReport:
    """Train a model on `dataset` in the run folder `out`: see `learn.training.train`.

    Args:
        config: Sizes and training settings, in place of those of the preset.

    Raises:
        BadInput: torch or matplotlib is not installed, or a value makes no sense.
    """
    require("torch", extra="train", to="train")
    require("matplotlib", extra="train", to="draw the curve of a training")  # the last step of a training
    from deepfracture.learn.presets import config_of
    from deepfracture.learn.training import train as run

    return run(dataset, Path(out), config or config_of(options), options, resume=resume)
