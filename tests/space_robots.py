"""Free-floating robots described elsewhere, and SPARTpy's account of them.

    pip install spartpy intel-openmp
    python -m tests.space_robots

prints the figures that tests/mechanics/test_space_robots.py holds. SPARTpy (Virgili-Llop's
SPART, compiled) is LGPL and no part of the installation. Its base twist is angular velocity in
base axes, then linear velocity of the base's centre of mass in inertial axes.

SPARTpy 1.1.3 leaves the bodies on a fixed joint out of its inverse dynamics (and so out of the
velocity terms of its forward dynamics), not out of the inertia of its forward dynamics: where
velocities matter, what hangs on the last link is made part of it first (`merged`).
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Body:
    """Mass [kg], centre of mass in the link's frame [m], inertia there [kg m^2]."""

    mass: float
    com: Triple
    moments: Triple
    products: Triple = (0.0, 0.0, 0.0)  # xy, xz, yz: off the matrix's diagonal, with its sign


@dataclass(frozen=True)
class Robot:
    """A base, links that turn about their z, and a body fixed on the last one."""

    base: Body
    places: tuple[tuple[Triple, Triple], ...]  # xyz [m], rpy [rad] of each joint in the last
    links: tuple[Body, ...]
    tip: Triple  # of the end body, in the last link [m]
    end: Body | None

    @property
    def n(self) -> int:
        return len(self.links)

    def merged(self) -> Robot:
        """The end body made part of the last link."""
        if self.end is None:
            return self
        last = self.links[-1]
        a, b = np.array(last.com), np.array(self.tip)
        mass = last.mass + self.end.mass
        com = (last.mass * a + self.end.mass * b) / mass
        total = np.diag(last.moments) + np.diag(self.end.moments)
        for m, r in ((last.mass, a - com), (self.end.mass, b - com)):
            total += m * (r @ r * np.eye(3) - np.outer(r, r))
        assert np.allclose(total, np.diag(np.diag(total)))
        one = Body(mass, tuple(com.tolist()), tuple(np.diag(total).tolist()))
        return replace(self, links=(*self.links[:-1], one), end=None)

    def urdf(self) -> str:
        """A URDF file: links `body0` (the base) to `bodyN`, the tool `end`."""
        parts = [_link("body0", self.base)]
        for i, ((xyz, rpy), body) in enumerate(zip(self.places, self.links, strict=True), 1):
            parts.append(_link(f"body{i}", body))
            parts.append(
                f'<joint name="joint{i}" type="continuous"><parent link="body{i - 1}"/>'
                f'<child link="body{i}"/><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'
                '<axis xyz="0 0 1"/></joint>'
            )
        parts.append(_link("end", self.end or Body(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))))
        parts.append(
            f'<joint name="tool" type="fixed"><parent link="body{self.n}"/><child link="end"/>'
            f'<origin xyz="{_text(self.tip)}"/></joint>'
        )
        return f'<robot name="robot">{"".join(parts)}</robot>'


def _text(values: Triple) -> str:
    return " ".join(repr(float(k)) for k in values)


def _link(name: str, body: Body) -> str:
    xx, yy, zz = body.moments
    xy, xz, yz = body.products
    return (
        f'<link name="{name}"><inertial><origin xyz="{_text(body.com)}"/>'
        f'<mass value="{body.mass!r}"/><inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}"'
        f' ixy="{xy!r}" ixz="{xz!r}" iyz="{yz!r}"/></inertial></link>'
    )


# SPARTpy 1.1.3's own example, floating_7dof_manipulator.urdf: 1579 kg, arm of 82 kg.
CHASER = Robot(
    base=Body(1579.20, (0.0, 0.0, 0.0), (699.98, 1621.45, 1621.45)),
    places=(
        ((1.5, 0.0, 0.0), (3.1416, -1.570796, 0.0)),
        ((0.0, 0.084, 0.256), (-1.570796, 0.0, 0.0)),
        ((0.0, -1.774, 0.084), (1.5708, 3.1416, 0.0)),
        ((0.0, 0.084, 0.126), (-1.5708, 0.0, 0.0)),
        ((0.0, -1.604, 0.084), (1.5708, 3.1416, 0.0)),
        ((0.0, -0.084, 0.126), (1.5708, 0.0, 0.0)),
        ((0.0, 0.126, 0.084), (-1.5708, 0.0, 0.0)),
    ),
    links=(
        Body(10.0, (0.0, 0.042, 0.128), (0.0645, 0.0645, 0.0198)),
        Body(17.0, (0.0, -0.887, 0.042), (4.4752, 0.0337, 4.4752)),
        Body(10.0, (0.0, 0.042, 0.063), (0.0232, 0.0232, 0.0198)),
        Body(16.0, (0.0, -0.802, 0.042), (3.4463, 0.0318, 3.4463)),
        Body(10.0, (0.0, -0.042, 0.063), (0.0232, 0.0232, 0.0198)),
        Body(10.0, (0.0, 0.063, 0.042), (0.0232, 0.0198, 0.0232)),
        Body(7.0, (0.0, 0.0, 0.24275), (0.0574, 0.0574, 0.0139)),
    ),
    tip=(0.0, 0.0, 0.294),
    end=Body(2.0, (0.0, 0.0, 0.0), (0.0032, 0.0032, 0.0032)),
)
Q = np.deg2rad([30.0, 20.0, 30.0, 20.0, 30.0, 20.0, 30.0])  # of its example
RATE = np.arange(1, 8) / 10  # of its example: joints rad/s; the first six also of the base
TURN = np.array(
    [
        [np.cos(np.deg2rad(3.0)), 0.0, np.sin(np.deg2rad(3.0))],
        [0.0, 1.0, 0.0],
        [-np.sin(np.deg2rad(3.0)), 0.0, np.cos(np.deg2rad(3.0))],
    ]
)  # attitude, that of its example but exactly orthonormal

