"""PPO: who steps the environments, and who learns.

`ppo`: Stable-Baselines3's PPO on the native vector environment against the same on one MuJoCo
simulation per environment, with 64 environments, rollouts and batches of 4096 decisions.

`learners`: the native learner against Stable-Baselines3's PPO, both on the native vector
environment, with the same network and hyper-parameters; `returns`: what both have learned after
the same number of decisions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.timing import Pair, side_by_side

ID = "ves_gym:ves/PumaRestToRest-v0"
EMULATED = "ves_gym:ves/PumaRestToRestEmulated-v1"  # randomised, in the laboratory `lab`
ENVS, BATCH = 64, 4096
ROLLOUTS = 2  # in one measurement
RUNS = 5
LEARNED = "ves/PumaDamp-v0"  # what the learners are compared on
DEFAULTS: dict[str, Any] = {"n_steps": 64}  # Stable-Baselines3's but for this: 4096 decisions
LARGE: dict[str, Any] = {  # those of the released configurations
    "n_steps": 64, "batch_size": 1024, "n_epochs": 8, "learning_rate": 1e-3,
    "gamma": 0.99, "gae_lambda": 0.95,
}  # fmt: skip
DECISIONS, SEEDS = 300_000, (0, 1, 2)  # of `returns`


def has_sb3() -> bool:
    """Whether Stable-Baselines3 can be imported."""
    try:
        import stable_baselines3  # noqa: F401
    except ImportError:
        return False
    return True


def _clocked(venv: Any) -> Any:
    """The environment with `stepping`, seconds spent in its steps."""
    from stable_baselines3.common.vec_env import VecEnvWrapper

    class Clocked(VecEnvWrapper):
        stepping = 0.0

        def reset(self) -> Any:
            return self.venv.reset()

        def step_wait(self) -> Any:
            begin = time.perf_counter()
            out = self.venv.step_wait()
            self.stepping += time.perf_counter() - begin
            return out

    return Clocked(venv)


def _learner(venv: Any) -> Callable[[], None]:
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger

    model = PPO(
        "MlpPolicy", venv, n_steps=BATCH // ENVS, batch_size=BATCH, device="cpu", seed=0
    )
    model.set_logger(
        Logger(folder=None, output_formats=[])
    )  # else a folder in the temporary one

    def work() -> None:
        model.learn(ROLLOUTS * BATCH, reset_num_timesteps=False)

    return work


def ppo() -> tuple[Pair, float, float]:
    """Seconds per measurement, and the share of each side's that is in env.step."""
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv

    from ves_gym.baselines.sb3 import Sb3VecEnv

    native = _clocked(Sb3VecEnv(gym.make_vec(ID, num_envs=ENVS, threads=1).unwrapped))
    single = _clocked(DummyVecEnv([lambda: gym.make(ID, backend="mujoco")] * ENVS))
    spent = {"native": 0.0, "single": 0.0}

    def timed(name: str, work: Callable[[], None]) -> Callable[[], None]:
        def go() -> None:
            begin = time.perf_counter()
            work()
            spent[name] += time.perf_counter() - begin

        return go

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        pair = side_by_side(
            timed("native", _learner(native)), timed("single", _learner(single)), RUNS
        )
    finally:
        torch.set_num_threads(threads)
        native.close()
        single.close()
    return pair, native.stepping / spent["native"], single.stepping / spent["single"]


def share(id: str = EMULATED) -> float:
    """Part of PPO's time that the native environment's steps and resets take."""
    import torch

    from ves_gym.baselines.sb3 import Sb3VecEnv

    native = _clocked(Sb3VecEnv(gym.make_vec(id, num_envs=ENVS, threads=1).unwrapped))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        learn = _learner(native)
        learn()
        native.stepping, begin = 0.0, time.perf_counter()
        for _ in range(RUNS):
            learn()
        return float(native.stepping / (time.perf_counter() - begin))
    finally:
        torch.set_num_threads(threads)
        native.close()


def _config(learner: str, hyperparameters: dict[str, Any], **changes: Any) -> Any:
    from ves_gym.baselines.config import TrainConfig

    return TrainConfig(
        env=LEARNED, algorithm="PPO", learner=learner, n_envs=ENVS, hold=4, reward_scale=20.0,
        hyperparameters=hyperparameters, **{"total_timesteps": 10**9, **changes},
    )  # fmt: skip


def learners(hyperparameters: dict[str, Any], rollouts: int = ROLLOUTS) -> Pair:
    """Seconds per measurement of the native learner and of Stable-Baselines3's."""
    from gymnasium.vector import AutoresetMode

    from ves_gym.baselines.evaluate import make_vector
    from ves_gym.baselines.train import make_learner, one_thread

    def work(learner: str) -> Callable[[], None]:
        config = _config(learner, hyperparameters)
        env = make_vector(LEARNED, ENVS, AutoresetMode.SAME_STEP, threads=1)
        trained = make_learner(config, 0, env)
        count = rollouts * ENVS * hyperparameters["n_steps"]

        def go() -> None:
            trained.learn(trained.steps + count, lambda: None)

        return go

    with one_thread("native"), one_thread("sb3"):
        return side_by_side(work("native"), work("sb3"), RUNS)


def returns() -> tuple[list[float], list[float]]:
    """Mean return of the last policy of every seed: native learner, Stable-Baselines3."""
    import tempfile
    from pathlib import Path

    from ves_gym.baselines.train import train

    out: dict[str, list[float]] = {"native": [], "sb3": []}
    for learner, found in out.items():
        config = _config(learner, LARGE, total_timesteps=DECISIONS)
        for seed in SEEDS:
            with tempfile.TemporaryDirectory() as folder:
                found.append(train(config, seed, Path(folder))[-1]["return"])
    return out["native"], out["sb3"]


def _tell_learners() -> dict[str, object]:
    out: dict[str, object] = {}
    for name, chosen in (("its defaults", DEFAULTS), ("large batches", LARGE)):
        pair = learners(chosen)
        steps = ROLLOUTS * ENVS * chosen["n_steps"]
        print(
            f"native learner, {name}: {pair.processor:.1f} x Stable-Baselines3 in processor"
            f" time, {pair.ratio:.1f} x on the clock ({pair.low:.1f}-{pair.high:.1f}),"
            f" {steps / pair.ours:,.0f} against {steps / pair.reference:,.0f} decisions/s"
        )
        out[name] = vars(pair)
    out["returns"], out["returns_reference"] = returns()
    print(
        f"mean return after {DECISIONS:,} decisions of {LEARNED}, a seed each:"
        f" native {np.round(out['returns'], 3)}, Stable-Baselines3"
        f" {np.round(out['returns_reference'], 3)}"
    )
    return out


def report() -> dict[str, object]:
    """The figures, printed."""
    if not has_sb3():
        return {}
    learned = _tell_learners()
    pair, ours, theirs = ppo()
    steps = ROLLOUTS * BATCH
    print(
        f"PPO n = {ENVS}, batch {BATCH}  {pair.ratio:5.1f} x one MuJoCo per environment"
        f" ({pair.low:.1f}-{pair.high:.1f}), {steps / pair.ours:,.0f} against"
        f" {steps / pair.reference:,.0f} steps/s; in env.step {ours:.0%} against {theirs:.0%}"
    )
    emulated = share()
    print(f"PPO on {EMULATED.split(':')[1]}: {emulated:.0%} of the time in env.step and reset")
    shares = {"share": ours, "share_reference": theirs, "share_emulated": emulated}
    return {**vars(pair), **shares, "learners": learned}


if __name__ == "__main__":
    report()
