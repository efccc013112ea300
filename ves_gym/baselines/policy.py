"""Policies in a safe format, run by NumPy alone.

A policy is two files: `NAME.json` says what it is (a closed list of architectures) and
`NAME.safetensors` holds the weights; the first names the second's SHA-256. Nothing in them
is ever executed. A Stable-Baselines3 zip is a pickle: whoever vouches for its origin loads it
with that library, and `sb3.from_sb3` makes a policy of it.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium.envs.registration import EnvSpec

from ves_gym._util.optional import require
from ves_gym._util.params import (
    Array,
    Index,
    Mask,
    ParameterError,
    from_plain,
    read_table,
    require_choice,
    require_positive,
    to_plain,
    write_bytes,
    write_text,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.version import __version__
from ves_gym.baselines.arm_features import ArmFeatures
from ves_gym.envs.vector import VesVectorEnv

SCHEMA = "ves-policy/1"
RELEASED = Path(__file__).parent / "policies"  # one folder per environment, without its version
ACTIVATIONS = ("tanh", "relu")
OUTPUTS = ("clip", "tanh")
_NEEDED = ("goal", "control")  # settings that give observations and actions their meaning
_LARGEST = 4096  # units of a layer: larger is no policy of ours


@dataclass(frozen=True, kw_only=True)
class Network:
    """A multi-layer perceptron from observation, or it and `features`, to an action."""

    sizes: tuple[int, ...]  # observation, hidden layers, action
    activation: str = "tanh"
    output: str = "clip"  # how the last layer is brought into [-1, 1]
    observation_limit: float = 5.0  # observations are clipped to +- this
    inputs: tuple[str, ...] = ()  # parts of a dictionary observation, in order; none: an array
    hold: int = 1  # control periods that an action is held for
    frames: int = 1  # observations of the last decisions that it takes, the oldest first
    features: ArmFeatures | None = None  # further inputs, after the observation's entries

    def __post_init__(self) -> None:
        require_choice(self, "activation", ACTIVATIONS)
        require_choice(self, "output", OUTPUTS)
        if len(self.sizes) < 2 or not all(0 < k <= _LARGEST for k in self.sizes):
            raise ParameterError(
                f"Network.sizes must be two or more of 1 to {_LARGEST}, got {self.sizes}"
            )
        require_positive(self, "observation_limit", "hold", "frames")
        if self.features is not None and (
            self.frames > 1 or self.observations != len(self.features.scales)
        ):
            raise ParameterError(
                f"Network.features are of one observation of {len(self.features.scales)}"
                f" entries, got {self.frames} of {self.observations}"
            )
        if self.sizes[0] % self.frames:
            raise ParameterError(
                f"Network.sizes must begin with a multiple of its {self.frames} frames, got"
                f" {self.sizes[0]}"
            )

    @property
    def observations(self) -> int:
        """Numbers of one observation."""
        return self.entries // self.frames

    @property
    def entries(self) -> int:
        """Numbers that a call takes: the observations of `frames` decisions."""
        return self.sizes[0] - (self.features.size if self.features else 0)


@dataclass
class Policy:
    """A network and its weights; a controller (see `controllers.Controller`).

    An action depends on its own observation alone, to the last bit: every row is multiplied
    on its own, however many there are.
    """

    network: Network
    weights: tuple[tuple[Array, Array], ...]  # (inputs, outputs), (outputs,) per layer
    about: Mapping[str, Any] = field(default_factory=dict)  # where it comes from, plain data
    name: str = "policy"
    privileged: ClassVar[bool] = False  # it sees what the observation holds
    _action: Array | None = field(default=None, init=False, repr=False, compare=False)
    _rows: Array | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        sizes = self.network.sizes
        shapes = list(itertools.pairwise(sizes))
        got = [W.shape for W, _ in self.weights]
        if got != shapes or [b.shape for _, b in self.weights] != [(k,) for k in sizes[1:]]:
            raise ParameterError(f"policy weights must have shapes {shapes}, got {got}")
        if not all(np.isfinite(W).all() and np.isfinite(b).all() for W, b in self.weights):
            raise ParameterError("policy weights must be finite")

    def settings(self, spec: EnvSpec) -> dict[str, Any]:
        """Settings that it was trained with and needs: see `controllers.Controller`."""
        trained = self.about.get("settings", {})
        return {key: trained[key] for key in _NEEDED if key in trained}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """Nothing to prepare; an environment of other spaces is refused."""
        width = env.batch.observations, env.batch.width
        if width != (self.network.observations, self.network.sizes[-1]):
            raise ParameterError(
                f"policy {self.name} takes {self.network.observations} observations to"
                f" {self.network.sizes[-1]} actions, the environment has {width[0]} and"
                f" {width[1]}"
            )

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """Actions (n, a) of observations (n, o); of the environment only its clock is read."""
        steps = env.batch.episodes.steps
        due = steps % self.network.hold == 0
        if self._action is None or len(self._action) != len(due):
            self._action, due = np.zeros((len(due), 1)), np.ones_like(due)
        if due.any():
            if self.network.frames > 1:
                observation = self._remember(self._side_by_side(observation), due, steps == 0)
            self._action = np.where(due[:, None], self(observation), self._action)
        return self._action.copy()

    def _remember(self, observation: Array, due: Mask, begun: Mask) -> Array:
        """(n, frames * o) observations of the last decisions, this one included."""
        fresh = np.tile(observation, self.network.frames)
        if self._rows is None or self._rows.shape != fresh.shape:
            self._rows = fresh
        moved = np.concatenate([self._rows[:, observation.shape[1] :], observation], axis=1)
        rows = np.where(due[:, None], moved, self._rows)
        self._rows = np.where(begun[:, None], fresh, rows)
        return self._rows

    def _side_by_side(self, observation: Any) -> Any:
        """The parts of a dictionary one after another, where they are what it takes."""
        inputs = self.network.inputs
        if not inputs:
            return observation
        if not isinstance(observation, Mapping):
            raise ParameterError(
                f"policy {self.name} needs a dictionary of {', '.join(inputs)}"
            )
        return np.concatenate([observation[k] for k in inputs], axis=-1)

    def __call__(self, observation: Any) -> Array:
        """Actions (n, a), in [-1, 1], of observations (n, o); of `frames` in a row, each."""
        net = self.network
        if net.frames == 1:
            observation = self._side_by_side(observation)
        x = np.asarray(observation, dtype=np.float64)
        if x.ndim != 2 or x.shape[1] != net.entries:
            raise ParameterError(
                f"policy {self.name} needs observations (n, {net.entries}), got {x.shape}"
            )
        x = np.clip(x, -net.observation_limit, net.observation_limit)
        if net.features is not None:
            x = np.concatenate([x, net.features(x)], axis=1)
        x = x[:, None, :]
        for W, b in self.weights[:-1]:
            x = x @ W + b
            x = np.tanh(x) if net.activation == "tanh" else np.maximum(x, 0.0)
        W, b = self.weights[-1]
        x = (x @ W + b)[:, 0]
        return np.tanh(x) if net.output == "tanh" else np.clip(x, -1.0, 1.0)


# --------------------------------------------------------------------------- files


def save_policy(policy: Policy, path: str | os.PathLike[str]) -> Path:
    """Write `path` (.json) and the weights beside it; the path of the JSON."""
    path = _json(path)
    save = _safetensors().save
    arrays = {}
    for i, (W, b) in enumerate(policy.weights):
        arrays[f"layer{i}.weight"] = np.ascontiguousarray(W, dtype=np.float32)
        arrays[f"layer{i}.bias"] = np.ascontiguousarray(b, dtype=np.float32)
    data = save(arrays)
    plain = {
        "schema": SCHEMA,
        "network": to_plain(policy.network),
        "weights": hashlib.sha256(data).hexdigest(),
        "about": to_plain(dict(policy.about)),
    }
    write_bytes(path.with_suffix(".safetensors"), data)
    write_text(path, json.dumps(plain, indent=1, allow_nan=False) + "\n")
    return path


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Read a policy; anything but the safe format is refused.

    Args:
        path: a .json file, or "PumaDamp/ppo": a released policy (`ves-gym list policies`).

    Raises:
        ParameterError: another kind of file, unknown keys, weights that do not fit.
    """
    if not Path(path).suffix and (RELEASED / f"{path}.json").is_file():
        path = RELEASED / f"{path}.json"
    path = _json(path)
    plain = read_table(path)
    keys = ("schema", "network", "weights", "about")
    if plain.get("schema") != SCHEMA or set(plain) != set(keys):
        raise ParameterError(
            f"{path}: expected a policy {SCHEMA} with {', '.join(keys)}, got"
            f" {plain.get('schema')!r} with {', '.join(plain)}"
        )
    network: Network = from_plain(Network, plain["network"], f"{path}: network")
    file = path.with_suffix(".safetensors")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise ParameterError(f"{file}: weights cannot be read: {error.strerror}") from None
    if hashlib.sha256(data).hexdigest() != plain["weights"]:
        raise ParameterError(f"{file}: these are not the weights that {path.name} names")
    arrays = load_arrays(data, f"{file}: weights cannot be read")
    layers = range(len(network.sizes) - 1)
    names = [f"layer{i}.{k}" for i in layers for k in ("weight", "bias")]
    if set(arrays) != set(names):
        raise ParameterError(f"{file}: expected {', '.join(names)}, got {', '.join(arrays)}")
    with np.errstate(invalid="ignore"):  # what is not finite is refused
        weights = tuple(
            (arrays[f"layer{i}.weight"].astype(float), arrays[f"layer{i}.bias"].astype(float))
            for i in layers
        )
    return Policy(network, weights, plain["about"], name=path.stem)


