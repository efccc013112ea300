"""A PUMA 560 on a free cube that meets a ball, as MJCF written by hand, run by plain MuJoCo.

Nothing here asks the package for a model: the numbers are those of thesis Appendix B and of
the scene, the base floats on MuJoCo's own free joint, and the contact's law is restated.
"""

from __future__ import annotations

import mujoco
import numpy as np

Array = np.ndarray

STIFFNESS, DAMPING, FRICTION, SLIP_TIME = 2e4, 60.0, 0.2, 0.01
BALL = {"mass": 12.0, "moments": (0.3, 0.5, 0.4), "com": (0.01, -0.02, 0.015), "radius": 0.2}
PAD, STEP = 0.05, 1.25e-3
CUBE = {"mass": 500.0, "moments": (187.5, 187.5, 187.5), "com": (0.0, 0.0, -0.75)}

# d, a, alpha, mass, centre, moments, rotor (thesis Appendix B, as docs/errata.md reads it)
PUMA = (
    (0.22844 + 0.672, 0.0, 90, 12.8, (0, 0, -0.056), (0.615, 0.615, 0.081), 1.14),
    (-0.2435, 0.4318, 0, 17.4, (-0.3638, 0.006, 0.016), (0.130, 0.524, 0.539), 4.710),
    (0.098, 0.4331, 0, 9.0, (-0.1420, 0.0, 0.0), (0.015, 0.574, 0.589), 0.835),
)


def _text(*values: float) -> str:
    return " ".join(repr(float(k)) for k in np.ravel(values))


def _inertial(mass: float, com: object, moments: object) -> str:
    return f'<inertial mass="{mass!r}" pos="{_text(com)}" diaginertia="{_text(moments)}"/>'


def _link(i: int, inside: str) -> str:
    d, a, alpha, mass, com, moments, rotor = PUMA[i]
    turn = _text(np.cos(np.deg2rad(alpha) / 2), np.sin(np.deg2rad(alpha) / 2), 0, 0)
    return (
        f'<body name="joint{i}"><joint name="q{i}" axis="0 0 1" armature="{rotor}"/>'
        f'<body name="link{i}" pos="{_text(a, 0, d)}" quat="{turn}">'
        f"{_inertial(mass, com, moments)}{inside}</body></body>"
    )


def mjcf(
    kp: Array, kd: Array, law: tuple[float, float], held: tuple[Array, Array] | None
) -> str:
    """The scene; `law` is solref of the pair, `held` place and quaternion on the tool."""
    shape = f'<geom name="ball" size="{BALL["radius"]}" mass="0" contype="0" conaffinity="0"/>'
    body = _inertial(BALL["mass"], BALL["com"], BALL["moments"]) + shape
    pad = f'<geom name="pad" size="{PAD}" mass="0" contype="0" conaffinity="0"/>'
    inside = f'<site name="tool"/>{pad}'
    free = f'<body name="ball"><freejoint/>{body}</body>'
    if held is not None:
        inside += (
            f'<body name="ball" pos="{_text(held[0])}" quat="{_text(held[1])}">{body}</body>'
        )
        free = ""
    for i in (2, 1, 0):
        inside = _link(i, inside)
    servo = "".join(
        f'<general joint="q{i}" gaintype="fixed" gainprm="1" biastype="affine"'
        f' biasprm="0 {_text(-kp[i], -kd[i])}"/>'
        for i in range(3)
    )
    sliding = f"{FRICTION} {FRICTION} 0 0 0"
    pair = (
        f'<pair geom1="pad" geom2="ball" condim="3" friction="{sliding}" margin="0"'
        f' solref="{_text(*law)}" solreffriction="{_text(-1e-12, -1e-4 / SLIP_TIME)}"'
        ' solimp="1e-4 1e-4 1e-3 0.5 2"/>'
    )
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/>'
        f'<option timestep="{STEP}" integrator="RK4" gravity="0 0 0" cone="elliptic"'
        ' impratio="1e5" tolerance="1e-15" iterations="100"/>'
        '<worldbody><body name="cube"><freejoint/>'
        f"{_inertial(CUBE['mass'], CUBE['com'], CUBE['moments'])}"
        f'<body name="foot">{_inertial(54.5, (0, 0, 0.283), (6.686, 6.465, 1.815))}</body>'
        f"{inside}</body>{free}</worldbody>"
        f"<contact>{'' if held is not None else pair}</contact><actuator>{servo}</actuator>"
        "</mujoco>"
    )


