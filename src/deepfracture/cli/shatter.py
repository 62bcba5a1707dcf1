"""`shatter`: the main job, from a shape and a ball to an animation, fragments and a report."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from deepfracture import api
from deepfracture.breakers.options import BreakerOptions
from deepfracture.cli.options import ThrowOptions
from deepfracture.export import check_formats, write_formats
from deepfracture.fracture import critical_stress
from deepfracture.fracture import material as preset
from deepfracture.geometry import mesh_defects
from deepfracture.runtime.files import atomic_contents
from deepfracture.runtime.lock import exclusive
from deepfracture.runtime.progress import Stage, collect_stages, log, stage
from deepfracture.types import Material, Shape
from deepfracture.world import Outcome, Scene, load_scene, save_scene

REPORT = "report.json"
TO_OPEN = ("animation.html", "animation.glb", "animation.usdc", "animation.mp4", "picture.png")
"""What a person opens first, of what was written."""


def shatter(
    name: str, *, out: Path, scene: Path | None = None, throw: ThrowOptions, material: str = "plaster",
    engine: str = "rapier", seed: int | None = None, repair: bool = False, breaker: str = "learned",
    options: BreakerOptions, film: bool = True, formats: tuple[str, ...] | None = None,
) -> None:  # fmt: skip
    """Break the shape `name` (or replay `scene`) and write `formats`, or the usual ones, into the folder `out`.

    The files appear there together, the report last. BadInput if another process writes to that folder."""
    check_formats(formats or ())
    with exclusive(out), collect_stages() as stages:
        with stage("load"):
            if scene is None:
                shapes = [api.load(name, repair=repair)]
                played = api.throw_scene(
                    shapes[0], name=name, repair=repair, **asdict(throw), material=material, engine=engine,
                    seed=seed or 0,
                )  # fmt: skip
            else:
                played = load_scene(scene)
                played = played if seed is None else replace(played, seed=seed)
                shapes = [api.load(placed.shape, repair=repair or placed.repair) for placed in played.shapes]
        with stage("load breakers"):
            chosen = played.breaker or breaker
            materials = {placed.material: preset(placed.material) for placed in played.shapes}
            made = api.scene_breaker(chosen, played, shapes, materials, options)
        with stage("world, with the break"):
            outcome = api.run(played, made, shapes=shapes, materials=materials)
        with atomic_contents(out, last=REPORT) as folder:
            breaks = [(c.fragments, c.shape) for c in outcome.breaks if c.fragments is not None]
            files = write_formats(
                outcome.recording, breaks, folder, formats, film=film,
                gravity=played.gravity, contact_material=played.contact_material,
            )  # fmt: skip
            with stage("write scene.toml"):
                save_scene(_portable(played, out), folder / "scene.toml")
            files.append("scene.toml")
            made_of = {shape: materials[placed.material] for placed, shape in zip(played.shapes, shapes, strict=True)}
            report = _report(outcome, played, made_of, chosen, stages, files)
            (folder / REPORT).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    log.info("%s", "  ".join(str(out / file) for file in [*files, REPORT]))
    log.info("%s", _summary(report, out))


def _portable(scene: Scene, out: Path) -> Scene:
    """The scene with mesh files named relative to the folder that it is written to."""
    placed = tuple(
        replace(p, shape=os.path.relpath(p.shape, out)) if Path(p.shape).is_file() else p for p in scene.shapes
    )
    return replace(scene, shapes=placed)


def _report(
    outcome: Outcome, scene: Scene, made_of: Mapping[Shape, Material], breaker: str, stages: Sequence[Stage],
    files: list[str],
) -> dict:  # fmt: skip
    """What report.json holds; of several collisions the strongest that broke something, or the strongest."""
    first = [collision for collision in outcome.collisions if collision.generation == 0]
    candidates = [collision for collision in first if collision.fragments is not None] or first
    main = max(candidates, key=lambda collision: collision.impact.magnitude[0], default=None)
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
            {"volume": piece.volume * cubed, "mass": piece.mass, "closed": mesh_defects(piece.mesh).closed}
            for piece in main.fragments
        ]
        report["volume_error"] = abs(main.fragments.volume / main.shape.mesh.volume - 1)
    return report


def _summary(report: dict, out: Path) -> str:
    """In plain words what happened, and what to open."""
    to_open = out / next((file for file in TO_OPEN if file in report["files"]), "")
    if report["impulse"] is None:
        return f"{report['shape']}: nothing touched it. Open {to_open}"
    impulse, unit = report["impulse"], "N s"
    if impulse >= 1000:
        impulse, unit = impulse / 1000, "kN s"
    what = f"broke into {len(report['fragments'])} pieces" if report["broke"] else "did not break"
    return (
        f"{report['shape']} {what} (hit by {impulse:.2g} {unit} at {_mega(report['sigma_1'])}; "
        f"{report['material']} breaks at {_mega(report['strength'])}). Open {to_open}"
    )


def _mega(stress: float) -> str:
    """A stress [Pa] in MPa, to two digits or the whole number."""
    return f"{stress / 1e6:.0f} MPa" if stress >= 1e7 else f"{stress / 1e6:.2g} MPa"
