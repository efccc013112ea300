"""Basilisk: a satellite that acts, an arm on it. `basilisk_servicer.py IN.npz OUT.npz`.

In: rows of `hub` (rigid bodies: mass, centre, inertia, 13 numbers), `links` (rotation and
position of each joint in the one before, then the body, 25), `wheels` (axis, inertia, viscous,
coulomb), `panels` (hinge: point, axis, stiffness, damping, body), `slosh` (axis, mass, place,
stiffness, damping), `jets` (place, direction, thrust); a loop as of `servo_loop`, with
`wheel_torque` and `on` (periods, ...). Out: `path`, as of `servo_loop`.
"""

import itertools
import sys

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import (
    THRSimConfig,
    hingedRigidBodyStateEffector,
    linearSpringMassDamper,
    reactionWheelStateEffector,
    spacecraft,
    spinningBodyNDOFStateEffector,
    svIntegrators,
    thrusterDynamicEffector,
)
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros, simIncludeRW

STEP = 0.625e-3  # s


def body(row):
    """Mass, centre of mass and inertia about it."""
    return row[0], row[1:4], row[4:13].reshape(3, 3)


def together(rows):
    """One rigid body of several."""
    mass = sum(row[0] for row in rows)
    centre = sum(row[0] * row[1:4] for row in rows) / mass
    about = np.zeros((3, 3))
    for m, c, I in map(body, rows):
        d = c - centre
        about += I + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, centre, about


def column(vector):
    """A vector as Basilisk takes it."""
    return [[float(k)] for k in vector]


def bodies(given):
    """Mass, centre and velocity of all bodies at the start, in the hub's axes."""
    v, spin, rates = given["start_u"][:3], given["start_u"][3:6], given["start_u"][6:]
    fixed = [*given["hub"], *(row[8:] for row in given["panels"])]
    fixed += [row[3:7] for row in given["slosh"]]
    out = [(row[0], row[1:4], v + np.cross(spin, row[1:4])) for row in fixed]
    R, p = np.eye(3), np.zeros(3)
    for row, q, rate in zip(given["links"], given["start_q"], rates, strict=True):
        step, R = R @ row[9:12], R @ row[:9].reshape(3, 3)
        p, v, spin = p + step, v + np.cross(spin, step), spin + rate * R[:, 2]
        R = R @ np.array([[np.cos(q), -np.sin(q), 0], [np.sin(q), np.cos(q), 0], [0, 0, 1]])
        c = R @ row[13:16]
        out.append((row[12], p + c, v + np.cross(spin, c)))
    return out


def arm_of(given):
    """The arm as a chain of spinning bodies, servos as springs."""
    arm = spinningBodyNDOFStateEffector.SpinningBodyNDOFStateEffector()
    for i, row in enumerate(given["links"]):
        m, c, I = body(row[12:])
        link = spinningBodyNDOFStateEffector.SpinningBody()
        link.setMass(float(m))
        link.setDCM_S0P(row[:9].reshape(3, 3).T.tolist())
        link.setR_SP_P(column(row[9:12]))
        link.setR_ScS_S(column(c))
        link.setISPntSc_S(I.tolist())
        link.setSHat_S([[0], [0], [1]])
        link.setK(float(given["kp"][i]))
        link.setC(float(given["kd"][i]))
        link.setThetaInit(float(given["start_q"][i]))
        link.setThetaDotInit(float(given["start_u"][6 + i]))
        arm.addSpinningBody(link)
    return arm


def panel_of(row):
    """A hinged body: it turns about its second axis, its centre lies against the first."""
    point, axis, (k, c) = row[:3], row[3:6], row[6:8]
    m, centre, I = body(row[8:])
    panel = hingedRigidBodyStateEffector.HingedRigidBodyStateEffector()
    d = np.linalg.norm(centre - point)
    first = -(centre - point) / d
    axes = np.array([first, axis, np.cross(first, axis)])
    panel.mass, panel.d, panel.k, panel.c = float(m), float(d), float(k), float(c)
    panel.r_HB_B, panel.dcm_HB = column(point), axes.tolist()
    panel.IPntS_S = (axes @ I @ axes.T).tolist()
    panel.thetaInit = panel.thetaDotInit = 0.0
    return panel


def slosh_of(row):
    """A mass on a spring."""
    mass = linearSpringMassDamper.LinearSpringMassDamper()
    mass.pHat_B, mass.massInit, mass.r_PB_B = column(row[:3]), float(row[3]), column(row[4:7])
    mass.k, mass.c = float(row[7]), float(row[8])
    mass.rhoInit = mass.rhoDotInit = 0.0
    return mass


def wheels_of(given, hub):
    """Balanced wheels, their inertia at rest within the hub."""
    factory = simIncludeRW.rwFactory()
    for row, speed in zip(given["wheels"], given["wheel_speed"], strict=True):
        factory.create(
            "custom", row[:3], Omega=float(speed / macros.RPM), Js=float(row[3]),
            cViscous=float(row[4]), fCoulomb=float(row[5]), RWModel=messaging.BalancedWheels,
            useRWfriction=True, useMaxTorque=False, useMinTorque=False,
        )  # fmt: skip
    effector = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft("wheels", effector, hub)
    return effector


