"""How many hinges a member of a boom needs: its frequencies against the closed form of a beam.

    python scripts/hinges_needed.py

Bending of a uniform member, clamped or pinned at one end and with a mass at the other, by k
Gauss-Legendre hinges: relative error of its slowest frequencies. Euler-Bernoulli beams in
closed form: Blevins, Formulas for Natural Frequency and Mode Shape (1979), chapter 8.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.mechanics.boom import NO_ARM, Boom, BoomJoint, BoomMember
from ves_gym.mechanics.finite_elements import Material, Section
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.link import Inertial, diagonal

LENGTH, STIFFNESS, MASS = 10.0, 2e6, 80.0  # m, EI [N m^2], kg
SLENDER = Section(area=1e-2, second_y=1e-6, second_z=1e-6, torsion=1e-6)
PIN = 1e-9  # stiffness of a pinned root over EI / L
TIPS = (0.0, 0.5, 2.0, 10.0)  # mass at the tip over that of the beam
COUNT = 3


def closed_form(tip: float, count: int = COUNT, pinned: bool = False) -> Array:
    """Return the slowest frequencies of a uniform beam (count,) [rad/s].

    Args:
        tip: mass at its end over its own [1].
        count: how many.
        pinned: at its root, instead of clamped; without its turning as a rigid body.
    """

    def at_the_tip(x: float) -> float:
        s, c, th = math.sin(x), math.cos(x), math.tanh(x)
        if pinned:
            return s - c * th + 2 * tip * x * s * th
        return 1 / math.cosh(x) + c + tip * x * (c * th - s)

    grid = np.linspace(0.5, math.pi * (count + 1.5), 4000)
    values = np.array([at_the_tip(x) for x in grid])
    turns = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))[:count]
    roots = np.array([scipy.optimize.brentq(at_the_tip, *grid[k : k + 2]) for k in turns])
    out: Array = (roots / LENGTH) ** 2 * math.sqrt(STIFFNESS * LENGTH / MASS)
    return out


def by_hinges(hinges: int, tip: float, count: int = COUNT, pinned: bool = False) -> Array:
    """Return the same of a boom's member, NaN where it has fewer (count,) [rad/s].

    Args:
        hinges: in either plane.
        tip, count, pinned: see `closed_form`.
    """
    material = Material(
        youngs_modulus=STIFFNESS / SLENDER.second_y,
        shear_modulus=1e12,
        density=MASS / LENGTH / SLENDER.area,
        source="made up",
    )
    pin = BoomJoint(
        axis=(0.0, 1.0, 0.0),
        mass=0.0,
        radius=0.1,
        q_min=-1.0,
        q_max=1.0,
        v_max=1.0,
        a_max=1.0,
        tau_max=1.0,
        stiffness=PIN * STIFFNESS / LENGTH,
    )
    member = BoomMember(
        joints=(pin,) if pinned else (),
        vector=(LENGTH, 0.0, 0.0),
        section=SLENDER,
        material=material,
        hinges=hinges,
    )
    ball = Inertial(mass=tip * MASS, com=(0.0,) * 3, inertia=diagonal(0.0, 0.0, 0.0))
    boom = Boom(name="beam", members=(member,), tip=ball if tip else None, source="made up")
    arm = boom.braked([0.0] * len(boom.joints), NO_ARM)
    whole, flexures = expand(arm), arm.base_flexures
    assert flexures is not None
    H = whole.inertia(np.zeros(1), np.zeros(len(flexures)))[6:-1, 6:-1]
    plane = np.array([k for k, f in enumerate(flexures) if abs(f.axis[1]) > 0.5])
    squares = scipy.linalg.eigh(
        np.diag(whole.stiffness[plane]), H[np.ix_(plane, plane)], eigvals_only=True
    )
    bending = np.sqrt(np.abs(squares))[1 if pinned else 0 :]
    out = np.full(count, np.nan)
    out[: len(bending)] = bending[:count]
    return out


def main() -> None:
    """Print the errors."""
    for pinned in (False, True):
        print(f"{'pinned' if pinned else 'clamped'}: error of the first {COUNT} frequencies")
        for hinges in range(1, 7):
            parts = []
            for tip in TIPS:
                error = by_hinges(hinges, tip, pinned=pinned) / closed_form(tip, pinned=pinned)
                errors = " ".join(
                    "      -" if math.isnan(k) else f"{k - 1:+7.4f}" for k in error
                )
                parts.append(f"tip {tip:4.1f}: {errors}")
            print(f"  {hinges} hinges  " + "   ".join(parts))


if __name__ == "__main__":
    main()
