"""Tables of docs/guide/install.md: size and time of installing the wheel into empty environments, and a first break.

    python benchmarks/install.py --pythons python3.10 python3.13
    python benchmarks/install.py --extras render play

For each Python: builds the wheel, installs it alone, breaks the pot with a network and with physics, and runs the
doctor. For each extra: what it adds to the first of these environments. Megabytes (1e6 bytes) of files in site-packages
as pip leaves them, with compiled bytecode, without pip itself. Seconds include the download, or pip's own cache.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from harness import ROOT, start, table, write_text

from deepfracture.runtime.progress import log
from deepfracture.types import BadInput

OF_PIP = ("pip", "setuptools", "pkg_resources", "_distutils_hack", "wheel")
"""What an environment has before anything is installed."""
EXTRAS = ("render", "usd", "play", "bullet", "data", "plots", "train", "onnx", "bench")
BREAKERS = ("learned", "physical")
MOST_FRAGMENTS = 500
"""A pot does not break into more."""


@dataclass(frozen=True)
class Environment:
    """An empty environment of some Python."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / ("Scripts" if os.name == "nt" else "bin") / "python"

    def run(self, *words: object) -> str:
        """What `python *words` says; it runs outside the repository, so that only what is installed is found."""
        done = subprocess.run(
            [str(self.python), *map(str, words)], capture_output=True, text=True, cwd=self.folder, env=_clean()
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(map(str, words))}: {done.stdout[-1000:]}{done.stderr[-2000:]}")
        return done.stdout

    def pip(self, *words: object) -> float:
        """Seconds that `pip *words` took."""
        begun = time.perf_counter()
        self.run("-m", "pip", "--quiet", "--disable-pip-version-check", *words)
        return time.perf_counter() - begun

    def packages(self) -> dict[str, str]:
        """Versions by name."""
        return {
            one["name"].lower(): one["version"] for one in json.loads(self.run("-m", "pip", "list", "--format=json"))
        }

    def sizes(self) -> dict[str, float]:
        """Megabytes by top-level name in site-packages, without what pip is."""
        said = self.run(
            "-c", "import sysconfig; print(sysconfig.get_path('purelib')); print(sysconfig.get_path('platlib'))"
        )
        found: dict[str, float] = {}
        for site in {Path(line) for line in said.split("\n") if line}:
            for entry in site.iterdir():
                if entry.name.split("-")[0] not in OF_PIP:
                    found[entry.name] = _megabytes(entry)
        return found


def _clean() -> dict[str, str]:
    """The environment of this process without what points Python elsewhere."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def _megabytes(path: Path) -> float:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
    return sum(file.stat().st_size for file in files) / 1e6


def environment(python: str, folder: Path) -> Environment:
    """A new one."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True, env=_clean())
    return Environment(folder)


def build(folder: Path) -> Path:
    """The wheel of the repository."""
    words = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(words, check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def broken(place: Environment, breaker: str, out: Path) -> tuple[int, float]:
    """Fragments of a pot, and seconds: the first run compiles what it needs."""
    begun = time.perf_counter()
    command = "import sys; from deepfracture.cli import main; main(sys.argv[1:])"
    place.run("-c", command, "shatter", "pot", "--breaker", breaker, "--speed", "16", "--out", out)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    count = len(report["fragments"])
    assert report["broke"] and 1 < count < MOST_FRAGMENTS, report
    assert all(piece["closed"] for piece in report["fragments"])
    assert not {"animation.html", "animation.mp4"} & set(report["files"]), "made without what makes them"
    return count, time.perf_counter() - begun


def base_row(python: str, wheel: Path, folder: Path) -> tuple[list[object], Environment]:
    """Python, seconds to install, megabytes, and what became of the pot."""
    place = environment(python, folder)
    seconds = place.pip("install", wheel)
    sizes = place.sizes()
    found = [broken(place, breaker, folder / breaker) for breaker in BREAKERS]
    place.run("-c", "from deepfracture.cli import main; main(['doctor'])")
    version = place.run("-c", "import platform; print(platform.python_version())").strip()
    log.warning("%s: %.0f MB in %.0f s; %s", version, sum(sizes.values()), seconds, found)
    row = [version, f"{seconds:.0f}", f"{sum(sizes.values()):.0f}"]
    return [*row, *(f"{count} ({took:.0f} s)" for count, took in found)], place


def extra_row(place: Environment, wheel: Path, extra: str) -> list[object]:
    """What an extra adds, and the largest parts of it; it is taken out again."""
    before, there = place.sizes(), place.packages()
    seconds = place.pip("install", f"{wheel}[{extra}]")
    after = place.sizes()
    added = {name: size - before.get(name, 0) for name, size in after.items() if size - before.get(name, 0) >= 1}
    new = [name for name in place.packages() if name not in there]
    if new:
        place.pip("uninstall", "--yes", *new)
    largest = sorted(added, key=lambda name: -added[name])[:4]
    total = sum(after.values()) - sum(before.values())
    return [extra, f"{seconds:.0f}", f"{total:.0f}", ", ".join(f"{name} {added[name]:.0f}" for name in largest)]


def install(
    pythons: Sequence[str] = (sys.executable,), extras: Sequence[str] = EXTRAS, out: Path = Path("runs/install.md")
) -> None:
    """Measure, and write the tables to `out`.

    Args:
        pythons: the interpreters, each with venv and pip.
        extras: what is added to the first environment, one after the other.
        out: file for the tables.
    """
    if not pythons:
        raise BadInput("--pythons: name at least one interpreter")
    with tempfile.TemporaryDirectory(prefix="deepfracture-install-") as name:
        folder = Path(name)
        wheel = build(folder)
        rows, places = [], []
        for number, python in enumerate(pythons):
            row, place = base_row(python, wheel, folder / f"environment{number}")
            rows.append(row)
            places.append(place)
        parts = sorted(places[0].sizes().items(), key=lambda part: -part[1])[:12]
        more = [extra_row(places[0], wheel, extra) for extra in extras]
    text = table(["Python", "install s", "MB", *(f"pot, {breaker}: fragments" for breaker in BREAKERS)], rows)
    text += "\n" + table(["part of the base", "MB"], [[part, f"{size:.0f}"] for part, size in parts])
    if more:
        text += "\n" + table(["extra", "install s", "MB more", "largest parts"], more)
    write_text(out, text)
    log.warning("%s\n%s", text, out)


if __name__ == "__main__":
    start(install)