def jets_of(given):
    """Thrusters without ramps."""
    effector = thrusterDynamicEffector.ThrusterDynamicEffector()
    for row in given["jets"]:
        jet = THRSimConfig.THRSimConfig()
        jet.thrLoc_B, jet.thrDir_B = column(row[:3]), column(row[3:6])
        jet.MaxThrust, jet.steadyIsp, jet.MinOnTime = float(row[6]), 290.0, 1e-6
        effector.addThruster(jet)
    return effector


def value(hub, name):
    """A state after the last step; messages of effectors are of the step before."""
    return np.ravel(hub.dynManager.getStateObject(name).getState())


def hub_of(given):
    """The satellite's body with the arm's base link, as it starts."""
    craft = spacecraft.Spacecraft()
    craft.setIntegrator(svIntegrators.svIntegratorRK4(craft))
    mass, centre, about = together(given["hub"])
    hub, moving = craft.hub, bodies(given)
    hub.mHub, hub.r_BcB_B, hub.IHubPntBc_B = float(mass), column(centre), about.tolist()
    total = sum(m for m, _, _ in moving)
    hub.r_CN_NInit = column(sum(m * c for m, c, _ in moving) / total)
    hub.v_CN_NInit = column(sum(m * v for m, _, v in moving) / total)
    hub.sigma_BNInit = column(np.zeros(3))
    hub.omega_BN_BInit = column(given["start_u"][3:6])
    return craft


def burns(on):
    """Periods that a command of the jets holds, by the one in which it is given."""
    changes = 1 + np.flatnonzero((on[1:] != on[:-1]).any(axis=1))
    edges = [0, *changes, len(on)]
    return {start: end - start for start, end in itertools.pairwise(edges)}


def main(given):
    """Play the loop; the path after each period."""
    craft = hub_of(given)
    arm, wheels, jets = arm_of(given), wheels_of(given, craft), jets_of(given)
    panels, slosh = map(panel_of, given["panels"]), map(slosh_of, given["slosh"])
    passive = [*panels, *slosh]
    for effector in (arm, *passive):
        craft.addStateEffector(effector)
    craft.addDynamicEffector(jets)
    simulation = SimulationBaseClass.SimBaseClass()
    task = simulation.CreateNewTask("t", macros.sec2nano(STEP))
    simulation.CreateNewProcess("p").addTask(task)
    for k, model in enumerate((wheels, jets, arm, *passive, craft)):
        model.ModelTag = f"model{k}"
        simulation.AddModelToTask("t", model)
    torque, motor = messaging.ArrayMotorTorqueMsg(), messaging.ArrayMotorTorqueMsg()
    burn = messaging.THRArrayOnTimeCmdMsg()
    arm.motorTorqueInMsg.subscribeTo(torque)
    wheels.rwMotorCmdInMsg.subscribeTo(motor)
    jets.cmdsInMsg.subscribeTo(burn)
    simulation.InitializeSimulation()
    out, period, lengths = [], float(given["period"]), burns(given["on"])
    for k, command in enumerate(given["command"]):
        now = macros.sec2nano(k * period)
        torque.write(messaging.ArrayMotorTorqueMsgPayload(motorTorque=command.tolist()), now)
        turn = given["wheel_torque"][k].tolist()
        motor.write(messaging.ArrayMotorTorqueMsgPayload(motorTorque=turn), now)
        if k in lengths:
            lit = (given["on"][k] * lengths[k] * period).tolist()
            burn.write(messaging.THRArrayOnTimeCmdMsgPayload(OnTimeRequest=lit), now)
        simulation.ConfigureStopTime(macros.sec2nano((k + 1) * period))
        simulation.ExecuteSimulation()
        out.append(path_of(craft, arm, wheels, len(given["wheels"]), passive))
    return np.array(out)


def path_of(craft, arm, wheels, w, passive):
    """Joints, position, quaternion, wheels' speeds, ways of panels and sloshing masses."""
    state = craft.scStateOutMsg.read()
    quaternion = RigidBodyKinematics.MRP2EP(np.array(state.sigma_BN))
    speeds = wheels.rwSpeedOutMsg.read().wheelSpeeds[:w]
    names = [arm.getNameOfThetaState()]
    names += [getattr(k, "nameOfThetaState", None) or k.nameOfRhoState for k in passive]
    # messages of effectors are of the step before
    ways = [np.ravel(craft.dynManager.getStateObject(k).getState()) for k in names]
    return np.concatenate([ways[0], state.r_BN_N, quaternion, speeds, *ways[1:]])


if __name__ == "__main__":
    np.savez(sys.argv[2], path=main(dict(np.load(sys.argv[1]))))
