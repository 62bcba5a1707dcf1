"""Examples under the help of each command, and near words for mistyped commands and options."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from inspect import signature
from typing import get_type_hints

from deepfracture.runtime.progress import log
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
"""Working command lines, by command."""
RENAMED = {"convert": "copy", "--budget": "--max-faces"}
"""Deprecated commands and options."""
FIRST = ("shatter", "simulate", "train")
"""Commands whose examples the general help ends with."""
GLOBAL_OPTIONS = "every command also takes --quiet, --verbose and --profile FILE (for pstats or snakeviz)"


def asks_for_help(words: Sequence[str]) -> bool:
    return any(word in ("-h", "--help") for word in words)


def closing(words: Sequence[str]) -> str:
    """The text under the help that `words` ask for."""
    asked = next((word for word in words if word in EXAMPLES), None)
    lines = EXAMPLES[asked] if asked else [line for name in FIRST for line in EXAMPLES[name][:1]]
    title = "example:" if len(lines) == 1 else "examples:"
    return "\n".join([GLOBAL_OPTIONS, "", title, *(f"  {line}" for line in lines)]) + "\n"


def check_words(words: Sequence[str], commands: Mapping[str, Callable]) -> None:
    """Raises BadInput for a command or an option that does not exist, with the near one."""
    if not words or words[0].startswith("-"):
        return
    command = words[0].replace("_", "-")
    if command not in commands:
        raise BadInput(
            f"no command is called {words[0]!r}; there are {', '.join(commands)}{did_you_mean(words[0], commands)}"
        )
    known = [*_options(commands[command]), "--help"]
    for word in words[1:]:
        name = word.partition("=")[0].replace("_", "-")
        if name.startswith("--") and name not in known:
            raise BadInput(f"{command} has no option {name}; see {command} --help{did_you_mean(name, known)}")


def with_new_names(words: Sequence[str]) -> list[str]:
    """Deprecated commands and options replaced, with a warning for each."""
    found = []
    for place, word in enumerate(words):
        name, *value = word.split("=", 1)
        if name in RENAMED and (place == 0 or name.startswith("--")):
            log.warning("%s is deprecated, use %s", name, RENAMED[name])
            name = RENAMED[name]
        found.append("=".join([name, *value]))
    return found


def _options(command: Callable) -> Iterator[str]:
    """Options of a command: its parameters, and the fields of those that are dataclasses."""
    hints = get_type_hints(command)
    for name, parameter in signature(command).parameters.items():
        if parameter.kind is parameter.POSITIONAL_ONLY:
            continue
        options = fields(hints[name]) if is_dataclass(hints[name]) else [parameter]
        for option in options:
            flag = option.name.replace("_", "-")
            yield f"--{flag}"
            if isinstance(option.default, bool):
                yield f"--no-{flag}"
