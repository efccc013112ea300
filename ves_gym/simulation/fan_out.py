"""Copy one simulation of a snapshot into all simulations of another simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym.engine.kernel.blocks import lanes
from ves_gym.engine.kernel.emit import LANES
from ves_gym.simulation.state import Snapshot

_LANED = 2  # the first parts of the kernel's state lie in lanes


def fan_out(snapshot: Snapshot, i: int, n: int) -> Snapshot:
    """Return the snapshot of n simulations that all are where simulation i was.

    Whatever was assigned to it and its random generator are copied too: under the same
    commands all n go on alike, noise included.

    Args:
        snapshot: of a simulator on backend kernel or mujoco, without a payload to grasp.
        i: which of its simulations.
        n: how many to make.

    Raises:
        ParameterError: another backend, a payload, or no such simulation.
    """
    count = len(snapshot.diverged)
    if not 0 <= i < count:
        raise ParameterError(f"fan_out needs a simulation of 0 to {count - 1}, got {i}")
    if snapshot.backend_name not in ("kernel", "mujoco"):
        raise ParameterError(
            f"fan_out needs backend kernel or mujoco, got {snapshot.backend_name}"
        )
    if snapshot.payload is not None:
        raise ParameterError("fan_out cannot copy simulations that grasp a payload")

    def rows(array: Any) -> Any:
        return np.repeat(array[i : i + 1], n, axis=0)

    state: Any = snapshot.backend
    if snapshot.backend_name == "kernel":
        laned = [np.tile(k[i // LANES, :, i % LANES], (n, 1)) for k in state[:_LANED]]
        state = (*map(lanes, laned), *map(rows, state[_LANED:]))
    else:
        state = tuple(None if k is None else rows(k) for k in state)
    loop = snapshot.emulation_loop
    if loop is not None:
        memory, (time, events, table, *noise) = loop
        stops = [
            e._replace(simulation=k) for e in events if e.simulation == i for k in range(n)
        ]
        table = None if table is None else rows(table)
        others = rows(time), stops, table, *map(rows, noise)
        loop = {name: rows(k) for name, k in memory.items()}, others
    delays, charts, actuators = (
        snapshot.joint_delays,
        snapshot.charts,
        snapshot.base_actuators,
    )
    if delays is not None:
        delays = tuple(map(rows, delays))
    if charts is not None:
        charts = tuple(map(rows, charts))
    if actuators is not None:
        *arrays, done, ready = actuators
        actuators = (*map(rows, arrays), done, ready)
    own = snapshot.assigned.get(i)
    return replace(
        snapshot,
        backend=state,
        generators=(snapshot.generators[i],) * n,
        gains=(rows(snapshot.gains[0]), rows(snapshot.gains[1])),
        diverged=rows(snapshot.diverged),
        emulation_loop=loop,
        assigned={} if own is None else dict.fromkeys(range(n), own),
        joint_delays=delays,
        charts=charts,
        base_actuators=actuators,
    )
