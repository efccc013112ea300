"""The picture of a run: arm, beam, base path and wrench as a MuJoCo scene, frame by frame.

Runs in the drawing process only (`movie`): it needs MuJoCo with its OpenGL.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from ves_gym.core.dynamics import joint_positions
from ves_gym.core.params import Array
from ves_gym.core.spatial import rotation
from ves_gym.core.system import System
from ves_gym.core.vehicle import Beam
from ves_gym.planners.scenes import beam_line
from ves_gym.report.render import View

_TRAIL = 3.0  # s of the base's past path that is drawn
_ARROW = 1.2  # m of the longest force or moment arrow

_BACKGROUND = (0.075, 0.090, 0.125)
_PALE = (0.90, 0.91, 0.93, 1.0)
JOINT = (0.93, 0.55, 0.16, 1.0)
_METAL = (0.52, 0.56, 0.62, 1.0)
_DARK = (0.30, 0.33, 0.38, 1.0)
_BEAM = (0.64, 0.70, 0.78, 1.0)
_GHOST = (0.55, 0.62, 0.75, 0.22)
TOOL = (0.88, 0.27, 0.27, 1.0)
FORCE = (0.35, 0.80, 0.48, 1.0)
MOMENT = (0.74, 0.52, 0.95, 1.0)
PATH = (0.32, 0.72, 0.98, 1.0)


class Drawing:
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
            self._cylinder(body, (0, 0, -1.15 * r), (0, 0, 1.15 * r), 1.2 * r, JOINT)
            if abs(link.d) > 1e-6:
                self._capsule(body, (0, 0, 0), knee, r, _PALE)
            if abs(link.a) > 1e-6:
                self._capsule(body, knee, end, 0.85 * r, _PALE)
        r, last = self._radius(self.system.arm.n), self.system.arm.links[-1]
        along = np.array([1.0, 0, 0]) if abs(last.a) > 1e-6 else np.array([0.0, 0, 1])
        across = np.array([0.0, 1, 0])
        self._sphere(body, end, 1.1 * r, TOOL)
        for side in (-1, 1):
            root = end + side * 0.8 * r * across
            self._capsule(body, root, root + 2.6 * r * along, 0.3 * r, TOOL)

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
            fade = (*PATH[:3], 0.15 + 0.85 * (i + 1) / len(trail))
            self._connect(scene, "CAPSULE", a, b, 0.005 * extent, fade)
        if "w" in self.clip:
            turn, origin = rotation(self.clip["y"][k]), self.clip["y"][k, :3]
            for part, rgba in ((slice(0, 3), FORCE), (slice(3, 6), MOMENT)):
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
