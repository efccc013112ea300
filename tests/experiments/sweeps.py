"""Small sweeps, their files, and how to kill their workers."""

import os
import random
import signal
import threading
import time
from pathlib import Path

from ves_gym.experiments.spec import spec_from_plain

SMALL = {  # two environments, a policy, a planner: units of a fraction of a second
    "evaluate": [
        {"envs": ["BeamLQR-v0"], "policies": ["zero", "released"], "episodes": 2},
        {
            "envs": ["PumaDamp-v0"],
            "policies": ["random"],
            "seeds": [3],
            "episodes": 2,
            "settings": {"duration": 1.0},
        },
    ],
    "plan": [{"suite": "reach100", "planners": ["direct"], "durations": [0.5], "queries": 1}],
}


def spec(plain=None, **changes):
    return spec_from_plain({**(plain or SMALL), **changes})


def many(count, **changes):
    """Units of some 10 ms each, once a worker is warm."""
    table = {"envs": ["BeamLQR-v0"], "policies": ["random"], "episodes": 1}
    return spec({"evaluate": [{**table, "seeds": list(range(count))}]}, **changes)


def files(folder, part="results"):
    """Names and contents of the files of a sweep."""
    return {p.name: p.read_bytes() for p in (Path(folder) / part).glob("*")}


def children():
    """Ids of the worker processes of this process."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid() and b"spawn_main" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
        except (OSError, IndexError, ValueError):  # ended meanwhile
            continue
    return found


class Killer:
    """Kills a worker of this process now and then, from the first result until left."""

    def __init__(self, folder, pause, times):
        self.folder, self.pause, self.times = Path(folder), pause, times
        self.killed = []
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        draw = random.Random(0)
        while not list(self.folder.glob("results/*.json")) and not self.over.wait(0.01):
            pass
        while len(self.killed) < self.times and not self.over.wait(self.pause):
            pids = [pid for pid in children() if pid not in self.killed]
            if pids:
                pid = draw.choice(pids)
                self.killed.append(pid)
                os.kill(pid, signal.SIGKILL)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.over.set()
        self.thread.join()


def wait_until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)
