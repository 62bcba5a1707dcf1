"""What the help of each command ends with, and what the program says to a command that it does not know."""

from __future__ import annotations

from collections.abc import Sequence

from deepfracture.runtime.suggest import did_you_mean
from deepfracture.types import BadInput

EXAMPLES: dict[str, tuple[str, ...]] = {
    "shatter": (
        "deepfracture shatter pot --seed 3",
        "deepfracture shatter statue.obj --breaker physical --material stone --speed 20 --up y",
        "deepfracture shatter --scene examples/scenes/falling.toml --out fallen",
    ),
    "play": (
        "deepfracture play",
        "deepfracture play statue.obj --model runs/statue/model.safetensors --up y",
    ),
    "simulate": ("deepfracture simulate statue.obj --collisions 240 --speed 8 30 --out data/statue",),
    "copy": ("deepfracture copy data/statue s3://bucket/statue",),
    "train": ("deepfracture train data/statue --out runs/statue --minutes 10",),
    "evaluate": (
        "deepfracture simulate pot --collisions 40 --repeats 4 --seed 7 --out data/held",
        "deepfracture evaluate data/held --dataset data/pot --model runs/pot/model.safetensors --out evaluated",
    ),
    "info": ("deepfracture info shattered/report.json",),
    "bench": (
        "deepfracture bench carve --shape bunny --resolution 64 --json bench.json",
        "deepfracture bench all --record runs/bench",
    ),
    "soak": (
        "deepfracture soak --hits 1000 --out soaked --workers 2",
        "deepfracture soak statue.obj --hits 100 --breakers voronoi physical --out soaked/statue",
    ),
    "validate": ("deepfracture validate --quick --plots plots",),
    "warm": ("deepfracture warm",),
    "doctor": ("deepfracture doctor",),
    "export-onnx": ("deepfracture export-onnx pot --out pot.onnx",),
    "completion": (
        "source <(deepfracture completion bash)",
        "deepfracture completion zsh > ~/.zfunc/_deepfracture",
        "deepfracture completion fish > ~/.config/fish/completions/deepfracture.fish",
    ),
}
"""Command lines by command; each is one that works."""
FIRST = ("shatter", "simulate", "train")
"""Commands whose examples the general help ends with."""
MANNERS = "every command also takes --quiet, --verbose and --profile FILE (where the time goes, for pstats or snakeviz)"


def asks_for_help(words: Sequence[str]) -> bool:
    return any(word in ("-h", "--help") for word in words)


def closing(words: Sequence[str]) -> str:
    """What stands under the help that `words` ask for."""
    asked = next((word for word in words if word in EXAMPLES), None)
    lines = EXAMPLES[asked] if asked else [line for name in FIRST for line in EXAMPLES[name][:1]]
    title = "example:" if len(lines) == 1 else "examples:"
    return "\n".join([MANNERS, "", title, *(f"  {line}" for line in lines)]) + "\n"


def check_command(words: Sequence[str], commands: Sequence[str]) -> None:
    """Raises BadInput when the first of `words` is neither an option nor a command."""
    if not words or words[0].startswith("-") or words[0].replace("_", "-") in commands:
        return
    raise BadInput(
        f"no command is called {words[0]!r}; there are {', '.join(commands)}{did_you_mean(words[0], commands)}"
    )
