"""A servo loop on a free base, as commands that another program can play."""

import numpy as np

from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.simulator import Simulator

START = np.array([0.01, -0.02, 0.03, 0.02, -0.03, 0.05])  # of the base: m/s, rad/s


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
