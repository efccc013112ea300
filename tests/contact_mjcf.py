"""A PUMA 560 on a free cube that meets a ball, as MJCF written by hand, run by plain MuJoCo.

Nothing here asks the package for a model: the numbers are those of thesis Appendix B and of
the scene, the base floats on MuJoCo's own free joint, and the contact's law is restated: as
MuJoCo states a contact, in accelerations, or as forces at MuJoCo's own points.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

Array = np.ndarray

LAW = {"stiffness": 2e4, "damping": 60.0, "friction": 0.2, "tangential_damping": 200.0}
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


def mjcf(kp: Array, kd: Array, law: tuple[float, ...], held: tuple[Array, Array] | None) -> str:
    """The scene; `law` is solref of the pair, () for none, `held` place and quaternion of the
    ball on the tool."""
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
    pair = (
        f'<pair geom1="pad" geom2="ball" condim="1" margin="0" solref="{_text(*law or (0,))}"'
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
        f"<contact>{pair if law else ''}</contact><actuator>{servo}</actuator>"
        "</mujoco>"
    )


def free_model(kp: Array, kd: Array) -> mujoco.MjModel:
    """Arm and free ball: the contact in accelerations, as MuJoCo states it."""
    model = mujoco.MjModel.from_xml_string(mjcf(kp, kd, (-1.0, -1.0), None))
    inverse = model.body("link2").invweight0[0] + model.body("ball").invweight0[0]
    text = mjcf(kp, kd, (-LAW["stiffness"] * inverse, -LAW["damping"] * inverse), None)
    return mujoco.MjModel.from_xml_string(text)


def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """What acts between pad and ball."""
    line, geoms = np.zeros(6), [model.geom(name).id for name in ("pad", "ball")]
    gap = mujoco.mj_geomDistance(model, data, *geoms, 1.0, line)
    _push(model, data, "link2", "ball", a=line[:3], b=line[3:], gap=gap)


def funnel(
    centre: Array, axis: Array, low: float, high: float, length: float
) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """What acts between the pad and a funnel fixed in space, at both walls of a section.

    Args:
        centre: of the funnel (3,).
        axis: unit vector (3,) from the end of radius `low` to that of `high`.
        low, high, length: [m].
    """

    def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        at = data.geom("pad").xpos - centre
        aside = at - (at @ axis) * axis
        for side in (1.0, -1.0):
            out = side * aside / np.linalg.norm(aside)
            ends = [r * out + z * axis for r, z in ((low, -length / 2), (high, length / 2))]
            along = ends[1] - ends[0]
            share = np.linalg.lstsq(along[:, None], at - ends[0], rcond=None)[0][0]
            wall = ends[0] + min(max(share, 0.0), 1.0) * along
            away = np.linalg.norm(at - wall)
            surface = at + (wall - at) / away * PAD
            ends = centre + surface, centre + wall
            _push(model, data, "link2", "world", a=ends[0], b=ends[1], gap=away - PAD)

    return push


def _push(
    model: mujoco.MjModel, data: mujoco.MjData, *names: str, a: Array, b: Array, gap: float
) -> None:
    """Spring, damper and friction at the middle of two bodies' overlap, from a to b."""
    if gap >= 0:
        return
    point, speed = (a + b) / 2, np.zeros(3)
    normal = (a - b) / gap  # out of the second body
    bodies = [model.body(name).id for name in names]
    for body, sign in zip(bodies, (1.0, -1.0), strict=True):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        speed += sign * jacobian @ data.qvel
    opening = speed @ normal
    force = max(0.0, -LAW["stiffness"] * gap - LAW["damping"] * opening)
    slip = speed - opening * normal
    drag = min(LAW["tangential_damping"], LAW["friction"] * force / np.linalg.norm(slip))
    for body, sign in zip(bodies, (1.0, -1.0), strict=True):
        total = sign * (force * normal - drag * slip)
        mujoco.mj_applyFT(model, data, total, np.zeros(3), point, body, data.qfrc_passive)


def run(
    kp: Array,
    kd: Array,
    start: Array,
    rates: Array,
    ball: tuple[Array, Array, Array, Array],
    hold: Array,
    steps: tuple[int, int],
    push: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None,
) -> tuple[Array, Array]:
    """Meet the ball for some steps, catch it as a latch would, and carry it for some more.

    Args:
        kp, kd: (3,) of the servo, which holds `hold` (3,) [rad].
        start, rates: (3,) joint angles and rates, the cube at rest at the origin.
        ball: place, quaternion, velocity of its origin, spin in its own axes.
        steps: before the catch, and after it.
        push: what acts before the catch in place of MuJoCo's own contact.

    Returns:
        (N, 3 + 3 + 4 + 3) joint angles, place and quaternion of the cube, place of the ball, at
        each step; (N, 3) force of the contact on the ball.
    """
    text = mjcf(kp, kd, (), None)
    model = free_model(kp, kd) if push is None else mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = np.r_[0, 0, 0, 1, 0, 0, 0, start, ball[0], ball[1]]
    data.qvel[:] = np.r_[np.zeros(6), rates, ball[2], ball[3]]
    rows, forces = [], []
    for part, count in enumerate(steps):
        data.ctrl[:] = kp * hold
        mujoco.set_mjcb_passive(push if part == 0 else None)
        for _ in range(count + part):
            mujoco.mj_forward(model, data)
            at = data.body("ball").xpos
            rows.append(np.r_[data.qpos[7:10], data.qpos[:7], at])
            free = model.nv == 15
            on_ball = data.qfrc_constraint if push is None else data.qfrc_passive
            forces.append(on_ball[9:12].copy() if free else np.zeros(3))
            mujoco.mj_step(model, data)
        mujoco.set_mjcb_passive(None)
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
    one = mujoco.MjModel.from_xml_string(mjcf(kp, kd, (), (place, turn)))
    after = mujoco.MjData(one)
    after.qpos[:], after.qvel[:] = data.qpos[:10], rates[:9]
    return one, after