# Of the same authors' collection (URDF_models/floating_planar_4dof_manipulator.urdf).
_ROD = Body(5.0, (0.25, 0.0, 0.0), (0.0063, 0.1073, 0.1073))
PLANAR = Robot(
    base=Body(300.0, (0.0, 0.0, 0.0), (6.25, 6.25, 12.5)),
    places=(
        ((0.25, 0.0, 0.0), (0.0, 0.0, 0.0)),
        *((((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)),) * 3),
    ),
    links=(_ROD,) * 4,
    tip=(0.5, 0.0, 0.0),
    end=Body(1.0, (0.0, 0.0, 0.0), (0.001, 0.001, 0.001)),
)
PLANAR_Q = np.array([0.5, -0.9, 1.2, -0.4])  # rad
GOAL = np.array([-0.30, 0.40, 0.20])  # of the tool, in inertial axes: m, m, rad
STEPS = 100  # of the fourth-order Runge-Kutta method, over the whole motion

# ETS-VII: geometry of Yoshida, Int. J. Robotics Research 22 (2003), masses and inertias of
# Yoshida and Abiko (AIAA Guidance, Navigation and Control 2002), as transcribed in
# github.com/vyas-shubham/TraceableRobotModels, whose author chose the centres of mass.
ETS_VII = Robot(
    base=Body(2550.0, (0.0, 0.0, 0.0), (6200.0, 3540.0, 7090.0), (48.2, 78.5, -29.2)),
    places=(
        ((-0.79, -0.29, 1.0), (0.0, 0.0, 3.1416)),
        ((0.0, -0.275, 0.35), (-1.570796, 0.0, 0.0)),
        ((0.0, -0.87, 0.0), (0.0, 0.0, 0.0)),
        ((-0.63, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.26), (1.5708, 0.0, 0.0)),
        ((0.0, 0.0, 0.28), (0.0, -1.5708, 0.0)),
    ),
    links=(
        Body(35.0, (0.0, 0.0, 0.175), (0.25, 0.25, 1.69)),
        Body(22.5, (0.0, -0.435, 0.0), (0.1, 1.31, 3.75)),
        Body(21.9, (-0.275, 0.0, 0.0), (0.1, 0.71, 2.53)),
        Body(16.5, (0.0, 0.0, 0.1335), (0.15, 0.15, 0.073)),
        Body(26.0, (0.0, 0.0, 0.1385), (0.15, 0.15, 0.13)),
        Body(18.5, (0.0, 0.0, 0.133), (0.97, 0.97, 0.26)),
    ),
    tip=(0.0, 0.0, 0.53),
    end=None,
)
ETS_VII_Q = np.array([0.5, 0.9, -1.2, 0.4, 0.8, 0.3])  # rad


def possible(robot: Robot) -> Robot:
    """The robot with each link's largest moment no larger than the sum of the others."""

    def cut(body: Body) -> Body:
        small, middle, _ = sorted(body.moments)
        x, y, z = (min(k, small + middle) for k in body.moments)
        return replace(body, moments=(x, y, z))

    return replace(robot, links=tuple(cut(body) for body in robot.links))


