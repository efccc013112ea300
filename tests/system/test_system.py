"""`System`: a time step that cannot be taken is refused, never rounded."""

import dataclasses
import pickle

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.vehicle import BENT, BENT_THESIS, DECOUPLED, get_vehicle
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System


@pytest.mark.parametrize(
    ("physics", "control", "steps"),
    [(1.25e-3, 12.5e-3, 10), (1e-3, 1e-3, 1), (0.1, 0.3, 3), (1 / 3e3, 1 / 80, 37.5)],
)
def test_the_control_period_is_a_whole_number_of_physics_steps(physics, control, steps):
    if steps == int(steps):
        assert System(physics_dt=physics, control_dt=control).substeps == steps
    else:
        with pytest.raises(ParameterError, match=r"control_dt must be a whole number.*37\.5"):
            System(physics_dt=physics, control_dt=control)


@pytest.mark.parametrize(
    ("physics", "control"),
    [(1e-3, 12.5e-3), (2e-3, 12.5e-3), (2e-2, 1e-2), (1.25e-3, 1.25e-2 * (1 + 1e-6))],
)
def test_any_other_control_period_is_refused(physics, control):
    with pytest.raises(ParameterError, match=r"System.control_dt must be a whole number"):
        System(physics_dt=physics, control_dt=control)


@pytest.mark.parametrize("integrator", ["rk4", "euler", "implicitfast"])
def test_a_step_too_long_for_the_fastest_mode_is_refused(integrator):
    """The simulator states the longest step; just below runs, just above does not start."""
    vehicle = BENT_THESIS if integrator == "implicitfast" else BENT  # of what the kernel takes
    system = System(vehicle=vehicle, integrator=integrator, physics_dt=0.5, control_dt=0.5)
    with pytest.raises(ParameterError, match=r"physics_dt must be <= .*, got 0.5 s") as caught:
        Simulator(system)
    longest = float(str(caught.value).split("<= ")[1].split(" s")[0])
    Simulator(system.replace(physics_dt=0.99 * longest, control_dt=0.99 * longest))
    with pytest.raises(ParameterError, match="physics_dt"):
        Simulator(system.replace(physics_dt=1.01 * longest, control_dt=1.01 * longest))


def test_a_system_is_frozen_hashable_and_picklable():
    system = System()
    with pytest.raises(dataclasses.FrozenInstanceError):
        system.mode = "other"
    with pytest.raises(ValueError, match="read-only"):
        system.base.K[0, 0] = 1.0
    assert len({system, System(), System(vehicle=DECOUPLED)}) == 2
    copy = pickle.loads(pickle.dumps(system))
    assert copy == system
    assert copy.hash == system.hash
    np.testing.assert_array_equal(copy.base.K, system.base.K)
    assert system.replace(vehicle=DECOUPLED).replace(vehicle=BENT) == system
    with pytest.raises(TypeError, match="colour"):
        system.replace(colour="red")


def test_arm_and_vehicle_go_by_name_as_on_the_command_line(tmp_path):
    named = System(arm="ur5e", vehicle="straight-vertical")
    assert named == System(arm=get_arm("ur5e"), vehicle=get_vehicle("straight-vertical"))
    named.arm.to_urdf(tmp_path / "arm.urdf")
    assert System(arm=tmp_path / "arm.urdf").arm.n == 6
    for wrong, said in (
        ({"vehicle": "bend"}, r"vehicle must be one of bent, .*did you mean \"bent\""),
        ({"arm": "ur5"}, r"arm must be one of puma560, .*did you mean \"ur5e\""),
        ({"arm": 3}, "System.arm must be an Arm, its name or its file, got 3"),
        ({"vehicle": None}, "System.vehicle must be a vehicle, its name or its file, got None"),
    ):
        with pytest.raises(ParameterError, match=said):
            System(**wrong)
