"""Breakers by name."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from deepfracture.breakers.base import PatternBreaker, PatternSource
from deepfracture.breakers.options import BREAKERS, BreakerOptions
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, Breaker, Grid, Material, Shape

if TYPE_CHECKING:
    from deepfracture.breakers.stored_patterns import StoredPatterns
    from deepfracture.learn import Model


def make_breaker(name: str, shape: Shape, material: Material, options: BreakerOptions | None = None) -> Breaker:
    """The breaker called `name` for `shape`.

    Raises `BadInput` when the name is unknown, or when no trained model or data set exists for the shape."""
    options = options or BreakerOptions()
    model = None if options.model is None else Path(options.model)
    patterns = None if options.dataset is None else open_patterns(shape, Path(options.dataset))
    source = make_source(name, shape, material, Grid(options.resolution), model=model, patterns=patterns)
    return PatternBreaker(source, material, options.roughness, options.max_faces)


def make_source(
    name: str,
    shape: Shape,
    material: Material,
    grid: Grid,
    *,
    model: Path | None = None,
    patterns: StoredPatterns | None = None,
) -> PatternSource:
    """The pattern source of `make_breaker`, without criterion and cut."""
    if name == "physical":
        from deepfracture.breakers.physical import Physical

        return Physical(material, grid)
    if name == "voronoi":
        from deepfracture.breakers.voronoi import Voronoi

        return Voronoi(material, grid)
    if name == "learned":
        return _learned(shape, material, model)
    if name == "cvd":
        from deepfracture.breakers.cvd import CentroidalVoronoi, fitted_count
        from deepfracture.breakers.voronoi import count_by_stress

        by_stress = partial(count_by_stress, material=material)
        return CentroidalVoronoi(by_stress if patterns is None else fitted_count(patterns), grid)
    if name in ("nearest", "random"):
        from deepfracture.breakers.nearest import NearestPattern
        from deepfracture.breakers.stored_patterns import RandomPattern

        if patterns is None:
            raise BadInput(
                f"{shape.name}: --breaker {name} reuses simulated patterns; name them with --dataset, "
                f"made by: deepfracture simulate {shape.name} --out data"
            )
        return NearestPattern(patterns) if name == "nearest" else RandomPattern(patterns)
    raise BadInput(f"breaker {name!r}: unknown; choose one of {', '.join(BREAKERS)}{did_you_mean(name, BREAKERS)}")


def _learned(shape: Shape, material: Material, path: Path | None) -> PatternSource:
    from deepfracture.learn import embedded_model

    path = path or embedded_model(shape.name)
    if path is None:
        raise BadInput(
            f"{shape.name}: no trained model for this shape; try --breaker physical, or train one: deepfracture "
            "simulate SHAPE --out data && deepfracture train data --out run, then use --model run/model.safetensors"
        )
    return next(iter(ablations(shape, material, path).values()))


def ablations(
    shape: Shape, material: Material, path: Path, patterns: StoredPatterns | None = None
) -> dict[str, PatternSource]:
    """The model in the file `path` as a source, by the name "", and without one or another of its parts.

    Args:
        patterns: The training patterns, for the selection of a code without the network.

    Raises:
        BadInput: There is no model in the file, or it is of another shape."""
    from deepfracture.breakers.learned import Learned, SelectedPattern
    from deepfracture.learn import PartitionModel, load_model

    model = load_model(path)
    _check(model, shape, material, path)
    settings = {"": model.inference, **model.ablations}
    sources: dict[str, PatternSource] = {
        name: Learned(partial(model.predictions, inference=inference), model.weakest_impulse)
        for name, inference in settings.items()
    }
    if patterns is not None and isinstance(model, PartitionModel):
        if len(model.codebook) != len(patterns.dataset):
            raise BadInput(f"{path}: trained on {len(model.codebook)} patterns, {patterns.dataset.path} holds others")
        sources["no network"] = SelectedPattern(model, patterns)
    return sources


def _check(model: Model, shape: Shape, material: Material, path: Path) -> None:
    """Refuse a model of another shape; warn of another material."""
    if not model.matches_shape(shape):
        raise BadInput(f"{path}: trained on another shape ({model.shape_name}), not on {shape.name}")
    trained = model.metadata.get("material", material.name)
    if trained != material.name:
        log.warning("%s: trained on %s, so the result is for %s, not for %s", path, trained, trained, material.name)


def open_patterns(shape: Shape, path: Path) -> StoredPatterns:
    """The simulated patterns of `shape` in the folder `path`, read on demand.

    Raises `BadInput` when there are none, or they are of another shape."""
    from deepfracture.breakers.stored_patterns import StoredPatterns
    from deepfracture.dataset import open_dataset

    dataset = open_dataset(path)
    if len(dataset) == 0:
        raise BadInput(f"{path}: no pattern in this data set yet; rerun deepfracture simulate to resume it")
    if dataset.shape.mesh.volume != shape.mesh.volume:
        raise BadInput(f"{path}: made for another shape ({dataset.shape.name}), not for {shape.name}")
    return StoredPatterns(dataset)
