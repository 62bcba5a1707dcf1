"""A trained model as an ONNX graph: from an impulse to the fragment that each voxel belongs to, by any runtime.

In the graph are the normaliser, the sine layer, the selection of the code, the decoder, and the splines up to the
greatest channel of each voxel. docs/reference/onnx.md describes the inputs, the outputs and the steps that remain.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deepfracture.learn.codes import OMEGA
from deepfracture.learn.inference import BANDWIDTH
from deepfracture.learn.partition.field import SMALL_COMPONENT
from deepfracture.learn.partition.lattice import SplineLattice
from deepfracture.learn.partition.selector import LEAST_WEIGHT
from deepfracture.runtime.extras import require
from deepfracture.runtime.files import atomic_file
from deepfracture.types import BadInput, Floats32, Grid

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto

    from deepfracture.learn.partition.model import PartitionModel

OPSET, IR = 17, 8
"""Of 2022: what game engines and runtimes of some years ago read."""
MOST_LABELS = 255
"""Labels are bytes."""
INPUTS = ("impulses", "random", "rank")
OUTPUTS = ("labels", "scores", "coefficients", "code", "order", "surface")


def export_onnx(model: PartitionModel, path: Path) -> int:
    """Write `model` to `path`, complete or not at all; returns its size [bytes].

    Raises:
        BadInput: onnx is not installed.
    """
    data = onnx_graph(model).SerializeToString()
    with atomic_file(path) as temporary:
        temporary.write_bytes(data)
    return len(data)


def onnx_graph(model: PartitionModel) -> ModelProto:
    """The graph, checked by onnx itself; docs/reference/onnx.md describes inputs and outputs."""
    require("onnx", extra="onnx", to="export a model to ONNX")
    from onnx import TensorProto, checker, helper

    if model.channels > MOST_LABELS:
        raise BadInput(f"{model.shape_name}: {model.channels} channels; labels are bytes, at most {MOST_LABELS}")
    graph, grid = _Graph(), model.domain.grid
    rows = _normalised(graph, model)
    order = _order(graph, model, rows)
    code = _code(graph, model, order)
    coefficients = _coefficients(graph, model, code)
    logits = _logits(graph, model.domain.lattice, coefficients, model.channels)
    surface = graph.const("surface_distance", model.domain.surface)
    _labels(graph, logits, surface)
    for made, name in ((logits, "scores"), (coefficients, "coefficients"), (code, "code"), (order, "order")):
        graph.node("Identity", made, name=name)
    graph.node("Identity", surface, name="surface")
    r, n, real = grid.resolution, len(model.selector.impulses), TensorProto.FLOAT
    value = helper.make_tensor_value_info
    inputs = [
        value("impulses", real, [model.config.features, 7]),
        value("random", real, [model.config.segment_size]),
        value("rank", TensorProto.INT64, []),
    ]
    outputs = [
        value("labels", TensorProto.UINT8, [r, r, r]),
        value("scores", real, [r, r, r, model.channels]),
        value("coefficients", real, [len(model.domain.nodes), model.channels]),
        value("code", real, [model.config.code_size]),
        value("order", TensorProto.INT64, [n]),
        value("surface", real, [r, r, r]),
    ]
    made = helper.make_model(
        helper.make_graph(graph.nodes, f"deepfracture {model.shape_name}", inputs, outputs, graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR,
        producer_name="deepfracture",
    )
    helper.set_model_props(made, metadata_of(model))
    checker.check_model(made, full_check=True)
    return made


def metadata_of(model: PartitionModel) -> dict[str, str]:
    """What a program needs to know beside the graph, as text: the metadata of the file."""
    grid = model.domain.grid
    return {
        "shape": model.shape_name,
        "resolution": str(grid.resolution),
        "spacing": repr(float(grid.spacing)),
        "first_voxel": json.dumps(grid.to_world([0, 0, 0]).tolist()),
        "max_impulse": repr(float(model.normaliser.max_impulse)),
        "channels": str(model.channels),
        "codes": str(len(model.selector.impulses)),
        "crumb_voxels": str(smallest_piece(grid)),
        "about": json.dumps(model.metadata),
    }


def smallest_piece(grid: Grid) -> int:
    """Voxels below which a piece joins its surroundings."""
    return max(2, round(SMALL_COMPONENT * grid.resolution**3))


class _Graph:
    """Nodes and constants as they are added; a value is known by its name."""

    def __init__(self) -> None:
        self.nodes: list[NodeProto] = []
        self.constants: list[TensorProto] = []

    def const(self, name: str, values: ArrayLike) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    def small(self, name: str, values: Floats32) -> str:
        """A constant of half the bytes; models store these arrays so, hence nothing is lost."""
        half = np.asarray(values, np.float16)
        assert np.array_equal(half.astype(np.float32), values), f"{name} was not stored as float16"
        return self.node("Cast", self.const(f"{name}.half", half), to=1)

    def node(self, kind: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Add an operation; returns the name of its first result."""
        from onnx import helper

        name = name or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def number(self, value: float) -> str:
        return self.const(f"number_{len(self.constants)}", np.float32(value))

    def ints(self, *values: int) -> str:
        return self.const(f"ints_{len(self.constants)}", np.array(values, np.int64))

    def reshape(self, value: str, shape: Sequence[int]) -> str:
        return self.node("Reshape", value, self.ints(*shape))

    def dense(self, value: str, weight: str, bias: NDArray, name: str) -> str:
        return self.node("Add", self.node("MatMul", value, weight), self.const(name, bias))

    def silu(self, value: str) -> str:
        """x / (1 + exp(-x)), as in `network`."""
        return self.node("Mul", value, self.node("Sigmoid", value))


