"""Does a solved episode return more than any that is not? Every id, twelve kinds of policies.

    python -m benchmarks.ranking --episodes 35      # of each kind and id: 10,080 in all

Per id: episodes solved and not, pairs of one of each in which the unsolved one returns as much,
least return of a solved episode, largest of an unsolved one, and the worst return of random,
constant and alternating actions over that of doing nothing.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import Controller, episode_rng
from ves_gym.baselines.evaluate import evaluate, settings_of
from ves_gym.baselines.policy import load_policy, released, task_name
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.envs.vector import VesVectorEnv

UNTHINKING = {"constant": 0, "bang-bang": 1, "swing": 20}  # periods between two changes of sign
# standard deviation of what is added to every action, share of the episode until zeros follow
NOISY, STOPPED, TRAINED = (0.1, 0.5), (0.5, 0.9), (0.0, 0.1, 0.5)


@dataclass
class Alternating:
    """Actions from end to end, neighbours opposed, which change sign every so many periods."""

    name: str
    periods: int  # 0: never
    privileged = False

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """Nothing to prepare."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        turns = env.batch.episodes.steps[:, None] // (self.periods or env.task.steps + 1)
        return np.where((turns + np.arange(env.batch.width)) % 2, -1.0, 1.0)


@dataclass
class Altered:
    """Acts as another controller does, with noise, until a share of the episode is over."""

    inner: Controller
    noise: float = 0.0
    share: float = 1.0
    privileged = True

    @property
    def name(self) -> str:
        return f"{self.inner.name} noise {self.noise:g} until {self.share:g}"

    def settings(self, spec: Any) -> dict[str, Any]:
        return settings_of(self.inner, spec.id)

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        self.inner.reset(env, ids)
        shape = env.num_envs, env.task.steps, env.batch.width
        if np.shape(getattr(self, "_added", ())) != shape:
            self._added = np.zeros(shape)
        for i in ids.tolist():
            self._added[i] = self.noise * episode_rng(env, i, 1).standard_normal(shape[1:])

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        at = np.minimum(env.batch.episodes.steps, env.task.steps - 1)
        action = self.inner.act(env, observation) + self._added[np.arange(len(at)), at]
        acting = at < self.share * env.task.steps
        return np.where(acting[:, None], np.clip(action, -1.0, 1.0), 0.0)


def policies(id: str) -> list[Controller]:
    """Return twelve kinds; a task without a released policy has its reference in that place."""
    reference = REFERENCES[task_name(id).removesuffix("Emulated")]
    trained = [load_policy(path) for path in released(id).values()]
    learned: Controller = trained[0] if trained else get_controller(reference)
    return [
        get_controller("zero"),
        get_controller("random"),
        *(Alternating(name, periods) for name, periods in UNTHINKING.items()),
        *(Altered(get_controller(reference), noise=k) for k in NOISY),
        *(Altered(get_controller(reference), share=k) for k in STOPPED),
        *(Altered(learned, noise=k if trained else k + 0.03) for k in TRAINED),
    ]


class Ranking(NamedTuple):
    """Returns of an id's episodes."""

    solved: Array
    unsolved: Array
    excess: float  # worst return of the unthinking over that of doing nothing

    @property
    def inversions(self) -> int:
        """Pairs in which the unsolved episode returns as much as the solved one, or more."""
        ranked = np.sort(self.solved)
        return int(np.searchsorted(ranked, self.unsolved, side="right").sum())


def rank(id: str, episodes: int) -> Ranking:
    """Play so many episodes of every kind."""
    rows = {
        policy.name: evaluate(policy, id, episodes=episodes, threads=1).rows
        for policy in policies(id)
    }
    returns = {name: np.array([row["return"] for row in of]) for name, of in rows.items()}
    every = np.concatenate(list(returns.values()))
    solved = np.array([bool(row["success"]) for of in rows.values() for row in of])
    worst = min(returns[name].min() for name in ("random", *UNTHINKING))
    return Ranking(every[solved], every[~solved], worst / returns["zero"].mean())


def main() -> None:
    """Print a row per id, and the whole."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=35)
    parser.add_argument("ids", nargs="*", help="default all")
    args = parser.parse_args()
    print(f"{'id':32}{'solved':>7}{'not':>6}{'inversions':>11}{'least':>9}{'most':>9}{'x':>6}")
    total: list[Ranking] = []
    for id in args.ids or sorted(k for k in gym.registry if k.startswith("ves/")):
        total.append(r := rank(id, args.episodes))
        least, most = r.solved.min(initial=np.inf), r.unsolved.max(initial=-np.inf)
        print(
            f"{id:32}{len(r.solved):7}{len(r.unsolved):6}{r.inversions:11}{least:9.3f}"
            f"{most:9.3f}{r.excess:6.2f}",
            flush=True,
        )
    episodes = sum(len(r.solved) + len(r.unsolved) for r in total)
    pairs = sum(len(r.solved) * len(r.unsolved) for r in total)
    print(
        f"{episodes} episodes, {pairs} pairs of a solved and an unsolved one, of which"
        f" {sum(r.inversions for r in total)} the wrong way round; worst return over that of"
        f" doing nothing {max(r.excess for r in total):.2f}"
    )


if __name__ == "__main__":
    main()
