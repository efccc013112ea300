"""Environments against Gymnasium's vectorisations of the same task, and against other suites.

Each pair makes the same number of environment steps on both sides, so that a ratio is one of
seconds per environment step. EnvPool is optional: without it its lines are left out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

from benchmarks.timing import Pair, side_by_side

ID = "ves_gym:ves/PumaRestToRest-v0"
EMULATED = "ves_gym:ves/PumaRestToRestEmulated-v0"
SPACE = tuple(
    f"ves_gym:ves/{name}-v0"
    for name in (
        "PumaReach", "PumaReachGoal", "PumaTrack", "MacroMicro", "PumaDamp", "FreeFlyerReach",
        "BeamLQR", "PoseReach", "PayloadTransfer", "ServicerCapture", "BerthingContact",
    )
)  # fmt: skip
PERIODS = 20  # vector steps of ours in one measurement
RUNS = 7


def random_steps(env: VectorEnv, env_steps: int) -> Callable[[], None]:
    """Work: so many environment steps of a vector, resets of ended episodes included."""
    n, count = env.num_envs, env_steps // env.num_envs
    shape = (count, n, *env.single_action_space.shape)
    moves = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    env.reset(seed=0)

    def work() -> None:
        for action in moves:
            env.step(action)

    return work


def against_workers(
    kind: type[VectorEnv],
    n: int,
    backend: str,
    id: str = ID,
    workers: int = 8,
    runs: int = RUNS,
) -> Pair:
    """Our vector of n against SyncVectorEnv or AsyncVectorEnv of the same task and engine."""
    ours = gym.make_vec(id, num_envs=n, backend=backend)
    theirs = kind([lambda: gym.make(id, backend=backend)] * workers)
    try:
        steps = n * PERIODS
        return side_by_side(random_steps(ours, steps), random_steps(theirs, steps), runs)
    finally:
        theirs.close()


def with_ends(
    id: str, n: int = 256, calls: int | None = None, backend: str = "kernel"
) -> dict[str, float]:
    """A vector of n on one thread, random actions, ends and resets included.

    Args:
        id: of the environment.
        n: how many.
        calls: vector steps that are timed; None: two episodes' length.
        backend: of the engine.

    Returns:
        Steps per second of processor time, the same of calls in which nothing ends or begins,
        and microseconds that an end and a beginning add.
    """
    env: Any = gym.make_vec(id, num_envs=n, threads=1, backend=backend)
    calls = 2 * env.unwrapped.task.steps if calls is None else calls
    size = (64, n, *env.single_action_space.shape)
    moves = np.random.default_rng(0).uniform(-1, 1, size).astype(np.float32)
    env.reset(seed=0)
    seconds, ends = np.zeros(calls), np.zeros(calls)
    for warm in (True, False):  # the first round compiles what ends and beginnings run
        for k in range(calls):
            begin = time.process_time()
            _, _, terminated, truncated, _ = env.step(moves[k % len(moves)])
            seconds[k], ends[k] = time.process_time() - begin, (terminated | truncated).sum()
        if warm:
            env.reset(seed=0)
    quiet = (ends == 0) & (np.roll(ends, 1) == 0)
    alone = float(np.median(seconds[quiet])) if quiet.any() else float(np.min(seconds))
    more = (seconds.sum() - alone * calls) / max(ends.sum(), 1)
    speed = n / float(seconds.mean())
    return {"steps/s": speed, "without ends": n / alone, "us per end": more * 1e6}


def has_envpool() -> bool:
    """Whether EnvPool can be imported."""
    try:
        import envpool  # noqa: F401
    except ImportError:
        return False
    return True


def against_envpool(id: str, n: int = 256, mine: str = ID, runs: int = RUNS) -> Pair:
    """Our vector of n on the kernel against EnvPool's, through Gymnasium's interface."""
    import envpool

    ours = gym.make_vec(mine, num_envs=n, backend="kernel")
    theirs = envpool.make(id, env_type="gymnasium", num_envs=n)
    work = random_steps(ours, n * PERIODS)
    size = (PERIODS, n, *theirs.action_space.shape)
    moves = np.random.default_rng(0).uniform(-1, 1, size) * theirs.action_space.high
    theirs.reset()

    def reference() -> None:
        for action in moves:
            theirs.step(action)

    return side_by_side(work, reference, runs)


def single(
    reference: str = "Pusher-v5", steps: int = 1000, mine: str = ID, runs: int = RUNS
) -> Pair:
    """One environment of `gym.make` against another, resets included."""

    def work(id: str) -> Callable[[], None]:
        env = gym.make(id)
        space = env.action_space
        size = (steps, *space.shape)
        moves = np.random.default_rng(0).uniform(space.low, space.high, size)
        env.reset(seed=0)

        def go() -> None:
            for action in moves:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()

        return go

    return side_by_side(work(mine), work(reference), runs)


_FIRST = """
import sys
import gymnasium as gym
env = gym.make(sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
sys.stdout.write("x")
sys.stdout.flush()
"""
_BARE = 'import gymnasium, sys; sys.stdout.write("x"); sys.stdout.flush()'
_MEMORY = """
import sys
import gymnasium as gym
env = gym.make_vec(sys.argv[1], num_envs=int(sys.argv[2]))
env.reset(seed=0)
for _ in range(env.task.steps + 2):  # through the end, where most is needed
    env.step(env.action_space.sample())
for line in open("/proc/self/status"):  # `getrusage` also counts the parent before exec
    if line.startswith("VmHWM"):
        print(int(line.split()[1]) / 1024)
"""


def _python(code: str, *arguments: str, cache: str | None = None) -> subprocess.Popen[str]:
    root = str(Path(__file__).parents[1])
    known = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([root, *known])}
    if cache is not None:  # modules compiled beforehand, as in an installed package
        settings.pop("PYTHONDONTWRITEBYTECODE", None)
        settings["PYTHONPYCACHEPREFIX"] = cache
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=settings,
        stdout=subprocess.PIPE,
        text=True,
    )


def first_step(runs: int = 7) -> dict[str, float]:
    """Median seconds from a process's start: to its first step, and to `import gymnasium`."""
    times: dict[str, list[float]] = {"ours": [], "gymnasium": []}
    with tempfile.TemporaryDirectory() as cache:
        for _ in range(runs + 1):
            for name, words in (("ours", (_FIRST, ID)), ("gymnasium", (_BARE,))):
                begin = time.perf_counter()
                process = _python(*words, cache=cache)
                assert process.stdout is not None
                assert process.stdout.read(1) == "x"
                times[name].append(time.perf_counter() - begin)
                process.communicate()
    return {name: float(np.median(values[1:])) for name, values in times.items()}


def memory(id: str = ID, n: int = 4096) -> float:
    """MiB that a process with n environments has needed at most."""
    out, _ = _python(_MEMORY, id, str(n)).communicate()
    return float(out)


def report(small: bool = False) -> dict[str, object]:
    """Every figure above, printed as it comes; `small`: just enough to see that it comes."""
    results: dict[str, object] = {}
    few, many, workers, runs = (2, 2, 1, 1) if small else (64, 256, 8, RUNS)

    def tell(name: str, what: str, pair: Pair, steps: int) -> None:
        results[name] = vars(pair)
        print(
            f"{what:17} {pair.ratio:5.1f} x {name} ({pair.low:.1f}-{pair.high:.1f}),"
            f" {steps / pair.ours:,.0f} steps/s"
            + (f", {pair.processor:.1f} x in processor time" if "EnvPool" in name else "")
        )

    for kind in (SyncVectorEnv, AsyncVectorEnv):
        pair = against_workers(kind, few, "mujoco", workers=workers, runs=runs)
        tell(f"{kind.__name__}({workers}), MuJoCo", f"env n = {few}", pair, few * PERIODS)
    for id in ("Pusher-v5", "Reacher-v5") if has_envpool() else ():
        pair = against_envpool(id, many, runs=runs)
        tell(f"EnvPool {id}", f"env n = {many}", pair, many * PERIODS)
        pair = against_envpool(id, many, EMULATED, runs)
        tell(f"EnvPool {id}, emulated", f"env n = {many}", pair, many * PERIODS)
    for id, note in ((ID, ""), (EMULATED, ", emulated")):
        pair = against_workers(AsyncVectorEnv, many, "kernel", id, workers, runs)
        tell(f"AsyncVectorEnv({workers}){note}", f"env n = {many}", pair, many * PERIODS)
        steps = 2 if small else 1000
        pair = single(steps=steps, mine=id, runs=runs)
        tell(f"Pusher-v5{note}", "gym.make", pair, steps)
    for id in (ID,) if small else (ID, EMULATED, *SPACE):
        name = id.rpartition("/")[2]
        results[f"with ends {name}"] = figures = with_ends(id, many, 4 if small else None)
        print(
            f"{many} environments, one thread: " + name,
            *(f"{k} {v:,.0f}" for k, v in figures.items()),
        )
    first = first_step(runs)
    results["first step"] = first
    print(
        f"first step        {first['ours']:.2f} s after the process's start"
        f" (`import gymnasium` alone {first['gymnasium']:.2f} s)"
    )
    count = few if small else 4096
    for id in (ID,) if small else (ID, EMULATED):
        name = id.rpartition("/")[2]
        results[f"memory {name}"] = used = memory(id, count)
        print(f"{count:,} environments {used:,.0f} MiB, {name}")
    return results


if __name__ == "__main__":
    report()