def _normalised(graph: _Graph, model: PartitionModel) -> str:
    """J^norm, shape (features, 7), of impulses [p, d, I]: `Normaliser`."""
    scale = np.array([1, 1, 1, 1, 1, 1, 2 / model.normaliser.max_impulse], np.float32)
    shift = np.array([0, 0, 0, 0, 0, 0, -1], np.float32)
    scaled = graph.node("Mul", "impulses", graph.const("normaliser.scale", scale))
    moved = graph.node("Add", scaled, graph.const("normaliser.shift", shift))
    return graph.node("Clip", moved, graph.number(-1), graph.number(1))


def _order(graph: _Graph, model: PartitionModel, rows: str) -> str:
    """All codes, the most typical first, shape (n,): `Choice`."""
    selector, node = model.selector, graph.node
    kernel = selector.kernel
    scale = np.array([1, 1, 1, *3 * [kernel.direction], kernel.impulse], np.float32) / np.float32(kernel.width)
    apart = node("Sub", graph.const("choice.rows", selector.impulses), rows)
    apart = node("Mul", apart, graph.const("choice.scale", scale))
    squares = node("ReduceSum", node("Mul", apart, apart), graph.ints(1, 2), keepdims=0)
    alike = node("Exp", node("Mul", squares, graph.number(-0.5)))
    alike = node("Add", alike, graph.number(LEAST_WEIGHT))
    off = node("Sub", graph.const("choice.segment", selector.segment), "random")
    unlike = node("ReduceSum", node("Mul", off, off), graph.ints(1), keepdims=0)
    unlike = node("Mul", unlike, graph.number(1 / (2 * BANDWIDTH**2)))
    least = node("ReduceMin", unlike, axes=[0], keepdims=1)
    weights = node("Mul", alike, node("Exp", node("Sub", least, unlike)))
    risk = node("MatMul", weights, graph.small("choice.apart", selector.pairwise))
    order = f"order_{len(graph.nodes)}"
    node("TopK", risk, graph.ints(len(selector.impulses)), axis=0, largest=0, sorted=1)
    graph.nodes[-1].output[:] = ["risk_sorted", order]
    return order


