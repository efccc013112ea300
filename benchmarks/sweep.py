"""What a sweep costs beside its units: 200 jobs of one second on two workers.

`--costs` does a few units of each kind and prints what one takes: processor, files, bytes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ves_gym._util.params import canonical_json, read_table, write_text
from ves_gym._util.process_pool import Workers
from ves_gym.experiments.spec import Evaluations, Plannings, Spec
from ves_gym.experiments.sweep import sweep


@dataclass(frozen=True)
class Overhead:
    """How long jobs took that take `seconds` each and nothing of the processor."""

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


def overhead(jobs: int = 200, workers: int = 2, seconds: float = 1.0) -> Overhead:
    """Time so many jobs."""
    with TemporaryDirectory() as folder:
        begin = time.perf_counter()
        with Workers(workers) as pool:
            running = [pool.submit(wait, folder, k, seconds) for k in range(jobs)]
            for job in running:
                job.result()
            took = time.perf_counter() - begin
    return Overhead(jobs, workers, jobs * seconds / workers, took)


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


def report(small: bool = False) -> dict[str, object]:
    """Print and return the share; `small`: just enough to see that it can be had."""
    found = overhead(2, 1, 0.01) if small else overhead()
    print(
        f"sweep            {found.efficiency:5.3f} of ideal: {found.jobs} jobs of"
        f" {found.ideal * found.workers / found.jobs:g} s on {found.workers} workers in"
        f" {found.took:.1f} s"
    )
    return asdict(found) | {"efficiency": found.efficiency}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--costs", action="store_true")
    args = parser.parse_args()
    if args.costs:
        with TemporaryDirectory() as folder:
            for what, count, seconds, size in costs(Path(folder)):
                print(f"{what}: {seconds:.2f} s, {size / 1e3:.1f} kB (median of {count})")
        return
    report()


if __name__ == "__main__":
    main()
