"""`deepfracture COMMAND ...`: exit status 0 on success, 2 for a bad file or value, 1 for other failures such as
a full disk; both are reported in one line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from deepfracture.breakers.options import BREAKERS, BreakerOptions
from deepfracture.cli.global_options import GlobalOptions, profiled, set_logging, split_global_options
from deepfracture.cli.help import asks_for_help, check_words, closing, with_new_names
from deepfracture.cli.options import (
    AXES,
    BENCHMARKS,
    FORMATS,
    Breaking,
    Count,
    Engine,
    File,
    Folder,
    MaterialName,
    ShapeName,
    Simulating,
    Throw,
    ThrowOptions,
    Training,
    one_of,
    option,
)
from deepfracture.dataset.options import SimulateOptions
from deepfracture.learn.options import TrainOptions
from deepfracture.runtime.files import explain_write_error
from deepfracture.runtime.progress import log
from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import RESOLUTIONS, BadInput, NoSolution

NAME = "deepfracture"
DESCRIPTION = "Breaks things beautifully: brittle fracture, simulated and learned, inside a rigid-body simulation."
SHELLS = ("bash", "zsh", "fish", "tcsh")
app = tyro.extras.SubcommandApp()


@app.command
def shatter(
    shape: ShapeName = "pot",
    /,
    breaker: Annotated[str, option(one_of(*BREAKERS))] = "learned",
    out: Annotated[Path, option("FOLDER")] = Path("shattered"),
    material: MaterialName = "plaster",
    scene: File = None,
    engine: Engine = "rapier",
    seed: Count = None,
    repair: bool = False,
    film: bool = True,
    formats: Annotated[tuple[str, ...] | None, option(f"{one_of(*FORMATS)} ...")] = None,
    throw: Throw = ThrowOptions(),
    breaking: Breaking = BreakerOptions(),
) -> None:
    """Throw a ball at a shape and break it: animation, fragments and a report.

    Args:
        shape: a mesh file, or a built-in shape.
        breaker: how it breaks.
        out: folder for the page, the .glb, the fragments, the film and report.json.
        material: material preset.
        scene: replay this scene file instead of throwing a ball.
        engine: rigid-body engine.
        seed: the same seed gives the same bytes (default: the scene's, or 0).
        repair: repair an open mesh.
        film: also render an .mp4 if ffmpeg is installed.
        formats: what to write (default: page, glb, picture, film and fragments).
        throw: how the ball is thrown.
        breaking: what the breaker is made from, and how finely it breaks.
    """
    from deepfracture.cli.shatter import shatter as run

    run(
        shape, breaker=breaker, out=out, material=material, throw=throw, scene=scene, options=breaking, engine=engine,
        seed=seed, repair=repair, film=film, formats=formats,
    )  # fmt: skip


@app.command
def play(
    shape: ShapeName = "pot",
    /,
    model: File = None,
    up: Annotated[str | None, option(one_of(*AXES))] = None,
    host: Annotated[str, option("ADDRESS")] = "127.0.0.1",
    port: Annotated[int, option("PORT")] = 8080,
    upload_limit: Annotated[float, option("MEGABYTES")] = 64.0,
    most_tabs: Annotated[int, option("N")] = 8,
) -> None:
    """Break shapes in the browser: serves a page on this machine.

    Args:
        shape: a mesh file or a built-in shape to start with.
        model: trained weights for it instead of the shipped ones.
        up: axis of the file that points up (default: y for .obj and .glb, else z).
        host: address that the page listens on; by default only this machine can reach it.
        port: port to listen on; the next free one if it is taken.
        upload_limit: largest mesh that can be dropped onto the page.
        most_tabs: browser tabs that can play at once, each in a world of its own.
    """
    from deepfracture.cli.play import play as run

    run(shape, model=model, up=up, host=host, port=port, upload_limit=upload_limit, most_tabs=most_tabs)


@app.command
def simulate(
    shape: ShapeName,
    /,
    out: Folder = None,
    material: MaterialName = "plaster",
    repair: bool = False,
    simulation: Simulating = SimulateOptions(),
) -> None:
    """Simulate collisions from all sides: the data that a model learns from. Rerun to resume.

    Args:
        shape: a mesh file, or a built-in shape.
        out: folder of the data set, or s3://BUCKET/PREFIX (default: data/SHAPE).
        material: material preset.
        repair: repair an open mesh.
        simulation: which collisions, and on what.
    """
    from deepfracture.cli.learning import simulate as run

    run(shape, out=out, material=material, repair=repair, options=simulation)


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
    out: Annotated[Path, option("FOLDER")],
    training: Training = TrainOptions(),
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
    out: Annotated[Path, option("FOLDER")],
    dataset: Folder = None,
    model: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="[NAME=]FILE")] = (),
    breakers: Annotated[tuple[str, ...], option(f"{one_of(*BREAKERS)} ...")] = ("nearest", "random", "cvd", "voronoi"),
    ablation: bool = False,
    draws: Annotated[int, option("N")] = 3,
    seed: Annotated[int, option("N")] = 0,
) -> None:
    """Measure breakers and models on held-out collisions, normalised by simulation-to-simulation variability.

    Args:
        held: data set of held-out collisions, made by `deepfracture simulate --repeats 4` with a seed of its own.
        out: folder for evaluation.md, evaluation.json and plots.
        dataset: training data, which nearest and random recall and from which cvd learns the number of fragments.
        model: trained weights.
        breakers: what to measure besides the models; learned is the shipped model.
        ablation: measure the first model also without one or another of its parts.
        draws: random codes for each collision.
        seed: the same seed gives the same numbers.
    """
    from deepfracture.cli.evaluate import evaluate as run

    run(held, dataset=dataset, model=model, breakers=breakers, ablation=ablation, out=out, draws=draws, seed=seed)


@app.command
def info(path: Annotated[Positional[str], tyro.conf.arg(metavar="FILE")], /) -> None:
    """Describe any file that the program reads or writes: mesh, scene, data set, model, report.

    Args:
        path: the file or folder, or the name of a built-in shape.
    """
    from deepfracture.cli.info import info as run

    run(path)


@app.command
def bench(
    room: Annotated[Positional[str], tyro.conf.arg(metavar=one_of(*BENCHMARKS))] = "all",
    /,
    shape: Annotated[str, option("SHAPE")] = "pot",
    resolution: Annotated[int, option(one_of(*RESOLUTIONS))] = 128,
    model: File = None,
    json: File = None,
    record: Folder = None,
) -> None:
    """Measure each stage on this machine: median seconds of warm runs, and memory.

    Args:
        room: what to measure.
        shape: a mesh file, or a built-in shape.
        resolution: voxels along each axis.
        model: trained weights for predictions, instead of the shipped ones of the shape.
        json: also write the rows to this file.
        record: folder that keeps them with the machine and the date, and compares with the last ones there.
    """
    from deepfracture.cli.bench import bench as run

    run(room, shape=shape, resolution=resolution, model=model, json_file=json, record=record)


@app.command
def soak(
    shapes: Annotated[Positional[tuple[str, ...]], tyro.conf.arg(metavar="[SHAPE ...]")] = (),
    /,
    hits: Annotated[int, option("N")] = 200,
    breakers: Annotated[tuple[str, ...], option(f"{one_of(*BREAKERS)} ...")] = (),
    seed: Annotated[int, option("N")] = 0,
    out: Folder = None,
    workers: Annotated[int, option("N")] = 1,
    limit: Annotated[float, option("SECONDS")] = 120.0,
    resolution: Annotated[int | None, option(one_of(*RESOLUTIONS))] = None,
    engine: Engine = "rapier",
    model: File = None,
    data: Folder = None,
    repair: bool = False,
) -> None:
    """Hit shapes at random, thousands of times, and check every fragment and pose. Exit status 0 only if all pass.

    Args:
        shapes: mesh files or built-in shapes (default: every built-in one).
        hits: how many, over all shapes and breakers.
        breakers: which breakers (default: those that are ready to use).
        seed: of the first hit; each next one has the next number, so any of them can be repeated alone.
        out: folder for hits.jsonl and summary.md; rerun to resume (default: nothing is kept).
        workers: processes.
        limit: longest time for one hit.
        resolution: voxels along each axis (default: 64, and 32 for physical).
        engine: rigid-body engine.
        model: trained weights for your own shape, for learned.
        data: folder that holds a data set for each shape, by its name, for nearest and random.
        repair: repair open meshes.
    """
    from deepfracture.cli.soak import soak as run

    if not run(
        hits=hits, out=out, workers=workers, limit=limit, shapes=shapes, breakers=breakers, seed=seed,
        resolution=resolution, engine=engine, model=model, data=data, repair=repair,
    ):  # fmt: skip
        sys.exit(1)


@app.command
def validate(json: File = None, plots: Folder = None, quick: bool = False) -> None:
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
    """Compile and cache the kernels, so that later commands start instantly."""
    from deepfracture.cli.warm import warm as run

    run()


@app.command
def doctor() -> None:
    """Check optional dependencies: what works on this machine, and how to install what is missing."""
    from deepfracture.cli.doctor import doctor as run

    run()


@app.command
def export_onnx(
    model: Annotated[Positional[str], tyro.conf.arg(metavar="MODEL")],
    /,
    out: Annotated[Path, option("FILE")],
) -> None:
    """Write a trained model as an ONNX graph, for game engines: from an impulse to the label of every voxel.

    Args:
        model: trained weights, or a built-in shape whose weights ship.
        out: the .onnx file.
    """
    from deepfracture.cli.onnx import export_onnx as run

    run(model, out=out)


@app.command
def completion(shell: Annotated[Positional[str], tyro.conf.arg(metavar=one_of(*SHELLS))], /) -> None:
    """Write a completion script for a shell, to be sourced or saved.

    Args:
        shell: whose completion script.
    """
    if shell not in SHELLS:
        raise BadInput(f"shell must be one of {', '.join(SHELLS)}, got {shell!r}{did_you_mean(shell, SHELLS)}")
    app.cli(prog=NAME, args=["--tyro-print-completion", shell])


def main(args: Sequence[str] | None = None) -> None:
    """Run one command; `args` are the words after the program's name, those of the process by default."""
    words, chosen = list(sys.argv[1:] if args is None else args), GlobalOptions()
    try:
        words, chosen = split_global_options(words)
        set_logging(chosen)
        words = with_new_names(words)
        check_words(words, commands())
        with profiled(chosen.profile):
            app.cli(prog=NAME, description=DESCRIPTION, args=words)
    except SystemExit as done:
        if not done.code and asks_for_help(words):
            sys.stdout.write(closing(words))
        raise
    except (BadInput, NoSolution) as problem:
        if chosen.verbose:
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
        sys.stderr.write(f"{NAME}: interrupted; rerun the same command to resume\n")
        sys.exit(130)


def commands() -> dict[str, Any]:
    """The function of every command, by the name that is typed."""
    return {name.replace("_", "-"): command.target for name, command in app._subcommands.items()}
