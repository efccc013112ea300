"""Draw docs/pictures/wiring.svg, the wires of the emulation loop: `python scripts/wiring.py`.

Where blocks stand and wires run is written here; which blocks and wires there are, what they
carry and when it arrives is asked of the loop. tests/simulation/blocks/test_wiring.py compares:
the picture does not go stale.
"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

import ves_gym as vg
from ves_gym.simulation.emulation_loop import EmulationLoop

PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "wiring.svg"
WIDTH, HEIGHT = 1210, 660
BOX = (140, 60)
Point = tuple[float, float]

PLACES: dict[str, Point] = {  # centre of each block
    "admittance": (190, 190),
    "computing_delay": (370, 190),
    "safety": (550, 190),
    "command_line": (730, 190),
    "platform": (910, 190),
    "engine_input": (1090, 190),
    "arm_inertia": (150, 350),
    "payload_compensation": (380, 350),
    "force_sensor": (730, 480),
    "gravity_estimate": (730, 590),
    "engine": (1090, 535),
}


class Net(NamedTuple):
    """One or more signals of a block on their way to the blocks that read them."""

    signals: str
    start: str
    ends: tuple[str, ...]
    lines: tuple[tuple[Point, ...], ...]  # each ends in an arrow
    label: Point  # of its first letter


def _along(y: float, start: float, end: float) -> tuple[tuple[Point, ...]]:
    return (((start, y), (end, y)),)


NETS = (
    Net("motion", "admittance", ("computing_delay",), _along(190, 260, 300), (259, 150)),
    Net("command", "computing_delay", ("safety",), _along(190, 440, 480), (431, 150)),
    Net("command_sent", "safety", ("command_line",), _along(190, 620, 660), (596, 150)),
    Net("command_received", "command_line", ("platform",), _along(190, 800, 840), (760, 150)),
    Net("y yd ydd", "platform", ("engine_input",), _along(180, 980, 1020), (968, 150)),
    Net(
        "command_sent frozen",
        "safety",
        ("admittance", "safety"),
        (
            ((580, 160), (580, 105), (205, 105), (205, 160)),
            ((530, 105), (530, 160)),
        ),
        (300, 98),
    ),
    Net("inertia", "arm_inertia", ("admittance",), (((150, 320), (150, 220)),), (97, 285)),
    Net("inertia", "arm_inertia", ("payload_compensation",), _along(362, 220, 290), (228, 379)),
    Net(
        "payload",
        "payload_compensation",
        ("admittance",),
        (((290, 338), (240, 338), (240, 220)),),
        (247, 285),
    ),
    Net(
        "y yd ydd",
        "platform",
        ("payload_compensation",),
        (((880, 220), (880, 350), (470, 350)),),
        (640, 343),
    ),
    Net(
        "y_measured",
        "platform",
        ("gravity_estimate",),
        (((930, 220), (930, 590), (800, 590)),),
        (812, 583),
    ),
    Net(
        "acceleration",
        "engine_input",
        ("engine",),
        (((1090, 220), (1090, 505)),),
        (1098, 300),
    ),
    Net(
        "wrench",
        "engine",
        ("force_sensor",),
        (((1020, 520), (975, 520), (975, 480), (800, 480)),),
        (812, 473),
    ),
    Net(
        "reading",
        "force_sensor",
        ("admittance", "safety"),
        (
            ((660, 480), (50, 480), (50, 205), (120, 205)),
            ((550, 480), (550, 220)),
        ),
        (300, 473),
    ),
    Net(
        "weight",
        "gravity_estimate",
        ("admittance",),
        (((660, 590), (28, 590), (28, 175), (120, 175)),),
        (300, 583),
    ),
    # from outside
    Net("kp kd", "joint servo", ("admittance",), (((165, 128), (165, 160)),), (138, 122)),
    Net("q", "engine", ("arm_inertia",), (((150, 412), (150, 380)),), (145, 428)),
    Net(
        "kp kd",
        "joint servo",
        ("payload_compensation",),
        (((380, 412), (380, 380)),),
        (355, 428),
    ),
    Net(
        "y_engine yd_engine",
        "engine",
        ("engine_input",),
        (((1090, 128), (1090, 160)),),
        (1018, 122),
    ),
    Net("draws", "generators", ("force_sensor",), (((730, 418), (730, 450)),), (708, 412)),
    Net("q", "engine", ("gravity_estimate",), (((700, 652), (700, 620)),), (684, 640)),
)
INK, QUIET, LATE, NOW = "#1b1f24", "#57606a", "#b35900", "#0550ae"
BEFORE = "before the engine: from the last readings to the path of its platform"
BANDS = (  # x, y, width, height, colour, what it is, where that is written
    (74, 62, 1122, 376, "#eef4fb", BEFORE, (84, 80)),
    (590, 442, 300, 212, "#f1f7ee", "after the engine: the readings", (640, 540)),
)


def picture(system: vg.System | None = None) -> str:
    """Return the nominal loop as SVG.

    Args:
        system: another emulated system with the same blocks.

    Raises:
        ValueError: blocks or wires are not those that have a place here.
    """
    loop = EmulationLoop(system or vg.System(mode="emulated"), 1, [np.random.default_rng(0)])
    wires = loop.wiring.describe(loop.shape)
    blocks = loop.wiring.describe_blocks(loop.p)
    late = _late(wires)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"'
        ' font-family="Helvetica, Arial, sans-serif" font-size="13">',
        "<title>The emulation loop: its blocks and the wires between them</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        *(
            f'<marker id="{name}" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="7"'
            ' markerHeight="7" orient="auto">'
            f'<path d="M0 0L10 5L0 10z" fill="{colour}"/></marker>'
            for name, colour in (("late", LATE), ("now", NOW), ("in", QUIET))
        ),
    ]
    for x, y, width, height, colour, text, at in BANDS:
        parts.append(
            f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="{colour}"/>'
        )
        parts.append(_text(*at, text, QUIET, "italic"))
    parts += [_net(net, late) for net in NETS]
    parts += [_block(row["name"], ", ".join(row["memory"])) for row in blocks]
    parts.append(_block("engine", "arm on its platform"))
    parts += _legend()
    return "\n".join([*parts, "</svg>", ""])


def _late(wires: list[dict[str, str]]) -> set[tuple[str, str, str]]:
    """Wires on which signals arrive a period later; all have a place, and no others do."""
    found = {(w["from"], w["to"], w["signal"]) for w in wires}
    drawn = {
        (net.start, end, name)
        for net in NETS
        for end in net.ends
        for name in net.signals.split()
    }
    if found != drawn:
        raise ValueError(f"scripts/wiring.py: wires differ: {sorted(found ^ drawn)}")
    return {(w["from"], w["to"], w["signal"]) for w in wires if w["when"] != "at once"}


def _net(net: Net, late: set[tuple[str, str, str]]) -> str:
    kinds = {(net.start, end, name) in late for end in net.ends for name in net.signals.split()}
    if len(kinds) != 1:
        raise ValueError(f"scripts/wiring.py: {net.signals} arrive at different times")
    outside = net.start not in PLACES or (net.start == "engine" and net.signals != "wrench")
    colour, kind = (LATE, "late") if kinds == {True} else (NOW, "now")
    if outside:
        colour, kind = QUIET, "in"
    dash = ' stroke-dasharray="6 4"' if kind == "late" else ""
    out = []
    for line in net.lines:
        path = "M" + "L".join(f"{x:g} {y:g}" for x, y in line)
        out.append(
            f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.6"{dash}'
            f' marker-end="url(#{kind})"/>'
        )
    out.append(_text(*net.label, ", ".join(net.signals.split()), colour))
    return "\n".join(out)


def _block(name: str, below: str) -> str:
    (x, y), (width, height) = PLACES[name], BOX
    width = 180 if name == "payload_compensation" else width
    colour = "#f6e8d8" if name == "engine" else "#ffffff"
    box = (
        f'<rect x="{x - width / 2:g}" y="{y - height / 2:g}" width="{width}" height="{height}"'
        f' rx="6" fill="{colour}" stroke="{INK}" stroke-width="1.4"/>'
    )
    rise = 4 if below else -4
    lines = [_text(x, y - rise, name, INK, "bold", "middle")]
    if below:
        lines.append(_text(x, y + 16, below, QUIET, "", "middle", 11))
    return "\n".join([box, *lines])


def _text(
    x: float, y: float, text: str, colour: str, style: str = "", anchor: str = "", size: int = 0
) -> str:
    more = f' text-anchor="{anchor}"' if anchor else ""
    more += f' font-size="{size}"' if size else ""
    more += {"bold": ' font-weight="bold"', "italic": ' font-style="italic"'}.get(style, "")
    return f'<text x="{x:g}" y="{y:g}" fill="{colour}"{more}>{escape(text)}</text>'


def _legend() -> list[str]:
    rows = (
        (30, NOW, "now", "", "in the same control period"),
        (260, LATE, "late", ' stroke-dasharray="6 4"', "held, read a period later"),
        (480, QUIET, "in", "", "from outside: engine, joint servo, random numbers"),
    )
    out = []
    for x, colour, kind, dash, text in rows:
        out.append(
            f'<path d="M{x} 30L{x + 36} 30" stroke="{colour}" stroke-width="1.6"{dash}'
            f' marker-end="url(#{kind})"/>'
        )
        out.append(_text(x + 44, 34, text, colour))
    out.append(_text(880, 34, "small: what the block remembers", QUIET, "", "", 11))
    return out


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(PICTURE.name)
