"""A live picture: the arm, the whole structure, and the energy strip beneath.

For drawing processes (`screen`, `window`), as `drawing` is.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import Array
from ves_gym.rendering.drawing import BACKGROUND, FORCE, MOMENT, PATH, TARGET, Drawing
from ves_gym.rendering.live import LiveSettings

MAIN = 0.62  # of the width is the arm's; the rest shows the whole, its base magnified
_STRIP = 0.22  # of the height
_POINTS = 500  # of a line of the strip
_SWAY = 0.15  # of what is seen, the largest magnified motion of the base
_TURN = 0.5  # rad, its largest rotation as drawn
_EDGE = 8  # px around words
_ARROW = 0.6  # m, of the longest arrow
_LEAST = 2e-3  # m, rad: smaller motions are not magnified more
# J, least top of the strip: MuJoCo draws a range below 1e-5 about zero, to -1e-5
_AXIS = 1e-4
_ROOM = 0.3  # m the base moves before the arm's camera follows
_GRAY, _ENERGY, _STRAIN = (0.85, 0.88, 0.92), (0.32, 0.72, 0.98), (0.55, 0.60, 0.68)
_FONT = mujoco.mjtFont.mjFONT_NORMAL


@dataclass
class History:
    """Samples of an episode so far."""

    episode: Any = None
    samples: list[dict[str, Any]] = field(default_factory=list)
    magnify: float = math.inf  # of the base's motion in the picture of the whole


class Stage:
    """Draws the samples it is sent into the present OpenGL context.

    A sample may say of which simulation it is (`row`); each has a history of its own, and the
    picture is of the one that the last sample was of.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self.settings = settings
        self.drawing = Drawing(settings.system, settings.width, settings.height)
        self.context = mujoco.MjrContext(self.drawing.model, _font_scale(settings.height))
        self.scene = self.drawing.scene
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        self.option = mujoco.MjvOption()
        self.strip = _strip()
        self.stiff = bool(settings.system.base.K.any())  # a satellite has no strain energy
        self.fitted = 0, 0  # the size of picture that the cameras are for
        self.histories: dict[int, History] = {}
        self.history = History()

    # ---------------------------------------------------------------- history

    def add_samples(self, message: str) -> None:
        """Add a line of samples to the history; time that goes back rewrites it."""
        samples = json.loads(message)
        for sample in samples:
            row = sample.get("row", 0)
            if row not in self.histories or sample["episode"] != self.histories[row].episode:
                self.histories[row] = History(sample["episode"])
            self.history = self.histories[row]
            while self.samples and self.samples[-1]["t"] >= sample["t"]:
                self.samples.pop()
            self.samples.append(sample)
        if self.settings.rolling:
            first = self.samples[-1]["t"] - self.settings.span
            self.samples[:] = [k for k in self.samples if k["t"] >= first]

    @property
    def samples(self) -> list[dict[str, Any]]:
        """Of the simulation that is shown."""
        return self.history.samples

    def _all(self, name: str) -> Array:
        return np.array([k[name] for k in self.samples], float)

    # ----------------------------------------------------------------- picture

    def paint(self, width: int, height: int) -> None:
        """Draw the latest sample into the bound framebuffer [px]."""
        strip, main = round(_STRIP * height), round(MAIN * width)
        band = self.settings.lines * self._text_height
        floor = strip + band
        arm = mujoco.MjrRect(0, floor, main, height - floor)
        overview = mujoco.MjrRect(main, floor, width - main, height - floor)
        if self.fitted != (width, height):
            self._fit(arm, overview)
            self.fitted = width, height
        sample, y = self.samples[-1], self._all("y")
        u = None if sample["u"] is None else np.array(sample["u"])
        factors = (self.settings.magnify or 1.0), self._magnified(y)
        for rect, camera, extent, k in zip(
            (arm, overview), self.cameras, self.extents, factors, strict=True
        ):
            if rect is arm:  # a base that leaves the picture takes it along
                place = k * y[-1, :3]
                camera.lookat[:] = self.home + place - np.clip(place, -_ROOM, _ROOM)
            modes = None if u is None else k * u
            self.drawing.pose(k * y[-1], np.array(sample["q"]), modes)
            mujoco.mjv_updateScene(
                self.drawing.model, self.drawing.data, self.option, None, camera,
                mujoco.mjtCatBit.mjCAT_ALL, self.scene,
            )  # fmt: skip
            self.drawing.add_support(k * y[-1], extent, modes)
            if rect is arm:
                self._wrench(sample, k * y[-1])
                self._marker(sample, extent)
                if sample.get("payload") is not None:
                    self.drawing.add_payload(np.array(sample["payload"]))
            else:
                self.drawing.add_path(k * y, extent)
            mujoco.mjr_render(rect, self.scene, self.context)
        mujoco.mjr_rectangle(mujoco.MjrRect(0, strip, width, band), *BACKGROUND, 1.0)
        for i, text in enumerate(sample["text"][: self.settings.lines]):
            self._text(text, _EDGE, floor - (i + 1) * self._text_height, _GRAY)
        self._words(arm, overview)
        self._energy(mujoco.MjrRect(0, 0, width, strip))

    def _fit(self, arm: mujoco.MjrRect, overview: mujoco.MjrRect) -> None:
        """One camera on all places the arm can reach, one on the whole structure."""
        robot, ways = self.settings.system.arm, np.vstack([np.eye(3), -np.eye(3)])
        shoulder, below = np.array([0.0, 0.0, robot.links[0].d]), np.array([0.0, 0.0, -_ARROW])
        reach = 0.0
        for root, span in zip(robot.feet, robot.spans, strict=True):
            away = math.dist(root.position, robot.feet[0].position)
            length = sum(math.hypot(k.a, k.d) for k in robot.links[span][1:])
            reach = max(reach, away + length)
        payload = self.settings.system.payload
        if payload is not None:
            reach += float(payload.edges.max())
        plate = 0.5 * reach * ways[[0, 1, 3, 4]]
        around = np.vstack([shoulder + reach * ways, plate, below])
        points, room = self.drawing.framing(around)
        fit, shape = self.drawing.camera, overview.width / overview.height
        near = fit(around, 0.1, 130, -18, arm.width / arm.height)
        self.cameras = [near, fit(points, room, 110, -14, shape)]
        self.extents = [float(np.ptp(k, axis=0).max()) for k in (around, points)]
        self.home = near.lookat.copy()

    def _magnified(self, y: Array) -> float:
        """The settings' factor, or a round one that never grows within an episode."""
        if self.settings.magnify:
            self.history.magnify = self.settings.magnify
            return self.history.magnify
        move = max(_LEAST, float(np.linalg.norm(y[:, :3], axis=1).max()))
        turn = max(_LEAST, float(np.linalg.norm(y[:, 3:], axis=1).max()))
        most = min(_SWAY * self.extents[1] / move, _TURN / turn)
        self.history.magnify = min(self.history.magnify, _round_down(max(1.0, most)))
        return self.history.magnify

    def _wrench(self, sample: dict[str, Any], y: Array) -> None:
        """An arrow is full at what moves the arm with 0.3 m/s^2, or at the largest so far."""
        if sample["w"] is None:
            return
        mass = sum(k.inertial.mass for k in self.settings.system.arm.links)
        sizes = np.linalg.norm(self._all("w").reshape(-1, 2, 3), axis=2)
        force, moment = sizes.max(axis=0, initial=0.3 * mass)
        self.drawing.add_wrench(y, np.array(sample["w"]), (force, moment), _ARROW)

    def _marker(self, sample: dict[str, Any], extent: float) -> None:
        """The first point as a ball, what follows it as a line."""
        if sample["marker"] is None:
            return
        points = np.array(sample["marker"])
        colour = (*TARGET[:3], 0.45)
        for a, b in itertools.pairwise(points):
            self.drawing.connect("CAPSULE", a, b, 0.006 * extent, colour)
        self.drawing.ball(points[0], 0.02 * extent, TARGET)

    # ------------------------------------------------------------------- words

    def _words(self, arm: mujoco.MjrRect, overview: mujoco.MjrRect) -> None:
        sample = self.samples[-1]
        lines: list[tuple[str, Any]] = [
            (f"t = {sample['t']:.2f} s", _GRAY),
            (f"base energy {sample['E']:.3g} J", _ENERGY),
        ]
        if self.stiff:
            lines.append((f"strain {sample['strain']:.3g} J", _STRAIN))
        if sample["w"] is not None:
            force, moment = np.linalg.norm(np.array(sample["w"]).reshape(2, 3), axis=1)
            lines += [(f"force {force:.0f} N", FORCE), (f"moment {moment:.0f} N m", MOMENT)]
        if sample["marker"] is not None:
            lines.append(("target", TARGET))
        self._column(arm, lines)
        self._column(
            overview, [(f"base motion x {self.history.magnify:g}", _GRAY), ("base path", PATH)]
        )

    def _column(self, rect: mujoco.MjrRect, lines: list[tuple[str, Any]]) -> None:
        """Write lines from the top, as many as half of a small picture takes."""
        top = rect.bottom + rect.height - _EDGE
        for i, (text, rgb) in enumerate(lines[: rect.height // (2 * self._text_height)]):
            self._text(text, rect.left + _EDGE, top - (i + 1) * self._text_height, rgb[:3])

    @property
    def _text_height(self) -> int:
        return round(1.15 * self.context.charHeight)

    def _text(self, text: str, start: int, bottom: int, rgb: Any) -> None:
        """Write at pixels from the lower left; MuJoCo's font has ASCII alone."""
        text = text.encode("ascii", "replace").decode()
        width = int(sum(self.context.charWidth[ord(k)] for k in text))
        rect = mujoco.MjrRect(start, bottom, width, self.context.charHeight)
        mujoco.mjr_label(rect, _FONT, text, 0, 0, 0, 0, *rgb, self.context)

    def _energy(self, rect: mujoco.MjrRect) -> None:
        t, E, strain = self._all("t"), self._all("E"), self._all("strain")
        figure, top = self.strip, _round_up(max(_AXIS, float(E.max())))
        first = max(0.0, t[-1] - self.settings.span) if self.settings.rolling else 0.0
        figure.range[:] = ((first, first + self.settings.span), (0.0, top))
        stride = max(1, math.ceil(len(t) / _POINTS))
        for index, values in enumerate((E, strain) if self.stiff else (E,)):
            points = np.column_stack([t, values])[::-stride].ravel()  # the latest always
            figure.linepnt[index] = len(points) // 2
            figure.linedata[index][: len(points)] = points
        figure.flg_ticklabel[:] = [int(rect.height > 2 * self._text_height)] * 2
        mujoco.mjr_figure(rect, figure, self.context)


def _strip() -> Any:
    figure = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.figurergba[:], figure.panergba[:] = (*BACKGROUND, 1), (0.1, 0.12, 0.16, 1)
    figure.gridrgb[:], figure.textrgb[:] = (0.25, 0.28, 0.33), _GRAY
    figure.linergb[0], figure.linergb[1] = _ENERGY, _STRAIN
    figure.linewidth, figure.gridwidth = 2.0, 1.0
    figure.gridsize[:] = (6, 3)
    figure.xformat, figure.yformat = "%.3g s", "%.3g J"
    figure.flg_legend = 0
    return figure


def _font_scale(height: int) -> Any:
    scale = mujoco.mjtFontScale
    return scale.mjFONTSCALE_100 if height < 900 else scale.mjFONTSCALE_200


def _round_down(value: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... that is not above value."""
    size = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return size * max(k for k in (1, 2, 5) if k * size <= value * (1 + 1e-9))


def _round_up(value: float) -> float:
    size = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return size * next(k for k in (1, 2, 5, 10) if k * size >= value * (1 - 1e-9))
