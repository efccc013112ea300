"""The PUMA 560 of the thesis, Appendix B.

Numbers are the thesis's print, except where `docs/errata.md` says otherwise: its
I2zz and I3zz contain the motors' reflected inertia, which belongs on the joint.
"""

from __future__ import annotations

from math import pi, radians

from ves_gym.mechanics.arm import Arm, Inertial, Link, diagonal

_SOURCE = (
    "thesis Appendix B (Armstrong, Khatib, Burdick 1986); rotor inertias split off I2zz and"
    " I3zz; joint ranges 320/220/270 deg (Corke's Robotics Toolbox model) about the thesis's"
    " zero; torque limits AKB 1986;"
    " a_max: what tau_max gives the arm stretched out, rounded down (this project)"
)

# Base link, platform top to shoulder pan axis. Thesis B.2: r0, M0, I0.
_BASE = Inertial(mass=54.5, com=(0.0, 0.0, 0.283), inertia=diagonal(6.686, 6.465, 1.815))

PUMA_560 = Arm(
    name="puma560",
    source=_SOURCE,
    base=_BASE,
    links=(
        Link(
            d=0.22844 + 0.672,  # d0 + d1
            a=0.0,
            alpha=pi / 2,
            inertial=Inertial(
                mass=12.8, com=(0.0, 0.0, -0.056), inertia=diagonal(0.615, 0.615, 0.081)
            ),
            rotor_inertia=1.14,  # AKB 1986; the thesis's I1 carries none
            q_min=radians(-160),
            q_max=radians(160),
            v_max=radians(82),
            a_max=10.0,
            tau_max=97.6,
        ),
        Link(
            d=-0.2435,
            a=0.4318,
            alpha=0.0,
            inertial=Inertial(
                mass=17.4, com=(-0.3638, 0.006, 0.016), inertia=diagonal(0.130, 0.524, 0.539)
            ),
            rotor_inertia=4.710,  # 5.249 printed = 0.539 + 4.710
            q_min=radians(-110),
            q_max=radians(110),
            v_max=radians(54),
            a_max=15.0,
            tau_max=186.4,
        ),
        Link(
            d=0.098,
            a=0.4331,
            alpha=0.0,
            inertial=Inertial(
                mass=9.0, com=(-0.1420, 0.0, 0.0), inertia=diagonal(0.015, 0.574, 0.589)
            ),
            rotor_inertia=0.835,  # 1.424 printed = 0.589 + 0.835; see docs/errata.md
            q_min=radians(-135),
            q_max=radians(135),
            v_max=radians(122),
            a_max=40.0,
            tau_max=89.4,
        ),
    ),
)
