"""The PUMA's virtual manipulator (thesis B.5, B.6): its masses and lengths as printed."""

import numpy as np
import pytest

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560


def virtual_links(arm: Arm) -> Array:
    """(n + 1, 3) virtual links [m] from the centre of mass to the base.

    Row j turns with link j (row 0 with the base): in its DH frame, as thesis B.5 and B.6
    print them. Row 0 ends in the platform-top origin, theirs in the base link's centre.
    """
    bodies = [arm.base, *(link.inertial for link in arm.links)]
    masses = np.array([b.mass for b in bodies])
    beyond = np.cumsum(masses[::-1])[::-1]  # mass of body j and of all after it
    out = np.array([-b.mass * np.array(b.com) for b in bodies])
    _, turn, place, _ = arm.feet[0]
    lengths = np.zeros((arm.n, *out.shape))  # of each link, by the bodies they turn with
    for j, link in enumerate(arm.links):
        # d lies along the axis before the link, a along the link's own x before beta
        lengths[j, j] = link.d * (turn[:, 2] if j == 0 else np.eye(3)[2])
        lengths[j, j + 1] = link.a * link.far_end[0][0]
    lengths[0, 0] += place
    out -= np.tensordot(beyond[1:], lengths, axes=1)
    return out / arm.mass


PRINTED_MASS = 93.4  # kg, B.5; the masses it lists sum to 93.7


def test_links_to_the_base_are_those_printed_in_b6():
    """d2, d3, a2, a3 to the digits printed. d1 is printed to the base link's centre, -0.263
    by R1 = 0.629 m: its own lengths give R1 = 0.617 m, so -0.258."""
    links = virtual_links(PUMA_560) * PUMA_560.mass / PRINTED_MASS
    assert links[1, 2] == pytest.approx(0.0765, abs=6e-5)
    assert links[2, 2] == pytest.approx(-0.0125, abs=1e-4)  # of rounded r3 and l3
    assert links[2, 0] == pytest.approx(-0.054, abs=5e-4)
    assert links[3, 0] == pytest.approx(-0.0281, abs=6e-5)
    to_centre = virtual_links(PUMA_560)[0, 2] + PUMA_560.base.com[2]
    assert to_centre == pytest.approx(-0.263 * 0.617 / 0.629, abs=5e-4)
