"""Policies as ONNX, for engines that are not ours: written, never read.

An ONNX file is a program. This package makes one from a policy's numbers, runs what it has
made itself to compare the actions, and loads none from elsewhere: `load_policy` reads the safe
format alone.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import installed, require
from ves_gym._util.params import Array, write_bytes
from ves_gym.baselines.policy import Policy

OPSET = 17
TOLERANCE = 1e-6  # of an action in [-1, 1]
_NONE = 1e-300  # length of no direction


def to_onnx(policy: Policy) -> bytes:
    """Return a policy as an ONNX model, from observation (n, o) to action (n, a) in float32.

    Within, numbers are in double precision, as in `Policy`. Parts of a dictionary observation
    are one after another in the order of the entry `inputs` of the model's metadata; `hold`
    there is the number of control periods that an action is to be held for, `frames` that of
    the observations of the last decisions that it takes, the oldest first.
    """
    require("a policy as ONNX", "onnx")
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    net = policy.network
    nodes: list[Any] = []
    numbers: list[Any] = []

    def constant(name: str, value: Any) -> str:
        numbers.append(numpy_helper.from_array(np.asarray(value, np.float64), name))
        return name

    def add(kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"x{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    x = add("Cast", "observation", to=TensorProto.DOUBLE)
    limit = net.observation_limit
    x = add("Clip", x, constant("low", -limit), constant("high", limit))
    if net.features is not None:
        split = [f"entry{i}" for i in range(net.entries)]
        nodes.append(helper.make_node("Split", [x], split, axis=1))
        graph_of = _Formulas(add, constant)
        columns = [_Column(name, graph_of) for name in split]
        more = net.features.formulas(columns, graph_of, graph_of.clip)
        x = add("Concat", x, *(k.name for k in more), axis=1)
    for i, (W, b) in enumerate(policy.weights):
        x = add("MatMul", x, constant(f"layer{i}.weight", W))
        x = add("Add", x, constant(f"layer{i}.bias", b))
        if i + 1 < len(policy.weights):
            x = add("Tanh" if net.activation == "tanh" else "Relu", x)
    if net.output == "tanh":
        x = add("Tanh", x)
    else:
        x = add("Clip", x, constant("least", -1.0), constant("most", 1.0))
    nodes.append(helper.make_node("Cast", [x], ["action"], to=TensorProto.FLOAT))
    graph = helper.make_graph(
        nodes,
        policy.name,
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", net.entries])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", net.sizes[-1]])],
        numbers,
    )
    model = helper.make_model(
        graph,
        producer_name="ves_gym",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=8,  # of the first release with this opset: any engine of today reads it
    )
    about = {"env": str(policy.about.get("env", "")), "hold": str(net.hold)}
    about |= {"frames": str(net.frames), "inputs": " ".join(net.inputs)}
    helper.set_model_props(model, about)
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString()
    return data


class _Formulas:
    """Makes nodes of the operations on columns: the namespace of `ArmFeatures.formulas`.

    Args:
        add: adds a node, by its kind and inputs; the name of its output.
        constant: adds a number, by its name.
    """

    def __init__(self, add: Callable[..., str], constant: Callable[[str, float], str]) -> None:
        self._add, self._constant = add, constant
        self._numbers: dict[float, str] = {}

    def __call__(self, kind: str, *inputs: _Column | float) -> _Column:
        """Return the column (n, 1) that a node makes of columns and numbers."""
        names = [k.name if isinstance(k, _Column) else self.number(k) for k in inputs]
        return _Column(self._add(kind, *names), self)

    def number(self, value: float) -> str:
        """Return the name of a constant, one for every value."""
        if value not in self._numbers:
            name = f"number{len(self._numbers)}"
            self._numbers[value] = self._constant(name, float(value))
        return self._numbers[value]

    def sin(self, x: _Column) -> _Column:
        """Sine."""
        return self("Sin", x)

    def cos(self, x: _Column) -> _Column:
        """Cosine."""
        return self("Cos", x)

    def sqrt(self, x: _Column) -> _Column:
        """Square root."""
        return self("Sqrt", x)

    def arctan2(self, y: _Column, x: _Column) -> _Column:
        """Angle of a direction [rad].

        Engines have the arctangent in single precision alone. What it leaves of the angle is so
        small that its sine, which they have in double precision, makes up for it.
        """
        long = self("Max", self.sqrt(x * x + y * y), _NONE)
        half = y * (1.0 / (long + self("Abs", x)))  # its tangent, for x >= 0
        single = self("Atan", self._cast(half, "FLOAT"))
        near = 2.0 * self._cast(single, "DOUBLE")
        behind = self.where(y < 0.0, -math.pi, math.pi) - near
        rough = self.where(x < 0.0, behind, near)
        return rough + (y * self.cos(rough) - x * self.sin(rough)) * (1.0 / long)

    def _cast(self, x: _Column, kind: str) -> _Column:
        from onnx import TensorProto

        return _Column(self._add("Cast", x.name, to=getattr(TensorProto, kind)), self)

    def where(self, condition: _Column, x: _Column | float, y: _Column | float) -> _Column:
        """Return x where the condition holds, else y."""
        return self("Where", condition, x, y)

    def clip(self, x: _Column, low: float, high: float) -> _Column:
        """Return x brought into low to high."""
        return self("Clip", x, low, high)


class _Column:
    """A column (n, 1) of the graph, with the operators of a number."""

    def __init__(self, name: str, formulas: _Formulas) -> None:
        self.name, self.formulas = name, formulas

    def __add__(self, other: _Column | float) -> _Column:
        return self.formulas("Add", self, other)

    def __mul__(self, other: _Column | float) -> _Column:
        return self.formulas("Mul", self, other)

    def __sub__(self, other: _Column | float) -> _Column:
        return self.formulas("Sub", self, other)

    def __neg__(self) -> _Column:
        return self.formulas("Neg", self)

    def __lt__(self, other: _Column | float) -> _Column:
        return self.formulas("Less", self, other)

    def __rsub__(self, other: float) -> _Column:
        return -self + other

    def __rtruediv__(self, other: float) -> _Column:
        return self.formulas("Div", other, self)

    __radd__, __rmul__ = __add__, __mul__


def difference(policy: Policy, data: bytes, rows: int = 1000) -> float:
    """Return by how much the actions of a model made by `to_onnx` differ from the policy's.

    Args:
        policy: it was made from.
        data: of the model; run by onnxruntime where that is installed, else by the reference
            evaluator of the package onnx.
        rows: number of observations drawn, a part of them beyond the policy's limit.
    """
    draw = np.random.default_rng(0)
    width = policy.network.entries
    x = draw.uniform(-1.2, 1.2, (rows, width)) * policy.network.observation_limit
    x[: rows // 2] *= 0.1
    observation = x.astype(np.float32)
    ours = _plain(policy, observation)
    theirs = _run(data, observation)
    return float(np.abs(ours - theirs).max())


def _plain(policy: Policy, observation: Any) -> Array:
    """Actions of rows, whether the policy takes them whole or in parts."""
    if policy.network.frames > 1 or not policy.network.inputs:
        return policy(observation)
    first, *others = policy.network.inputs
    parts = dict.fromkeys(others, observation[:, :0])
    return policy({first: observation, **parts})


def _run(data: bytes, observation: Any) -> Any:
    given = {"observation": observation}
    if installed("onnxruntime"):
        import onnxruntime

        engine: Any = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    else:
        import onnx
        from onnx.reference import ReferenceEvaluator

        engine = ReferenceEvaluator(onnx.load_from_string(data))
    (action,) = engine.run(None, given)
    return action


def write_onnx(policy: Policy, path: str | os.PathLike[str]) -> float:
    """Write a policy as ONNX, once its actions have been compared; the largest difference.

    Args:
        policy: to write.
        path: of the file; nothing is written where the actions differ by more than
            `TOLERANCE`.

    Raises:
        ArithmeticError: they do.
    """
    data = to_onnx(policy)
    gap = difference(policy, data)
    if not gap <= TOLERANCE:
        raise ArithmeticError(
            f"{path}: actions of the model differ from the policy's by {gap:.3g}, expected at"
            f" most {TOLERANCE:g}"
        )
    write_bytes(Path(path), data)
    return gap
