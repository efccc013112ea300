"""The body that the tool meets, and the points where they touch, in MuJoCo's batch."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco  # before its submodules

# isort: split
from mujoco.batch import Batch

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.mjcf import LEAST
from ves_gym.engine.mjcf_contact import FIELDS, TARGET
from ves_gym.mechanics.attitude import conjugate, from_matrix, rotate
from ves_gym.mechanics.payload import Contact, net_wrench, spring_energy

_APART = -1e6  # m, margin of pairs that shall not touch


class ContactBatch:
    """The body that the tool touches in n simulations. Poses in the engine's frame of space.

    Args:
        contact: law and shapes.
        model: with `mjcf_contact.add_contact`.
        batch: its simulations.
    """

    def __init__(self, contact: Contact, model: mujoco.MjModel, batch: Batch) -> None:
        self.contact, self.batch, self.model = contact, batch, model
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        self._sensed = batch.bind("sensordata")
        self._tool = batch.bind("site_xpos")
        self._site = model.site("tool").id
        first = int(model.sensor("contact").adr[0])
        self._data = slice(first, first + int(model.sensor("contact").dim[0]))

    def target(self, com: Array) -> tuple[Array, Array, Array, Array]:
        """Place, attitude, velocity of the centre of mass, spin; it and `com` in own axes."""
        place, turn = self._qpos[:, -7:-4].copy(), self._qpos[:, -4:].copy()
        velocity, spin = self._qvel[:, -6:-3], self._qvel[:, -3:].copy()
        return place, turn, velocity + rotate(turn, np.cross(spin, com)), spin

    def set_target(
        self, ids: Index, place: Array, turn: Array, velocity: Array, spin: Array, com: Array
    ) -> None:
        """Put free bodies there.

        Args:
            ids: (k,) which.
            place, turn: (k, 3) [m], (k, 4) unit quaternions.
            velocity, spin, com: (k, 3), the last two in own axes [m/s, rad/s, m].
        """
        self._qpos[ids, -7:-4], self._qpos[ids, -4:] = place, turn
        self._qvel[ids, -6:-3] = velocity - rotate(turn, np.cross(spin, com))
        self._qvel[ids, -3:] = spin

    def set_frame(self, ids: Index, place: Array, turn: Array) -> None:
        """Put shapes that are fixed in space where the engine's frame, at `place` (k, 3) [m]
        and `turn` (k, 4), has them."""
        if self.contact.on != "space":
            return
        self.batch.bind("mocap_pos")[ids, 0] = rotate(conjugate(turn), -place)
        self.batch.bind("mocap_quat")[ids, 0] = conjugate(turn)

    def set_body(self, ids: Index, mass: Array, com: Array, inertia: Array) -> None:
        """Change mass properties (k,), (k, 3), (k, 3, 3) of free bodies, in their own axes."""
        set_body(self.batch, ids, self.model.body(TARGET).id, mass, com, inertia)

    def set_touching(self, ids: Index, touching: Mask) -> None:
        """Let the shapes of simulations (k,) touch, or pass through each other."""
        margin = np.where(touching, 0.0, _APART)
        self.batch.expand("pair_margin")[ids] = margin[:, None]

    def measured(self) -> tuple[Array, Array]:
        """Wrench on the tool (n, 6), engine's frame, at the tool, and energy stored (n,) [J].

        At this instant, under the command of now.
        """
        self.batch.forward()
        points: Any = self._sensed[:, self._data].reshape(self.batch.nsim, -1, FIELDS)
        wrench = net_wrench(points, self._tool[:, self._site])
        return wrench, spring_energy(points, self.contact.stiffness)


def set_body(
    batch: Batch, ids: Index, body: int, mass: Array, com: Array, inertia: Array
) -> None:
    """Change mass properties of a body in simulations (k,).

    Args:
        batch: the simulations.
        ids: (k,) which.
        body: its number in the model.
        mass, com, inertia: (k,), (k, 3), (k, 3, 3) in the body's frame.
    """
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    values = {
        "body_mass": mass,
        "body_ipos": com,
        "body_iquat": from_matrix(axes),
        "body_inertia": np.maximum(moments, LEAST),
        "body_sameframe": np.zeros(len(ids)),  # its axes are no longer the body's
    }
    for name, numbers in values.items():
        batch.expand(name)[ids, body] = numbers
