"""Environments under fixed actions: short ones in lockstep, whole ones, and who solves them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

import ves_gym as vg
from tests.golden.compare import RELATIVE
from tests.golden.probe import Probe, pattern

ON_A_BEAM = ("PumaRestToRest", "PumaReach", "PumaReachGoal", "PumaTrack", "PumaDamp")
OTHERS = (
    "MacroMicro", "FreeFlyerReach", "DualArmReach", "BeamLQR", "PoseReach", "PayloadTransfer",
)  # fmt: skip
IN_SPACE = ("ServicerCapture", "BerthingContact")
IDS = (
    *(f"ves/{name}-v0" for name in (*ON_A_BEAM, *OTHERS, *IN_SPACE)),
    *(f"ves/{name}Emulated-v0" for name in (*ON_A_BEAM, *OTHERS)),
)
LANES = 8
SHORT = 20  # control periods of an episode in lockstep
STEPS = 27  # through its end, the reset, and into the next
ENERGIES = ("E_mean", "E_res", "E_peak", "E_int")
FLOAT32 = 3e-7  # observations are given in single precision


def in_lockstep(id: str, **settings: Any) -> Callable[[], dict[str, Any]]:
    """Return a measurement: eight short episodes, livelier from lane to lane, and a reset."""

    def measure() -> dict[str, Any]:
        period = 0.05 if "Servicer" in id else 0.0125  # s
        env = gym.make_vec(id, num_envs=LANES, duration=SHORT * period, **settings)
        observation, info = env.reset(seed=19)
        out: dict[str, Any] = {"drawn": sums(info), "observed": [lanes_of(observation)]}
        total, terms, rewards = np.zeros(LANES), {}, []
        width = env.single_action_space.shape[0]
        for step in range(STEPS):
            action = np.stack([pattern(step, width, (k + 1) / LANES) for k in range(LANES)])
            observation, reward, terminated, truncated, info = env.step(action)
            total = total + reward
            for name in (k for k in info if k.startswith("reward/")):
                terms[name] = terms.get(name, 0.0) + info[name]
            if (terminated | truncated).any() and "ended" not in out:
                out["ended"] = [step, terminated.tolist(), truncated.tolist()]
                out["success"] = info["success"].tolist()
                out["energies"] = {
                    k: v[::2] for k, v in info.items() if k.startswith("energy/")
                }
            if step % 4 == 2:
                rewards.append(total)
            if step in (10, SHORT - 1, STEPS - 1):
                out["observed"].append(lanes_of(observation))
        out["rewards"] = rewards
        out["terms"] = {k: v[::4] for k, v in terms.items()}
        out["drawn again"] = sums(info)
        env.close()
        return out

    return measure


def alone(id: str) -> Callable[[], dict[str, Any]]:
    """Return a measurement: a short episode of a single environment."""

    def measure() -> dict[str, Any]:
        period = 0.05 if "Servicer" in id else 0.0125  # s
        env = gym.make(id, duration=SHORT * period)
        observation, info = env.reset(seed=23)
        out: dict[str, Any] = {"rewards": []}
        for step in range(SHORT):
            action = pattern(step, env.action_space.shape[0], 0.5)
            observation, reward, terminated, truncated, info = env.step(action)
            out["rewards"].append(float(reward))
        out["ended"] = [bool(terminated), bool(truncated)]
        out["info"] = {k: v for k, v in info.items() if "/" in k and np.ndim(v) == 0}
        parts = observation.values() if isinstance(observation, dict) else [observation]
        out["observed"] = [float(f"{k:.8g}") for part in parts for k in part.tolist()]
        env.close()
        return out

    return measure


# What else one may ask an environment for: the id, and settings.
SETTINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "another vehicle": ("ves/PumaRestToRest-v0", {"vehicle": "free-floating"}),
    "another arm": ("ves/PumaReach-v0", {"arm": "ur5e"}),
    "control acceleration": ("ves/PumaRestToRest-v0", {"control": "acceleration"}),
    "control joint_velocity": ("ves/PumaReach-v0", {"control": "joint_velocity"}),
    "control tool_velocity": ("ves/PumaReach-v0", {"control": "tool_velocity"}),
    "control pd_target": ("ves/PumaReach-v0", {"control": "pd_target"}),
    "control torque": ("ves/PumaReach-v0", {"control": "torque"}),
    "control pd_gains": ("ves/PumaDamp-v0", {"control": "pd_gains"}),
    "laboratory hard": ("ves/PumaRestToRestEmulated-v0", {"laboratory": "hard"}),
    "laboratory held-out": ("ves/PumaReachEmulated-v0", {"laboratory": "held-out"}),
    "effects": (
        "ves/PumaReach-v0",
        {
            "effects": [{"kind": "joint/coulomb", "torque": [1.0, 2.0, 0.5]}],
            "randomize": {
                "base/stiffness": {"error": [-0.2, 0.2]},
                "joint/viscous": {"damping": {"log_uniform": [[0.5] * 3, [2.0] * 3]}},
                "payload/mass": {"mass": {"normal": [2.0, 0.2]}},
            },
        },
    ),
    "delays": (
        "ves/PumaReachEmulated-v0",
        {
            "vehicle": "bent-thesis",
            "randomize": {
                "command/delay": {"delay": [0.0, 0.002]},
                "platform/delay": {"delay": [0.0, 0.002]},
                "sensor/lag": {"error": [-0.1, 0.1]},
            },
        },
    ),
    "same step": ("ves/PumaRestToRestEmulated-v0", {"autoreset_mode": "SameStep"}),
}
ALONE = ("ves/PumaReachGoal-v0", "ves/PumaRestToRestEmulated-v0", "ves/ServicerCapture-v0")


def lanes_of(observation: Any) -> list[float]:
    """Return the observation of one lane, the parts of a goal's side by side."""
    if isinstance(observation, dict):
        observation = np.concatenate([observation[k] for k in sorted(observation)], axis=1)
    return [float(f"{k:.8g}") for k in observation[2].tolist()]


