"""Joints that slide: read, computed and simulated as Pinocchio and MuJoCo do, or refused."""

import numpy as np
import pinocchio as pin
import pytest

from tests.two_engines import require_alike
from tests.urdf_arms import slider_urdf
from ves_gym._util.params import ParameterError
from ves_gym.engine.mjcf import TO_Y
from ves_gym.envs.build import build_task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.limits import LimitError, require_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT, FREE_FLOATING
from ves_gym.planners.coupling_map import coupling_map
from ves_gym.planners.query import Query
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Arm:
    path = tmp_path_factory.mktemp("arm") / "slider.urdf"
    path.write_text(slider_urdf())
    return Arm.from_file(path, tip="l4")


def states(n: int = 6) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    return rng.uniform(0, 0.4, (n, 4)), rng.normal(size=(n, 4))


def test_accelerations_on_a_free_base_are_pinocchios(arm):
    system = System(arm=arm, vehicle=FREE_FLOATING)
    model = pinocchio_model(arm, system.base)
    data = model.createData()
    rng = np.random.default_rng(5)
    for backend in ("kernel", "mujoco"):
        sim = Simulator(system, 4, backend=backend, servo=None)
        y, yd = 0.3 * rng.normal(size=(2, 4, 6))
        q, v = states(4)
        tau = rng.normal(size=(4, 4))
        sim.reset(q=q, v=v, y=y, yd=yd)
        _, z, zd = sim.backend.read()
        _, found = sim.backend.evaluate(tau)
        for k in range(4):
            order = np.r_[TO_Y, 6 + np.arange(4)]
            true = pin.aba(model, data, z[k][order], zd[k][order], np.r_[np.zeros(6), tau[k]])
            error = np.abs(found[k] - true[np.argsort(order)]).max()
            assert error <= 1e-10 * max(1.0, np.abs(true).max())


@pytest.mark.parametrize("vehicle", [FREE_FLOATING, BENT], ids=["satellite", "bent"])
def test_a_run_is_the_same_on_both_engines_and_its_ledger_closes(arm, vehicle):
    system = System(arm=arm, vehicle=vehicle)
    motion = Motion.straight([0.0, 0.0, 0.0, 0.1], [0.5, 0.3, -0.4, 0.5], 1.0)
    log = require_alike(system, motion)
    balance = EnergyBalance.of(log)
    print(balance)
    assert balance.relative <= 1e-5
    assert np.abs(log.q - log.q_cmd)[-1].max() < 0.01  # its own servo holds it


def test_units_and_refusals(arm, tmp_path):
    with pytest.raises(
        ParameterError, match=r"joint 2 must be within -0.4 to 0.5 m, got 0.9 m"
    ):
        arm.require_within_limits([0, 0.9, 0, 0.1])
    with pytest.raises(
        LimitError, match=r"position limit of joint 4 .* mm, allowed \+-300.0 mm"
    ):
        require_positions(arm, Motion.straight([0, 0, 0, 0], [0, 0, 0, 0.8], 2.0))
    system = System(arm=arm)
    for refused in (
        lambda: System(arm=arm, mode="emulated"),
        lambda: Query(system=system, start=(0.0,) * 4, goal=(0.1,) * 4, duration=1.0),
        lambda: coupling_map(system, (0, 2), [0.0] * 4),
        lambda: build_task("reach", arm=arm),
    ):
        with pytest.raises(
            ParameterError, match="takes revolute joints, got slider with j2, j4"
        ):
            refused()
    path = tmp_path / "slider.urdf"
    path.write_text(slider_urdf().replace('lower="0.0" upper="0.6" ', ""))
    with pytest.raises(ParameterError, match="'j4' is prismatic and has no <limit"):
        Arm.from_file(path, tip="l4")
