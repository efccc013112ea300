"""Exudyn: an arm on a clamped chain of tubes, as geometrically exact beams.

`exudyn_beam.py IN.npz OUT.npz`. In: `members` (vector from clamp to flange, outer diameter,
wall), `material` (E, G, rho), `hub` (the arm's base link: mass, centre, inertia), `links`
(rotation and position of each joint in the one before, then the body), `kp`, `kd` of servos to
angle zero, `command` (runs, steps + 1, n) [N m] at multiples of `step` s, from rest at
`start_q` (runs, n). Out: `E` (runs, steps + 1), energy of the base with the joints locked at
that instant. Undamped: its beams take no damping matrix.
"""

import itertools
import sys

import exudyn as exu
import numpy as np
from exudyn.utilities import (
    GenericJoint,
    MarkerBodyRigid,
    MarkerNodeRigid,
    NodeRigidBodyEP,
    ObjectBeamGeometricallyExact,
    RigidBodyInertia,
    RotationMatrix2EulerParameters,
)

ELEMENTS = 32  # of all members
FIXED = [1] * 6
OUT = exu.OutputVariableType


def section_of(outer, wall, material):
    """A tube that stretches, shears (Cowper), twists and bends."""
    E, G, rho = material
    nu = E / 2 / G - 1
    a, b = outer / 2, outer / 2 - wall
    A, I = np.pi * (a**2 - b**2), np.pi / 4 * (a**4 - b**4)
    m = b / a
    even = (1 + m**2) ** 2
    shear = 6 * (1 + nu) * even / ((7 + 6 * nu) * even + (20 + 12 * nu) * m**2)
    section = exu.BeamSection()
    C = np.diag([E * A, shear * G * A, shear * G * A, 2 * G * I, E * I, E * I])
    section.stiffnessMatrix, section.massPerLength = C, rho * A
    section.inertia = rho * np.diag([2 * I, I, I])
    return section


