"""Draw a run log with MuJoCo's renderer: a GIF, an MP4 or a window.

MuJoCo reads its OpenGL backend from MUJOCO_GL when it is imported, and a broken OpenGL
may hang or abort. All drawing therefore happens in a child process
(`python -m ves_gym.report.render`), and a backend is tried in another one before.
"""

from __future__ import annotations

import ctypes.util
import dataclasses
import importlib.util
import itertools
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ves_gym.core.dynamics import joint_positions
from ves_gym.core.energy import base_energy, base_rate
from ves_gym.core.params import Array, ParameterError, require_positive, unit, write_bytes
from ves_gym.core.runlog import RunLog
from ves_gym.core.spatial import rotation
from ves_gym.core.system import System
from ves_gym.core.vehicle import Beam
from ves_gym.planners.scenes import beam_line

_PATIENCE = 30.0  # s a backend may take to draw one small picture
_STALL = 180.0  # s without a finished frame after which drawing has hung
_TRAIL = 3.0  # s of the base's past path that is drawn
_ARROW = 1.2  # m of the longest force or moment arrow
_GAP = 2  # pixels between the two pictures

FORMATS = {".gif": ("PIL", "pillow"), ".mp4": ("imageio_ffmpeg", "imageio-ffmpeg")}


class RenderError(ValueError):
    """Nothing can be drawn on this machine; the message says what is missing."""


@dataclass(frozen=True, kw_only=True)
class View:
    """How a run is shown."""

    width: int = unit("px", default=960)
    height: int = unit("px", default=480)
    fps: float = unit("1/s", default=25.0)
    speed: float = unit("1", default=1.0)  # of the run's clock
    magnify: float = unit("1", default=1.0)  # of the base's motion

    def __post_init__(self) -> None:
        require_positive(self, "fps", "speed", "magnify")
        for name in ("width", "height"):
            pixels = getattr(self, name)
            if pixels % 2 or not 64 <= pixels <= 4096:
                raise ParameterError(
                    f"View.{name} must be an even number from 64 to 4096 px, got {pixels}"
                )


