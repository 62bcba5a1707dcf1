"""`deepfracture COMMAND ...`: exit status 0 when the work was done, 2 for a bad file or value, 1 for what went
wrong with good ones, such as a full disk; both in one line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from deepfracture.cli.help import asks_for_help, check_command, closing
from deepfracture.cli.manner import Manner, profiled, set_logging, split_manner
from deepfracture.learn.options import TrainOptions
from deepfracture.runtime.files import explain_write_error
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput, NoSolution

NAME = "deepfracture"
SHELLS = ("bash", "zsh", "fish", "tcsh")
ShapeName = Annotated[Positional[str], tyro.conf.arg(metavar="SHAPE", help="A mesh file, or a built-in shape.")]
RENAMED = {"convert": "copy"}
"""Former names of commands, accepted for a release."""
app = tyro.extras.SubcommandApp()


@dataclass(frozen=True)
class Throw:
    """How the ball is thrown."""

    speed: float = 9.0
    """Speed at which the ball is launched, 4 m away [m/s]; a slow one falls on its way (the shape is 2 m long)."""
    radius: float = 0.2
    """Radius of the steel ball [m]."""
    heading: float | None = None
    """Direction that the ball comes from, degrees around the vertical; drawn from the seed if not given."""
    up: str = "z"
    """Axis of the file that points up: x, y or z."""


@app.command
def shatter(
    shape: ShapeName = "pot",
    /,
    breaker: str = "learned",
    out: Path = Path("shattered"),
    material: str = "plaster",
    throw: tyro.conf.OmitArgPrefixes[Throw] = Throw(),
    scene: Path | None = None,
    model: Path | None = None,
    dataset: Path | None = None,
    resolution: int = 64,
    roughness: float = 0.0,
    budget: int | None = None,
    engine: str = "rapier",
    seed: int | None = None,
    repair: bool = False,
    film: bool = True,
    formats: tuple[str, ...] | None = None,
) -> None:
    """Throw a ball at a shape and break it: animation, fragments and a report.

    Args:
        shape: a mesh file, or a built-in shape.
        breaker: learned, physical, voronoi, nearest, cvd or random.
        out: folder for the page, the .glb, the fragments, the film and report.json.
        material: a whole-material preset.
        throw: how the ball is thrown.
        scene: replay this scene file instead of throwing a ball.
        model: trained weights instead of the shipped ones.
        dataset: simulated patterns that --breaker nearest and random recall.
        resolution: voxels along each axis for physical and voronoi.
        roughness: grain of the crack faces [m], of a body two metres long.
        budget: most triangles a fragment, taken from the cracks as far as their rims allow.
        engine: rapier or bullet.
        seed: the same seed gives the same bytes (default: the scene's, or 0).
        repair: mend a mesh that is not closed.
        film: also render an .mp4 where the machine can.
        formats: what to write: page, glb, picture, film, fragments (these by default), usd, usda, usdz, obj-sequence,
            ply-sequence.
    """
    from deepfracture.cli.shatter import shatter as run

    run(
        shape, breaker=breaker, out=out, material=material, throw=throw, scene=scene, model=model, dataset=dataset,
        resolution=resolution, roughness=roughness, budget=budget, engine=engine, seed=seed, repair=repair, film=film,
        formats=formats,
    )  # fmt: skip


@app.command
def play(
    shape: ShapeName = "pot",
    /,
    model: Path | None = None,
    up: str | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    upload_limit: float = 64.0,
    most_tabs: int = 8,
) -> None:
    """Shoot at things in the browser: a page on this machine.

    Args:
        shape: a mesh file or a built-in shape to begin with.
        model: trained weights for it instead of the shipped ones.
        up: axis of the file that points up: x, y or z (default: y for .obj and .glb, else z).
        host: address that the page listens on; by default this machine alone can reach it.
        port: where it listens; the next free one if it is taken.
        upload_limit: largest mesh that can be dropped onto the page [MB].
        most_tabs: tabs that play at once, each a world of its own.
    """
    from deepfracture.cli.play import play as run

    run(shape, model=model, up=up, host=host, port=port, upload_limit=upload_limit, most_tabs=most_tabs)


@app.command
def simulate(
    shape: ShapeName,
    /,
    out: Path | None = None,
    collisions: int = 60,
    material: str = "plaster",
    resolution: int = 64,
    speed: tuple[float, float] = (4.0, 15.0),
    scene: str = "single",
    refracture: int = 0,
    frames: int = 60,
    repeats: int = 1,
    workers: int | None = None,
    executor: str = "local",
    address: str | None = None,
    limit: float = 600.0,
    memory: float | None = None,
    retry: bool = False,
    seed: int = 0,
    repair: bool = False,
) -> None:
    """Simulate collisions from all sides: the data that a model learns from. Run again to go on.

    Args:
        shape: a mesh file, or a built-in shape.
        out: folder of the data set, or s3://BUCKET/PREFIX (default: data/SHAPE).
        collisions: balls to throw; those that break nothing are counted and left out.
        material: a whole-material preset.
        resolution: voxels along each axis.
        speed: slowest and fastest ball [m/s].
        scene: single, dual (two balls), strength (one line, many speeds), points (one direction, many points) or
            shear (beside the edge of a block).
        refracture: generations of fragments that may break again when they meet each other or the ball ...
        frames: ... within this many frames after the hit, at 60 a second.
        repeats: times that each collision is simulated, with other weak places in the material (for evaluate).
        workers: collisions at once (default: two, or all processors of a cluster).
        executor: local, or ray: the machines of a cluster.
        address: of the Ray cluster (default: the one that this machine belongs to).
        limit: seconds after which a collision is given up and counts as failed.
        memory: gigabytes beyond which a worker is ended and its collision counts as failed.
        retry: first drop what failed or is damaged, and simulate it again.
        seed: the same seed gives the same bytes, however many workers.
        repair: mend a mesh that is not closed.
    """
    from deepfracture.cli.learning import simulate as run

    run(
        shape, out=out, collisions=collisions, material=material, resolution=resolution, speed=speed,
        scene=scene, refracture=refracture, frames=frames, repeats=repeats, workers=workers, executor=executor,
        address=address, limit=limit, memory=memory, retry=retry, seed=seed, repair=repair,
    )  # fmt: skip


@app.command
def copy(
    source: Annotated[Positional[Path], tyro.conf.arg(metavar="SOURCE")],
    target: Annotated[Positional[Path], tyro.conf.arg(metavar="TARGET")],
    /,
) -> None:
    """Copy a data set to another folder or bucket and verify every byte. Rerun to resume.

    Args:
        source: folder or s3://BUCKET/PREFIX of the data set.
        target: folder or s3://BUCKET/PREFIX of the copy.
    """
    from deepfracture.cli.learning import copy as run

    run(source, target)


@app.command
def train(
    dataset: Annotated[Positional[Path], tyro.conf.arg(metavar="DATASET")],
    /,
    out: Path,
    training: tyro.conf.OmitArgPrefixes[TrainOptions] = TrainOptions(),
) -> None:
    """Train the generative model on simulated collisions. Rerun to resume.

    Args:
        dataset: folder or s3://BUCKET/PREFIX made by `deepfracture simulate`.
        out: run folder; the finished weights are model.safetensors in it.
        training: what to train, for how long and where.
    """
    from deepfracture.cli.learning import train as run

    run(dataset, out=out, options=training)


@app.command
def evaluate(
    held: Annotated[Positional[Path], tyro.conf.arg(metavar="HELD")],
    /,
    out: Path,
    dataset: Path | None = None,
    model: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    breakers: tuple[str, ...] = ("nearest", "random", "cvd", "voronoi"),
    ablation: bool = False,
    draws: int = 3,
    seed: int = 0,
) -> None:
    """Measure breakers and models on collisions that they have never seen, in units of chaos itself.

    Args:
        held: data set of held-out collisions, made by `deepfracture simulate --repeats 4` with a seed of its own.
        out: folder for evaluation.md, evaluation.json and plots.
        dataset: training data, which nearest and random recall and from which cvd learns the number of fragments.
        model: trained weights, or NAME=FILE; may be given several times.
        breakers: any of learned (the shipped model), physical, voronoi, nearest, cvd and random.
        ablation: measure the first model also without one or another of its parts.
        draws: random codes for each collision.
        seed: the same seed gives the same numbers.
    """
    from deepfracture.cli.evaluate import evaluate as run

    run(held, dataset=dataset, model=model, breakers=breakers, ablation=ablation, out=out, draws=draws, seed=seed)


@app.command
def info(path: Annotated[Positional[str], tyro.conf.arg(metavar="FILE")], /) -> None:
    """Look at any file that the program reads or writes: mesh, scene, data set, model, report.

    Args:
        path: the file or folder, or the name of a built-in shape.
    """
    from deepfracture.cli.info import info as run

    run(path)


@app.command
def bench(
    room: Annotated[Positional[str], tyro.conf.arg(metavar="ROOM")] = "all",
    /,
    shape: str = "pot",
    resolution: int = 128,
    model: Path | None = None,
    json: Path | None = None,
    record: Path | None = None,
) -> None:
    """Measure what each stage takes on this machine: seconds in the median of warm runs, and memory.

    Args:
        room: fracture, carve, learn, world or all.
        shape: a mesh file, or a built-in shape.
        resolution: voxels along each axis.
        model: a trained model for predictions, in place of the shipped one of the shape.
        json: also write the rows to this file.
        record: folder that keeps them with the machine and the date, and compares with the last ones there.
    """
    from deepfracture.cli.bench import bench as run

    run(room, shape=shape, resolution=resolution, model=model, json_file=json, record=record)


@app.command
def soak(
    shapes: Annotated[Positional[tuple[str, ...]], tyro.conf.arg(metavar="[SHAPE ...]")] = (),
    /,
    hits: int = 200,
    breakers: tuple[str, ...] = (),
    seed: int = 0,
    out: Path | None = None,
    workers: int = 1,
    limit: float = 120.0,
    resolution: int | None = None,
    engine: str = "rapier",
    model: Path | None = None,
    data: Path | None = None,
    repair: bool = False,
) -> None:
    """Hit shapes at random, thousands of times, and check every fragment and pose. Exit status 0 only if all is well.

    Args:
        shapes: mesh files or built-in shapes (default: every built-in one).
        hits: how many, over all shapes and breakers.
        breakers: any of learned, physical, voronoi, nearest, cvd and random (default: those that are ready).
        seed: of the first hit; each next one has the next number, so any of them can be repeated alone.
        out: folder for hits.jsonl and summary.md; run again to go on. Default: nothing is kept.
        workers: processes.
        limit: longest time for one hit [s].
        resolution: voxels along each axis (default: 64, and 32 for physical).
        engine: rapier or bullet.
        model: trained weights of a shape of yours, for learned.
        data: folder that holds a data set for each shape, by its name, for nearest and random.
        repair: mend meshes that are not closed.
    """
    from deepfracture.cli.soak import soak as run

    if not run(
        shapes, hits=hits, breakers=breakers, seed=seed, out=out, workers=workers, limit=limit,
        resolution=resolution, engine=engine, model=model, data=data, repair=repair,
    ):  # fmt: skip
        sys.exit(1)


@app.command
def validate(json: Path | None = None, plots: Path | None = None, quick: bool = False) -> None:
    """Check the physics against closed forms. Exit status 0 only if every row is within its limit.

    Args:
        json: also write the rows to this file.
        plots: also draw each case into this folder.
        quick: smaller bodies and fewer repetitions, the same limits.
    """
    from deepfracture.cli.validate import validate as run

    if not run(json_file=json, plots=plots, quick=quick):
        sys.exit(1)


@app.command
def warm() -> None:
    """Compile and cache the kernels, so that later commands start at once."""
    from deepfracture.cli.warm import warm as run

    run()


@app.command
def doctor() -> None:
    """Say which optional parts work on this machine, and what to type to install those that are missing."""
    from deepfracture.cli.doctor import doctor as run

    run()


@app.command
def export_onnx(
    model: Annotated[Positional[str], tyro.conf.arg(metavar="MODEL")],
    /,
    out: Path,
) -> None:
    """Write a trained model as an ONNX graph, for game engines: from an impulse to the label of every voxel.

    Args:
        model: trained weights, or a built-in shape whose weights ship.
        out: the .onnx file.
    """
    from deepfracture.cli.onnx import export_onnx as run

    run(model, out=out)


@app.command
def completion(shell: Annotated[Positional[str], tyro.conf.arg(metavar="SHELL")], /) -> None:
    """Write what makes a shell complete commands and options, to be sourced or saved.

    Args:
        shell: bash, zsh, fish or tcsh.
    """
    if shell not in SHELLS:
        raise BadInput(f"shell must be one of {', '.join(SHELLS)}, got {shell!r}{did_you_mean(shell, SHELLS)}")
    app.cli(prog=NAME, args=["--tyro-print-completion", shell])


def main(args: Sequence[str] | None = None) -> None:
    """Run one command; `args` are the words after the program's name, those of the process by default."""
    words, manner = list(sys.argv[1:] if args is None else args), Manner()
    try:
        words, manner = split_manner(words)
        set_logging(manner)
        if words and words[0] in RENAMED:
            log.warning("the command %s is deprecated; use %s", words[0], RENAMED[words[0]])
            words[0] = RENAMED[words[0]]
        check_command(words, commands())
        with profiled(manner.profile):
            app.cli(prog=NAME, description="Breaks things beautifully.", args=words)
    except SystemExit as done:
        if not done.code and asks_for_help(words):
            sys.stdout.write(closing(words))
        raise
    except (BadInput, NoSolution) as problem:
        if manner.verbose:
            log.debug("where it happened", exc_info=problem)
        sys.stderr.write(f"{NAME}: {problem}\n")
        sys.exit(problem.status)
    except OSError as problem:
        line = explain_write_error(problem)
        if line is None:
            raise
        sys.stderr.write(f"{NAME}: {line}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.stderr.write(f"{NAME}: interrupted; run the same command again to go on\n")
        sys.exit(130)


def commands() -> tuple[str, ...]:
    """Every command, as it is typed."""
    return tuple(name.replace("_", "-") for name in app._subcommands)
