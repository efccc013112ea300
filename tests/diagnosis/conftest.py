"""Logs of machines in which something is hidden, from the generator of the trial."""

from dataclasses import replace

import pytest

from benchmarks.trial import cases, write
from ves_gym.system.runlog import RunLog

SINES, MOVES, REVERSALS, FURTHER = range(cases.RUNS)  # what the runs are

PLAIN = replace(
    cases.draw("tests", 0),
    category="single",
    mode="emulated",
    vehicle="stiff",
    arm="puma560",
    platform="pose",
    period=0.005,
    noise="white",
    feedforward=True,
    factor=1.0,
    stated=True,
)
"""A PUMA on the platform, which moves like a base on springs, at 200 Hz."""


@pytest.fixture(scope="session")
def hidden(tmp_path_factory):
    """(kind, place, signed size) of each effect, seed -> logs, the last held back."""
    made: dict[str, list[RunLog]] = {}

    def make(*effects: tuple, seed: int = 0, runs=(SINES, MOVES, FURTHER)) -> list[RunLog]:
        key = repr((effects, seed, runs))
        if key not in made:
            made[key] = simulated(*effects, seed=seed, runs=runs)
        return list(made[key])

    def simulated(*effects: tuple, seed: int, runs: tuple[int, ...]) -> list[RunLog]:
        case = replace(
            PLAIN,
            index=seed,
            kinds=tuple(kind for kind, _, _ in effects),
            slots=tuple(slot for _, slot, _ in effects),
            signs=tuple(1.0 if size > 0 else -1.0 for _, _, size in effects),
            shapes=(0.5,) * len(effects),
        )
        at, folder = write.setting("tests", case), tmp_path_factory.mktemp("hidden")
        plant = at.plant.copy()
        for which, (_, _, size) in enumerate(effects):
            write.add_effect(plant, case, which, abs(size))
        write.write_runs("tests", at, plant, folder, runs)
        return [RunLog.load(folder / f"run-{run + 1}.csv") for run in runs]

    return make
