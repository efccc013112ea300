"""PPO on the native vector environment against PPO on one MuJoCo simulation per environment.

Both sides train the same network with the same hyper-parameters on the same task: 64
environments, rollouts and batches of 4096 decisions. What differs is who steps them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym

from benchmarks.timing import Pair, side_by_side

ID = "ves_gym:ves/PumaRestToRest-v0"
EMULATED = "ves_gym:ves/PumaRestToRestEmulated-v1"  # randomised, in the laboratory `lab`
ENVS, BATCH = 64, 4096
ROLLOUTS = 2  # in one measurement
RUNS = 5


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

    model = PPO(
        "MlpPolicy", venv, n_steps=BATCH // ENVS, batch_size=BATCH, device="cpu", seed=0
    )

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


def report() -> dict[str, object]:
    """The figures, printed."""
    if not has_sb3():
        return {}
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
    return {**vars(pair), **shares}


if __name__ == "__main__":
    report()