def along(vector):
    """A frame whose first axis lies along a vector."""
    x = vector / np.linalg.norm(vector)
    y = np.cross([0.0, 1.0, 0.0] if abs(x[1]) < 0.9 else [0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def weld(mbs, one, other, R_one, R_other):
    """Join two markers whose frames are R_one and R_other."""
    mbs.AddObject(
        GenericJoint(
            markerNumbers=[one, other], constrainedAxes=FIXED,
            rotationMarker0=R_one.T, rotationMarker1=R_other.T,
        )
    )  # fmt: skip


def beam(mbs, given):
    """Members from clamp to flange, the flange at the origin: elements and last node."""
    at = -given["members"][:, :3].sum(axis=0)
    ground = mbs.CreateGround(referencePosition=at.tolist())
    last, R_last = mbs.AddMarker(MarkerBodyRigid(bodyNumber=ground)), np.eye(3)
    elements, node, count = [], None, ELEMENTS // len(given["members"])
    for row in given["members"]:
        R, section = along(row[:3]), section_of(*row[3:], given["material"])
        turn = list(RotationMatrix2EulerParameters(R))
        nodes = [
            mbs.AddNode(NodeRigidBodyEP(referenceCoordinates=[*(at + s * row[:3]), *turn]))
            for s in np.linspace(0, 1, count + 1)
        ]
        weld(mbs, last, mbs.AddMarker(MarkerNodeRigid(nodeNumber=nodes[0])), R_last, R)
        length = np.linalg.norm(row[:3]) / count
        for pair in itertools.pairwise(nodes):
            element = ObjectBeamGeometricallyExact(
                nodeNumbers=list(pair), length=length, sectionData=section
            )
            elements.append(mbs.AddObject(element))
        node, at = nodes[-1], at + row[:3]
        last, R_last = mbs.AddMarker(MarkerNodeRigid(nodeNumber=node)), R
    return elements, node, last, R_last


def arm(mbs, given, start, torques, flange, R_flange):
    """Bodies at their centres of mass, joined at the start: bodies and motors."""

    def body(row, R, p):
        inertia = RigidBodyInertia(mass=row[0], inertiaTensor=row[4:13].reshape(3, 3))
        return mbs.CreateRigidBody(
            referencePosition=list(p + R @ row[1:4]), referenceRotationMatrix=R, inertia=inertia
        )

    R, p = np.eye(3), np.zeros(3)
    bodies, motors = [body(given["hub"], R, p)], []
    centre = (-given["hub"][1:4]).tolist()
    marker = mbs.AddMarker(MarkerBodyRigid(bodyNumber=bodies[0], localPosition=centre))
    weld(mbs, flange, marker, R_flange, R)
    for row, q, kp, kd, torque in zip(
        given["links"], start, given["kp"], given["kd"], torques, strict=True
    ):
        R, p = R @ row[:9].reshape(3, 3), p + R @ row[9:12]
        axis = R[:, 2].tolist()
        R = R @ np.array([[np.cos(q), -np.sin(q), 0], [np.sin(q), np.cos(q), 0], [0, 0, 1]])
        bodies.append(body(row[12:], R, p))
        pair = {"itemNumbers": bodies[-2:], "position": p.tolist(), "axis": axis}
        mbs.CreateRevoluteJoint(**pair)
        motors.append(
            mbs.CreateTorsionalSpringDamper(
                **pair, stiffness=kp, damping=kd, offset=-q, torque=-torque
            )
        )
    return bodies, motors


def base_energy(mbs, elements, node, bodies, rows):
    """Energy of the beam, and of the arm's bodies as the flange carries them along."""
    E = sum(
        mbs.GetObjectOutputBody(k, OUT.KineticEnergy)
        + mbs.GetObjectOutputBody(k, OUT.PotentialEnergy)
        for k in elements
    )
    origin, v, w = (
        np.array(mbs.GetNodeOutput(node, kind))
        for kind in (OUT.Position, OUT.Velocity, OUT.AngularVelocity)
    )
    for body, row in zip(bodies, rows, strict=True):
        p = np.array(mbs.GetObjectOutputBody(body, OUT.Position))
        R = np.array(mbs.GetObjectOutputBody(body, OUT.RotationMatrix)).reshape(3, 3)
        moving, turning = v + np.cross(w, p - origin), R.T @ w
        E += 0.5 * row[0] * moving @ moving
        E += 0.5 * turning @ row[4:13].reshape(3, 3) @ turning
    return E


def play(given, run):
    """Energies of one run."""
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    elements, node, flange, R_flange = beam(mbs, given)
    commands, out = given["command"][run], []
    bodies, motors = arm(mbs, given, given["start_q"][run], commands[0], flange, R_flange)
    rows = [given["hub"], *(row[12:] for row in given["links"])]
    mbs.Assemble()

    def before(mbs, t):
        out.append(base_energy(mbs, elements, node, bodies, rows))
        command = commands[min(round(t / float(given["step"])), len(commands) - 1)]
        for motor, torque in zip(motors, command, strict=True):
            mbs.SetObjectParameter(motor, "torque", -float(torque))
        return True

    mbs.SetPreStepUserFunction(before)
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps = len(commands) - 1
    settings.timeIntegration.endTime = (len(commands) - 1) * float(given["step"])
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.newton.absoluteTolerance = 1e-4  # rounding of EA
    settings.timeIntegration.newton.relativeTolerance = 1e-7
    settings.timeIntegration.adaptiveStep = False  # a failure is an error, not a long wait
    settings.solutionSettings.writeSolutionToFile = False
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
    out.append(base_energy(mbs, elements, node, bodies, rows))
    return out


if __name__ == "__main__":
    given = dict(np.load(sys.argv[1]))
    runs = range(len(given["command"]))
    np.savez(sys.argv[2], E=[play(given, k) for k in runs])
