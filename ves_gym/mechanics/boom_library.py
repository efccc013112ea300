"""Booms by name: what a small arm may stand on far from its host."""

from __future__ import annotations

import math

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm import Inertial, diagonal
from ves_gym.mechanics.boom import Boom
from ves_gym.mechanics.boom_member import BoomJoint, BoomMember
from ves_gym.mechanics.section import Material, Tube

QUASI_ISOTROPIC = Material(
    youngs_modulus=70e9,
    shear_modulus=27e9,
    density=1600.0,
    source="nominal, this project: quasi-isotropic graphite-epoxy",
)

_TUBE = Tube(outer_diameter=0.33, wall=0.005)
_LOSS = 0.003  # s: ratio 0.005 at 0.5 Hz
_PACE = math.radians(5.0)  # rad/s, approximately, of the Shuttle's arm without a payload


def _joint(name: str, axis: tuple[float, float, float], torque: float, k: float) -> BoomJoint:
    least, most = (-math.pi, math.pi) if name == "shoulder_yaw" else (-2.8, 2.8)
    return BoomJoint(
        name=name,
        axis=axis,
        mass=60.0 if name == "elbow_pitch" else 55.0,
        radius=0.2,
        q_min=least,
        q_max=most,
        v_max=_PACE,
        a_max=0.02,
        tau_max=torque,
        stiffness=k,
        damping=_LOSS * k,
        rotor_inertia=torque / 1.5,  # 1000 kg m^2 at the shoulder: a gear of some thousand
    )


SHUTTLE_LIKE = Boom(
    name="shuttle-like",
    members=(
        BoomMember(
            joints=(
                _joint("shoulder_yaw", (0.0, 0.0, 1.0), 1500.0, 1.2e6),
                _joint("shoulder_pitch", (0.0, 1.0, 0.0), 1500.0, 1.2e6),
            ),
            vector=(6.4, 0.0, 0.0),
            section=_TUBE,
            material=QUASI_ISOTROPIC,
            loss=_LOSS,
        ),
        BoomMember(
            joints=(_joint("elbow_pitch", (0.0, 1.0, 0.0), 750.0, 6e5),),
            vector=(7.0, 0.0, 0.0),
            section=_TUBE,
            material=QUASI_ISOTROPIC,
            loss=_LOSS,
        ),
    ),
    flange=(0.0, math.pi / 2, 0.0),  # the arm's z continues the boom
    tip=Inertial(mass=130.0, com=(-0.3, 0.0, 0.0), inertia=diagonal(2.6, 5.2, 5.2)),
    bandwidth=0.5,
    source="nominal, this project, at the size of the Shuttle's arm (15.2 m with its wrist,"
    " 410 kg, two graphite-epoxy booms of 0.33 m, 5 deg/s: NASA, JAXA): two members of 6.4"
    " and 7.0 m, EI 4.7e6 N m^2, three joints, what was its wrist a body at the tip",
)

# Bent so that the flange gives along all six axes, above its root and to the side.
REACHING_OUT = (0.3, -1.1, 1.7)  # rad

BOOMS: dict[str, Boom] = {SHUTTLE_LIKE.name: SHUTTLE_LIKE}


def get_boom(name: str) -> Boom:
    """Return a boom that comes with the package, by name.

    Raises:
        ParameterError: an unknown name.
    """
    if name not in BOOMS:
        raise ParameterError(
            f"boom must be one of {', '.join(BOOMS)}, got {name!r}{did_you_mean(name, BOOMS)}"
        )
    return BOOMS[name]
