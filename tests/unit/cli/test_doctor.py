"""The doctor tries what it names, tells what is broken, and prescribes one line."""

from __future__ import annotations

import pytest

from deepfracture.cli import doctor, main
from deepfracture.cli.doctor import Finding, Part, advice, examine, kernels, parts
from deepfracture.runtime import extras


def part(use, *, module: str = "json", extra: str | None = "play", unavailable: str = "") -> Part:
    return Part("name", "does", module, extra, use, unavailable)


def raises() -> str:
    raise OSError("libGL.so.1: cannot open\nmore")


def test_a_part_is_used_not_only_imported() -> None:
    found = examine(part(lambda: "1.0"))
    assert (found.state, found.detail) == ("works", "1.0")
    broken = examine(part(raises))
    assert (broken.state, broken.detail) == ("broken", "OSError: libGL.so.1: cannot open")


def test_missing_parts_name_their_remedy_or_why_there_is_none() -> None:
    assert examine(part(raises, module="no_such")).detail == "pip install 'deepfracture[play]'"
    assert examine(part(raises, module="no_such", unavailable="no wheel")).detail == "no wheel"


def test_the_advice_is_one_line() -> None:
    works = Finding(part(raises), "works", "")
    missing = Finding(part(raises, extra="usd"), "missing", "")
    never = Finding(part(raises, extra="bullet", unavailable="no wheel"), "missing", "no wheel")
    broken = Finding(part(raises, extra="render"), "broken", "")
    assert advice([works, never]) == "everything available on this machine works"
    assert advice([works, missing, missing]) == "install everything missing: pip install 'deepfracture[usd]'"
    assert advice([missing, broken]).endswith("pip install 'deepfracture[usd,render]' --force-reinstall")
    assert "installation is incomplete" in advice([Finding(part(raises, extra=None), "broken", "")])


def test_what_is_installed_here_works(capsys: pytest.CaptureFixture[str]) -> None:
    main(["doctor"])
    lines = capsys.readouterr().out.splitlines()
    named = [one for one in parts() if extras.is_installed(one.module)]
    assert len(named) >= 5
    for one in named:
        (line,) = [line for line in lines if line.startswith(f"{one.name:<10} ")]
        assert line.split(one.name, 1)[1].split()[0] == "works", line
    assert "cores" in "".join(lines) and "kernels" in "".join(lines)


def test_the_engine_check_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    from deepfracture.world import engines

    real = engines.open_engine
    monkeypatch.setattr(engines, "open_engine", lambda name, **how: real(name, **{**how, "gravity": 0.0}))
    rapier = next(one for one in parts() if one.name == "rapier")
    assert examine(rapier).state == "broken"


def test_kernels_are_counted_by_file() -> None:
    compiled, wanted = kernels()
    assert wanted > 20 and 0 <= compiled <= wanted


def test_without_the_libraries_everything_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "is_installed", lambda module: module == "rapier3d")
    main(["doctor"])
    out = capsys.readouterr().out
    prescription = out.rstrip().splitlines()[-1]
    assert prescription.startswith("install everything missing: pip install 'deepfracture[")
    assert {"play", "render", "usd", "train", "onnx"} <= set(prescription.split("[")[1].split("]")[0].split(","))
