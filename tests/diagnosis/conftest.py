"""Logs of machines in which something is hidden, from the generator of the blind benchmark."""

import numpy as np
import pytest

from ves_gym.system.runlog import RunLog


@pytest.fixture(scope="session")
def hidden():
    """(kinds and slots and magnitudes, seed) -> logs, the last held back; each made once."""
    pytest.importorskip("numba")
    from ves_gym.diagnosis.benchmark.blind.cases import BlindCase, CasePlan, Runner
    from ves_gym.diagnosis.benchmark.blind.effects import HiddenEffect
    from ves_gym.diagnosis.benchmark.blind.machine import controller, nominal
    from ves_gym.diagnosis.benchmark.blind.noise import digital, draw_noise, stamps
    from ves_gym.diagnosis.benchmark.blind.setup import with_nuisance
    from ves_gym.diagnosis.benchmark.blind.write import logs_of

    runner = Runner(nominal().to_dict(), controller())
    made: dict[str, list[RunLog]] = {}

    def make(
        *effects: tuple, seed: int = 0, kinds=("multisine", "moves", "fast")
    ) -> list[RunLog]:
        key = repr((effects, seed, kinds))
        if key not in made:
            made[key] = simulated(*effects, seed=seed, kinds=kinds)
        return list(made[key])

    def simulated(*effects: tuple, seed: int, kinds: tuple[str, ...]) -> list[RunLog]:
        rng = np.random.default_rng(seed)
        machine = with_nuisance(runner.nominal, rng)
        motions = [runner.safe_motion(kind, rng) for kind in kinds]
        broken = digital(machine)
        for kind, slot, size, constants in effects:
            broken = HiddenEffect(kind, slot, size, constants).applied(broken)
        noises = [draw_noise(runner.samples, rng) for _ in motions]
        records = runner.records(broken, motions, noises)
        t = [stamps(runner.samples, machine.dt, machine.clock, rng) for _ in motions]
        case = BlindCase(0, CasePlan("null", (), ()), (), (), t, records, motions)
        return logs_of(case, runner.description, controller())

    return make
