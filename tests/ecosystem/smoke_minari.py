# /// script
# dependencies = ["minari[create,hdf5]"]
# ///
"""Minari: a data set collected, read back, and its environment made again."""

import os
import tempfile

import gymnasium as gym
import numpy as np

import ves_gym  # noqa: F401  files the ids

EPISODES = 3
ENTRIES = ("reward/failure", "energy/E_mean")


def collect(name: str, folder: str) -> int:
    """Return the number of steps in a data set of random episodes."""
    os.environ["MINARI_DATASETS_PATH"] = folder  # read as Minari is imported
    import minari

    class Infos(minari.StepDataCallback):
        """What a data set keeps of the infos: Minari wants the same entries at every step."""

        def __call__(self, env, obs, info, *rest, **kwargs):
            """Return what is kept of a step."""
            data = super().__call__(env, obs, info, *rest, **kwargs)
            return {**data, "info": {key: float(info.get(key, 0.0)) for key in ENTRIES}}

    env = minari.DataCollector(
        gym.make(name, duration=0.25), step_data_callback=Infos, record_infos=True
    )
    env.action_space.seed(0)
    for seed in range(EPISODES):
        env.reset(seed=seed)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            over = terminated or truncated
    label = f"ves/{name.removeprefix('ves/').lower()}"
    dataset = env.create_dataset(dataset_id=label, algorithm_name="random")
    dataset = minari.load_dataset(label)
    assert dataset.total_episodes == EPISODES
    again = dataset.recover_environment()
    assert again.spec.max_episode_steps == again.unwrapped.task.steps == 20
    for seed, episode in enumerate(dataset):
        first, _ = again.reset(seed=seed)
        rewards = [again.step(action)[1] for action in episode.actions]
        np.testing.assert_array_equal(np.asarray(rewards), episode.rewards)
        assert episode.infos["energy"]["E_mean"][-1] > 0  # to HDF5 a slash is a group
        start = episode.observations
        if isinstance(first, dict):
            first, start = first["observation"], start["observation"]
        np.testing.assert_array_equal(first, start[0])
    return dataset.total_steps


def main() -> str:
    """Collect; return what was run."""
    names = ("ves/PumaReach-v0", "ves/PumaReachGoal-v0", "ves/PumaDampEmulated-v0")
    with tempfile.TemporaryDirectory() as folder:
        steps = sum(collect(name, folder) for name in names)
    return (
        "data sets of PumaReach, PumaReachGoal and PumaDampEmulated with parts of their infos:"
        f" {steps} steps, read back and replayed bit for bit in the recovered environments"
    )


if __name__ == "__main__":
    print("ran:", main())
