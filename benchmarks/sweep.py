"""What a sweep costs beside its units: 200 jobs of one second on two workers.

`--storm` sends 2,000 short jobs to a Dask cluster of several processes, of which one is killed
(SIGKILL) again and again and others are added while it runs. `--costs` does a few units of
each kind and prints what one takes: processor, files, bytes.
"""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from ves_gym._util.params import canonical_json, read_table, write_text
from ves_gym.experiments.executors import open_executor
from ves_gym.experiments.spec import Evaluations, Plannings, Spec
from ves_gym.experiments.sweep import sweep


@dataclass(frozen=True)
class Overhead:
    """How long jobs took that take `seconds` each and nothing of the processor."""

    executor: str
    jobs: int
    workers: int
    ideal: float  # s
    took: float  # s, starting the workers included

    @property
    def efficiency(self) -> float:
        """Share of the time in which every worker was at its job."""
        return self.ideal / self.took


def wait(folder: str, name: int, seconds: float) -> None:
    """A unit that waits, and stores a result as a sweep's does."""
    end = time.perf_counter() + seconds
    text = canonical_json({"name": name}) + "\n"
    write_text(Path(folder) / f"{name}.json", text)
    time.sleep(max(0.0, end - time.perf_counter()))


def overhead(
    executor: str = "local", jobs: int = 200, workers: int = 2, seconds: float = 1.0
) -> Overhead:
    """Time so many jobs."""
    with TemporaryDirectory() as folder:
        begin = time.perf_counter()
        with open_executor(executor, workers=workers, folder=Path(folder)) as pool:
            running = [pool.submit(wait, folder, k, seconds) for k in range(jobs)]
            for job in running:
                job.result()
            took = time.perf_counter() - begin
    return Overhead(executor, jobs, workers, jobs * seconds / workers, took)


@dataclass(frozen=True)
class Storm:
    """What became of jobs on a cluster whose workers were killed and added."""

    jobs: int
    seconds: float  # of a job
    answers: int  # that came back, one per job
    stored: int  # results in the folder
    repeated: int  # jobs done twice: their worker died after the result, before it told
    killed: int
    added: int
    took: float  # s, from the first job to the last answer
    worker_seconds: float  # of workers that were there meanwhile

    @property
    def efficiency(self) -> float:
        """Share of the time of workers that were there in which they were at a job."""
        return self.jobs * self.seconds / self.worker_seconds


def wait_once(folder: str, name: int, seconds: float) -> int:
    """A unit that waits and stores a result, or notes that there was one already."""
    time.sleep(seconds)
    for suffix in ("result", f"again-{time.time_ns()}"):
        try:
            os.close(os.open(Path(folder) / f"{name}.{suffix}", os.O_CREAT | os.O_EXCL))
            break
        except FileExistsError:
            continue
    return name


def storm(
    jobs: int = 2000,
    workers: int = 6,
    seconds: float = 0.3,
    pause: float = 20.0,
    extra: int = 2,
) -> Storm:
    """Send jobs to a local Dask cluster; kill a worker every `pause` s, add `extra` of them.

    A killed worker is started again by its nanny, as on any cluster.

    Args:
        jobs: to be done.
        workers: processes at the beginning.
        seconds: that a job takes.
        pause: between two kills [s].
        extra: workers that are added, one after each kill.
    """
    killed, over, present = 0, threading.Event(), 0.0
    with (
        TemporaryDirectory() as folder,
        open_executor("dask", workers=workers, folder=Path(folder), deaths=10) as pool,
    ):
        cluster = cast(Any, pool).client.cluster

        def disturb() -> None:
            nonlocal killed, present
            last, due, added = time.perf_counter(), time.perf_counter() + pause, 0
            while not over.wait(0.05):
                now = time.perf_counter()
                present += (now - last) * len(cluster.scheduler_info["workers"])
                last = now
                if now < due:
                    continue
                due = now + pause
                victims = [w for w in cluster.workers.values() if w.pid is not None]
                if victims:
                    os.kill(victims[killed % len(victims)].pid, signal.SIGKILL)
                    killed += 1
                if added < extra:
                    added += 1
                    cluster.scale(workers + added)

        pool.submit(wait_once, folder, jobs, 0.0).result()  # imports are no part of it
        (Path(folder) / f"{jobs}.result").unlink()
        thread = threading.Thread(target=disturb, daemon=True)
        begin = time.perf_counter()
        thread.start()
        running = [pool.submit(wait_once, folder, k, seconds) for k in range(jobs)]
        answers = [job.result() for job in running]
        took = time.perf_counter() - begin
        over.set()
        thread.join()
        names = [file.name for file in Path(folder).iterdir()]
    stored = {name for name in names if name.endswith(".result")}
    assert sorted(answers) == list(range(jobs))
    return Storm(
        jobs, seconds, len(answers), len(stored), len(names) - len(stored), killed, extra, took,
        present,
    )  # fmt: skip


def costs(folder: Path) -> list[tuple[str, int, float, float]]:
    """Do a few units of each kind.

    Args:
        folder: for their results.

    Returns:
        What they are, how many, processor time [s] and bytes of files of one.
    """
    evaluations = [
        Evaluations(envs=("PumaReach-v0",), policies=("released",), seeds=(0, 100)),
        Evaluations(envs=("PumaDampEmulated-v0",), policies=("zero",), seeds=(0, 100)),
    ]
    plannings = [
        Plannings(suite="reach100", planners=(name,), queries=4, durations=(2.0,))
        for name in ("straight", "direct", "refined")
    ]
    specs = [
        *(
            (f"{e.envs[0]} {e.policies[0]}, 100 episodes", Spec(evaluate=(e,)))
            for e in evaluations
        ),
        *((f"{p.planners[0]}, a query at 2 s", Spec(plan=(p,))) for p in plannings),
    ]
    out = []
    for k, (name, spec) in enumerate(specs):
        place = folder / str(k)
        done = sweep(spec, place, workers=1).done
        about = [read_table(file) for file in (place / "about").iterdir()]
        size = sum(
            f.stat().st_size for part in ("about", "results") for f in (place / part).iterdir()
        )
        seconds = sorted(a["processor_seconds"] for a in about)[len(about) // 2]
        out.append((name, len(done), seconds, size / len(about)))
    return out


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--executor", nargs="+", default=["local", "dask"])
    parser.add_argument("--storm", action="store_true")
    parser.add_argument("--costs", action="store_true")
    args = parser.parse_args()
    if args.costs:
        with TemporaryDirectory() as folder:
            for what, count, seconds, size in costs(Path(folder)):
                print(f"{what}: {seconds:.2f} s, {size / 1e3:.1f} kB (median of {count})")
        return
    if args.storm:
        s = storm()
        print(
            f"sweep, dask: {s.answers} answers and {s.stored} results of {s.jobs} jobs of"
            f" {s.seconds:g} s, {s.repeated} done twice; {s.killed} workers killed, {s.added}"
            f" added; {s.took:.1f} s, {s.efficiency:.3f} of ideal"
        )
        return
    for name in args.executor:
        found = overhead(name)
        print(
            f"sweep, {name:<8} {found.efficiency:5.3f} of ideal: {found.jobs} jobs of 1 s on"
            f" {found.workers} workers in {found.took:.1f} s"
        )


if __name__ == "__main__":
    main()