def _code(graph: _Graph, model: PartitionModel, order: str) -> str:
    """The code of rank `rank` in that order, shape (code_size,): impulse through the sine layer, then segment."""
    index = graph.node("Gather", order, "rank", axis=0)
    row = graph.node("Gather", "choice.rows", index, axis=0)
    weight = graph.const("siren.weight", model.weights["siren.weight"])
    waves = graph.dense(row, weight, model.weights["siren.bias"], "siren.bias")
    waves = graph.node("Sin", graph.node("Mul", waves, graph.number(OMEGA)))
    impulse = graph.reshape(waves, [-1])
    return graph.node("Concat", impulse, graph.node("Gather", "choice.segment", index, axis=0), axis=0)


def _coefficients(graph: _Graph, model: PartitionModel, code: str) -> str:
    """What the code makes of the waves at the nodes of the lattice, shape (nodes, channels): `network.compose`."""
    weights = model.weights
    hidden = graph.reshape(code, [1, -1])
    for name in ("first", "second"):
        weight = graph.small(f"{name}.weight", weights[f"{name}.weight"])
        hidden = graph.silu(graph.dense(hidden, weight, weights[f"{name}.bias"], f"{name}.bias"))
    weight = graph.small("head.weight", weights["head.weight"])
    made = graph.dense(hidden, weight, weights["head.bias"], "head.bias")
    matrix = graph.reshape(made, [model.config.basis, model.channels])
    # Made from constants alone, so a runtime computes these 30 MB once, when it loads the 7 MB file.
    places = graph.const("nodes", model.domain.nodes.astype(np.float32))
    vectors = graph.const("waves.vector", weights["waves.vector"])
    waves = graph.node("Sin", graph.dense(places, vectors, weights["waves.phase"], "waves.phase"))
    gain = model.domain.lattice.gain(weights["waves.vector"]).astype(np.float32)
    return graph.node("MatMul", graph.node("Mul", waves, graph.const("waves.gain", gain)), matrix)


def _logits(graph: _Graph, lattice: SplineLattice, coefficients: str, channels: int) -> str:
    """The splines at all voxels, shape (r, r, r, channels), an axis at a time; voxels outside the body mean nothing."""
    side = lattice.number.shape[0]
    r = len(lattice.cell)
    padded = graph.node("Concat", coefficients, graph.const("nothing", np.zeros((1, channels), np.float32)), axis=0)
    number = np.where(lattice.number < 0, len(lattice.nodes), lattice.number).astype(np.int64)
    values = graph.node("Gather", padded, graph.const("lattice.number", number.ravel()), axis=0)
    matrix = graph.const("lattice.weights", spline_matrix(lattice))
    for shape in ((side, side * side * channels), (r, side, side * channels), (r, r, side, channels)):
        values = graph.node("MatMul", matrix, graph.reshape(values, shape))
    return values


def spline_matrix(lattice: SplineLattice) -> Floats32:
    """From nodes along an axis to voxels along it, shape (r, cells + 2): three weights a row."""
    r = len(lattice.cell)
    matrix = np.zeros((r, lattice.number.shape[0]), np.float32)
    for k in range(3):
        matrix[np.arange(r), lattice.cell + k] = lattice.weights[:, k]
    return matrix


def _labels(graph: _Graph, logits: str, surface: str) -> str:
    """1 above the greatest channel of each voxel inside, 0 outside, shape (r, r, r)."""
    from onnx import TensorProto

    best = graph.node("Cast", graph.node("ArgMax", logits, axis=3, keepdims=0), to=TensorProto.UINT8)
    inside = graph.node("Cast", graph.node("Greater", surface, graph.number(0)), to=TensorProto.UINT8)
    above = graph.node("Add", best, graph.const("one", np.uint8(1)))
    return graph.node("Mul", above, inside, name="labels")
