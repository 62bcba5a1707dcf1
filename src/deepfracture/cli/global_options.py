"""Options that every command takes: --quiet, --verbose and --profile FILE."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from deepfracture.runtime.progress import Stage, collect_stages, disable_progress, log
from deepfracture.types import BadInput


@dataclass(frozen=True)
class GlobalOptions:
    """What --quiet, --verbose and --profile FILE ask for, anywhere in the command line."""

    quiet: bool = False
    verbose: bool = False
    profile: Path | None = None


def split_global_options(words: Sequence[str]) -> tuple[list[str], GlobalOptions]:
    """The words of a command line without the global options, and those options.

    Raises:
        BadInput: --profile without a file, or quiet and verbose at once.
    """
    left: list[str] = []
    given, profile = set(), None
    rest = iter(words)
    for word in rest:
        if word in ("-q", "--quiet", "-v", "--verbose"):
            given.add("quiet" if "q" in word else "verbose")
        elif word == "--profile" or word.startswith("--profile="):
            name = word.partition("=")[2] or next(rest, "")
            if not name or name.startswith("-"):
                raise BadInput("--profile takes the file to write to, for example --profile shatter.prof")
            profile = Path(name)
        else:
            left.append(word)
    if len(given) == 2:
        raise BadInput("--quiet and --verbose exclude each other")
    return left, GlobalOptions("quiet" in given, "verbose" in given, profile)


class _Stderr(logging.StreamHandler):
    """Writes to the current stderr, so that lines go above a running progress bar."""

    @property
    def stream(self) -> TextIO:
        return sys.stderr

    @stream.setter
    def stream(self, stream: TextIO) -> None: ...


def set_logging(options: GlobalOptions) -> None:
    """One line a stage; only warnings when quiet; times of day and debug messages when verbose."""
    form = "%(asctime)s %(levelname)-7s %(message)s" if options.verbose else "%(message)s"
    logging.basicConfig(level=logging.WARNING, format=form, datefmt="%H:%M:%S", handlers=[_Stderr()])
    log.setLevel(logging.WARNING if options.quiet else logging.DEBUG if options.verbose else logging.INFO)
    disable_progress(options.quiet)


@contextmanager
def profiled(path: Path | None) -> Iterator[None]:
    """Profile this block into `path`, and log the share of each stage."""
    if path is None:
        yield
        return
    from cProfile import Profile

    profile, start = Profile(), time.perf_counter()
    with collect_stages() as stages:
        profile.enable()
        try:
            yield
        finally:
            profile.disable()
            path.parent.mkdir(parents=True, exist_ok=True)
            profile.dump_stats(path)
            log.warning("%s", _shares(stages, time.perf_counter() - start, path))


def _shares(stages: Sequence[Stage], seconds: float, path: Path) -> str:
    """A table of stages, the longest first; stages may lie inside each other."""
    total: dict[str, float] = {}
    for done in stages:
        total[done.stage] = total.get(done.stage, 0.0) + done.seconds
    longest = sorted(total, key=lambda name: -total[name])
    lines = [f"  {name:<28} {total[name]:8.2f} s  {total[name] / seconds:4.0%}" for name in longest]
    return "\n".join(
        [
            f"{seconds:.1f} s in all, with profiling; stages, some inside others:",
            *lines,
            f"functions: python -m pstats {path}, then 'sort cumulative' and 'stats 30'",
        ]
    )
