"""PPO: who steps the environments, and who learns.

`ppo`: Stable-Baselines3's PPO on the native vector environment against the same on one MuJoCo
simulation per environment, with 64 environments, rollouts and batches of 4096 decisions.

`learners`: the native learner against Stable-Baselines3's PPO, both on the native vector
environment, with the same network and hyper-parameters; `returns`: what both have learned after
the same number of decisions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.timing import Pair, side_by_side

ID = "ves_gym:ves/PumaRestToRest-v0"
EMULATED = "ves_gym:ves/PumaRestToRestEmulated-v0"  # randomised, in the laboratory `lab`
ENVS, BATCH = 64, 4096
ROLLOUTS = 2  # in one measurement
RUNS = 5
LEARNED = "ves/PumaDamp-v0"  # what the learners are compared on
HOLD, SCALE = 4, 20.0  # of its actions and rewards
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


@contextmanager
def _one_thread() -> Iterator[None]:
    """PyTorch and linear algebra on one thread: layers this small are slower on more."""
    import torch

    from ves_gym._util.threads import on_one_thread

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with on_one_thread():
            yield
    finally:
        torch.set_num_threads(threads)


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


def _sb3_ppo(venv: Any, seed: int = 0, **hyperparameters: Any) -> Any:
    """A new PPO of Stable-Baselines3."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger

    model = PPO("MlpPolicy", venv, device="cpu", seed=seed, **hyperparameters)
    # the default one makes a folder among the temporary files
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def _learner(venv: Any, batch: int) -> Callable[[], None]:
    model = _sb3_ppo(venv, n_steps=batch // venv.num_envs, batch_size=batch)
    return lambda: model.learn(ROLLOUTS * batch, reset_num_timesteps=False)


def ppo(envs: int = ENVS, batch: int = BATCH, runs: int = RUNS) -> tuple[Pair, float, float]:
    """Seconds per measurement, and the share of each side's that is in env.step."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from ves_gym.baselines.sb3 import Sb3VecEnv

    native = _clocked(Sb3VecEnv(gym.make_vec(ID, num_envs=envs, threads=1).unwrapped))
    single = _clocked(DummyVecEnv([lambda: gym.make(ID, backend="mujoco")] * envs))
    spent = {"native": 0.0, "single": 0.0}

    def timed(name: str, work: Callable[[], None]) -> Callable[[], None]:
        def go() -> None:
            begin = time.perf_counter()
            work()
            spent[name] += time.perf_counter() - begin

        return go

    with _one_thread():
        pair = side_by_side(
            timed("native", _learner(native, batch)),
            timed("single", _learner(single, batch)),
            runs,
        )
    native.close()
    single.close()
    return pair, native.stepping / spent["native"], single.stepping / spent["single"]


def share(envs: int = ENVS, batch: int = BATCH, runs: int = RUNS) -> float:
    """Part of PPO's time that the native environment's steps and resets take."""
    from ves_gym.baselines.sb3 import Sb3VecEnv

    native = _clocked(Sb3VecEnv(gym.make_vec(EMULATED, num_envs=envs, threads=1).unwrapped))
    with _one_thread():
        learn = _learner(native, batch)
        learn()
        native.stepping, begin = 0.0, time.perf_counter()
        for _ in range(runs):
            learn()
        share = float(native.stepping / (time.perf_counter() - begin))
    native.close()
    return share


def _config(hyperparameters: dict[str, Any], **changes: Any) -> Any:
    from ves_gym.baselines.config import TrainConfig

    return TrainConfig(
        env=LEARNED, algorithm="PPO", hold=HOLD, reward_scale=SCALE,
        hyperparameters=hyperparameters,
        **{"n_envs": ENVS, "total_timesteps": 10**9, **changes},
    )  # fmt: skip


def _held(envs: int) -> Any:
    """The environments as Stable-Baselines3 takes them, actions held, rewards scaled."""
    from ves_gym.baselines.sb3 import Sb3VecEnv

    env = gym.make_vec(f"ves_gym:{LEARNED}", num_envs=envs, threads=1).unwrapped
    return Sb3VecEnv(env, hold=HOLD, reward_scale=SCALE)


def learners(hyperparameters: dict[str, Any], envs: int = ENVS, runs: int = RUNS) -> Pair:
    """Seconds per measurement of the native learner and of Stable-Baselines3's."""
    from gymnasium.vector import AutoresetMode

    from ves_gym.baselines.evaluate import make_vector
    from ves_gym.baselines.learner import Learner

    count = ROLLOUTS * envs * hyperparameters["n_steps"]
    env = make_vector(LEARNED, envs, AutoresetMode.SAME_STEP, threads=1)
    ours = Learner(_config(hyperparameters, n_envs=envs), 0, env)
    theirs = _sb3_ppo(_held(envs), **hyperparameters)
    with _one_thread():
        return side_by_side(
            lambda: ours.learn(ours.steps + count, lambda: None),
            lambda: theirs.learn(count, reset_num_timesteps=False),
            runs,
        )


def _falling(remaining: float) -> float:
    """Learning rate where a share of the training remains, as the native learner has it."""
    return float(remaining * LARGE["learning_rate"])


def returns(
    decisions: int = DECISIONS,
    seeds: tuple[int, ...] = SEEDS,
    envs: int = ENVS,
    episodes: int = 100,
) -> tuple[list[float], list[float]]:
    """Mean return of the last policy of every seed: native learner, Stable-Baselines3."""
    import tempfile
    from pathlib import Path

    from ves_gym.baselines.evaluate import evaluate
    from ves_gym.baselines.sb3 import from_sb3
    from ves_gym.baselines.train import VALIDATION, train

    config = _config(LARGE, total_timesteps=decisions, n_envs=envs, eval_episodes=episodes)
    ours, theirs = [], []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            ours.append(train(config, seed, Path(folder))[-1]["return"])
        changes = {**LARGE, "learning_rate": _falling}
        with _one_thread():
            model = _sb3_ppo(
                _held(envs), seed, policy_kwargs={"log_std_init": config.log_std}, **changes
            )
            model.learn(decisions)
        policy = from_sb3(model)
        found = evaluate(policy, LEARNED, episodes=episodes, seed=VALIDATION, threads=1)
        theirs.append(float(np.mean(found.values("return")[0])))
    return ours, theirs


def _tell_learners(small: bool) -> dict[str, object]:
    out: dict[str, object] = {}
    envs, runs = (2, 1) if small else (ENVS, RUNS)
    for name, chosen in (("its defaults", DEFAULTS), ("large batches", LARGE)):
        pair = learners(chosen, envs, runs)
        steps = ROLLOUTS * envs * chosen["n_steps"]
        print(
            f"native learner, {name}: {pair.processor:.1f} x Stable-Baselines3 in processor"
            f" time, {pair.ratio:.1f} x on the clock ({pair.low:.1f}-{pair.high:.1f}),"
            f" {steps / pair.ours:,.0f} against {steps / pair.reference:,.0f} decisions/s"
        )
        out[name] = vars(pair)
    few: dict[str, Any] = {"decisions": 128, "seeds": (0,), "envs": 2, "episodes": 1}
    ours, theirs = returns(**few) if small else returns()
    out["returns"], out["returns_reference"] = ours, theirs
    print(
        f"mean return on {LEARNED}, a seed each: native {np.round(ours, 3)},"
        f" Stable-Baselines3 {np.round(theirs, 3)}"
    )
    return out


def report(small: bool = False) -> dict[str, object]:
    """The figures, printed; `small`: just enough to see that they can be had."""
    if not has_sb3():
        return {}
    learned = _tell_learners(small)
    envs, batch, runs = (2, 8, 1) if small else (ENVS, BATCH, RUNS)
    pair, ours, theirs = ppo(envs, batch, runs)
    steps = ROLLOUTS * batch
    print(
        f"PPO n = {envs}, batch {batch}  {pair.ratio:5.1f} x one MuJoCo per environment"
        f" ({pair.low:.1f}-{pair.high:.1f}), {steps / pair.ours:,.0f} against"
        f" {steps / pair.reference:,.0f} steps/s; in env.step {ours:.0%} against {theirs:.0%}"
    )
    emulated = share(envs, batch, runs)
    print(f"PPO on {EMULATED.split(':')[1]}: {emulated:.0%} of the time in env.step and reset")
    shares = {"share": ours, "share_reference": theirs, "share_emulated": emulated}
    return {**vars(pair), **shares, "learners": learned}


if __name__ == "__main__":
    report()
