"""What a sweep costs beside its units: 200 jobs of one second on two workers."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ves_gym._util.params import canonical_json, write_text
from ves_gym.experiments.executors import open_executor


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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--executor", nargs="+", default=["local", "dask"])
    for name in parser.parse_args().executor:
        found = overhead(name)
        print(
            f"sweep, {name:<8} {found.efficiency:5.3f} of ideal: {found.jobs} jobs of 1 s on"
            f" {found.workers} workers in {found.took:.1f} s"
        )


if __name__ == "__main__":
    main()
