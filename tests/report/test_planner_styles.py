"""Colours and strokes of planners: each pair differs, for those who see fewer colours too."""

import itertools

import numpy as np
import pytest

from ves_gym.planners.registry import PLANNERS
from ves_gym.report.planner_styles import COLOURS, DARK, STYLES, style_of

# Machado, Oliveira, Fernandes, IEEE TVCG 15(6), 2009, severity 1: linear RGB as it is seen
SEEN = {
    "all colours": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array(  # of linear sRGB, IEC 61966-2-1
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def linear(colour):
    """(3,) linear RGB of #rrggbb."""
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """(3,) CIE L*a*b* of linear RGB, white point of sRGB."""
    x = XYZ @ np.clip(rgb, 0, 1) / XYZ.sum(axis=1)
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one, other):
    """Ratio of WCAG 2."""
    low, high = sorted(0.05 + float(XYZ[1] @ linear(c)) for c in (one, other))
    return high / low


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("palette", [COLOURS, DARK], ids=["light", "dark"])
def test_colours_are_apart_for_the_colour_blind(palette, seen):
    """Reference: 2.3 is a difference that is just seen (CIE76); 10 is seen at a glance."""
    points = [lab(np.asarray(SEEN[seen]) @ linear(colour)) for colour in palette]
    near = min(np.linalg.norm(a - b) for a, b in itertools.combinations(points, 2))
    assert near > 10


@pytest.mark.parametrize(
    ("palette", "page"), [(COLOURS, "#ffffff"), (DARK, "#191f26")], ids=["light", "dark"]
)
def test_lines_stand_out_from_the_page(palette, page):
    """Reference: WCAG 2, 1.4.11: 3 for graphics."""
    assert min(contrast(colour, page) for colour in palette) > 3


def test_no_two_planners_look_alike():
    assert len(set(STYLES.values())) == len(STYLES)
    names = [*PLANNERS, "own-1", "own-2"]
    styles = [style_of(name, names) for name in names]
    assert len(set(styles)) == len(styles)
