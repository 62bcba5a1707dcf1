"""`doctor`: try every optional dependency, and say how to install what is missing."""

from __future__ import annotations

import io
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import deepfracture
from deepfracture._version import __version__
from deepfracture.runtime.extras import is_installed, pip_command
from deepfracture.runtime.files import scratch_folder

BASE = ("numpy", "scipy", "numba", "manifold3d", "rapier3d", "trimesh", "pillow")
"""Distributions whose versions a bug report needs."""
VERSION_TIMEOUT = 20
"""Longest time for another program to print its version [s]."""


@dataclass(frozen=True)
class Part:
    """An optional part of the program."""

    name: str
    purpose: str
    module: str
    """What is imported."""
    extra: str | None
    """Extra of this program that installs it; None: part of every installation."""
    use: Callable[[], str]
    """A small use of it, which returns a short description; any error means that it is broken."""
    unavailable: str = ""
    """Why it cannot be installed here, if so."""


@dataclass(frozen=True)
class Finding:
    """Whether a part works."""

    part: Part
    state: str
    """works, missing, or broken."""
    detail: str


def doctor() -> None:
    """Try every part and print the result."""
    for line in machine():
        sys.stdout.write(f"{line}\n")
    findings = []
    for part in parts():
        findings.append(examine(part))
        sys.stdout.write(f"{_line(findings[-1])}\n")
        sys.stdout.flush()
    for line in external_programs():
        sys.stdout.write(f"{line}\n")
    sys.stdout.write(f"\n{advice(findings)}\n")


def machine() -> Iterator[str]:
    """The machine, in a few lines."""
    where = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    yield f"deepfracture {__version__} on {where}"
    yield "  " + ", ".join(f"{name} {_version(name)}" for name in BASE)
    free = _free_memory()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield f"  {cores} cores" + ("" if free is None else f", {free[1]:.1f} of {free[0]:.1f} GB of memory free")
    compiled, wanted = kernels()
    state = "not compiled yet: run `deepfracture warm` once (two to five minutes)"
    if compiled:
        state = f"compiled in {compiled} of {wanted} files" + ("" if compiled == wanted else "; the rest on first use")
    yield f"  kernels {state}"


def kernels() -> tuple[int, int]:
    """Source files whose kernels are in Numba's cache, and all source files with cached kernels."""
    from deepfracture.geometry import aabb_tree as some

    package = Path(deepfracture.__file__).parent
    sources = [path for path in package.rglob("*.py") if re.search(r"^@njit\(.*cache=True", path.read_text(), re.M)]
    first = next(value for value in vars(some).values() if hasattr(value, "_cache"))
    folder = Path(first._cache.cache_path)
    beside = folder.parent == package / "geometry"
    tag = f"py{sys.version_info.major}{sys.version_info.minor}"
    found = sum(
        any(
            (path.parent / "__pycache__").glob(f"{path.stem}.*{tag}.nbi")
            if beside
            else folder.parent.rglob(f"{path.stem}.*{tag}.nbi")
        )
        for path in sources
    )
    return found, len(sources)


def parts() -> tuple[Part, ...]:
    """Everything that is tried, in table order."""
    python = sys.version_info
    bullet = sys.platform == "linux" and python < (3, 12)
    return (
        Part("rapier", "rigid bodies", "rapier3d", None, lambda: _falls("rapier")),
        Part(
            "bullet", "rigid bodies, as in the paper", "pybullet", "bullet", lambda: _falls("bullet"),
            "" if bullet else "wheels only for Linux and Python <= 3.11; rapier does the same",
        ),
        Part("page", "animation.html, play", "viser", "play", _page),
        Part("film", "animation.mp4", "imageio_ffmpeg", "render", _film),
        Part("usd", "Houdini, Omniverse, Blender", "pxr", "usd", _usd),
        Part(
            "data sets", "simulate, train, evaluate", "zarr", "data", _store,
            "" if python >= (3, 11) else "zarr 3 needs Python 3.11 or newer",
        ),
        Part("buckets", "data sets at s3://", "obstore", "s3", _bucket),
        Part("ray", "simulate --executor ray", "ray", "ray", lambda: f"ray {import_module('ray').__version__}"),
        Part("plots", "train, evaluate, validate --plots", "matplotlib", "plots", _plot),
        Part("torch", "train", "torch", "train", _torch),
        Part("onnx", "export-onnx", "onnxruntime", "onnx", _onnx),
    )  # fmt: skip


def examine(part: Part) -> Finding:
    """Import and use a part."""
    if part.unavailable and not is_installed(part.module):
        return Finding(part, "missing", part.unavailable)
    if not is_installed(part.module):
        return Finding(part, "missing", pip_command(part.extra) if part.extra else "reinstall deepfracture")
    try:
        return Finding(part, "works", part.use())
    except Exception as error:  # any error of a third-party library is the finding
        reason = (str(error).strip().splitlines() or [""])[0]
        return Finding(part, "broken", f"{type(error).__name__}: {reason}"[:120])


def advice(findings: list[Finding]) -> str:
    """The command that installs everything missing or broken."""
    wanted = [
        finding.part.extra
        for finding in findings
        if finding.state != "works"
        and finding.part.extra
        and not (finding.state == "missing" and finding.part.unavailable)
    ]
    if any(finding.state != "works" and finding.part.extra is None for finding in findings):
        return "the installation is incomplete: pip install --force-reinstall deepfracture"
    if not wanted:
        return "everything available on this machine works"
    again = " --force-reinstall" if any(finding.state == "broken" for finding in findings) else ""
    return f"install everything missing: {pip_command(*dict.fromkeys(wanted))}{again}"