def free_model(kp: Array, kd: Array) -> mujoco.MjModel:
    """Arm and free ball: the contact in accelerations, as MuJoCo states it."""
    model = mujoco.MjModel.from_xml_string(mjcf(kp, kd, (-1.0, -1.0), None))
    inverse = model.body("link2").invweight0[0] + model.body("ball").invweight0[0]
    text = mjcf(kp, kd, (-STIFFNESS * inverse, -DAMPING * inverse), None)
    return mujoco.MjModel.from_xml_string(text)


def run(
    kp: Array,
    kd: Array,
    start: Array,
    rates: Array,
    ball: tuple[Array, Array, Array, Array],
    hold: Array,
    steps: tuple[int, int],
) -> tuple[Array, Array]:
    """Meet the ball for some steps, catch it as a latch would, and carry it for some more.

    Args:
        kp, kd: (3,) of the servo, which holds `hold` (3,) [rad].
        start, rates: (3,) joint angles and rates, the cube at rest at the origin.
        ball: place, quaternion, velocity of its origin, spin in its own axes.
        steps: before the catch, and after it.

    Returns:
        (N, 3 + 3 + 4 + 3) joint angles, place and quaternion of the cube, place of the ball, at
        each step; (N, 3) force of the contact on the ball.
    """
    model = free_model(kp, kd)
    data = mujoco.MjData(model)
    data.qpos[:] = np.r_[0, 0, 0, 1, 0, 0, 0, start, ball[0], ball[1]]
    data.qvel[:] = np.r_[np.zeros(6), rates, ball[2], ball[3]]
    rows, forces = [], []
    for part, count in enumerate(steps):
        data.ctrl[:] = kp * hold
        for _ in range(count + part):
            mujoco.mj_forward(model, data)
            at = data.body("ball").xpos
            rows.append(np.r_[data.qpos[7:10], data.qpos[:7], at])
            free = model.nv == 15
            forces.append(data.qfrc_constraint[9:12].copy() if free else np.zeros(3))
            mujoco.mj_step(model, data)
        if part == 0:
            model, data = _caught(model, data, kp, kd)
    return np.array(rows), np.array(forces)


def _caught(
    model: mujoco.MjModel, data: mujoco.MjData, kp: Array, kd: Array
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The ball on the tool as it sits now, after the impulse that stops it there."""
    mujoco.mj_forward(model, data)
    M, J, row = np.zeros((15, 15)), np.zeros((6, 15)), np.zeros((2, 3, 15))
    mujoco.mj_fullM(model, data, M)
    tool = data.site("tool").xpos.copy()
    for name, sign in (("link2", 1.0), ("ball", -1.0)):
        mujoco.mj_jac(model, data, row[0], row[1], tool, model.body(name).id)
        J += sign * np.vstack(row)
    by = np.linalg.solve(M, J.T)
    rates = data.qvel - by @ np.linalg.solve(J @ by, J @ data.qvel)
    link = data.body("link2").xmat.reshape(3, 3)
    place = link.T @ (data.body("ball").xpos - data.body("link2").xpos)
    turn = np.zeros(4)
    relative = link.T @ data.body("ball").xmat.reshape(3, 3)
    mujoco.mju_mat2Quat(turn, np.ascontiguousarray(relative).ravel())
    one = mujoco.MjModel.from_xml_string(mjcf(kp, kd, (-1.0, -1.0), (place, turn)))
    after = mujoco.MjData(one)
    after.qpos[:], after.qvel[:] = data.qpos[:10], rates[:9]
    return one, after
