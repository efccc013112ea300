"""Runs as a recording for rerun's viewer: arms on their bases, and every column over time.

What is drawn is placed in float32, as rerun stores poses and points; the columns beside it are
the log's own float64. Time is in whole nanoseconds.
"""

from __future__ import annotations

import itertools
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, write_bytes
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.attitude import IDENTITY, exp, from_angles, from_matrix, rotate
from ves_gym.mechanics.chain import upright
from ves_gym.mechanics.flexure import expand, link_frames
from ves_gym.mechanics.link import Capsule, Inertial
from ves_gym.mechanics.meshes import Mesh
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import Appendage, Beam, FlexibleBase, beam_line
from ves_gym.rendering.link_meshes import meshes_of
from ves_gym.rendering.render import View, described
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_files import QUANTITIES

TIMELINE = "time"  # s since the first sample
_COLORS = ((82, 184, 250), (237, 140, 41), (89, 204, 122), (189, 133, 250), (224, 69, 69))
_PALE, _GRAY = (230, 232, 237), (163, 179, 199)
_PLOTTED = {"energy": "base energy [J]", "q": "joints [rad]", "y": "base [m, rad]"}
_SEEN = ("base", "beam", "legs", "payload", "tool")
_THICKNESS = 0.045  # of an arm's length, where its links have no shape


def write_rerun(
    path: str | os.PathLike[str], runs: Mapping[str, RunLog], magnify: float = 1.0
) -> None:
    """Write runs side by side into one .rrd recording, completely or not at all.

    Entities of a run lie under its name: `base` (pose), `base/link_1` ... (poses in the base's
    axes), `beam` or `legs`, `tool` (its way), `energy` [J], and a group of series per quantity
    of the log. The base's motion is magnified; series are as they are.
    """
    path, magnify = Path(path), View(magnify=magnify).magnify
    if path.suffix != ".rrd":
        raise ParameterError(f"{path}: expected a .rrd name")
    require("a recording for rerun", "rerun")
    import rerun as rr

    scenes = {name: RecordingScene(log, magnify) for name, log in runs.items()}
    with tempfile.TemporaryDirectory(prefix="ves-rerun-") as folder:
        file = Path(folder) / "runs.rrd"
        recording = rr.RecordingStream("ves_gym")
        recording.save(file, default_blueprint=_blueprint(scenes))
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for (name, scene), color in zip(scenes.items(), itertools.cycle(_COLORS)):
            _write(recording, rr.escape_entity_path_part(name), scene, color)
        recording.flush()
        recording.disconnect()
        write_bytes(path, file.read_bytes())


class RecordingScene:
    """Drawn data of a run: arrays (N, ...) on the log's clock, the base's motion
    magnified."""

    def __init__(self, log: RunLog, magnify: float = 1.0) -> None:
        self.log, self.system = log, described(log)
        self.y = magnify * log.y
        flexible = self.system.mode == "ideal" and log.u is not None
        self._u: Array | None = magnify * np.asarray(log.u) if flexible else None

    @cached_property
    def base(self) -> tuple[Array, Array]:
        """Places (N, 3) [m] and attitudes (N, 4), scalar first, of the platform top."""
        return self.y[:, :3], from_angles(self.y[:, 3:])

    @cached_property
    def links(self) -> tuple[Array, Array]:
        """Places (N, m, 3) [m] and attitudes (N, m, 4) of the links, in the base's axes."""
        at = link_frames(self.system.arm, self.log.q, self._u)
        return at.position, from_matrix(at.rotation)

    @cached_property
    def tool(self) -> Array:
        """(N, 3) places of the tool in space [m]."""
        turned = rotation(self.y) @ self.links[0][:, -1, :, None]
        return self.y[:, :3] + turned[..., 0]

    @cached_property
    def support(self) -> Array | None:
        """Lines (N, k, points, 3) that bear the arm [m]: a beam, or the legs of a platform."""
        system = self.system
        if system.mode == "emulated":
            stewart = system.emulator_settings.stewart
            top = np.array(stewart.top) @ np.swapaxes(rotation(self.y), -1, -2)
            head = top + self.y[:, None, :3]
            foot = np.broadcast_to(stewart.feet, head.shape)
            return np.stack([foot, head], axis=-2)
        if not isinstance(system.vehicle, (Beam, FlexibleBase)):
            return None
        modes = system.base.m
        u = None if self._u is None or not modes else self._carried[:, -modes:]
        line = beam_line(system.vehicle, self.y, u)
        return None if line is None else line[:, None]

    @property
    def surroundings(self) -> Array:
        """(k, 3) points of what bears the arm, at the start [m]: none of a plate alone."""
        body = self.system.base.body
        if self.support is not None:
            return self.support[0].reshape(-1, 3)
        if body is None:
            return np.zeros((0, 3))
        reach = 3.0 * float(body.box()[0].max())  # its panels stand out
        return np.array(body.com) + reach * np.array([[-1.0] * 3, [1.0] * 3])

    @property
    def _carried(self) -> Array:
        """(N, c + m) motion of what the base carries, and of its modes; zero if unknown."""
        base, bends = self.system.base, self.system.arm.bends
        size = len(base.carried) + base.m
        if self._u is None:
            return np.zeros((len(self.y), size))
        return self._u[:, bends : bends + size]

    def appendages(self) -> Iterator[tuple[Inertial, Array, Array]]:
        """Yield each part on a hinge or slide: its body, places (N, 3) and attitudes (N, 4)."""
        for part, moved in zip(self.system.base.carried, self._carried.T, strict=False):
            if not isinstance(part, Appendage) or self.system.mode == "emulated":
                continue
            axis, point = np.array(part.axis), np.array(part.point)
            if part.joint == "slide":
                still = np.broadcast_to(IDENTITY, (len(moved), 4))
                yield part.body, moved[:, None] * axis, still
            else:
                turn = exp(moved[:, None] * axis)
                yield part.body, point - rotate(turn, point), turn


