"""One healthy machine for all tests of the generator."""

import numpy as np
import pytest


@pytest.fixture(scope="package")
def description():
    from ves_gym.diagnosis.benchmark.blind.machine import nominal

    return nominal().to_dict()


@pytest.fixture(scope="package")
def gains():
    from ves_gym.diagnosis.benchmark.blind.machine import controller

    return controller()


@pytest.fixture(scope="package")
def runner(description, gains):
    pytest.importorskip("numba")
    from ves_gym.diagnosis.benchmark.blind.cases import Runner

    return Runner(description, gains)


@pytest.fixture(scope="package")
def setup(runner):
    return runner.nominal


@pytest.fixture(scope="package")
def library_record(description):
    """Play a motion on the library's simulator; a record with the generator's columns."""
    from ves_gym.mechanics.dynamics import inverse_dynamics
    from ves_gym.simulation.simulator import Simulator
    from ves_gym.system.system import System

    def play(motion, start, samples, effects=()):
        system = System.from_dict(description).replace(effects=tuple(effects))
        sim = Simulator(system, warn_at=None)
        sim.reset(q=start[:3], v=start[3:6])
        k = system.substeps
        s = motion.at(np.arange((samples - 1) * k + 1) * system.physics_dt)
        tau = inverse_dynamics(system.arm, s.q, s.v, s.a)[0]
        commands = sim.servo_command(s.q[None], s.v[None], tau[None])
        rows = []
        for i in range(samples):
            state, now = sim.state, sim.readings
            torque, _ = sim.evaluate(commands[:, i * k])
            parts = (state.q, state.v, torque, state.y, now.y_cmd, now.wrench)
            rows.append(np.concatenate([*parts, now.wrench - now.gravity], axis=-1)[0])
            if i + 1 < samples:
                sim.play(commands[:, i * k : (i + 1) * k + 1])
        assert not sim.events
        return np.stack(rows)

    return play
