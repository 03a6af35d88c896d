"""Networks as ONNX models."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import onnxruntime
from gymnasium import Space, spaces
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from apel.learners.deep.encoding import Encoder
from apel.learners.deep.graph import GraphLayer, NetworkGraph, graph_of
from apel.learners.deep.normalising import EPSILON

_OPSET = 17
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}
_NUM_CHECKED, _TOLERANCE = 1_000, 1e-4


def checked_model(learner: Any, space: Space[Any], first_action: int) -> bytes:
    """The bytes of the model of a deep learner that sees ``space``, after a thousand observations through both.

    Raises
    ------
    ValueError
        If its network has no such form, or gives other actions.
    """
    graph, encoder = graph_of(learner), learner_encoder(learner)
    if graph is None:
        message = f"found {type(learner).__name__}, expected a shipped deep learner"
        raise ValueError(message)
    model = _Model(graph, encoder, first_action).build(encoder.observation_shape)
    onnx.checker.check_model(model, full_check=True)
    stored: bytes = model.SerializeToString()
    _check(stored, learner, space, first_action)
    return stored


def learner_encoder(learner: Any) -> Encoder:
    """What makes the inputs of its network."""
    encoder: Encoder = learner._batched.encoder
    return encoder


def _check(stored: bytes, learner: Any, space: Space[Any], first_action: int) -> None:
    observations = sampled(space, _NUM_CHECKED)
    session = onnxruntime.InferenceSession(stored, providers=["CPUExecutionProvider"])
    values, actions = session.run(["values", "action"], {"observation": observations.astype(np.float32)})
    for observation, value, action in zip(observations, values, actions, strict=True):
        expected = learner.action_values(observation)
        best = int(np.argmax(expected))
        chosen = int(action) - first_action
        # Two values may be the same but for their last bits, which are computed in another order.
        if chosen != best and abs(float(expected[chosen] - expected[best])) > _TOLERANCE * (1 + abs(expected[best])):
            message = f"onnxruntime gives the values {value.tolist()} at {observation}, expected {expected.tolist()}"
            raise ValueError(message)


def sampled(space: Space[Any], count: int) -> NDArray[Any]:
    """``[count, …]``: random elements of a space, the same ones every time."""
    drawn = spaces.Box(space.low, space.high, dtype=space.dtype.type) if isinstance(space, spaces.Box) else space
    drawn.seed(0)
    return np.stack([np.asarray(drawn.sample()) for _ in range(count)])


class _Model:
    """Builds the nodes of a model one after the other."""

    def __init__(self, graph: NetworkGraph, encoder: Encoder, first_action: int) -> None:
        self._graph, self._encoder, self._first_action = graph, encoder, first_action
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def build(self, observation_shape: tuple[int, ...]) -> Any:
        graph = self._graph
        x, is_flat = self._inputs(), False
        for layer in graph.body:
            x, is_flat = self._layer(layer, x, is_flat)
        if not is_flat and not graph.body:
            x = self._node("Flatten", x, axis=1)
        advantage = self._chain(graph.head, x)
        if graph.value:
            mean = self._node("ReduceMean", advantage, axes=[1], keepdims=1)
            advantage = self._node("Sub", self._node("Add", self._chain(graph.value, x), advantage), mean)
        self._nodes.append(helper.make_node("Identity", [advantage], ["values"]))
        best = self._node("ArgMax", advantage, axis=1, keepdims=0)
        first = self._constant(np.array(self._first_action, dtype=np.int64))
        self._nodes.append(helper.make_node("Add", [best, first], ["action"]))
        num_actions = graph.head[-1].bias.shape[0]
        made = helper.make_graph(
            self._nodes,
            "policy",
            [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", *observation_shape])],
            [
                helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", num_actions]),
                helper.make_tensor_value_info("action", TensorProto.INT64, ["batch"]),
            ],
            self._constants,
        )
        return helper.make_model(made, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=9)

    def _inputs(self) -> str:
        """What `Encoder` makes of observations."""
        sizes, starts = self._encoder.one_hot
        if not len(sizes):
            x = "observation"
            if not self._encoder.observation_shape:
                x = self._node("Reshape", x, self._constant(np.array([-1, 1], dtype=np.int64)))
            scale = self._encoder.scale
            return x if scale == 1 else self._node("Mul", x, self._constant(np.array(scale, dtype=np.float32)))
        rows = self._node("Reshape", "observation", self._constant(np.array([-1, len(sizes)], dtype=np.int64)))
        columns = []
        for i, (size, start) in enumerate(zip(sizes.tolist(), starts.tolist(), strict=True)):
            column = self._node("Gather", rows, self._constant(np.array([i], dtype=np.int64)), axis=1)
            code = self._node("Cast", column, to=TensorProto.INT64)
            known = self._constant(np.arange(start, start + size, dtype=np.int64))
            columns.append(self._node("Cast", self._node("Equal", code, known), to=TensorProto.FLOAT))
        return columns[0] if len(columns) == 1 else self._node("Concat", *columns, axis=1)

    def _layer(self, layer: GraphLayer, x: str, is_flat: bool) -> tuple[str, bool]:
        if layer.weight.ndim == 4:
            if self._graph.channels_last and layer is self._graph.body[0]:
                x = self._node("Transpose", x, perm=[0, 3, 1, 2])
            shape = {"strides": [layer.stride] * 2, "pads": list(layer.pads)}
            x = self._node("Conv", x, self._constant(layer.weight), self._constant(layer.bias), **shape)
        else:
            x = x if is_flat else self._node("Flatten", x, axis=1)
            is_flat = True
            x = self._node("Gemm", x, self._constant(layer.weight), self._constant(layer.bias))
            if layer.normalised:
                gain = self._constant(np.ones(layer.bias.shape, dtype=np.float32))
                x = self._node("LayerNormalization", x, gain, axis=-1, epsilon=EPSILON)
        return self._activated(layer, x), is_flat

    def _chain(self, layers: tuple[GraphLayer, ...], x: str) -> str:
        x = self._node("Flatten", x, axis=1)
        for layer in layers:
            x, _ = self._layer(layer, x, True)
        return x

    def _activated(self, layer: GraphLayer, x: str) -> str:
        return x if layer.activation == "linear" else self._node(_ACTIVATIONS[layer.activation], x)

    def _node(self, kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"x{len(self._nodes)}"
        self._nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def _constant(self, value: NDArray[Any]) -> str:
        name = f"c{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name