def capsules(arm: Arm) -> list[tuple[Capsule, ...]]:
    """Shapes of the base link and of each link, as `dynamics` has them, in its own frame.

    Those of the arm's file; along d and a of the DH table where there are none.
    """
    out = [arm.base_shape or ()]
    for row, part in enumerate(arm.ordered):
        link, i = part.link, min(row, arm.n - 1)
        if link.shape is not None:
            out.append(link.shape)
            continue
        span = arm.span_of(i)
        size = float(sum(math.hypot(k.a, k.d) for k in arm.links[span]))
        radius = _THICKNESS * size * (1 - 0.45 * (i - span.start) / (span.stop - span.start))
        turn, end = link.far_end
        corners = [(np.array(k) - end) @ turn for k in ((0, 0, 0), (0, 0, link.d), end)]
        out.append(
            tuple(
                Capsule(start=tuple(a.tolist()), end=tuple(b.tolist()), radius=radius)
                for a, b in itertools.pairwise(corners)
                if np.linalg.norm(b - a) > 1e-6
            )
        )
    return out


# ------------------------------------------------------------------------------ rerun


def _write(recording: Any, name: str, scene: RecordingScene, color: tuple[int, ...]) -> None:
    """Everything of one run under its name."""
    import rerun as rr

    log = scene.log
    since = np.rint((log.t - log.t[0]) * 1e9).astype("timedelta64[ns]")  # rerun would cut
    clock = [rr.TimeColumn(TIMELINE, duration=since)]

    def send(entity: str, columns: Any) -> None:
        recording.send_columns(f"{name}/{entity}", clock, columns)

    def stay(entity: str, thing: Any) -> None:
        recording.log(f"{name}/{entity}", thing, static=True)

    def pose(entity: str, places: Array, turns: Array) -> None:
        turns = np.roll(turns, -1, axis=-1)  # rerun's scalar is last
        send(entity, rr.Transform3D.columns(translation=places, quaternion=turns))

    arm = scene.system.arm
    overview = expand(arm).arm if arm.bends else arm
    shapes = capsules(overview)
    pose("base", *scene.base)
    stay("base", _plate(scene, shapes))
    if meshes := meshes_of(arm.base_meshes):
        stay("base/shape", _mesh(meshes, _PALE))
    elif shapes[0]:
        stay("base/shape", _capsules(shapes[0], _PALE))
    for i, (part, shape) in enumerate(zip(overview.ordered, shapes[1:], strict=True)):
        pose(f"base/{part.body}", *(values[:, i] for values in scene.links))
        if meshes := meshes_of(part.link.meshes):
            stay(f"base/{part.body}", _mesh(meshes, color))
        elif shape:
            stay(f"base/{part.body}", _capsules(shape, color))
    for k, (body, *moving) in enumerate(scene.appendages(), 1):
        pose(f"base/appendage_{k}", *moving)
        stay(f"base/appendage_{k}", _box(body))
    if scene.support is not None:
        count, points = scene.support.shape[1:3]
        entity = "legs" if count > 1 else "beam"
        strips = list(scene.support.reshape(-1, points, 3))
        lines = rr.LineStrips3D.columns(strips=strips).partition([count] * len(log))
        send(entity, lines)
        stay(entity, rr.LineStrips3D.from_fields(radii=0.03, colors=_GRAY))
    if log.p is not None and scene.system.payload is not None:
        pose("payload", log.p[:, :3], log.p[:, 3:])
        payload = scene.system.payload
        half, middle = payload.edges / 2, payload.inertial.com
        stay("payload", rr.Boxes3D(half_sizes=half, centers=middle, fill_mode="solid"))
    stay("tool", rr.LineStrips3D([scene.tool], radii=0.004, colors=color))
    energy = log_base_energy(log, scene.system)
    series = {"energy": np.column_stack([energy.total, energy.strain, energy.kinetic])}
    series |= {k: v for k in QUANTITIES if (v := getattr(log, k)) is not None}
    for entity, values in series.items():
        columns = rr.Scalars.columns(scalars=values.ravel())
        send(entity, columns.partition([values.shape[1]] * len(log)))
        words = ["total", "strain", "kinetic"] if entity == "energy" else None
        words = words or [f"{entity}_{i + 1}" for i in range(values.shape[1])]
        stay(entity, rr.SeriesLines(names=[f"{name} {word}" for word in words]))


