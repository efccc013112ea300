"""A million random steps over every environment, with random effects."""

import dataclasses
import gc
import os

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import IDS, SHORT, flat, part
from ves_gym._util.params import ParameterError, from_plain
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import EFFECTS, Effect

STEPS = 1_000_000
PASSES = 4  # over all environments; the first two may still fill caches
SIZES = (1, 17, 64, 160)  # one simulation, odd blocks, full blocks, two threads
STRENGTH = 0.05  # of an effect's bounds


def random_effects(name, noise):
    """Some effects of random size that do something in an environment, as plain data."""
    chosen, kept, system = [], (), gym.make(name, randomize={}).unwrapped.task.system
    for kind, cls in sorted(EFFECTS.items()):
        if system.mode not in cls.modes or noise.random() < 0.7:
            continue
        plain = {"kind": kind}
        for field in dataclasses.fields(cls):
            low, high = field.metadata["bounds"]
            null = field.metadata["null"]
            regressor = kind == "gravity/moment"
            any_size = minimal_model(system.arm).size if regressor else system.arm.n
            shape = [any_size if k is None else k for k in field.metadata["shape"]]
            if null is None:
                value = noise.uniform(low, high, shape)
            else:
                value = null + STRENGTH * (noise.uniform(low, high, shape) - null)
            plain[field.name] = np.asarray(value).tolist()
        try:
            more = (*kept, from_plain(Effect, plain, "effect"))
            Simulator(system.replace(effects=more), warn_at=None)
        except ParameterError as error:
            # the last: stiff or heavily damped gears, for the step of an environment
            known = (
                "would do nothing", "got a satellite", "physics_dt must be",
                "the numbers of a rigid body", "needs its rotor_inertia > 0",
                "needs a mode that the base has", "carries wheels or appendages",
                "the rotor's own", "acts on a satellite in mode ideal",
            )  # fmt: skip
            assert any(text in str(error) for text in known), error
        else:
            chosen.append(plain)
            kept = more
    return chosen


def usage():
    """Resident memory [MiB], threads and file descriptors of this process."""
    gc.collect()
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[1])
    count = [len(os.listdir(f"/proc/self/{what}")) for what in ("task", "fd")]
    return np.array([pages * os.sysconf("SC_PAGE_SIZE") / 2**20, *count])


def soak(name, n, steps, settings, seed):
    """Random steps of a vector environment; (steps done, episodes, divergences)."""
    env = gym.make_vec(name, num_envs=n, **settings)
    env.action_space.seed(seed)
    env.reset(seed=seed)
    episodes = diverged = 0
    for k in range(-(-steps // n)):
        action = env.action_space.sample()
        if k % 3 == 0:
            action = np.sign(action)
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert np.isfinite(flat(observation)).all() and np.isfinite(reward).all()
        ended = terminated | truncated
        episodes += int(ended.sum())
        diverged += int((info["diverged"] & ended).sum())
        if ended.any():
            sound = ended & ~info["diverged"]
            assert all(np.isfinite(e[sound]).all() for e in part(info, "energy").values())
    env.close()
    return (k + 1) * n, episodes, diverged


@pytest.mark.slow
@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="no /proc")
def test_a_million_random_steps():
    """No exception, no number that is none; memory, threads and descriptors do not grow."""
    per_run = STEPS // (PASSES * len(IDS) * 2) + 1
    seen, total = [], np.zeros(3, int)
    for _ in range(PASSES):
        noise = np.random.default_rng(0)
        for name in IDS:
            effects = random_effects(name, noise)
            for more in ({}, {"effects": effects, "randomize": {}, **SHORT}):
                n = int(noise.choice(SIZES))
                # single environments are slower; they take a tenth of the steps
                steps = per_run if n > 1 else per_run // 10
                total += soak(name, n, steps, more, int(noise.integers(1000)))
        while total[0] < (len(seen) + 1) * STEPS // PASSES:  # make up for those
            total += soak(IDS[0], 160, per_run, {}, 0)
        seen.append(usage())
        print("pass", len(seen), "MiB, threads, descriptors:", seen[-1].round(1), total)
    assert total[0] >= STEPS
    growth = seen[-1] - seen[1]
    assert growth[0] < 10, seen
    assert growth[1] <= 0 and growth[2] <= 0, seen
