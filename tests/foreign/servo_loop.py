"""Arms as rows of numbers, and a servo loop on a free base as commands to play."""

from dataclasses import replace

import numpy as np

from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, Motion
from ves_gym.simulation.simulator import Simulator

START = np.array([0.01, -0.02, 0.03, 0.02, -0.03, 0.05])  # of the base: m/s, rad/s


def row(body):
    """Mass, centre of mass and inertia about it, (13,)."""
    return np.concatenate([[body.mass], body.com, np.ravel(body.inertia)])


def link_rows(arm):
    """Rotation and position of each joint in the one before, then the body there, (n, 25)."""
    return np.array([
        np.concatenate([R.ravel(), p, row(link.inertial_at_joint)])
        for (R, p), link in zip(arm.placements, arm.links, strict=False)
    ])  # fmt: skip


def without_rotors(arm):
    """The arm as programs have it that know no rotors; its motors alone feel them."""
    return replace(arm, links=tuple(replace(k, rotor_inertia=0.0) for k in arm.links))


def queries(arm, duration, count=5):
    """Ends (2, 3) whose straight line keeps the speed limits."""
    rng, out = np.random.default_rng(round(10 * duration)), []
    width = 0.6 * np.array([np.pi, np.pi / 2, np.pi / 2])
    while len(out) < count:
        ends = rng.uniform(-1, 1, (2, 3)) * width
        speed = np.abs(ends[1] - ends[0]) * QUINTIC_PEAK_SPEED / duration
        if (speed < arm.column("v_max")).all():
            out.append(ends)
    return out


def servo_loop(system, seconds, asked=lambda k: {}, **start):
    """Lead the joints along a quintic from the middle of their ranges.

    The servos are springs kp and dampers kd to angle zero; the rest of their torque is
    `command` (periods, n), held over each period.

    Args:
        system: of a free base.
        seconds: of the motion.
        asked: period -> what wheels and jets are asked for.
        start: more of `Simulator.reset`.

    Returns:
        The loop as arrays by name, and what it gave after each period (periods, ...): joints,
        position, quaternion (scalar first), then wheels' speeds and appendages' ways.
    """
    sim, arm = Simulator(system), system.arm
    low, high = arm.column("q_min"), arm.column("q_max")
    middle, reach = (low + high) / 2, np.minimum(0.4, (high - low) / 4)
    times = np.arange(round(seconds / system.control_dt)) * system.control_dt
    wanted = Motion.straight(middle - reach, middle + reach, duration=seconds).at(times)
    commands = sim.servo_command(wanted.q[None], wanted.v[None])[0]
    first = sim.reset(q=wanted.q[0], v=wanted.v[0], yd=START, **start)
    w, out = sim.wheel_speed.shape[1], []
    for k, command in enumerate(commands):
        state = sim.step(command[None], **asked(k))
        pose = [state.q[0], state.y[0, :3], state.attitude[0]]
        out.append(np.concatenate([*pose, sim.wheel_speed[0], sim.internal_state[0][0, w:]]))
    return {
        "kp": sim.servo.kp, "kd": sim.servo.kd, "command": commands,
        "period": system.control_dt, "start_q": first.q[0],
        "start_u": np.concatenate([first.yd[0], first.v[0]]),
    }, np.array(out)  # fmt: skip
