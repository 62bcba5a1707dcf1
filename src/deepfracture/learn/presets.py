"""From the options of a training run to the configuration of a network."""

from __future__ import annotations

from dataclasses import replace

from deepfracture.learn.options import OURS, PRESETS, TrainOptions
from deepfracture.learn.partition.config import PartitionConfig
from deepfracture.learn.published.config import PublishedConfig, preset
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

EPOCHS = {True: 400, False: 1000}
"""Default passes over the data: for the project's own network, some ten minutes for 200 patterns at r = 64 on two
cores; and the paper's."""


def with_default_epochs(options: TrainOptions) -> TrainOptions:
    """The same, with the preset's number of epochs if neither epochs nor minutes are given."""
    if options.epochs is not None or options.minutes is not None:
        return options
    return replace(options, epochs=EPOCHS[options.preset == OURS])


def config_of(options: TrainOptions) -> PartitionConfig | PublishedConfig:
    """The configuration that a preset stands for.

    Raises:
        BadInput: There is no such preset, or the width or the features make no sense.
    """
    if options.preset not in PRESETS:
        raise BadInput(
            f"preset must be one of {', '.join(PRESETS)}, got {options.preset!r}{did_you_mean(options.preset, PRESETS)}"
        )
    if options.preset != OURS:
        return preset(options.preset, width=options.width, features=options.features)
    if options.width != 1:
        raise BadInput(f"width {options.width:g}: only for the presets {', '.join(PRESETS[1:])}; leave it out")
    return PartitionConfig(features=options.features)
