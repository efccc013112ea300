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

from ves_gym._util.optional import require
from ves_gym._util.params import write_bytes
from ves_gym.baselines.arm_features import ArmFeatures
from ves_gym.baselines.policy import Policy
from ves_gym.engine.kernel.symbolic import column, symbols

OPSET = 17
TOLERANCE = 1e-6  # of an action in [-1, 1]
_SHORTEST = 1e-300  # length of a direction: zero has none


class _Graph:
    """Nodes and numbers of a model under way; every method gives the name of an output."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.numbers: dict[str, Any] = {}  # by name, also that of a number itself

    def constant(self, name: str, value: Any) -> str:
        """Add an array under a name."""
        from onnx import numpy_helper

        self.numbers[name] = numpy_helper.from_array(np.asarray(value, np.float64), name)
        return name

    def number(self, value: float) -> str:
        """Add a number, unless it is there."""
        name = repr(float(value))
        return name if name in self.numbers else self.constant(name, value)

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add a node."""
        from onnx import helper

        name = f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def cosine(self, angle: str) -> str:
        """Add a cosine as a sine: of old engines only that has double precision."""
        return self.add("Sin", self.add("Add", angle, self.number(math.pi / 2)))

    def angle(self, y: str, x: str) -> str:
        """Add the angle of a direction [rad], y and x columns of its sides.

        Engines have the arctangent in single precision alone. What it leaves of the angle is
        so small that its sine, which they have in double precision, makes up for it.
        """
        from onnx import TensorProto

        add, zero = self.add, self.number(0.0)
        squares = add("Add", add("Mul", x, x), add("Mul", y, y))
        long = add("Max", add("Sqrt", squares), self.number(_SHORTEST))
        half = add("Div", y, add("Add", long, add("Abs", x)))  # its tangent, for x >= 0
        single = add("Atan", add("Cast", half, to=TensorProto.FLOAT))
        near = add("Mul", add("Cast", single, to=TensorProto.DOUBLE), self.number(2.0))
        turns = self.number(-math.pi), self.number(math.pi)
        straight = add("Where", add("Less", y, zero), *turns)
        rough = add("Where", add("Less", x, zero), add("Sub", straight, near), near)
        missing = add(
            "Sub", add("Mul", y, self.cosine(rough)), add("Mul", x, add("Sin", rough))
        )
        return add("Add", rough, add("Div", missing, long))


