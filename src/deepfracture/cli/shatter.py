"""`shatter`: the main job, from a shape and a ball to an animation, fragments and a report."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepfracture.api import scene_breaker, throw_scene
from deepfracture.cli.formats import check_formats, write_formats
from deepfracture.fracture import critical_stress
from deepfracture.fracture import material as preset
from deepfracture.geometry import faults, load_shape
from deepfracture.runtime.files import atomic_contents
from deepfracture.runtime.lock import exclusive
from deepfracture.runtime.progress import Stage, collect_stages, log, stage
from deepfracture.types import Material, Shape
from deepfracture.world import Outcome, Scene, load_scene, save_scene
from deepfracture.world import simulate as run_world

if TYPE_CHECKING:
    from deepfracture.cli.main import Throw

REPORT = "report.json"


def shatter(
    name: str, *, breaker: str, out: Path, material: str, throw: Throw, scene: Path | None, model: Path | None,
    dataset: Path | None, resolution: int, roughness: float, budget: int | None = None, engine: str,
    seed: int | None, repair: bool, film: bool,
    formats: tuple[str, ...] | None = None,
) -> None:  # fmt: skip
    """Break the shape `name` (or replay `scene`) and write `formats`, or the usual ones, into the folder `out`.

    The files appear there together, the report last. BadInput if another process is at that folder."""
    check_formats(formats or ())
    with exclusive(out), collect_stages() as stages:
        with stage("load"):
            if scene is None:
                shape = load_shape(name, repair=repair)
                played = throw_scene(
                    shape, name=name, repair=repair, **asdict(throw), material=material, engine=engine, seed=seed or 0
                )
                shapes = [shape]
            else:
                played = load_scene(scene)
                played = played if seed is None else replace(played, seed=seed)
                shapes = [load_shape(placed.shape, repair=repair or placed.repair) for placed in played.shapes]
        with stage("load breakers"):
            chosen = played.breaker or breaker
            materials = {placed.material: preset(placed.material) for placed in played.shapes}
            seam = scene_breaker(
                chosen, played, shapes, materials,
                model=model, dataset=dataset, resolution=resolution, roughness=roughness,
                budget=budget,
            )  # fmt: skip
        with stage("world, with the break"):
            rng = np.random.default_rng(played.seed)
            outcome = run_world(played, shapes, seam, rng, materials=materials)
        made_of = {shape: materials[placed.material] for placed, shape in zip(played.shapes, shapes, strict=True)}
        with atomic_contents(out, last=REPORT) as folder:
            files = write_formats(outcome, played, folder, formats, film=film)
            with stage("write scene.toml"):
                save_scene(_portable(played, out), folder / "scene.toml")
            files.append("scene.toml")
            report = _report(outcome, played, made_of, chosen, stages, files)
            (folder / REPORT).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    log.info("%s", _summary(report, outcome))
    log.info("%s", "  ".join(str(out / file) for file in [*files, REPORT]))


def _portable(scene: Scene, out: Path) -> Scene:
    """The scene with mesh files named relative to the folder that it is written to."""
    placed = tuple(
        replace(p, shape=os.path.relpath(p.shape, out)) if Path(p.shape).is_file() else p for p in scene.shapes
    )
    return replace(scene, shapes=placed)


def _report(
    outcome: Outcome, scene: Scene, made_of: dict[Shape, Material], breaker: str, stages: list[Stage], files: list[str]
) -> dict:
    """What report.json holds; of several collisions the strongest that broke something, or the strongest.

    made_of: the material of each shape."""
    first = [collision for collision in outcome.collisions if collision.generation == 0]
    asked = [collision for collision in first if collision.fragments is not None] or first
    main = max(asked, key=lambda collision: collision.impact.magnitude[0], default=None)
    report: dict = {
        "shape": ", ".join(placed.shape for placed in scene.shapes),
        "breaker": breaker,
        "material": ", ".join(dict.fromkeys(placed.material for placed in scene.shapes)),
        "seed": scene.seed,
        "broke": bool(outcome.breaks),
        "impulse": None,
        "sigma_1": None,
        "strength": None,
        "fragments": [],
        "volume_error": None,
        "stages": [asdict(done) for done in stages],
        "files": files,
    }
    if main is None:
        return report
    material = made_of[main.shape]
    area = float(np.linalg.norm(main.shape.mesh.area_vectors, axis=1).sum())
    report["impulse"] = float(main.impact.magnitude[0])
    report["sigma_1"] = critical_stress(main.impact, material, area)
    report["strength"] = material.strength
    if main.fragments is not None:
        cubed = main.shape.scale**3  # volumes in the user's units
        report["fragments"] = [
            {"volume": piece.volume * cubed, "mass": piece.mass, "closed": faults(piece.mesh).closed}
            for piece in main.fragments
        ]
        report["volume_error"] = abs(main.fragments.volume / main.shape.mesh.volume - 1)
    return report


def _summary(report: dict, outcome: Outcome) -> str:
    if report["impulse"] is None:
        return f"{report['shape']}: nothing touched it"
    hit = f"impulse {report['impulse']:.0f} N s, sigma_1 {report['sigma_1']:.3g} Pa"
    if not report["broke"]:
        return (
            f"{report['shape']}: {hit}: it did not break ({report['material']}, strength {report['strength']:.3g} Pa)"
        )
    return (
        f"{report['shape']}: {hit}: {len(report['fragments'])} fragments, volume kept to "
        f"{report['volume_error']:.1e}, {outcome.recording.duration:.1f} s of animation"
    )