class Spart:
    """SPARTpy on one robot."""

    def __init__(self, text: str) -> None:
        from SPARTpy import SPART

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(text)
            self.spart: Any = SPART(str(path))
        self.bodies = self.spart.robot.n_links_joints
        self.n = self.spart.robot.n_q

    def _motion(self, R: Array, q: Array, u0: Array, um: Array) -> tuple[Any, ...]:
        spart, r0 = self.spart, np.zeros(3)
        _, RL, _, rL, e, g = spart.kinematics(R, r0, q)
        Bij, Bi0, P0, pm = spart.diff_kinematics(R, r0, rL, e, g)
        t0, tL = spart.velocities(Bij, Bi0, P0, pm, u0, um)
        I0, Im = spart.i_i(R, RL)
        return t0, tL, P0, pm, I0, Im, Bij, Bi0

    def forces(self, R: Array, q: Array, u: Array, udot: Array) -> Array:
        """(6 + n,) wrench on the base and torques of a motion."""
        t0, tL, P0, pm, I0, Im, Bij, Bi0 = self._motion(R, q, u[:6], u[6:])
        t0dot, tLdot = self.spart.accelerations(
            t0, tL, P0, pm, Bi0, Bij, u[:6], u[6:], udot[:6], udot[6:]
        )
        free = (np.zeros(6), np.zeros((6, self.bodies)))
        return np.concatenate(
            self.spart.inverse_dynamics(*free, t0, tL, t0dot, tLdot, P0, pm, I0, Im, Bij, Bi0)
        )

    def accelerations(self, R: Array, q: Array, u: Array, tau: Array) -> Array:
        """(6 + n,) accelerations under a wrench on the base and torques."""
        t0, tL, P0, pm, I0, Im, Bij, Bi0 = self._motion(R, q, u[:6], u[6:])
        free = (np.zeros(6), np.zeros((6, self.bodies)))
        return np.concatenate(
            self.spart.forward_dynamics(
                tau[:6], tau[6:], *free, t0, tL, P0, pm, I0, Im, Bij, Bi0, u[:6], u[6:]
            )
        )

    def inertia(self, q: Array) -> Array:
        """(6 + n, 6 + n) generalised inertia, from forward dynamics at rest."""
        rest, R = np.zeros(6 + self.n), np.eye(3)
        return np.linalg.inv(
            np.array([self.accelerations(R, q, rest, e) for e in np.eye(6 + self.n)]).T
        )

    def response(self, q: Array, R: Array | None = None) -> Array:
        """(6, n) base twist per joint rate of a robot without momentum."""
        R = np.eye(3) if R is None else R
        rest, torques = np.zeros(6 + self.n), np.eye(6 + self.n)[6:]
        moved = np.array([self.accelerations(R, q, rest, tau) for tau in torques]).T
        return moved[:6] @ np.linalg.inv(moved[6:])

    def jacobian(self, q: Array, R: Array | None = None) -> Array:
        """(6, n) generalised Jacobian: twist of the end body, angular first, per joint rate."""
        R = np.eye(3) if R is None else R
        base = self.response(q, R)
        columns = [
            self._motion(R, q, base[:, i], e)[1][:, -1] for i, e in enumerate(np.eye(self.n))
        ]
        return np.array(columns).T


def planar_motion(jacobian: Any, response: Any) -> Array:
    """(STEPS + 1, 4 + 3) joints and base pose (x, y, angle): the tool on the line to GOAL.

    Resolved motion with the generalised Jacobian (Umetani and Yoshida 1989), least joint rates,
    quintic in time.

    Args:
        jacobian: (q, R) -> (6, 4).
        response: (q, R) -> (6, 4); both angular part first, linear in inertial axes.
    """

    def rate(s: float, z: Array) -> Array:
        c, d = np.cos(z[6]), np.sin(z[6])
        R = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]])
        speed = 30 * s**2 * (1 - s) ** 2
        qd = np.linalg.pinv(jacobian(z[:4], R)[[3, 4, 2]]) @ GOAL * speed
        return np.concatenate([qd, (response(z[:4], R) @ qd)[[3, 4, 2]]])

    path, h = [np.concatenate([PLANAR_Q, np.zeros(3)])], 1.0 / STEPS
    for k in range(STEPS):
        z, s = path[-1], k * h
        a = rate(s, z)
        b = rate(s + h / 2, z + h / 2 * a)
        c = rate(s + h / 2, z + h / 2 * b)
        d = rate(s + h, z + h * c)
        path.append(z + h / 6 * (a + 2 * b + 2 * c + d))
    return np.array(path)


def main() -> None:
    """Print what SPARTpy says."""
    np.set_printoptions(precision=15, linewidth=100)
    u = np.concatenate([RATE[:6], RATE])
    chaser, planar = Spart(CHASER.merged().urdf()), Spart(PLANAR.urdf())
    print("inertia, diagonal", repr(np.diag(chaser.inertia(Q))))
    print("base response to RATE", repr(chaser.response(Q) @ RATE))
    print("forces", repr(chaser.forces(TURN, Q, u, u / 10)))
    print("accelerations", repr(chaser.accelerations(TURN, Q, u, 10 * u)))
    print("generalised Jacobian", repr(planar.jacobian(PLANAR_Q)[[3, 4, 2]]))
    ets = Spart(possible(ETS_VII).urdf())
    print("ETS-VII, attitude per joint rates", repr(ets.response(ETS_VII_Q)[:3]))
    print("resolved motion", repr(planar_motion(planar.jacobian, planar.response)[-1]))


if __name__ == "__main__":
    main()
