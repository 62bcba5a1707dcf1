"""In a game's loop: the world goes on at 60 frames a second while a fracture is computed.

    python examples/08_game_loop.py --shots 6

Balls fly at a pot; when one hits, the breaker works in a thread of its own and the loop goes on with the pot whole. A
few frames later the fragments take its place. The table says what each step took here, and how many frames the
player saw the pot whole after the hit. `deepfracture play` and `Live` break at once instead: simpler, but the frame
of the hit is then as long as the break.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from starting import start

import deepfracture as df
from deepfracture.runtime.files import atomic_file
from deepfracture.runtime.progress import collect_stages, log

FRAME = 1 / 60
"""Seconds."""
STAGES = ("predict", "segment", "cut")


@dataclass(frozen=True)
class Shot:
    """What one hit cost."""

    impulse: float
    """[N s]"""
    fragments: int
    milliseconds: dict[str, float]
    frames: int
    """Frames of 1/60 s that went by before the fragments were there."""


def game_loop(
    out: Path = Path("runs/08_game_loop"), *, shape: str = "pot", shots: int = 6, realtime: bool = True, seed: int = 0
) -> list[Shot]:
    """Hit a shape in a running loop; writes times.txt and times.png.

    Args:
        out: folder.
        shape: one with a trained model: pot, mug, bunny or base.
        shots: hits, each on a new shape.
        realtime: wait for the clock, as a game does.
        seed: of the hits.
    """
    if shots < 1:
        raise df.BadInput(f"shots must be at least 1, got {shots}")
    body = df.load(shape)
    breaker = df.breaker("learned", body)
    rng = np.random.default_rng(seed)
    breaker(body, blow_at(body, rng), rng)  # the model is read and the first cut prepared before the game starts
    with ThreadPoolExecutor(1) as worker:
        found = [one_shot(body, breaker, worker, realtime=realtime, rng=rng) for _ in range(shots)]
    write(found, out)
    return found


def blow_at(body: df.Shape, rng: np.random.Generator) -> df.Impact:
    """A ball from somewhere around."""
    azimuth = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return df.hit(body, 3 * along, impulse=float(rng.uniform(1500, 3500)), speed=12)


def one_shot(
    body: df.Shape, breaker: df.Breaker, worker: ThreadPoolExecutor, *, realtime: bool, rng: np.random.Generator
) -> Shot:
    """The loop from a hit until the fragments are in the world."""
    blow = blow_at(body, rng)
    task: Future = worker.submit(timed, breaker, body, blow, rng)
    frames, due = 0, time.perf_counter()
    while not task.done():
        frames += 1  # here the game moves everything else, and draws
        due += FRAME
        if realtime:
            time.sleep(max(0.0, due - time.perf_counter()))
    fragments, milliseconds = task.result()
    return Shot(float(blow.magnitude[0]), len(fragments or ()), milliseconds, frames)


def timed(
    breaker: df.Breaker, body: df.Shape, blow: df.Impact, rng: np.random.Generator
) -> tuple[df.Fragments | None, dict[str, float]]:
    """Break, and say how long each step took [ms]."""
    begin = time.perf_counter()
    with collect_stages() as stages:
        fragments = breaker(body, blow, rng)
    taken = {name: 1000 * sum(done.seconds for done in stages if done.stage == name) for name in STAGES}
    return fragments, {**taken, "all": 1000 * (time.perf_counter() - begin)}


def write(shots: list[Shot], out: Path) -> None:
    """The table, and bars of the steps beside a frame's sixtieth of a second."""
    from matplotlib.figure import Figure

    lines = [f"{'N s':>6} {'pieces':>6} " + " ".join(f"{name:>8}" for name in (*STAGES, "all")) + " ms  frames"]
    for shot in shots:
        cells = " ".join(f"{shot.milliseconds[name]:8.1f}" for name in (*STAGES, "all"))
        lines.append(f"{shot.impulse:6.0f} {shot.fragments:6d} {cells}     {shot.frames:6d}")
    log.info("%s", "\n".join(lines))
    with atomic_file(out / "times.txt") as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    bottom = np.zeros(len(shots))
    for name, colour in zip(STAGES, ("#3e4854", "#c9a27e", "#a04a2c"), strict=True):
        height = np.array([shot.milliseconds[name] for shot in shots])
        axes.bar(range(len(shots)), height, bottom=bottom, label=name, color=colour)
        bottom += height
    axes.axhline(1000 * FRAME, color="black", lw=0.8, ls="--", label="one frame")
    axes.set(xlabel="shot", ylabel="milliseconds")
    axes.legend(ncols=4, fontsize=8)
    with atomic_file(out / "times.png") as temporary:
        figure.savefig(temporary, format="png", dpi=100)


if __name__ == "__main__":
    start(game_loop)