def _capsules(shape: tuple[Capsule, ...], color: tuple[int, ...]) -> Any:
    import rerun as rr

    ends = [(np.array(k.start), np.array(k.end)) for k in shape]
    return rr.Capsules3D(
        lengths=[np.linalg.norm(b - a) for a, b in ends],
        radii=[k.radius for k in shape],
        translations=[a for a, _ in ends],
        quaternions=[np.roll(_upright_to(b - a), -1) for a, b in ends],
        colors=color,
        fill_mode="solid",
    )


def _mesh(meshes: list[Mesh], color: tuple[int, ...]) -> Any:
    """Meshes of one body as one."""
    import rerun as rr

    firsts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    faces = [mesh.faces + k for mesh, k in zip(meshes, firsts, strict=False)]
    return rr.Mesh3D(
        vertex_positions=np.concatenate([mesh.points for mesh in meshes]),
        triangle_indices=np.concatenate(faces),
        albedo_factor=color,
    )


def _upright_to(way: Array) -> Array:
    """Attitude (4,), scalar first, that turns z into a direction (3,)."""
    length = np.linalg.norm(way)
    return from_matrix(upright(way / length)) if length else np.array(IDENTITY)


def _plate(scene: RecordingScene, shapes: list[tuple[Capsule, ...]]) -> Any:
    """Return the body under the arm: that of a satellite, or a plate."""
    import rerun as rr

    body = scene.system.base.body
    if body is not None and scene.system.mode == "ideal":
        return _box(body)
    radius = 3.6 * max((k.radius for shape in shapes for k in shape), default=0.1)
    if scene.system.mode == "emulated":
        top = np.array(scene.system.emulator_settings.stewart.top)
        radius = float(np.linalg.norm(top[:, :2], axis=1).max())
    return rr.Cylinders3D(
        lengths=[0.06],
        radii=[radius],
        centers=[[0.0, 0.0, -0.03]],
        colors=_GRAY,
        fill_mode="solid",
    )


def _box(body: Inertial) -> Any:
    import rerun as rr

    half, axes = body.box()
    turn = np.roll(from_matrix(axes), -1)
    return rr.Boxes3D(
        half_sizes=half, centers=body.com, quaternions=turn, colors=_GRAY, fill_mode="solid"
    )


def _blueprint(scenes: Mapping[str, RecordingScene]) -> Any:
    """The arms near and whole on the left, series on the right."""
    import rerun as rr
    import rerun.blueprint as rrb

    names = [rr.escape_entity_path_part(name) for name in scenes]
    contents = [f"/{name}/{entity}/**" for name in names for entity in _SEEN]
    plots = [
        rrb.TimeSeriesView(name=title, contents=[f"/{name}/{entity}" for name in names])
        for entity, title in _PLOTTED.items()
    ]
    arms = [scene.tool for scene in scenes.values()] + [np.zeros((1, 3))]
    around = [scene.surroundings for scene in scenes.values()]
    near, overview = (
        rrb.Spatial3DView(name=title, contents=contents, eye_controls=_eye(np.vstack(points)))
        for title, points in (("arms", arms), ("whole", [*arms, *around]))
    )
    space = rrb.Vertical(near, overview, row_shares=[3, 2]) if any(map(len, around)) else near
    layout = rrb.Horizontal(space, rrb.Vertical(*plots), column_shares=[3, 2])
    return rrb.Blueprint(layout, collapse_panels=True)


def _eye(points: Array) -> Any:
    """Return the position of a camera that sees points (N, 3)."""
    import rerun.blueprint as rrb

    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    away = 1.2 * max(float(np.linalg.norm(high - low)), 0.5)
    return rrb.EyeControls3D(
        position=middle + away * np.array([0.75, -0.6, 0.3]),
        look_target=middle,
        eye_up=(0, 0, 1),
    )
