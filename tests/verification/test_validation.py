"""Physics against closed forms: every case of `deepfracture validate` at its small size, and the command itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deepfracture.cli import main
from deepfracture.types import FracturePattern, Grid
from deepfracture.validation import CASES, Case, Curve, Finding, Plot, Report, suite
from deepfracture.validation.beam import DEPTH, shear_stress
from deepfracture.validation.breaking import crack_faces
from deepfracture.validation.penny import finite_body, kink


@pytest.mark.parametrize("name", CASES)
def test_case_is_within_its_limits(name: str) -> None:
    findings = CASES[name].quick().findings
    assert findings
    assert not [finding for finding in findings if not finding.ok]


def _case(error: float) -> Case:
    def report() -> Report:
        plot = Plot("line", "a line", "x", "y", (Curve("line", [0, 1], [1, 2], "-"),))
        return Report((Finding("a case", 1.0, 1.0 + error, error, 0.1, 7),), (plot,))

    return Case(report, report)


@pytest.fixture
def cases(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    return lambda **cases: monkeypatch.setattr(suite, "CASES", cases)


def test_command_prints_a_table_and_writes_rows_and_plots(
    cases: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cases(good=_case(0.05))
    main(["validate", "--quick", "--json", str(tmp_path / "rows.json"), "--plots", str(tmp_path / "plots")])
    table = capsys.readouterr().out.splitlines()
    assert table[0].split() == ["case", "exact", "ours", "error", "limit", "ok", "N", "seconds"]
    assert table[1].split()[:6] == ["a", "case", "1", "1.05", "0.05", "0.1"]
    assert table[-1] == "1 of 1 within their limits"
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert list(row) == ["case", "exact", "ours", "error", "limit", "ok", "n", "seconds"]
    assert row["ok"] is True
    assert [path.name for path in (tmp_path / "plots").iterdir()] == ["line.png"]
    assert (tmp_path / "plots" / "line.png").stat().st_size < 60_000


@pytest.mark.parametrize("error", [0.2, float("nan")])
def test_command_fails_when_a_row_is_beyond_its_limit(
    error: float, cases: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    cases(good=_case(0.05), bad=_case(error))
    with pytest.raises(SystemExit) as end:
        main(["validate"])
    assert end.value.code == 1
    assert "1 of 2" in capsys.readouterr().out


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_flexure_carries_the_force_and_leaves_the_sides_free(poisson: float) -> None:
    count = 200
    axis = (np.arange(count) + 0.5) / count * DEPTH - DEPTH / 2
    x, y = np.meshgrid(axis, axis, indexing="ij")
    along, across = shear_stress(x, y, poisson)
    inertia = DEPTH**4 / 12
    assert along.sum() * (DEPTH / count) ** 2 == pytest.approx(inertia, rel=1e-3)
    edge = np.full(count, DEPTH / 2)
    assert np.abs(shear_stress(edge, axis, poisson)[0]).max() < 0.02 * along.max()
    assert np.abs(shear_stress(axis, edge, poisson)[1]).max() < 1e-9
    # Equilibrium along the bar: ∂τ_xz/∂x + ∂τ_yz/∂y = -∂σ_z/∂z = -x (P / I = 1).
    step = DEPTH / count
    left = np.gradient(along, step, axis=0) + np.gradient(across, step, axis=1) + x
    assert np.abs(left[20:-20, 20:-20]).max() < 1e-3 * DEPTH


def test_finite_body_and_kink_have_their_known_values() -> None:
    assert finite_body(0.0) == pytest.approx(1.0)
    assert finite_body(0.5) > finite_body(0.25) > 1
    assert kink(np.array([1.0, 0.0])) == 0
    assert kink(np.array([0.0, 1.0])) == pytest.approx(-70.53, abs=0.01)  # Erdogan & Sih 1963


def test_crack_faces_lie_between_the_labels() -> None:
    grid = Grid(32)
    labels = np.zeros(grid.shape, np.int32)
    labels[8:20, 4:6, 10:13], labels[20:24, 4:6, 10:13] = 1, 2
    centres, axes = crack_faces(FracturePattern(grid, labels, np.zeros(grid.shape, np.float32)))
    assert len(axes) == 6
    assert (axes == 0).all()
    assert centres[:, 0] == pytest.approx(grid.to_world(19.5))
    assert centres[:, 1:].min(axis=0) == pytest.approx(grid.to_world([4, 10]))
    assert centres[:, 1:].max(axis=0) == pytest.approx(grid.to_world([5, 12]))
