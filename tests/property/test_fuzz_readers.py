"""Whatever bytes a file holds, reading it gives an object or one line: a short run of `benchmarks/fuzz.py`."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepfracture.runtime.progress import log

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
try:
    from fuzz import Case, _head, mutate, outcome, readers
finally:
    sys.path.remove(str(BENCHMARKS))

NEEDS = {"model": "torch", "field-model": "torch", "checkpoint": "torch", "dataset": "zarr", "dataset-arrays": "zarr"}
SHORT = st.integers(0, (1 << 16) - 1)
MOVES = st.lists(st.tuples(SHORT, SHORT, SHORT), min_size=1, max_size=4)


def in_head(pattern: bytes, new: bytes) -> Callable[[bytes], bytes]:
    """Swaps what a pattern finds in the JSON head of a safetensors file."""

    def swap(data: bytes) -> bytes:
        head = _head(data)
        assert head is not None
        text, swaps = re.subn(pattern, new, head[0])
        assert swaps == 1
        return head[1](text)

    return swap


DEEP, LONG = "[" * 100_000, "7" * 5000
FOUND = {
    "a scene nested too deeply, TOML": ("scene.toml", f"a = {DEEP}"),
    "a scene nested too deeply, JSON": ("scene.json", DEEP),
    "a number of thousands of digits, TOML": ("scene.toml", f"gravity = {LONG}"),
    "a number of thousands of digits, JSON": ("scene.json", f'{{"gravity": {LONG}}}'),
    "the same in hexadecimal, which Python reads but does not write": ("scene.toml", f"seed = 0x{LONG}\nshapes = []"),
    "a number that no float holds": ("scene.json", f'{{"shapes": [{{"shape": "pot", "material": "glass", "position": '
                                     f'[0, 0, {"9" * 400}]}}], "gravity": {"9" * 400}}}'),
    "a key of many letters": ("scene.toml", f"{'a' * 50_000} = 1"),
    "an engine that is a list": ("scene.json", '{"shapes": [{"shape": "pot", "material": "glass"}], "engine": []}'),
    "a face of many letters": ("mesh.obj", f"v 0 0 0\nf {'x' * 40_000} 1 1\n"),
    "a head of many letters": ("mesh.off", f"OFF\n{'x' * 40_000} 1 1\n"),
    "faces of a glTF file without vertices": (
        "mesh.gltf", lambda tree: tree.replace(b'"count": 8', b'"count": -2147483648')),
    "a report nested too deeply": ("report", DEEP),
    "a report without its stages' seconds": ("report", '{"breaker": "a", "shape": "a", "seed": 1, "stages": [{}]}'),
    "a report whose stages are numbers": ("report", '{"breaker": "a", "shape": "a", "seed": 1, "stages": [1]}'),
    "a report of a stage that takes longer than a float holds": (
        "report", f'{{"breaker": "a", "shape": "a", "seed": 1, "stages": [{{"stage": "a", "seconds": 1{"0" * 400}, '
                  f'"peak_mb": 1}}]}}'),
    "a model of infinitely many channels": (
        "model", in_head(rb'(channels\\": )\d+(, \\"max_impulse)', rb"\1Infinity\2")),
    "a field model of a size that torch refuses at length": (
        "field-model", in_head(rb'(impulse_size\\": )\d+', rb"\g<1>9223372036854775807")),
    "distances of 128 GiB": ("distances", b"\x93NUMPY\x01\x00v\x00{'descr': '<f4', 'fortran_order': False, 'shape': "
                             b"(34359738352,), }".ljust(128)),
    "distances whose head does not end": ("distances", b"\x93NUMPY\x01\x00v\x00{'descr': ('<f4', ".ljust(128)),
}  # fmt: skip
"""What the fuzzers found, each by its reader and the file, or what makes it of a good one."""


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    """The valid files of each reader, made when they are first asked for."""

    class Made(dict[str, Case]):
        def __missing__(self, name: str) -> Case:
            self[name] = Case(readers()[name], tmp_path_factory.mktemp(name))
            return self[name]

    return Made()


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Of what is passed over in broken files, a thousand lines."""
    before = log.level
    log.setLevel(logging.CRITICAL)
    yield
    log.setLevel(before)


@pytest.mark.parametrize("name", list(readers()))
def test_mutated_files_are_read_or_refused_in_one_line(name: str, cases: dict[str, Case]) -> None:
    if name in NEEDS and find_spec(NEEDS[name]) is None:
        pytest.skip(f"{NEEDS[name]} is not installed")
    case = cases[name]

    @settings(max_examples=25, deadline=None, database=None, suppress_health_check=list(HealthCheck), derandomize=True)
    @given(SHORT, MOVES)
    def check(number: int, moves: list[tuple[int, int, int]]) -> None:
        case.put(number, lambda content: mutate(content, moves, case.others))
        try:
            outcome(case.reader, case.place)
        finally:
            case.restore(number)

    check()


@pytest.mark.parametrize("what", list(FOUND))
def test_what_fuzzing_found_is_refused_in_one_line(what: str, cases: dict[str, Case]) -> None:
    name, content = FOUND[what]
    if name in NEEDS and find_spec(NEEDS[name]) is None:
        pytest.skip(f"{NEEDS[name]} is not installed")
    case = cases[name]
    if isinstance(content, str):
        content = content.encode()
    case.put(0, content if callable(content) else lambda _: content)
    try:
        assert outcome(case.reader, case.place) == "refused"
    finally:
        case.restore(0)


def test_the_fuzzer_notices_a_reader_that_raises_something_else(cases: dict[str, Case]) -> None:
    """Else all of the above would pass for a fuzzer that sees nothing."""
    from dataclasses import replace

    def fails(folder: Path) -> None:
        raise KeyError("x")

    with pytest.raises(KeyError):
        outcome(replace(cases["report"].reader, read=fails), cases["report"].place)
