"""Drake: an arm of a URDF on a free body. `drake_arms.py IN.npz OUT.npz`.

In: `urdf` (text); `mass`, `com`, `inertia` of the body under its base link; states `q`, `u`
(twist of the base and joint rates, linear part first, at attitude zero) under torques `tau`;
a servo `kp`, `kd` whose `command` (periods, n) [N m] is held over `period` s from `start_q`,
`start_u`. Out: `M`, the base held; accelerations `a`, as u; joints, position and quaternion of
the base after each period in `path`.
"""

import sys

import numpy as np
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteSpring, RotationalInertia, SpatialInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

MOVED = [3, 4, 5, 0, 1, 2]  # Drake has the angular part first


def plant_of(given, free, servo=False):
    """A plant without gravity: the arm on the body, or its base held."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(str(given["urdf"]), "urdf")
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    base = plant.GetBodyByName("base")
    if free:
        I = given["inertia"]
        about = RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        whole = SpatialInertia.MakeFromCentralInertia(given["mass"], given["com"], about)
        body = plant.AddRigidBody("satellite", base.model_instance(), whole)
        plant.WeldFrames(base.body_frame(), body.body_frame())
    else:
        plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.RemoveAllJointActuatorEffortLimits()  # for servos are springs here, beside the motors
    if servo:  # to angle zero: the command carries the reference
        drives = [plant.get_joint_actuator(k) for k in plant.GetJointActuatorIndices()]
        joints = [plant.get_mutable_joint(k.joint().index()) for k in drives]
        for joint, kp, kd in zip(joints, given["kp"], given["kd"], strict=True):
            plant.AddForceElement(RevoluteSpring(joint, 0.0, kp))
            joint.set_default_damping(joint.default_damping() + kd)
    plant.Finalize()
    return plant


def put(plant, context, q, u):
    """Set joints, and the base at the origin with its twist."""
    base = plant.GetBodyByName("base")
    plant.SetPositions(context, np.concatenate([[1.0], np.zeros(6), q]))
    plant.SetVelocities(context, np.concatenate([np.zeros(6), u[6:]]))
    plant.SetFreeBodySpatialVelocity(context, base, SpatialVelocity(w=u[3:6], v=u[:3]))


def held(given):
    """Mass matrices."""
    plant = plant_of(given, free=False)
    context, out = plant.CreateDefaultContext(), []
    for q in given["q"]:
        plant.SetPositions(context, q)
        out.append(plant.CalcMassMatrix(context))
    return out


def accelerations(given):
    """Forward dynamics on the free body."""
    plant = plant_of(given, free=True)
    context, out = plant.CreateDefaultContext(), []
    for q, u, tau in zip(given["q"], given["u"], given["tau"], strict=True):
        put(plant, context, q, u)
        plant.get_actuation_input_port().FixValue(context, tau)
        rate = plant.EvalTimeDerivatives(context).get_generalized_velocity().CopyToVector()
        out.append(np.concatenate([rate[MOVED], rate[6:]]))
    return out


def path(given):
    """The closed loop, integrated to 1e-10."""
    plant = plant_of(given, free=True, servo=True)
    context = plant.CreateDefaultContext()
    put(plant, context, given["start_q"], given["start_u"])
    plant.get_actuation_input_port().FixValue(context, given["command"][0])
    simulator = Simulator(plant, context)
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 0.01)
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    out = []
    for k, command in enumerate(given["command"], start=1):
        plant.get_actuation_input_port().FixValue(context, command)
        simulator.AdvanceTo(k * float(given["period"]))
        at = plant.GetPositions(context)
        out.append(np.concatenate([at[7:], at[4:7], at[:4]]))
    return out


if __name__ == "__main__":
    given = dict(np.load(sys.argv[1]))
    np.savez(sys.argv[2], M=held(given), a=accelerations(given), path=path(given))