def sums(info: dict[str, Any]) -> dict[str, Any]:
    """Return the sums of what was drawn, lane by lane."""
    return {
        k: v.sum(axis=1)[::2]
        for k, v in info.items()
        if k.startswith("randomized/") and v.dtype == float
    }


class Rehearsed:
    """A controller that acts by `pattern`, lane by lane livelier, calmer and harder."""

    name = "rehearsed"
    privileged = False

    def __init__(self) -> None:
        self.steps = np.zeros(3, int)

    def reset(self, env: Any, ids: Any) -> None:
        """See `Controller`."""
        self.steps[ids] = 0

    def act(self, env: Any, observation: Any) -> np.ndarray:
        """See `Controller`."""
        width = env.single_action_space.shape[0]
        lively, calm, _ = (
            pattern(int(step), width, scale)
            for step, scale in zip(self.steps, (0.5, 0.125, 0.0), strict=True)
        )
        self.steps += 1
        return np.stack([lively, calm, np.ones(width)])  # the last until a joint is at its end


def whole(id: str) -> Callable[[], dict[str, Any]]:
    """Return a measurement: three whole episodes under fixed actions."""
    return lambda: rows(vg.evaluate(id, [Rehearsed()], episodes=3, n_envs=3, seed=7))


def rows(evaluated: Any) -> dict[str, Any]:
    """Return what an evaluation says of its episodes."""
    (evaluation,) = evaluated
    found = evaluation.rows
    out = {k: [row[k] for row in found] for k in ("length", "success", "failed")}
    out |= {k: [float(row[k]) for row in found] for k in ("return", *ENERGIES)}
    return out


# What is evaluated where, for how long [s] (None: the whole episode), and whether it is slow.
# Not hotspot: by which of its spots a search goes depends on rounding.
CONTROLLERS: dict[str, tuple[str, float | None, bool]] = {
    "zero": ("PumaDamp", 1.0, False),
    "random": ("PumaReach", 1.0, False),
    "hold": ("PumaDampEmulated", 1.0, False),
    "high": ("PumaDamp", 1.0, False),
    "pped": ("PumaDamp", 1.0, False),
    "straight": ("PumaRestToRest", None, False),
    "direct": ("PumaRestToRestEmulated", None, False),
    "refined": ("PumaRestToRest", None, False),
    "robust": ("PumaRestToRestEmulated", None, True),
    "adaptive": ("PumaRestToRestEmulated", None, True),
    "mppi": ("PumaRestToRest", None, False),
    "lqr": ("BeamLQR", None, False),
    "lqi": ("PumaDamp", 1.0, False),
    "tuned": ("PumaDamp", 1.0, False),
    "receding": ("PumaDamp", 0.5, False),
    "resolved": ("PumaReach", 1.0, False),
    "resolved-gentle": ("PumaReach", 1.0, False),
    "closing": ("PumaReach", 1.0, False),
    "closing-pose": ("PoseReach", None, True),
    "braced": ("FreeFlyerReach", None, True),
    "resolved-pose": ("PoseReach", 1.0, False),
    "compensating": ("DualArmReach", None, False),
    "servicer": ("ServicerCapture", None, True),
}


# Searches end elsewhere when rounding changes: what they come to is as near as this.
SEARCHED = {"tuned": 1e-3}


def by(controller: str, name: str, duration: float | None) -> Callable[[], dict[str, Any]]:
    """Return a measurement: two episodes of a built-in controller."""

    def measure() -> dict[str, Any]:
        changed = {} if duration is None else {"duration": duration}
        id = f"ves/{name}-v0"
        return rows(vg.evaluate(id, controller, episodes=2, seed=3, **changed))

    return measure


def probes() -> dict[str, Probe]:
    """Return all of them by name."""
    loose = {"observed": FLOAT32}
    return {
        **{f"{id} in lockstep": Probe(in_lockstep(id), loose=loose) for id in IDS},
        **{f"{id} whole": Probe(whole(id), slow="Servicer" in id) for id in IDS},
        **{f"{id} alone": Probe(alone(id), loose=loose) for id in ALONE},
        **{
            f"with {name}": Probe(
                in_lockstep(id, **settings), loose=loose, slow=name == "another arm"
            )
            for name, (id, settings) in SETTINGS.items()
        },
        **{
            f"controller {k} in {name}": Probe(
                by(k, name, duration), slow=slow, relative=SEARCHED.get(k, RELATIVE)
            )
            for k, (name, duration, slow) in CONTROLLERS.items()
        },
    }
