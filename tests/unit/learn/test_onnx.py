"""The exported graph says what the model says, in another runtime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepfracture.learn import PartitionModel, embedded_model, load_partition_model
from deepfracture.learn.partition import network
from deepfracture.learn.partition.field import _assign_labels, _node_argmax
from deepfracture.learn.partition.onnx import OUTPUTS, export_onnx, spline_matrix
from deepfracture.types import BadInput, Impact

ort = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")
TOLERANCE = 1e-4
CLOSE = 1e-3
"""Two scores nearer than this are a tie: either channel may win."""


@pytest.fixture(scope="module")
def model() -> PartitionModel:
    path = embedded_model("pot")
    assert path is not None
    return load_partition_model(path)


@pytest.fixture(scope="module")
def session(model: PartitionModel, tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("onnx") / "deep" / "pot.onnx"
    size = export_onnx(model, path)
    assert size == path.stat().st_size < 10e6
    return ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def hits(model: PartitionModel, count: int):
    """Random impulses, random codes."""
    rng = np.random.default_rng(5)
    for _ in range(count):
        position, direction = rng.uniform(-1, 1, 3), rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        strength = float(rng.uniform(0.1, 1.2)) * model.normaliser.max_impulse  # beyond I_max it is clipped
        impact = Impact([position], [direction], [strength], [-direction], speed=9.0, radius=0.2)
        yield impact, rng.standard_normal(model.config.segment_size, np.float32)


def answer(session, model: PartitionModel, impact: Impact, random, rank: int = 0) -> dict[str, np.ndarray]:
    rows = np.zeros((model.config.features, 7), np.float32)
    rows[0] = [*impact.position[0], *impact.direction[0], impact.magnitude[0]]
    found = session.run(list(OUTPUTS), {"impulses": rows, "random": random, "rank": np.array(rank)})
    return dict(zip(OUTPUTS, found, strict=True))


def labels_of(model: PartitionModel, coefficients: np.ndarray) -> np.ndarray:
    """The label of each voxel as `decode_logits` finds it, before small components are relabelled."""
    body, lattice, r = model.domain, model.domain.lattice, model.domain.grid.resolution
    labels = np.zeros((r + 2,) * 3, np.int16)
    leaders = _node_argmax(coefficients)
    _assign_labels(
        coefficients, leaders, lattice.cells, lattice.number, lattice.start, lattice.weights, body.surface, labels,
        0, len(lattice.cells),
    )  # fmt: skip
    return labels[1:-1, 1:-1, 1:-1]


@pytest.mark.parametrize("rank", [0, 7])
def test_it_agrees_with_the_model(model: PartitionModel, session, rank: int) -> None:
    seen = set()
    for impact, random in hits(model, 4):
        found = answer(session, model, impact, random, rank)
        row = model.normaliser(impact).astype(np.float32)
        order = model.selector(row, random)
        assert found["order"][rank] == order[rank] and sorted(found["order"]) == sorted(order)
        code = model.codebook[order[rank]]
        np.testing.assert_allclose(found["code"], code, atol=1e-5)
        coefficients = model.node_features @ network.mixing_matrices(model.weights, code[None], np)[0]
        np.testing.assert_allclose(found["coefficients"], coefficients, atol=TOLERANCE)
        labels = labels_of(model, coefficients)
        different = found["labels"] != labels
        first, second = np.sort(found["scores"], axis=3)[..., [-1, -2]].transpose(3, 0, 1, 2)
        assert (first - second)[different].max(initial=0) < CLOSE and different.sum() < 20
        assert len(np.unique(labels)) > 5
        seen.add(int(order[rank]))
    assert len(seen) > 1  # other impulses, other patterns


def test_it_agrees_with_torch(model: PartitionModel, session) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    weights = {name: torch.from_numpy(value) for name, value in model.weights.items()}
    impact, random = next(hits(model, 1))
    found = answer(session, model, impact, random)
    code = torch.from_numpy(model.codebook[found["order"][0]])[None]
    coefficients = torch.from_numpy(model.node_features) @ network.mixing_matrices(weights, code, torch)[0]
    np.testing.assert_allclose(found["coefficients"], coefficients.numpy(), atol=TOLERANCE)


def test_the_scores_are_the_splines_of_the_coefficients(model: PartitionModel, session) -> None:
    impact, random = next(hits(model, 1))
    found, lattice = answer(session, model, impact, random), model.domain.lattice
    rng = np.random.default_rng(0)
    inside = np.argwhere(model.domain.surface > 0)
    for i, j, k in rng.choice(inside, 50):
        a, b, c = lattice.cell[[i, j, k]]
        near = found["coefficients"][lattice.number[a : a + 3, b : b + 3, c : c + 3]]
        w = lattice.weights
        value = np.einsum("a,b,c,abcm->m", w[i], w[j], w[k], near)
        np.testing.assert_allclose(found["scores"][i, j, k], value, atol=TOLERANCE)
    np.testing.assert_allclose(spline_matrix(lattice).sum(axis=1), 1, atol=1e-6)


def test_outside_there_is_no_label_and_the_surface_is_told(model: PartitionModel, session) -> None:
    impact, random = next(hits(model, 1))
    found = answer(session, model, impact, random)
    assert ((found["labels"] == 0) == (model.domain.surface <= 0)).all()
    np.testing.assert_array_equal(found["surface"], model.domain.surface)


def test_the_file_tells_what_it_is_of(model: PartitionModel, session) -> None:
    facts = session.get_modelmeta().custom_metadata_map
    assert facts["shape"] == "pot" and float(facts["max_impulse"]) == model.normaliser.max_impulse
    assert int(facts["resolution"]) == 64 and int(facts["crumb_voxels"]) == 30


def test_the_command_writes_it_and_refuses_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from deepfracture.cli import main

    out = tmp_path / "mug.onnx"
    main(["export-onnx", "mug", "--out", str(out)])
    assert out.stat().st_size > 1e6
    with pytest.raises(SystemExit):
        main(["export-onnx", str(tmp_path / "none.safetensors"), "--out", str(out)])
    assert "no such file" in capsys.readouterr().err


def test_without_the_library_it_is_one_line(
    model: PartitionModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deepfracture.runtime import extras

    monkeypatch.setattr(extras, "is_installed", lambda module: module != "onnx")
    with pytest.raises(BadInput, match=r"pip install 'deepfracture\[onnx\]'"):
        export_onnx(model, tmp_path / "pot.onnx")
    assert not list(tmp_path.iterdir())


def test_the_lines_of_the_documentation_finish_the_job(model: PartitionModel, session) -> None:
    import re

    text = (Path(__file__).parents[3] / "docs" / "reference" / "onnx.md").read_text()
    lines = "\n".join(block for block in re.findall(r"```python\n(.*?)```", text, re.S) if block.startswith("def "))
    made: dict = {"np": np}
    exec(lines, made)
    impact, random = next(hits(model, 1))
    found = answer(session, model, impact, random)
    least = int(session.get_modelmeta().custom_metadata_map["crumb_voxels"])
    labels = made["without_crumbs"](found["labels"], least)
    assert (labels != found["labels"]).any(), "no crumb to sweep: the test says nothing"
    expected = model.decode(model.codebook[found["order"][0]])
    assert expected.cuts is not None and (made["cut_bits"](labels) != expected.cuts).sum() < 20
    assert np.count_nonzero(expected.cuts) > 500
    cut = np.argwhere(((expected.cuts & 1) > 0) & (model.domain.surface > 0.05))[0]
    here, there = tuple(cut), (cut[0] + 1, cut[1], cut[2])
    scores = found["scores"]
    t = made["crossing"](scores[here], scores[there], labels[here] - 1, labels[there] - 1)
    assert 0 < t < 1 and expected.values[here] <= (t + 1e-4) * model.domain.grid.spacing