def render(
    log: RunLog,
    path: str | os.PathLike[str],
    view: View | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Draw a run log into a .gif or .mp4 file, written completely or not at all.

    Returns:
        `frames` (how many) and `backend` (the OpenGL that drew them).

    Raises:
        RenderError: no OpenGL, or a package is missing.
        ParameterError: another suffix, or a frame rate the format cannot hold.
    """
    path, view = Path(path), view or View()
    _require_format(path, view)
    clip = _clip(log, view)
    backend = choose_backend()
    with tempfile.TemporaryDirectory(prefix="ves-render-") as folder:
        picture = Path(folder) / f"out{path.suffix}"
        _run_child(clip, view, picture, backend, progress)
        write_bytes(path, picture.read_bytes())
    return {"frames": len(clip["t"]), "backend": backend}


def show(log: RunLog, view: View | None = None) -> None:
    """Replay a run log in a window until it is closed.

    Raises:
        RenderError: no display, or its OpenGL does not work.
    """
    view = view or View()
    clip = _clip(log, view)
    if not has_display():
        raise RenderError("a window needs a display: DISPLAY is not set; write a GIF instead")
    found = probe("glfw")
    if not found.works:
        raise RenderError(f"a window needs glfw's OpenGL, which fails here: {found.reason}")
    with tempfile.TemporaryDirectory(prefix="ves-render-") as folder:
        _run_child(clip, view, Path(folder) / "window", "glfw", None)


def _require_format(path: Path, view: View) -> None:
    if path.suffix not in FORMATS:
        raise ParameterError(f"{path}: expected a {' or '.join(FORMATS)} name")
    for suffix in (".gif", path.suffix):  # labels are drawn with Pillow in either format
        module, package = FORMATS[suffix]
        if importlib.util.find_spec(module) is None:
            raise RenderError(
                f"{path.suffix} files need {package}, which is not installed:"
                " pip install 'ves-gym[report]'"
            )
    period = 100 / view.fps  # a GIF counts hundredths of a second
    if path.suffix == ".gif" and (round(period) < 1 or abs(period - round(period)) > 1e-6):
        near = 100 / max(2, round(period))
        raise ParameterError(
            "a GIF shows each frame for a whole number of 1/100 s: fps must be 100 / k"
            f" (50, 25, 20, 10, ...), got {view.fps:g}; nearest {near:.4g}"
        )


# ------------------------------------------------------------------------ the OpenGL


class Probe(NamedTuple):
    """Whether an OpenGL backend draws on this machine, or why not."""

    backend: str
    works: bool
    reason: str


_LIBRARIES = {  # backend -> (library, Debian packages)
    "egl": ("EGL", "libegl1 libgl1-mesa-dri"),
    "osmesa": ("OSMesa", "libosmesa6"),
}
_ON = ("", "enable", "enabled", "on", "true", "1")  # MuJoCo's words for "choose yourself"
_TRY = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 0, "it draws nothing but black"
"""


def has_display() -> bool:
    """Whether a window can be expected to open."""
    if platform.system() != "Linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def candidates() -> tuple[str, ...]:
    """Backends to try, in order: MUJOCO_GL alone if set, else what the platform has."""
    known = {
        "Linux": ("egl", "osmesa", "glfw", "glx"),
        "Darwin": ("cgl", "glfw"),
        "Windows": ("wgl", "glfw"),
    }.get(platform.system(), ("glfw",))
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked not in _ON:
        if asked not in known:
            raise RenderError(
                f"drawing needs MUJOCO_GL to be one of {', '.join(known)} or unset,"
                f" got {os.environ['MUJOCO_GL']!r}"
            )
        return (asked,)
    if platform.system() == "Linux":
        return ("egl", "osmesa", "glfw") if has_display() else ("egl", "osmesa")
    return known[:1]


@cache
def probe(backend: str, timeout: float = _PATIENCE) -> Probe:
    """Try to draw with a backend, in a child process that may hang or crash."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _TRY],
            env=_environment(backend),
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return Probe(backend, False, f"drawing hangs (gave up after {timeout:g} s)")
    if done.returncode == 0:
        return Probe(backend, True, "works")
    library, _ = _LIBRARIES.get(backend, ("", ""))
    if library and ctypes.util.find_library(library) is None:
        return Probe(backend, False, f"lib{library} is missing")
    if backend in ("glfw", "glx") and not has_display():
        return Probe(backend, False, "no display (DISPLAY is not set)")
    return Probe(backend, False, _last_words(done.returncode, done.stderr))


def choose_backend() -> str:
    """The first OpenGL backend that draws, or a RenderError that says what to install."""
    tried = []
    for backend in candidates():
        found = probe(backend)
        if found.works:
            return backend
        tried.append(f"{backend}: {found.reason}")
    raise RenderError(f"no OpenGL to draw with ({'; '.join(tried)}); {install_hint()}")


def install_hint() -> str:
    """What to do where no backend draws."""
    setting = os.environ.get("MUJOCO_GL")
    state = "is not set" if setting is None else f"is {setting!r}"
    packages = ", or ".join(packages for _, packages in _LIBRARIES.values())
    return f"MUJOCO_GL {state}; on Debian or Ubuntu: apt-get install {packages}"


def _last_words(status: int, stderr: str) -> str:
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    if status < 0:
        return f"it crashes (signal {-status})"
    return lines[-1] if lines else f"it ends with status {status}"


def _environment(backend: str) -> dict[str, str]:
    """Environment of a drawing process: the backend, and this very package."""
    here = str(Path(__file__).parents[2])
    paths = [here, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
    return {**environment, "MUJOCO_GL": backend, "PYTHONPATH": os.pathsep.join(paths)}


# ----------------------------------------------------------------- frames of a run log


def _clip(log: RunLog, view: View) -> dict[str, Any]:
    """What each frame shows, from a log: plain arrays, the base's motion magnified."""
    if "system" not in log.meta:
        raise ParameterError("the log does not say what to draw: its metadata has no 'system'")
    system = System.from_dict(log.meta["system"], "log metadata: system")
    if log.n_joints != system.arm.n:
        raise ParameterError(
            f"the log's system has an arm of {system.arm.n} joints, its columns {log.n_joints}"
        )
    t = np.arange(log.t[0], log.t[-1] + 1e-9, view.speed / view.fps)

    def at(values: Array) -> Array:
        return np.stack([np.interp(t, log.t, column) for column in values.T], axis=1)

    E = base_energy(system, log.q, log.y, base_rate(log)).total
    clip = {
        "t": t - log.t[0],
        "q": at(log.q),
        "y": view.magnify * at(log.y),
        "E": np.interp(t, log.t, E),
    }
    if log.w is not None:
        clip["w"] = at(log.w)
    return {"system": system, **clip}


def _run_child(
    clip: dict[str, Any],
    view: View,
    target: Path,
    backend: str,
    progress: Callable[[float], None] | None,
) -> None:
    job = target.with_name("job.npz")
    plain = json.dumps({"system": clip["system"].to_dict(), "view": dataclasses.asdict(view)})
    arrays = {k: v for k, v in clip.items() if k != "system"}
    np.savez(job, job=np.array(plain), **arrays)
    with open(target.with_name("stderr.txt"), "w+", encoding="utf-8") as errors:
        child = subprocess.Popen(
            [sys.executable, "-m", "ves_gym.report.render", str(job), str(target)],
            env=_environment(backend),
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        watch = None if target.suffix == "" else _Watch(child)
        assert child.stdout is not None
        try:
            for line in child.stdout:  # one per frame: the fraction done
                if watch is not None:
                    watch.seen()
                if progress is not None:
                    progress(float(line))
            status = child.wait()
        finally:
            if watch is not None:
                watch.stop()
            if child.poll() is None:
                child.kill()
                child.wait()
            child.stdout.close()
        if watch is not None and watch.fired:
            raise RenderError(f"drawing with {backend} hung: no frame for {_STALL:g} s")
        if status != 0:
            errors.seek(0)
            words = _last_words(status, errors.read())
            raise RenderError(f"drawing with {backend} failed: {words}")


class _Watch:
    """Kills a process that has not been seen working for `_STALL` seconds."""

    def __init__(self, child: subprocess.Popen[str]) -> None:
        self.child, self.last, self.fired = child, time.monotonic(), False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def seen(self) -> None:
        self.last = time.monotonic()

    def stop(self) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.wait(0.5):
            if time.monotonic() - self.last > _STALL:
                self.fired = True
                self.child.kill()
                return


# ------------------------------------------------------------- in the drawing process

_BACKGROUND = (0.075, 0.090, 0.125)
_PALE = (0.90, 0.91, 0.93, 1.0)
_JOINT = (0.93, 0.55, 0.16, 1.0)
_METAL = (0.52, 0.56, 0.62, 1.0)
_DARK = (0.30, 0.33, 0.38, 1.0)
_BEAM = (0.64, 0.70, 0.78, 1.0)
_GHOST = (0.55, 0.62, 0.75, 0.22)
_TOOL = (0.88, 0.27, 0.27, 1.0)
_FORCE = (0.35, 0.80, 0.48, 1.0)
_MOMENT = (0.74, 0.52, 0.95, 1.0)
_PATH = (0.32, 0.72, 0.98, 1.0)


class _Drawing:
    """The structure as MuJoCo geometry, posed frame by frame."""

    def __init__(self, system: System, clip: dict[str, Array], view: View) -> None:
        import mujoco

        self.mj, self.system, self.clip, self.view = mujoco, system, clip, view
        self.beam = beam_line(system.vehicle, clip["y"])
        self.rest = beam_line(system.vehicle, np.zeros((1, 6)))
        turned = joint_positions(system.arm, clip["q"]) @ np.swapaxes(
            rotation(clip["y"]), -1, -2
        )
        self.arm = turned + clip["y"][:, None, :3]  # (N, n + 1, 3)
        self.model = self._model()
        self.data = mujoco.MjData(self.model)
        self.frame = 1.0 / view.fps

    # ------------------------------------------------------------------ model

    def _model(self) -> Any:
        from ves_gym.core.model import build_spec

        mj, system = self.mj, self.system
        spec = build_spec(
            system.arm,
            system.base,
            gravity=(0.0, 0.0, 0.0),
            integrator=system.integrator,
            physics_dt=system.physics_dt,
        )
        spec.add_texture(
            name="sky",
            type=mj.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mj.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=_BACKGROUND,
            rgb2=_BACKGROUND,
            width=32,
            height=192,
        )
        spec.visual.headlight.ambient = [0.35] * 3
        spec.visual.headlight.diffuse = [0.35] * 3
        spec.visual.headlight.specular = [0.1] * 3
        spec.visual.global_.offwidth = max(64, self.view.width // 2)
        spec.visual.global_.offheight = self.view.height
        spec.visual.quality.offsamples = 4
        spec.stat.center, spec.stat.extent = [0.0, 0.0, 0.0], 4.0
        spec.visual.map.znear, spec.visual.map.zfar = 0.02, 100.0
        spec.worldbody.add_light(
            type=mj.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[2, -4, 6],
            dir=[-0.35, 0.6, -0.75],
            diffuse=[0.6] * 3,
            castshadow=False,
        )
        self._add_base(spec)
        self._add_arm(spec)
        return spec.compile()

    def _add_base(self, spec: Any) -> None:
        platform, vehicle = spec.body("platform"), self.system.vehicle
        r = self._radius(0)
        self._cylinder(platform, (0, 0, -0.06), (0, 0, 0), 3.6 * r, _METAL)
        reach = self.system.arm.links[0].d
        if reach > 4 * r:  # the pedestal under the first joint
            self._cylinder(platform, (0, 0, 0), (0, 0, 0.72 * reach), 1.25 * r, _DARK)
        self._cylinder(spec.worldbody, (0, 0, -0.06), (0, 0, 0), 3.6 * r, _GHOST)
        body = self.system.base.body
        if body is not None:
            self._box(platform, np.array(body.com), *_equal_box(body), _METAL)
        if isinstance(vehicle, Beam):
            clamp, along = vehicle.nodes[0], np.array(vehicle.segments[0])
            along = along / np.linalg.norm(along)
            size = max(0.6, 4 * vehicle.outer_diameter)
            wall = np.array([0.12, size, size])
            self._box(spec.worldbody, clamp - 0.12 * along, wall, _frame_along(along), _DARK)

    def _add_arm(self, spec: Any) -> None:
        for i, link in enumerate(self.system.arm.links):
            body, r = spec.body(f"link_{i + 1}"), self._radius(i)
            end, knee = np.array([link.a, 0.0, link.d]), np.array([0.0, 0.0, link.d])
            self._cylinder(body, (0, 0, -1.15 * r), (0, 0, 1.15 * r), 1.2 * r, _JOINT)
            if abs(link.d) > 1e-6:
                self._capsule(body, (0, 0, 0), knee, r, _PALE)
            if abs(link.a) > 1e-6:
                self._capsule(body, knee, end, 0.85 * r, _PALE)
        r, last = self._radius(self.system.arm.n), self.system.arm.links[-1]
        along = np.array([1.0, 0, 0]) if abs(last.a) > 1e-6 else np.array([0.0, 0, 1])
        across = np.array([0.0, 1, 0])
        self._sphere(body, end, 1.1 * r, _TOOL)
        for side in (-1, 1):
            root = end + side * 0.8 * r * across
            self._capsule(body, root, root + 2.6 * r * along, 0.3 * r, _TOOL)

    def _radius(self, i: int) -> float:
        arm = self.system.arm
        size = float(sum(math.hypot(k.a, k.d) for k in arm.links))
        return 0.045 * size * (1 - 0.45 * i / arm.n)

    def _geom(self, body: Any, kind: str, rgba: Any, **options: Any) -> None:
        options = {k: np.asarray(v, float).tolist() for k, v in options.items()}
        kind = getattr(self.mj.mjtGeom, f"mjGEOM_{kind}")
        body.add_geom(type=kind, rgba=rgba, contype=0, conaffinity=0, mass=0, **options)

    def _capsule(self, body: Any, a: Any, b: Any, radius: float, rgba: Any) -> None:
        self._geom(body, "CAPSULE", rgba, size=[radius, 0, 0], fromto=[*a, *b])

    def _cylinder(self, body: Any, a: Any, b: Any, radius: float, rgba: Any) -> None:
        self._geom(body, "CYLINDER", rgba, size=[radius, 0, 0], fromto=[*a, *b])

    def _sphere(self, body: Any, at: Any, radius: float, rgba: Any) -> None:
        self._geom(body, "SPHERE", rgba, size=[radius, 0, 0], pos=at)

    def _box(self, body: Any, at: Any, half: Array, axes: Array, rgba: Any) -> None:
        quat = np.zeros(4)
        self.mj.mju_mat2Quat(quat, np.ascontiguousarray(axes).ravel())
        self._geom(body, "BOX", rgba, size=half, pos=at, quat=quat)

    # ------------------------------------------------------------------ frames

    def pose(self, k: int) -> None:
        """Put the structure where frame k has it."""
        from ves_gym.core.model import TO_Y

        self.data.qpos[TO_Y] = self.clip["y"][k]
        self.data.qpos[6:] = self.clip["q"][k]
        self.mj.mj_kinematics(self.model, self.data)
        self.mj.mj_comPos(self.model, self.data)
        self.mj.mj_camlight(self.model, self.data)

    def decorate(self, scene: Any, k: int, extent: float) -> None:
        """Add what is not a rigid body: bent beam, the plate's path, force and moment."""
        if self.beam is not None and self.rest is not None:
            radius = max(self.system.vehicle.outer_diameter / 2, 0.004 * extent)  # type: ignore[union-attr]
            for a, b in zip(self.rest[0, :-1], self.rest[0, 1:], strict=True):
                self._connect(scene, "CAPSULE", a, b, 0.5 * radius, _GHOST)
            for a, b in zip(self.beam[k, :-1], self.beam[k, 1:], strict=True):
                self._connect(scene, "CAPSULE", a, b, radius, _BEAM)
        first = max(0, k - round(_TRAIL / self.frame / self.view.speed))
        stride = max(1, (k - first) // 60)
        past = self.clip["y"][first : k + 1][::-stride][::-1]  # ends at this very frame
        rim = 4.0 * self._radius(0) * np.array([0.64, -0.77, 0.0])  # where cameras see it
        trail = past[:, :3] + rotation(past) @ rim
        for i, (a, b) in enumerate(itertools.pairwise(trail)):
            fade = (*_PATH[:3], 0.15 + 0.85 * (i + 1) / len(trail))
            self._connect(scene, "CAPSULE", a, b, 0.005 * extent, fade)
        if "w" in self.clip:
            turn, origin = rotation(self.clip["y"][k]), self.clip["y"][k, :3]
            for part, rgba in ((slice(0, 3), _FORCE), (slice(3, 6), _MOMENT)):
                most = np.linalg.norm(self.clip["w"][:, part], axis=1).max()
                arrow = _ARROW * (turn @ self.clip["w"][k, part]) / max(most, 1e-12)
                if np.linalg.norm(arrow) > 0.02:
                    self._connect(scene, "ARROW", origin, origin + arrow, 0.025, rgba)

    def _connect(
        self, scene: Any, kind: str, a: Array, b: Array, radius: float, rgba: Any
    ) -> None:
        if scene.ngeom >= scene.maxgeom or np.linalg.norm(b - a) < 1e-9:
            return
        geom, shape = scene.geoms[scene.ngeom], getattr(self.mj.mjtGeom, f"mjGEOM_{kind}")
        zero = np.zeros(3)
        self.mj.mjv_initGeom(
            geom, shape, zero, zero, np.eye(3).ravel(), np.array(rgba, np.float32)
        )
        self.mj.mjv_connector(geom, shape, radius, np.asarray(a), np.asarray(b))
        scene.ngeom += 1

    def camera(
        self, points: Array, margin: float, azimuth: float, elevation: float, aspect: float
    ) -> Any:
        """A camera that frames all the points, seen in a given direction [deg]."""
        az, el = math.radians(azimuth), math.radians(elevation)
        ahead = np.array(
            [math.cos(az) * math.cos(el), math.sin(az) * math.cos(el), math.sin(el)]
        )
        right = np.array([math.sin(az), -math.cos(az), 0.0])
        axes = np.stack([right, np.cross(right, ahead)])
        flat = points @ axes.T
        at = axes.T @ ((flat.min(axis=0) + flat.max(axis=0)) / 2)
        tangent = math.tan(math.radians(self.model.vis.global_.fovy) / 2)
        offset = points - at
        need = (np.abs(offset @ axes.T) + margin) / (tangent * np.array([aspect, 1.0]))
        camera = self.mj.MjvCamera()
        camera.type = self.mj.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = at
        camera.distance = float((need.max(axis=1) - offset @ ahead).max())
        camera.azimuth, camera.elevation = azimuth, elevation
        return camera

    def cameras(self, aspect: float) -> list[tuple[Any, float]]:
        """A camera on everything and one on the arm, each with the size of what it sees."""
        arm = np.vstack([self.arm.reshape(-1, 3), np.zeros((1, 3))])
        whole = arm
        if self.beam is not None:
            whole = np.vstack([arm, self.beam.reshape(-1, 3)])
        body, margin = self.system.base.body, 0.6
        if body is not None:
            margin += float(_equal_box(body)[0].max())
            whole = np.vstack([arm, self.clip["y"][:, :3] + np.array(body.com)])
        out = []
        for points, room, azimuth, elevation in (
            (whole, margin, 110, -14),
            (arm, 0.4, 130, -18),
        ):
            camera = self.camera(points, room, azimuth, elevation, aspect)
            out.append((camera, float(np.ptp(points, axis=0).max())))
        return out


def _frame_along(x: Array) -> Array:
    """(3, 3) rotation whose first column is the unit vector x."""
    helper = np.eye(3)[int(np.abs(x).argmin())]
    y = np.cross(helper, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _equal_box(body: Any) -> tuple[Array, Array]:
    """Half sizes (3,) [m] and axes (3, 3) of the homogeneous box with a body's inertia."""
    moments, axes = np.linalg.eigh(np.array(body.inertia))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    squares = 6 / max(body.mass, 1e-9) * (moments.sum() - 2 * moments)
    return np.sqrt(np.maximum(squares, 1e-4)) / 2, axes


def _frames(drawing: _Drawing) -> Iterator[Array]:
    """Finished pictures (height, width, 3) uint8, reported on stdout one by one."""
    import mujoco
    from PIL import Image, ImageDraw, ImageFont

    view, clip = drawing.view, drawing.clip
    half = (view.width - _GAP) // 2
    cameras = drawing.cameras(half / view.height)
    font = ImageFont.load_default(max(10, view.height // 28))
    count, margin = len(clip["t"]), view.height // 40
    legend = [("base path", _PATH)]
    if "w" in clip:
        legend += [("force on base", _FORCE), ("moment", _MOMENT)]
    with mujoco.Renderer(drawing.model, view.height, half, max_geom=2000) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        for k in range(count):
            drawing.pose(k)
            page = np.full((view.height, view.width, 3), 60, np.uint8)
            for side, (camera, extent) in enumerate(cameras):
                renderer.update_scene(drawing.data, camera)
                drawing.decorate(renderer.scene, k, extent)
                left = side * (view.width - half)
                page[:, left : left + half] = renderer.render()
            image = Image.fromarray(page)
            text = f"t = {clip['t'][k]:5.2f} s    base energy {clip['E'][k]:.3g} J"
            if view.magnify != 1:
                text += f"    base motion x {view.magnify:g}"
            pen = ImageDraw.Draw(image)
            pen.text((margin, margin), text, (225, 230, 240), font)
            at = margin
            for word, rgba in legend:
                colour = tuple(round(255 * c) for c in rgba[:3])
                pen.text((at, view.height - margin), word, colour, font, anchor="ls")
                at += round(font.getlength(word)) + 2 * margin
            print((k + 1) / count, flush=True)
            yield np.asarray(image)


def _write_gif(path: Path, frames: Iterator[Array], fps: float) -> None:
    from PIL import Image

    first = Image.fromarray(next(frames))
    # one palette for all, so that nothing flickers; with the colours that come later
    shades = np.linspace(0.25, 1.0, 16)[:, None, None]
    accents = np.array([c[:3] for c in (_FORCE, _MOMENT, _PATH, _TOOL, _JOINT)])
    swatch = Image.fromarray((255 * shades * accents).round().astype(np.uint8))
    sample = first.copy()
    sample.paste(swatch.resize((first.width, first.height // 4), Image.Resampling.NEAREST))
    palette = sample.quantize(256, Image.Quantize.MEDIANCUT)

    def reduced(image: Image.Image) -> Image.Image:
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    reduced(first).save(
        path,
        save_all=True,
        append_images=(reduced(Image.fromarray(f)) for f in frames),
        duration=round(1000 / fps),
        loop=0,
    )


def _write_mp4(path: Path, frames: Iterator[Array], view: View) -> None:
    import imageio_ffmpeg

    size = (view.width, view.height)
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=view.fps, macro_block_size=2)
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def _window(drawing: _Drawing) -> None:
    import mujoco.viewer

    with mujoco.viewer.launch_passive(
        drawing.model, drawing.data, show_left_ui=False, show_right_ui=False
    ) as viewer:
        camera, extent = drawing.cameras(4 / 3)[0]
        viewer.cam.lookat[:], viewer.cam.distance = camera.lookat, camera.distance
        viewer.cam.azimuth, viewer.cam.elevation = camera.azimuth, camera.elevation
        k, due = 0, time.monotonic()
        while viewer.is_running():
            with viewer.lock():
                drawing.pose(k)
                viewer.user_scn.ngeom = 0
                drawing.decorate(viewer.user_scn, k, extent)
            viewer.sync()
            k = (k + 1) % len(drawing.clip["t"])
            due = max(due + drawing.frame, time.monotonic() - 1.0)
            time.sleep(max(0.0, due - time.monotonic()))


def _main(job: str, target: str) -> None:
    with np.load(job) as held:
        clip = {k: held[k] for k in held.files if k != "job"}
        plain = json.loads(str(held["job"]))
    view = View(**plain["view"])
    drawing = _Drawing(System.from_dict(plain["system"]), clip, view)
    path = Path(target)
    if path.suffix == ".gif":
        _write_gif(path, _frames(drawing), view.fps)
    elif path.suffix == ".mp4":
        _write_mp4(path, _frames(drawing), view)
    else:
        _window(drawing)


if __name__ == "__main__":
    _main(*sys.argv[1:])
