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
from ves_gym._util.params import ParameterError, write_bytes
from ves_gym.baselines.arm_features import ArmFeatures
from ves_gym.baselines.policy import Policy
from ves_gym.engine.kernel.symbolic import column, symbols

OPSET = 17
TOLERANCE = 1e-6  # of an action in [-1, 1]
_SHORTEST = 1e-300  # length of a direction: zero has none


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
        x = add("Concat", x, *_features(net.features, split, add, constant), axis=1)
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


# Of CasADi, as nodes; truth is what `Where` takes
_NODES = {
    "OP_ADD": "Add",
    "OP_SUB": "Sub",
    "OP_MUL": "Mul",
    "OP_DIV": "Div",
    "OP_NEG": "Neg",
    "OP_SIN": "Sin",
    "OP_COS": "Cos",
    "OP_SQRT": "Sqrt",
    "OP_FABS": "Abs",
    "OP_FMIN": "Min",
    "OP_FMAX": "Max",
    "OP_LT": "Less",
    "OP_NOT": "Not",
}


def _features(
    features: ArmFeatures,
    entries: list[str],
    add: Callable[..., str],
    constant: Callable[..., str],
) -> list[str]:
    """Return the columns of the features, traced and written instruction by instruction.

    Args:
        features: of an observation.
        entries: its columns (n, 1).
        add: adds a node, by its kind and inputs; the name of its output.
        constant: adds a number, by its name.
    """
    import casadi as ca

    x = symbols("x", (1, len(entries)))
    graph = ca.Function("features", [column(x)], [ca.cse(column(features(x)))])
    kinds = {getattr(ca, name): kind for name, kind in _NODES.items()}
    constants: dict[float, str] = {}

    def number(value: float) -> str:
        if value not in constants:
            constants[value] = constant(f"number{len(constants)}", value)
        return constants[value]

    columns: dict[int, str] = {}
    out = [""] * graph.size1_out(0)
    for k in range(graph.n_instructions()):
        op, into = graph.instruction_id(k), graph.instruction_output(k)
        operands = graph.instruction_input(k)
        if op == ca.OP_OUTPUT:
            out[into[1]] = columns[operands[0]]
            continue
        if op == ca.OP_CONST:
            columns[into[0]] = number(graph.instruction_constant(k))
            continue
        if op == ca.OP_INPUT:
            columns[into[0]] = entries[operands[1]]
            continue
        a, b = columns[operands[0]], columns[operands[-1]]
        if op in kinds:
            column_ = add(kinds[op], *(columns[i] for i in operands))
        elif op == ca.OP_SQ:
            column_ = add("Mul", a, a)
        elif op == ca.OP_TWICE:
            column_ = add("Add", a, a)
        elif op == ca.OP_INV:
            column_ = add("Div", number(1.0), a)
        elif op == ca.OP_IF_ELSE_ZERO:
            column_ = add("Where", a, b, number(0.0))
        elif op == ca.OP_ATAN2:
            column_ = _angle(a, b, add, number)
        else:
            raise ParameterError(f"operation {op} of the features has no ONNX node")
        columns[into[0]] = column_
    return out


def _angle(y: str, x: str, add: Callable[..., str], number: Callable[[float], str]) -> str:
    """Angle of a direction [rad].

    Engines have the arctangent in single precision alone. What it leaves of the angle is so
    small that its sine, which they have in double precision, makes up for it.

    Args:
        y, x: columns of its sides.
        add, number: see `_features`.
    """
    from onnx import TensorProto

    squares = add("Add", add("Mul", x, x), add("Mul", y, y))
    long = add("Max", add("Sqrt", squares), number(_SHORTEST))
    half = add("Div", y, add("Add", long, add("Abs", x)))  # its tangent, for x >= 0
    single = add("Atan", add("Cast", half, to=TensorProto.FLOAT))
    near = add("Mul", add("Cast", single, to=TensorProto.DOUBLE), number(2.0))
    zero = number(0.0)
    straight = add("Where", add("Less", y, zero), number(-math.pi), number(math.pi))
    rough = add("Where", add("Less", x, zero), add("Sub", straight, near), near)
    missing = add("Sub", add("Mul", y, add("Cos", rough)), add("Mul", x, add("Sin", rough)))
    return add("Add", rough, add("Div", missing, long))


def difference(policy: Policy, data: bytes, rows: int = 1000) -> float:
    """Return by how much the actions of a model made by `to_onnx` differ from the policy's.

    Args:
        policy: it was made from.
        data: of the model, which onnxruntime runs.
        rows: number of observations drawn, a part of them beyond the policy's limit.
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
