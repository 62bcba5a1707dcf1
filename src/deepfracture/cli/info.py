"""`info`: describe any file that the program reads or writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput


def info(name: str) -> None:
    """Describe a data set, model, report, scene, mesh file or built-in shape."""
    path = Path(name)
    if path.is_dir() or name.startswith("s3://"):
        lines = _dataset(name)
    elif path.suffix == ".safetensors":
        lines = _model(path)
    elif path.suffix == ".toml":
        lines = _scene(path)
    elif path.suffix == ".json":
        lines = _json(path)
    else:
        lines = _shape(name)
    for line in lines:
        log.info("%s", line)


def _dataset(path: str) -> list[str]:
    from deepfracture.dataset import verify_dataset

    data, damaged = verify_dataset(path)
    counts = [record.fragments for record in data.samples]
    again, frames = data.settings.refracture, data.settings.frames
    lines = [
        f"{path}: data set of {data.shape.name} ({data.material.name}), scene {data.settings.scene}",
        *([f"  refracture: {again} generations within {frames} frames"] if again else []),
        f"  {len(data)} patterns from {data.tried} collisions, {data.unbroken} without fracture, {data.failed} failed",
    ]
    if counts:
        lines.append(f"  largest impulse {data.max_impulse:.0f} N s")
        lines.append(f"  fragments: {min(counts)} to {max(counts)}, median {np.median(counts):.0f}")
    if damaged:
        lines += [f"  entry {number:06d} is damaged: {problem}" for number, problem in sorted(damaged.items())]
        lines.append(f"  {len(damaged)} damaged: rerun the simulate command with --retry to rebuild them")
    else:
        lines.append("  all entries intact (SHA-256)")
    return lines


def _model(path: Path) -> list[str]:
    from deepfracture.learn import load_model

    model = load_model(path, device="cpu")
    command, loss = model.metadata.get("command", "an unknown command"), model.metadata.get("loss", "unknown")
    lines = [
        f"{path}: {model.description} of {model.shape_name} at r = {model.domain.grid.resolution}, "
        f"{len(model.codebook)} codes, {path.stat().st_size / 1e6:.1f} MB",
        f"  trained by {command}, loss {loss}",
    ]
    for true, exact, decoded in model.metadata.get("counts", ()):
        lines.append(f"  fragments of a training pattern: {true}, its exact field {exact}, decoded {decoded}")
    return lines


def _scene(path: Path) -> list[str]:
    from deepfracture.world import load_scene

    scene = load_scene(path)
    things = [f"{placed.shape} of {placed.material}" for placed in scene.shapes]
    things += [f"{len(scene.blocks)} fixed blocks"] if scene.blocks else []
    speeds = [float(np.linalg.norm(ball.velocity)) for ball in scene.balls]
    return [
        f"{path}: scene with {', '.join(things)}",
        f"  {len(speeds)} balls at {', '.join(f'{speed:.1f}' for speed in speeds) or 'no'} m/s",
        f"  gravity {scene.gravity} m/s^2, {'a' if scene.floor else 'no'} floor, up to {scene.duration} s, "
        f"{scene.engine}, seed {scene.seed}",
    ]


def _json(path: Path) -> list[str]:
    if not path.is_file():  # reading a device may never end
        raise BadInput(f"{path}: no such file")
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise BadInput(f"{path}: cannot be read as JSON: nested too deeply") from None
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as JSON: {str(error)[:200]}") from error
    if not isinstance(report, dict) or "stages" not in report:
        return _scene(path)
    try:
        return _report(path, report)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{path}: incomplete report of shatter ({str(error)[:200]}); run it again") from error


def _report(path: Path, report: dict) -> list[str]:
    lines = [f"{path}: report of shatter {report['shape']} --breaker {report['breaker']} --seed {report['seed']}"]
    lines += [f"  {step['stage']:<28} {step['seconds']:8.3f} s  {step['peak_mb']:6.0f} MB" for step in report["stages"]]
    lines.append(f"  {len(report['fragments'])} fragments, files: {', '.join(report['files'])}")
    return lines


def _shape(name: str) -> list[str]:
    from deepfracture.geometry import load_shape

    shape = load_shape(name)
    low, high = (shape.to_user(corner) for corner in shape.mesh.bounds)
    return [
        f"{name}: closed mesh, {len(shape.mesh.vertices)} vertices, {len(shape.mesh.faces)} triangles",
        f"  box {np.round(low, 6).tolist()} to {np.round(high, 6).tolist()}, "
        f"volume {shape.mesh.volume * shape.scale**3:.6g}",
    ]