def external_programs() -> Iterator[str]:
    """Programs that results are exported to."""
    blender = shutil.which("blender")
    if blender is None:
        yield f"{'blender':<10} {'missing':<8} Alembic, FBX and the add-on: install Blender and add it to PATH"
        return
    try:
        said = subprocess.run(
            [blender, "--version"], capture_output=True, text=True, timeout=VERSION_TIMEOUT, check=True
        )
        words = (said.stdout.splitlines() or ["no version"])[0]
        yield f"{'blender':<10} {'works':<8} Alembic, FBX and the add-on: {words}, {blender}"
    except (OSError, subprocess.SubprocessError) as error:
        yield f"{'blender':<10} {'broken':<8} {blender}: {type(error).__name__}"


def _line(finding: Finding) -> str:
    return f"{finding.part.name:<10} {finding.state:<8} {finding.part.purpose}: {finding.detail}"


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "missing"


def _free_memory() -> tuple[float, float] | None:
    """Total and free memory [GB], on Linux."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    known = {line.split(":")[0]: float(line.split()[1]) / 1e6 for line in lines if line.endswith("kB")}
    return known["MemTotal"], known["MemAvailable"]


def _falls(name: str) -> str:
    """A cube falls for a tenth of a second."""
    from deepfracture.geometry import MassProperties
    from deepfracture.types import ContactMaterial
    from deepfracture.world.engine import BodyState
    from deepfracture.world.engines import open_engine

    engine = open_engine(name, gravity=10.0, contact=ContactMaterial(0.5, 0.1))
    try:
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        start = BodyState(np.array([0, 0, 10.0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
        cube = engine.add_body([corners], MassProperties(1.0, np.zeros(3), np.eye(3)), start)
        for _ in range(24):
            engine.step(1 / 240)
        fell = 10.0 - float(engine.state(cube).position[2])
    finally:
        engine.close()
    if not 0.04 < fell < 0.06:
        raise RuntimeError(f"a cube fell {fell:.3f} m in 0.1 s instead of 0.05")
    return _version({"rapier": "rapier3d", "bullet": "pybullet"}[name])


def _page() -> str:
    viser = import_module("viser")
    with redirect_stdout(io.StringIO()):  # viser prints its address
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            server.scene.add_box("/box")
            html = server.get_scene_serializer().as_html()
        finally:
            server.stop()
    return f"viser {_version('viser')}, a page of {len(html) / 1e6:.1f} MB"


def _film() -> str:
    import imageio_ffmpeg

    with scratch_folder() as folder:
        path = folder / "film.mp4"
        writer = imageio_ffmpeg.write_frames(str(path), (64, 64), fps=30, codec="libx264", ffmpeg_log_level="error")
        writer.send(None)
        for grey in (0, 128, 255):
            writer.send(np.full((64, 64, 3), grey, np.uint8))
        writer.close()
        size = path.stat().st_size
    return f"ffmpeg {imageio_ffmpeg.get_ffmpeg_version()}, a film of {size} bytes"


def _usd() -> str:
    usd: Any = import_module("pxr.Usd")
    stage = usd.Stage.CreateInMemory()
    import_module("pxr.UsdGeom").Sphere.Define(stage, "/ball")
    if "ball" not in stage.GetRootLayer().ExportToString():
        raise RuntimeError("the written stage lacks its prim")
    return "USD " + ".".join(str(number) for number in usd.GetVersion())


def _store() -> str:
    zarr = import_module("zarr")
    with scratch_folder() as folder:
        group = zarr.open_group(folder, mode="w")
        array = group.create_array("numbers", shape=(4,), dtype="f4")
        array[...] = np.arange(4)
        back = np.asarray(zarr.open_group(folder, mode="r")["numbers"])
    if back.tolist() != [0, 1, 2, 3]:
        raise RuntimeError(f"0, 1, 2, 3 read back as {back.tolist()}")
    return f"zarr {_version('zarr')}"


def _bucket() -> str:
    obstore = import_module("obstore")
    store = import_module("obstore.store").MemoryStore()
    obstore.put(store, "numbers", b"0123")
    if bytes(obstore.get(store, "numbers").bytes()) != b"0123":
        raise RuntimeError("the object read back differs from the one written")
    return f"obstore {_version('obstore')}"


def _plot() -> str:
    from matplotlib.figure import Figure

    figure, data = Figure(figsize=(1, 1)), io.BytesIO()
    figure.subplots().plot([0, 1])
    figure.savefig(data, format="png")
    return f"matplotlib {_version('matplotlib')}"


def _torch() -> str:
    torch = import_module("torch")
    found = [
        name for name, there in (("cuda", torch.cuda.is_available), ("mps", torch.backends.mps.is_available)) if there()
    ]
    device = torch.device(found[0] if found else "cpu")
    if float(torch.ones(4, device=device).sum()) != 4:
        raise RuntimeError(f"the sum of four ones on {device} is not four")
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else f"{torch.get_num_threads()} threads"
    return f"torch {torch.__version__} on {device.type}, {name}"


def _onnx() -> str:
    import onnxruntime
    from onnx import TensorProto, helper

    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("Add", ["x", "x"], ["y"])], "twice", [value("x", TensorProto.FLOAT, [1])],
        [value("y", TensorProto.FLOAT, [1])],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    (twice,) = session.run(None, {"x": np.ones(1, np.float32)})
    if float(np.asarray(twice)[0]) != 2:
        raise RuntimeError(f"1 + 1 gave {twice}")
    return f"onnx {_version('onnx')}, onnxruntime {_version('onnxruntime')}"
