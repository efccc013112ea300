"""Contact of the tool as MuJoCo has it: shapes, pairs that touch, a sensor of their points.

MuJoCo states a contact in accelerations: at rest of everything else it is
f = max(0, (k d + b d') / (A + R)), with A the bodies' inverse inertia along the normal and
R = (1 - i) / i A0 by its impedance i, A0 the sum of the bodies' `invweight0`. With the least
impedance, 1e-4, A is nothing beside R, and solref = (-stiffness A0, -damping A0) makes it the
spring and the damper in N/m and N s/m, for bodies of any mass (docs/physics.md).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco
from ves_gym._util.params import Array
from ves_gym.engine.mjcf import quaternion, set_inertial
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.payload import Contact, ContactShape, Payload

IMPEDANCE = 1e-4  # mjMINIMP
FRICTION_RATIO = 1e5  # of normal to tangential regularisation: it lifts the force by 1e-4
POINTS = 8  # of a pair of shapes, at most
FIELDS = 14  # numbers of each, see `contact.net_wrench`
TARGET = "target"

_GEOMS = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}
_DATA = sum(
    1 << int(field)
    for field in (
        mujoco.mjtConDataField.mjCONDATA_FOUND,
        mujoco.mjtConDataField.mjCONDATA_FORCE,
        mujoco.mjtConDataField.mjCONDATA_DIST,
        mujoco.mjtConDataField.mjCONDATA_POS,
        mujoco.mjtConDataField.mjCONDATA_NORMAL,
        mujoco.mjtConDataField.mjCONDATA_TANGENT,
    )
)


def add_contact(
    spec: mujoco.MjSpec, arm: Arm, contact: Contact, payload: Payload | None
) -> None:
    """Add the body that the tool meets, last of all bodies, and what happens where they touch.

    Args:
        spec: written; complete but for this.
        arm: whose last link has the tool.
        contact: shapes and law.
        payload: that floats freely, where the contact is on it.
    """
    option = spec.option
    option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, FRICTION_RATIO
    option.tolerance, option.iterations = 1e-15, 100
    if contact.on == "base":
        target = spec.body("platform").add_body(name=TARGET)
    else:
        target = spec.worldbody.add_body(name=TARGET)
        target.mocap = contact.on == "space"
    if contact.on == "payload":
        assert payload is not None
        target.add_freejoint(name=TARGET)
        set_inertial(target, payload.inertial)
        # with a body on it the engine takes any numbers for its inertia (`set_body`)
        target.add_body(name="fixture", pos=list(payload.grip.position))
    link = spec.body(f"link_{arm.n}")
    place, turn = tool_in_link(arm)
    for i, shape in enumerate(contact.tool, start=1):
        add_shape(link, shape, place, turn, name=f"tool_{i}")
    for i, shape in enumerate(contact.target, start=1):
        add_shape(target, shape, np.zeros(3), np.eye(3), name=f"target_{i}")
    pairs = [
        _add_pair(spec, contact, i, j)
        for i in range(1, len(contact.tool) + 1)
        for j in range(1, len(contact.target) + 1)
    ]
    sensor = spec.add_sensor(
        name="contact",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        objname=link.name,
        reftype=mujoco.mjtObj.mjOBJ_BODY,
        refname=TARGET,
    )
    sensor.intprm = [_DATA, 0, POINTS * len(pairs)]
    model = spec.compile()
    inverse = sum(model.body(name).invweight0[0] for name in (link.name, TARGET))
    for pair in pairs:
        pair.solref = [-contact.stiffness * inverse, -contact.damping * inverse]
        pair.solreffriction = [-1e-12, -IMPEDANCE / contact.slip_time]


def tool_in_link(arm: Arm) -> tuple[Array, Array]:
    """Return place (3,) and axes (3, 3) of the tool in the engine's frame of the last link."""
    rotation, place = arm.links[-1].far_end
    return place, rotation @ arm.tool_rotation


def geom_of(shape: ContactShape) -> tuple[Any, Array]:
    """Return MuJoCo's type of a shape, and its size (3,) [m]."""
    size = np.zeros(3)
    size[: len(shape.size)] = shape.size
    if shape.form == "box":
        size /= 2
    elif shape.form != "sphere":
        size[1] /= 2
    return _GEOMS[shape.form], size


def add_shape(
    body: Any, shape: ContactShape, place: Array, turn: Array, **options: Any
) -> None:
    """Add a shape without mass, which touches in its pairs only.

    Args:
        body: of the model, written.
        shape: in axes of its own body.
        place, turn: (3,) and (3, 3) of these axes in those of `body`.
        options: further attributes, such as a name.
    """
    form, size = geom_of(shape)
    body.add_geom(
        type=form,
        size=size.tolist(),
        pos=(place + turn @ np.array(shape.place.position)).tolist(),
        quat=quaternion(turn @ shape.place.rotation),
        mass=0.0,
        contype=0,
        conaffinity=0,
        **options,
    )


def _add_pair(spec: mujoco.MjSpec, contact: Contact, i: int, j: int) -> Any:
    slides = contact.friction > 0
    return spec.add_pair(
        name=f"contact_{i}_{j}",
        geomname1=f"tool_{i}",
        geomname2=f"target_{j}",
        condim=3 if slides else 1,
        friction=[contact.friction, contact.friction, 0.0, 0.0, 0.0] if slides else [1.0] * 5,
        solimp=[IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0],
        margin=0.0,
        gap=0.0,
    )