def task_name(id: str) -> str:
    """Return an environment's name, such as PumaReach of ves/PumaReach-v0."""
    return id.rpartition("/")[2].rpartition("-v")[0]


def released(id: str) -> dict[str, Path]:
    """Policies that come with the package for an environment, by name.

    An ...Emulated id has those of its twin in space.
    """
    files = (RELEASED / task_name(id).removesuffix("Emulated")).glob("*.json")
    return {path.stem: path for path in sorted(files)}


def _json(path: str | os.PathLike[str]) -> Path:
    path = Path(path)
    if path.suffix != ".json":
        names = [f"{k.parent.name}/{k.stem}" for k in sorted(RELEASED.glob("*/*.json"))]
        raise ParameterError(
            "a policy is a .json file with a .safetensors file beside it, or one of"
            f" {', '.join(names)}, got {str(path)!r}{did_you_mean(path.as_posix(), names)};"
            " pickles are not read (but see baselines.from_sb3)"
        )
    return path


def load_arrays(data: bytes, complaint: str) -> dict[str, Array]:
    """Arrays by name in the bytes of a safetensors file.

    Raises:
        ParameterError: `complaint` and why; the library quotes whole headers, which are cut.
    """
    from safetensors import SafetensorError

    try:
        return _safetensors().load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ParameterError(f"{complaint}: {str(error)[:200]}") from None


def _safetensors() -> Any:
    require("a policy's file", "safetensors")
    import safetensors.numpy

    return safetensors.numpy


def versions(*packages: str) -> dict[str, str]:
    """Versions of ves_gym, Python, NumPy and the packages named."""
    installed = {name: version(name) for name in ("numpy", "gymnasium", *packages)}
    return {"ves_gym": __version__, "python": platform.python_version(), **installed}
