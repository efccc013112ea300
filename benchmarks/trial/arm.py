"""An arm and rigid bodies on a base of six coordinates, by MuJoCo.

The model text is written here from the numbers of a description (`[arm]` and `[vehicle]` of a
`system.toml`): Denavit-Hartenberg links, each with its inertia in the frame at its end. Base
coordinates are Y = (x, y, z, phi_x, phi_y, phi_z), R = Rz Ry Rx.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Table = Mapping[str, Any]

GRAVITY = 9.81  # m/s^2
BASE = np.array([0, 1, 2, 5, 4, 3])  # MuJoCo's coordinates in the order of Y


def turn_x(angle: float) -> Array:
    """Rotation about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation(angles: npt.ArrayLike) -> Array:
    """R = Rz Ry Rx of angles about x, y, z [rad]."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def twist_matrix(y: Array) -> Array:
    """T (6, 6) with (velocity, angular velocity) in platform axes = T Y', at pose Y."""
    T = np.zeros((6, 6))
    R = rotation(y[3:])
    T[:3, :3] = R.T
    (cx, cy), (sx, sy) = np.cos(y[3:5]), np.sin(y[3:5])
    T[3:, 3:] = [[1.0, 0.0, -sy], [0.0, cx, sx * cy], [0.0, -sx, cx * cy]]
    return T


def _inertial(mass: float, com: Array, inertia: Array) -> str:
    """Text of an inertia about its centre of mass.

    MuJoCo refuses a body whose moments miss A + B >= C by rounding, as a flat one's may.
    """
    i = inertia + 1e-10 * np.trace(inertia) * np.eye(3)
    six = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    return (
        f'<inertial mass="{mass!r}" pos="{" ".join(repr(float(c)) for c in com)}" '
        f'fullinertia="{" ".join(repr(float(v)) for v in six)}"/>'
    )


def _quaternion(R: Array) -> str:
    """Text of a rotation."""
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R).ravel())
    return " ".join(repr(float(v)) for v in q)


def model_text(base: Table | None, links: Sequence[Table]) -> str:
    """MJCF of a base link on six coordinates, and links after it.

    Args:
        base: `mass`, `com`, `inertia` of what is fixed to the base.
        links: rows of Denavit and Hartenberg, with `inertial` and `rotor_inertia`.
    """
    joints = "".join(
        f'<joint type="{kind}" axis="{axis}"/>'
        for kind, axis in (
            ("slide", "1 0 0"),
            ("slide", "0 1 0"),
            ("slide", "0 0 1"),
            ("hinge", "0 0 1"),
            ("hinge", "0 1 0"),
            ("hinge", "1 0 0"),
        )
    )
    body = ""
    if base is not None:
        body = _inertial(base["mass"], np.asarray(base["com"]), np.asarray(base["inertia"]))
    text, end = f'<body name="base">{joints}{body}', "</body>"
    place, R = np.zeros(3), np.eye(3)
    for k, link in enumerate(links):
        zero = link.get("offset") or 0.0
        turn = R @ np.array(
            [[np.cos(zero), -np.sin(zero), 0.0], [np.sin(zero), np.cos(zero), 0.0], [0, 0, 1.0]]
        )
        A, step = turn_x(link["alpha"]), np.array([link["a"], 0.0, link["d"]])
        part = link["inertial"]
        com = step + A @ np.asarray(part["com"])
        inertia = A @ np.asarray(part["inertia"]) @ A.T
        text += (
            f'<body name="link{k}" pos="{" ".join(repr(float(p)) for p in place)}" '
            f'quat="{_quaternion(turn)}"><joint type="hinge" axis="0 0 1" '
            f'armature="{float(link["rotor_inertia"])!r}"/>'
            f"{_inertial(part['mass'], com, inertia)}"
        )
        end += "</body>"
        place, R = step, A
    return (
        '<mujoco><compiler angle="radian" balanceinertia="false"/>'
        f'<option gravity="0 0 0"/><worldbody>{text}{end}</worldbody></mujoco>'
    )


class Bodies:
    """Inertia and velocity terms of a base link and n links behind it."""

    def __init__(self, base: Table | None, links: Sequence[Table]) -> None:
        self.model = mujoco.MjModel.from_xml_string(model_text(base, links))
        self.data = mujoco.MjData(self.model)
        self.n = len(links)
        self.order = np.concatenate([BASE, 6 + np.arange(self.n)])
        self._mixed = np.ix_(self.order, self.order)
        self._full = np.zeros((6 + self.n, 6 + self.n))
        self._bias = np.zeros(6 + self.n)
        self.mass = float(self.model.body_mass.sum())

    def terms(self, z: Array, rate: Array) -> tuple[Array, Array]:
        """Return M(z) and c(z, z') of M z'' + c = forces, without gravity.

        Args:
            z: (6 + n,) base coordinates [m, rad] and joint angles [rad].
            rate: (6 + n,) their rates.

        Returns:
            (6 + n, 6 + n) and (6 + n,), in the order of z.
        """
        m, d = self.model, self.data
        d.qpos[self.order] = z
        d.qvel[self.order] = rate
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_makeM(m, d)
        mujoco.mj_fullM(m, d, self._full)
        mujoco.mj_comVel(m, d)
        mujoco.mj_rne(m, d, 0, self._bias)
        return self._full[self._mixed], self._bias[self.order]

    def weight(self, z: Array) -> Array:
        """Return the generalised forces (6 + n,) of the weight of all bodies at z."""
        m, d = self.model, self.data
        d.qpos[self.order] = z
        d.qvel[:] = 0.0
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_comVel(m, d)
        m.opt.gravity[2] = -GRAVITY
        mujoco.mj_rne(m, d, 0, self._bias)
        m.opt.gravity[2] = 0.0
        return -self._bias[self.order]


def arm_bodies(arm: Table) -> Bodies:
    """Bodies of an arm's description: its base link and its links."""
    return Bodies(arm["base"], arm["links"])
