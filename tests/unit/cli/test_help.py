"""The command line helps: examples that work, near words for mistyped ones, completion, quiet, verbose, profile."""

from __future__ import annotations

import logging
import pstats
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from deepfracture.cli import main
from deepfracture.cli.global_options import GlobalOptions, split_global_options
from deepfracture.cli.help import EXAMPLES, with_new_names
from deepfracture.cli.main import commands
from deepfracture.runtime.progress import collect_stages, log, stage, track
from deepfracture.types import BadInput


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of a command line that ends the program."""
    with pytest.raises(SystemExit) as ended:
        main(words)
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


@pytest.mark.parametrize("command", commands())
def test_the_help_of_every_command_ends_with_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = said(capsys, command, "--help")
    last = out.rstrip().splitlines()[-1].strip()
    assert code == 0 and command in EXAMPLES and last == EXAMPLES[command][-1]
    for example in EXAMPLES[command]:
        words = shlex.split(re.sub(r"^source <\((.*)\)$|[>|].*$", r"\1", example))
        assert words[0] == "deepfracture" and words[1] in commands()
        if words[1] == command:  # every option of the example is one that the help names
            assert {word for word in words if word.startswith("--")} <= set(re.findall(r"--[\w-]+", out)), example


def test_the_general_help_ends_with_examples(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = said(capsys, "--help")
    assert code == 0 and out.rstrip().splitlines()[-1].strip() == EXAMPLES["train"][0] and "--profile FILE" in out


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("shater", "pot"), "'shatter'"),
        (("shatter", "poot"), "'pot'"),
        (("shatter", "pot", "--breaker", "fysical"), "'physical'"),
        (("shatter", "pot", "--material", "plastr"), "'plaster'"),
        (("shatter", "pot", "--engine", "raper"), "'rapier'"),
        (("simulate", "bar", "--scene", "duel"), "'dual'"),
        (("bench", "crave"), "'carve'"),
        (("export-onnx", "bunyn", "--out", "x.onnx"), "'bunny'"),
        (("completion", "bsh"), "'bash'"),
    ],
)
def test_a_mistyped_word_is_met_with_the_near_one(
    words: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    code, _, err = said(capsys, *words)
    assert code == 2 and err.count("\n") == 1 and err.endswith(f"did you mean {meant}?\n")


def test_a_mistyped_file_is_met_with_the_near_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "statue.obj").write_text("v 0 0 0\n")
    code, _, err = said(capsys, "info", str(tmp_path / "statu.obj"))
    assert code == 2 and "no such file; did you mean 'statue.obj'?" in err


def test_a_mistyped_option_is_met_with_the_near_one(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = said(capsys, "shatter", "pot", "--breker", "voronoi")
    assert (
        code == 2
        and err == "deepfracture: shatter has no option --breker; see shatter --help; did you mean '--breaker'?\n"
    )
    _, _, err = said(capsys, "train", "data", "--out", "run", "--epoch=3")
    assert err.endswith("train has no option --epoch; see train --help; did you mean '--epochs'?\n")


def test_the_help_shows_types_as_words_and_allowed_values(capsys: pytest.CaptureFixture[str]) -> None:
    from deepfracture.breakers import BREAKERS
    from deepfracture.cli import options
    from deepfracture.dataset import EXECUTORS
    from deepfracture.export import FORMATS
    from deepfracture.fracture import MATERIALS
    from deepfracture.world import ENGINES, KINDS, UPRIGHT

    for command in commands():
        _, out, _ = said(capsys, command, "--help")
        assert "None" not in out and "[STR" not in out and "PATH" not in out, command
    assert set(options.MATERIALS) == set(MATERIALS) and set(options.ENGINES) == set(ENGINES)
    assert options.SCENES == KINDS and options.EXECUTORS == EXECUTORS and set(options.AXES) == set(UPRIGHT)
    assert set(options.FORMATS) == set(FORMATS)
    _, out, _ = said(capsys, "shatter", "--help")
    for values in (BREAKERS, options.MATERIALS, options.ENGINES, options.AXES):
        assert options.one_of(*values) in out


def test_the_help_is_instant(capsys: pytest.CaptureFixture[str]) -> None:
    code = (
        "import sys\n"
        "from deepfracture.cli import main\n"
        "try:\n    main(['shatter', '--help'])\n"
        "except SystemExit:\n    pass\n"
        "assert not {'numba', 'scipy', 'torch', 'zarr', 'viser'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_a_deprecated_option_works_with_one_line_of_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert with_new_names(["convert", "a", "b"]) == ["copy", "a", "b"]
    assert caplog.messages == ["convert is deprecated, use copy"]
    assert with_new_names(["--budget=400", "--budget", "4"]) == ["--max-faces=400", "--max-faces", "4"]
    caplog.clear()
    words = ["shatter", "bar", "--breaker", "voronoi", "--resolution", "32", "--speed", "16", "--formats", "fragments"]
    main([*words, "--out", str(tmp_path / "out"), "--budget", "400"])
    warned = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warned == ["--budget is deprecated, use --max-faces"]
    assert "coarsen" in " ".join(caplog.messages) or "decimate" in " ".join(caplog.messages)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_that_its_shell_accepts(
    shell: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, out, _ = said(capsys, "completion", shell)
    assert code == 0 and all(command in out for command in commands()) and "breaker" in out
    if shutil.which(shell):
        script = tmp_path / "completion"
        script.write_text(out)
        subprocess.run([shell, "-n", str(script)], check=True)


def test_global_options_are_taken_from_anywhere_in_the_line() -> None:
    words, options = split_global_options(["shatter", "-q", "pot", "--profile", "a.prof", "--seed", "3"])
    assert words == ["shatter", "pot", "--seed", "3"] and options == GlobalOptions(quiet=True, profile=Path("a.prof"))
    assert split_global_options(["info", "--verbose", "--profile=b"])[1] == GlobalOptions(
        verbose=True, profile=Path("b")
    )
    for wrong in (["--profile"], ["--profile", "--seed"], ["-q", "-v"]):
        with pytest.raises(BadInput):
            split_global_options(["info", *wrong])


def test_quiet_says_nothing_and_the_next_command_does(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quiet", "info", "bar"])
    assert log.level == logging.WARNING and capsys.readouterr().err == ""
    main(["info", "bar"])
    assert log.level == logging.INFO


def test_a_profile_says_where_the_time_went(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "deep" / "shatter.prof"
    words = ["shatter", "bar", "--breaker", "voronoi", "--resolution", "32", "--speed", "16", "--no-film"]
    main([*words, "--out", str(tmp_path / "out"), "--profile", str(file)])
    table = caplog.messages[-1]
    assert "world, with the break" in table and "write animation.glb" in table
    stats = pstats.Stats(str(file))
    assert any(name == "shatter" for _, _, name in stats.stats)  # type: ignore[attr-defined]


def test_stages_reach_the_block_around_as_well() -> None:
    with collect_stages() as outer:
        with collect_stages() as inner, stage("a"):
            pass
        with stage("b"):
            pass
    assert [done.stage for done in inner] == ["a"] and [done.stage for done in outer] == ["a", "b"]


def test_progress_is_silent_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(track(range(3), name="three")) == [0, 1, 2]
    assert capsys.readouterr() == ("", "")


def test_progress_shows_the_time_left_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import sys
    import time

    from deepfracture.runtime import progress

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(progress, "SHOW_AFTER", 0.2)
    monkeypatch.setenv("TERM", "xterm")
    progress.disable_progress(False)
    for _ in track(range(12), name="twelve steps"):
        time.sleep(0.1)
    drawn = screen.getvalue()
    assert "twelve steps" in drawn and re.search(r"\d of 12", drawn) and "left" in drawn
    screen.truncate(0)
    for _ in track(range(3), name="quick"):
        pass
    assert "quick" not in screen.getvalue()