def to_onnx(policy: Policy) -> bytes:
    """Return a policy as an ONNX model, from observation (n, o) to action (n, a) in float32.

    Within, numbers are in double precision, as in `Policy`. Parts of a dictionary observation
    are one after another in the order of the entry `inputs` of the model's metadata; `hold`
    there is the number of control periods that an action is to be held for, `frames` that of
    the observations of the last decisions that it takes, the oldest first.
    """
    require("a policy as ONNX", "onnx")
    import onnx
    from onnx import TensorProto, helper

    net, graph = policy.network, _Graph()
    add, constant = graph.add, graph.constant
    limit = net.observation_limit
    x = add("Cast", "observation", to=TensorProto.DOUBLE)
    x = add("Clip", x, constant("low", -limit), constant("high", limit))
    if net.features is not None:
        split = [f"entry{i}" for i in range(net.entries)]
        graph.nodes.append(helper.make_node("Split", [x], split, axis=1))
        x = add("Concat", x, *_features(net.features, split, graph), axis=1)
    for i, (W, b) in enumerate(policy.weights):
        x = add("MatMul", x, constant(f"layer{i}.weight", W))
        x = add("Add", x, constant(f"layer{i}.bias", b))
        if i + 1 < len(policy.weights):
            x = add("Tanh" if net.activation == "tanh" else "Relu", x)
    if net.output == "tanh":
        x = add("Tanh", x)
    else:
        x = add("Clip", x, constant("least", -1.0), constant("most", 1.0))
    graph.nodes.append(helper.make_node("Cast", [x], ["action"], to=TensorProto.FLOAT))
    taken, outputs = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])]
        for name, size in (("observation", net.entries), ("action", net.sizes[-1]))
    )
    numbers = list(graph.numbers.values())
    model = helper.make_model(
        helper.make_graph(graph.nodes, policy.name, taken, outputs, numbers),
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


# Of CasADi, as nodes of columns a, b; truth is what `Where` takes
_NODES: dict[str, Callable[[_Graph, str, str], str]] = {
    **{
        f"OP_{name}": lambda graph, a, b, kind=kind: graph.add(kind, a, b)  # type: ignore[misc]
        for name, kind in {
            "ADD": "Add", "SUB": "Sub", "MUL": "Mul", "DIV": "Div", "FMIN": "Min",
            "FMAX": "Max", "LT": "Less",
        }.items()
    },
    **{
        f"OP_{name}": lambda graph, a, b, kind=kind: graph.add(kind, a)  # type: ignore[misc]
        for name, kind in {
            "NEG": "Neg", "SIN": "Sin", "SQRT": "Sqrt", "FABS": "Abs", "NOT": "Not",
        }.items()
    },
    "OP_COS": lambda graph, a, b: graph.cosine(a),
    "OP_SQ": lambda graph, a, b: graph.add("Mul", a, a),
    "OP_TWICE": lambda graph, a, b: graph.add("Add", a, a),
    "OP_INV": lambda graph, a, b: graph.add("Div", graph.number(1.0), a),
    "OP_IF_ELSE_ZERO": lambda graph, a, b: graph.add("Where", a, b, graph.number(0.0)),
    "OP_ATAN2": _Graph.angle,
}  # fmt: skip


def _features(features: ArmFeatures, entries: list[str], graph: _Graph) -> list[str]:
    """Columns of the features of `entries`, traced and written instruction by instruction."""
    import casadi as ca

    x = symbols("x", (1, len(entries)))
    traced = ca.Function("features", [column(x)], [ca.cse(column(features(x)))])
    nodes = {getattr(ca, name): node for name, node in _NODES.items()}
    columns: dict[int, str] = {}
    out = [""] * traced.size1_out(0)
    for k in range(traced.n_instructions()):
        op, into = traced.instruction_id(k), traced.instruction_output(k)
        operands = traced.instruction_input(k)
        if op == ca.OP_OUTPUT:
            out[into[1]] = columns[operands[0]]
        elif op == ca.OP_CONST:
            columns[into[0]] = graph.number(traced.instruction_constant(k))
        elif op == ca.OP_INPUT:
            columns[into[0]] = entries[operands[1]]
        else:
            assert op in nodes, f"operation {op} of the features has no ONNX node"
            a, b = columns[operands[0]], columns[operands[-1]]
            columns[into[0]] = nodes[op](graph, a, b)
    return out


def difference(policy: Policy, data: bytes, rows: int = 1000) -> float:
    """Return by how much actions of a model that `to_onnx` made differ from the policy's.

    onnxruntime runs it, on `rows` drawn observations, a part of them beyond the policy's limit.
    """
    require("to run an ONNX model", "onnxruntime")
    import onnxruntime

    net, draw = policy.network, np.random.default_rng(0)
    x = draw.uniform(-1.2, 1.2, (rows, net.entries)) * net.observation_limit
    x[: rows // 2] *= 0.1
    observation: Any = x.astype(np.float32)
    engine: Any = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    (theirs,) = engine.run(None, {"observation": observation})
    if net.inputs and net.frames == 1:  # all of it as the first part of the dictionary
        parts = dict.fromkeys(net.inputs, observation[:, :0])
        observation = {**parts, net.inputs[0]: observation}
    return float(np.abs(policy(observation) - theirs).max())


def write_onnx(policy: Policy, path: str | os.PathLike[str]) -> float:
    """Write a policy as ONNX, once its actions have been compared; the largest difference.

    Raises:
        ArithmeticError: they differ by more than `TOLERANCE`, and nothing is written.
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
