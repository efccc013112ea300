"""Basilisk: a satellite that acts, an arm on it. `basilisk_servicer.py IN.npz OUT.npz`.

In: rows of `hub` (rigid bodies: mass, centre, inertia, 13 numbers), `links` (rotation and
position of each joint in the one before, then the body, 25), `wheels` (axis, inertia, viscous,
coulomb), `panels` (hinge: point, axis, stiffness, damping, body), `slosh` (axis, mass, place,
stiffness, damping), `jets` (place, direction, thrust); a loop as of `servo_loop`, with
`wheel_torque` and `on` (periods, ...); `command`, `start_q`, `start_u` have runs in front.
Out: `path` (runs, periods, ...), as of `servo_loop`; `E`, `strain` (runs, periods): energy of
the base with arm and wheels locked at that instant, what springs hold of it [J].
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


def links_at(given, q):
    """Rotation and position of each link's frame in the hub's axes."""
    R, p, out = np.eye(3), np.zeros(3), []
    for row, angle in zip(given["links"], q, strict=True):
        p, R = p + R @ row[9:12], R @ row[:9].reshape(3, 3) @ turned([0, 0, 1], angle)
        out.append((R, p))
    return out


def turned(axis, angle):
    """A rotation (Rodrigues)."""
    x = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * x + (1 - np.cos(angle)) * x @ x


def bodies(given):
    """Mass, centre and velocity of all bodies at the start, in the hub's axes."""
    v, spin, rates = given["start_u"][:3], given["start_u"][3:6], given["start_u"][6:]
    fixed = [*given["hub"], *(row[8:] for row in given["panels"])]
    fixed += [row[3:7] for row in given["slosh"]]
    out, before = (
        [(row[0], row[1:4], v + np.cross(spin, row[1:4])) for row in fixed],
        np.zeros(3),
    )
    for row, rate, (R, p) in zip(
        given["links"], rates, links_at(given, given["start_q"]), strict=True
    ):
        v, spin = v + np.cross(spin, p - before), spin + rate * R[:, 2]
        c, before = R @ row[13:16], p
        out.append((row[12], p + c, v + np.cross(spin, c)))
    return out


def energy(given, v, w, q, ways, rates):
    """Energy of the base, arm and wheels locked, and what springs hold of it.

    Args:
        v, w: velocity of the hub's origin and its spin, its axes.
        q: joints.
        ways, rates: of panels, then of sloshing masses.
    """
    total, strain = 0.0, 0.0

    def add(m, c, I, v, w):
        nonlocal total
        total += 0.5 * m * v @ v + 0.5 * w @ I @ w

    for m, c, I in map(body, given["hub"]):
        add(m, c, I, v + np.cross(w, c), w)
    for row, (R, p) in zip(given["links"], links_at(given, q), strict=True):
        m, c, I = body(row[12:])
        c = p + R @ c
        add(m, c, R @ I @ R.T, v + np.cross(w, c), w)
    k = len(given["panels"])
    for row, at, rate in zip(given["panels"], ways[:k], rates[:k], strict=True):
        R, point, axis, (m, c, I) = turned(row[3:6], at), row[:3], row[3:6], body(row[8:])
        arm, strain = R @ (c - point), strain + 0.5 * row[6] * at**2
        moved = v + np.cross(w, point + arm) + rate * np.cross(axis, arm)
        add(m, c, R @ I @ R.T, moved, w + rate * axis)
    for row, at, rate in zip(given["slosh"], ways[k:], rates[k:], strict=True):
        c, strain = row[4:7] + at * row[:3], strain + 0.5 * row[7] * at**2
        add(row[3], c, np.zeros((3, 3)), v + np.cross(w, c) + rate * row[:3], w)
    return total + strain, strain


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
    """Play one run: path, energy and strain energy after each period."""
    craft = hub_of(given)
    arm, wheels, jets = arm_of(given), wheels_of(given, craft), jets_of(given)
    panels, slosh = map(panel_of, given["panels"]), map(slosh_of, given["slosh"])
    passive = [*panels, *slosh]
    for effector in (arm, *passive):
        craft.addStateEffector(effector)
    craft.addDynamicEffector(jets)
    simulation = SimulationBaseClass.SimBaseClass()
    task = simulation.CreateNewTask("t", macros.sec2nano(float(given["step"])))
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
        out.append(path_of(given, craft, arm, wheels, passive))
    return [np.array(k) for k in zip(*out, strict=True)]


def path_of(given, craft, arm, wheels, passive):
    """Joints, position, quaternion, wheels' speeds, ways of panels and masses; energies."""

    def value(name):  # messages of effectors are of the step before
        return np.ravel(craft.dynManager.getStateObject(name).getState())

    state, panels = craft.scStateOutMsg.read(), len(given["panels"])
    sigma, v = np.array(state.sigma_BN), np.array(state.v_BN_N)
    q = value(arm.getNameOfThetaState())
    names = ["Theta" if i < panels else "Rho" for i in range(len(passive))]
    ways, rates = (
        np.array([
            value(getattr(k, f"nameOf{name}{dot}State"))[0]
            for k, name in zip(passive, names, strict=True)
        ])
        for dot in ("", "Dot")
    )  # fmt: skip
    speeds = wheels.rwSpeedOutMsg.read().wheelSpeeds[: len(given["wheels"])]
    pose = [q, state.r_BN_N, RigidBodyKinematics.MRP2EP(sigma)]
    v = RigidBodyKinematics.MRP2C(sigma) @ v
    held = energy(given, v, np.array(state.omega_BN_B), q, ways, rates)
    return np.concatenate([*pose, speeds, ways]), *held


if __name__ == "__main__":
    given = dict(np.load(sys.argv[1]))
    varied = ("command", "start_q", "start_u")
    runs = [
        main({**given, **{k: given[k][i] for k in varied}})
        for i in range(len(given["command"]))
    ]
    path, E, strain = (np.array(k) for k in zip(*runs, strict=True))
    np.savez(sys.argv[2], path=path, E=E, strain=strain)
