"""Deprecated: the former place of `deepfracture.runtime.progress`; goes with the next release."""

import warnings

from deepfracture.runtime.progress import collect_stages, log, stage, track

__all__ = ["collect_stages", "log", "stage", "track"]
warnings.warn("deepfracture.progress has moved to deepfracture.runtime.progress", DeprecationWarning, stacklevel=2)
