"""Every registered environment, random walks through it, and bitwise comparison."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import gymnasium as gym
import numpy as np
import pytest

import ves_gym  # noqa: F401  files the ids

IDS = sorted(id for id in gym.registry if id.startswith("ves/"))
# in space and in the laboratory, by goals, truncated, with a payload, with wheels and jets
KINDS = (
    "ves/PumaRestToRest-v0", "ves/PumaTrackEmulated-v0", "ves/PumaReachGoal-v0",
    "ves/PumaDamp-v0", "ves/PayloadTransferEmulated-v0", "ves/ServicerCapture-v0",
)  # fmt: skip
every_id = pytest.mark.parametrize("name", IDS)
each_kind = pytest.mark.parametrize(
    "name", [k if k in KINDS else pytest.param(k, marks=pytest.mark.slow) for k in IDS]
)
SHORT = {"duration": 0.25}  # 20 periods: to the end of an episode in little time


def same(a, b) -> bool:
    """Whether two nested structures are equal bit for bit, types and shapes included."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray) and a.dtype == object:
        return a.shape == b.shape and same(a.tolist(), b.tolist())
    if isinstance(a, np.ndarray):
        return (a.dtype, a.shape) == (b.dtype, b.shape) and a.tobytes() == b.tobytes()
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if dataclasses.is_dataclass(a):
        names = [f.name for f in dataclasses.fields(a)]
        return all(same(getattr(a, k), getattr(b, k)) for k in names)
    if isinstance(a, float):
        return np.float64(a).tobytes() == np.float64(b).tobytes()
    return a == b


def part(info, group: str) -> dict:
    """The entries `group/name` of an info by their names."""
    start = f"{group}/"
    return {k.removeprefix(start): v for k, v in info.items() if k.startswith(start)}


def flat(observation) -> np.ndarray:
    """Observations (..., size), those of goal variants with their parts side by side."""
    if isinstance(observation, dict):
        return np.concatenate([observation[k] for k in sorted(observation)], axis=-1)
    return observation


def actions(env, count: int, seed: int) -> np.ndarray:
    """(count, *action shape) random actions, smooth enough to get somewhere."""
    shape = env.action_space.shape
    noise = np.random.default_rng(seed).uniform(-1, 1, (count, *shape))
    for k in range(1, count):
        noise[k] = 0.9 * noise[k - 1] + 0.1 * noise[k]
    return np.clip(2 * noise, -1, 1).astype(np.float32)


def walk(env, count: int, seed: int) -> list:
    """Outcomes of `count` random steps; a single environment begins anew when it ends."""
    out = []
    for action in actions(env, count, seed):
        out.append(env.step(action))
        if np.ndim(out[-1][2]) == 0 and (out[-1][2] or out[-1][3]):
            out.append(env.reset())
    return out


def episode(env, seed: int = 0, limit: int = 10_000) -> list:
    """Outcomes of random steps until the episode ends."""
    out = []
    for action in actions(env, limit, seed):
        out.append(env.step(action))
        if out[-1][2] or out[-1][3]:
            return out
    raise AssertionError(f"no end within {limit} steps")
