"""A system as a picture: arm, beam or legs, base path and wrench as a MuJoCo scene.

Runs in drawing processes only (`stage`): it needs MuJoCo with its OpenGL, so MuJoCo is imported
first and as it is, not by way of `_util.mujoco_loader`, which would do without.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import mujoco
import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.mjcf import LEAST, TO_Y, add_carried, build_spec, places
from ves_gym.mechanics.attitude import to_matrix
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.link import MeshFile
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import Appendage, Beam, FlexibleBase, beam_line
from ves_gym.rendering.link_meshes import meshes_of
from ves_gym.rendering.surfaces import add_surface, solids
from ves_gym.system.system import System

BACKGROUND = (0.075, 0.090, 0.125)
_PALE = (0.90, 0.91, 0.93, 1.0)
_JOINT = (0.93, 0.55, 0.16, 1.0)
_METAL = (0.52, 0.56, 0.62, 1.0)
_DARK = (0.30, 0.33, 0.38, 1.0)
_BEAM = (0.64, 0.70, 0.78, 1.0)
_GHOST = (0.55, 0.62, 0.75, 0.22)
_TOOL = (0.88, 0.27, 0.27, 1.0)
FORCE = (0.35, 0.80, 0.48, 1.0)
MOMENT = (0.74, 0.52, 0.95, 1.0)
PATH = (0.32, 0.72, 0.98, 1.0)
TARGET = (0.98, 0.86, 0.30, 1.0)
_PAYLOAD = (0.36, 0.66, 0.62, 1.0)
_PANEL = (0.20, 0.30, 0.62, 1.0)
_SURFACE = (0.98, 0.86, 0.30, 0.45)
_UPRIGHT, _ORIGIN = np.eye(3), np.zeros(3)
_CORNERS = np.array(list(itertools.product([-1, 1], repeat=3)))  # of a box


class Drawing:
    """The structure as MuJoCo geometry, posed frame by frame."""

    def __init__(self, system: System, width: int, height: int) -> None:
        self.system, self.size = system, (width, height)
        self.rest_beam: Any = None  # (k, 3) centreline of a beam
        self.feet: Any = None  # (6, 3) of legs
        if system.mode == "emulated":  # the laboratory stands on legs instead
            self.feet = system.emulator_settings.stewart.feet
        elif isinstance(system.vehicle, (Beam, FlexibleBase)):
            self._measure(system.vehicle)
        self.model = self._model()
        self.data = mujoco.MjData(self.model)
        self.scene = mujoco.MjvScene(self.model, maxgeom=2000)  # of this frame

    def _measure(self, vehicle: Beam | FlexibleBase) -> None:
        """Centreline at rest, per base coordinate and per internal mode."""
        lines = beam_line(vehicle, np.vstack([np.zeros(6), np.eye(6)]))
        if lines is None:  # a user's matrices without a line to draw
            return
        self.rest_beam, self.bend = lines[0], lines[1:] - lines[0]  # (6, k, 3) per Y
        self.thick, m = vehicle.outer_diameter, self.system.base.m
        if m:
            ripples: Any = beam_line(vehicle, np.zeros((m, 6)), np.eye(m))
            self.ripple = ripples - lines[0]  # (m, k, 3) per mode against the flange

    # ------------------------------------------------------------------ model

    def _model(self) -> Any:
        system = self.system
        spec = build_spec(
            system.arm,
            dataclasses.replace(system.base, internal=None),  # drawn as a line
            gravity=(0.0, 0.0, 0.0),
            integrator=system.integrator,
            physics_dt=system.physics_dt,
        )
        spec.add_texture(
            name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, rgb1=BACKGROUND,
            rgb2=BACKGROUND, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, width=32, height=192,
        )  # fmt: skip
        spec.visual.headlight.ambient = [0.35] * 3
        spec.visual.headlight.diffuse = [0.35] * 3
        spec.visual.headlight.specular = [0.1] * 3
        spec.visual.global_.offwidth, spec.visual.global_.offheight = self.size
        spec.visual.quality.offsamples = 4
        spec.visual.quality.numslices, spec.visual.quality.numstacks = 20, 8  # of round shapes
        spec.stat.center, spec.stat.extent = [0.0, 0.0, 0.0], 4.0
        spec.visual.map.znear, spec.visual.map.zfar = 0.02, 100.0
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[2, -4, 6],
            dir=[-0.35, 0.6, -0.75], diffuse=[0.6] * 3, castshadow=False,
        )  # fmt: skip
        self._add_base(spec)
        self._add_arm(spec)
        if self.feet is None:
            self._add_appendages(spec)
        self._add_surfaces(spec)
        return spec.compile()

    def _add_base(self, spec: Any) -> None:
        platform = spec.body("platform")
        r = self._radius(0)
        _rod(platform, "CYLINDER", (0, 0, -0.06), (0, 0, 0), 3.6 * r, _METAL)
        reach = self.system.arm.links[0].d
        if reach > 4 * r:  # the pedestal under the first joint
            _rod(platform, "CYLINDER", (0, 0, 0), (0, 0, 0.72 * reach), 1.25 * r, _DARK)
        _rod(spec.worldbody, "CYLINDER", (0, 0, -0.06), (0, 0, 0), 3.6 * r, _GHOST)
        body = self.system.base.body
        if self.feet is not None:
            stewart = self.system.emulator_settings.stewart
            top, floor = np.array(stewart.top), stewart.home_height + 0.05
            size = np.linalg.norm(top[:, :2], axis=1).max()
            _rod(platform, "CYLINDER", (0, 0, top[0, 2] - 0.05), (0, 0, -0.02), size, _METAL)
            size = 1.25 * np.linalg.norm(np.array(stewart.base)[:, :2], axis=1).max()
            plate = (0, 0, -floor - 0.06), (0, 0, -floor)
            _rod(spec.worldbody, "CYLINDER", *plate, size, _DARK)
            return
        if body is not None:
            _box(platform, body.com, *body.box(), _METAL)
        if self.rest_beam is not None:
            clamp, along = self.rest_beam[0], self.rest_beam[1] - self.rest_beam[0]
            along = along / np.linalg.norm(along)
            size = max(0.6, 4 * self.thick)
            wall = np.array([0.12, size, size])
            _box(spec.worldbody, clamp - 0.12 * along, wall, _frame_along(along), _DARK)

    def _add_arm(self, spec: Any) -> None:
        chain = expand(self.system.arm)
        _add_meshes(spec, spec.body("platform"), self.system.arm.base_meshes)
        for place, link in enumerate(chain.arm.links):
            if place in chain.driven:
                body = spec.body(f"link_{chain.driven.index(place) + 1}")
                if _add_meshes(spec, body, link.meshes, *link.far_end):
                    continue
            end, knee = np.array([link.a, 0.0, link.d]), np.array([0.0, 0.0, link.d])
            if place in chain.passive:
                body, r = spec.body(f"part_{chain.passive.index(place) + 1}"), self._boom_radius
            else:
                i = chain.driven.index(place)
                body, r = spec.body(f"link_{i + 1}"), self._radius(i)
                _rod(body, "CYLINDER", (0, 0, -1.15 * r), (0, 0, 1.15 * r), 1.2 * r, _JOINT)
            if abs(link.d) > 1e-6:
                _rod(body, "CAPSULE", (0, 0, 0), knee, r, _PALE)
            if abs(link.a) > 1e-6:
                _rod(body, "CAPSULE", knee, end, 0.85 * r, _PALE)
        body, last = self._add_followers(spec) or body, self.system.arm.ordered[-1].link
        r, end = self._radius(self.system.arm.n), np.array([last.a, 0.0, last.d])
        along = np.array([1.0, 0, 0]) if abs(last.a) > 1e-6 else np.array([0.0, 0, 1])
        across = np.array([0.0, 1, 0])
        _add(body, "SPHERE", _TOOL, size=[1.1 * r, 0, 0], pos=end)
        for side in (-1, 1):
            root = end + side * 0.8 * r * across
            _rod(body, "CAPSULE", root, root + 2.6 * r * along, 0.3 * r, _TOOL)

    def _add_followers(self, spec: Any) -> Any:
        """Links of joints that follow others, up to their far end or else their centre of
        mass; the body that has the tool, if it is one of them."""
        body, r = None, self._radius(self.system.arm.n)
        for part in self.system.arm.ordered:
            if part.ratios is not None:
                body, link = spec.body(part.body), part.link
                if _add_meshes(spec, body, link.meshes, *link.far_end):
                    continue
                R, p = link.far_end
                end = p if p.any() else R @ np.array(link.inertial.com)
                _rod(body, "CYLINDER", (0, 0, -1.15 * r), (0, 0, 1.15 * r), 1.2 * r, _JOINT)
                if np.abs(end).max() > 1e-6:
                    _rod(body, "CAPSULE", (0, 0, 0), end, r, _PALE)
        tool = self.system.arm.ordered[-1]
        return None if tool.ratios is None else spec.body(tool.body)

    def _add_appendages(self, spec: Any) -> None:
        """A box on its hinge or slide for each; wheels are inside the satellite."""
        add_carried(spec, self.system.base)
        for i, part in enumerate(self.system.base.carried, start=1):
            if isinstance(part, Appendage):
                body = spec.body(f"carried_{i}")
                _box(body, part.body.com, *part.body.box(), _PANEL)

    def _add_surfaces(self, spec: Any) -> None:
        """Add the surfaces of the tool, and those that it meets on the base or in space."""
        contact, arm = self.system.contact, self.system.arm
        if contact is None:
            return
        turn, place = arm.links[-1].far_end
        for shape in contact.tool:
            link = spec.body(f"link_{arm.n}")
            add_surface(link, shape, place, turn @ arm.tool_rotation, _SURFACE)
        if contact.on != "payload":
            body = spec.body("platform") if contact.on == "base" else spec.worldbody
            for shape in contact.target:
                add_surface(body, shape, np.zeros(3), np.eye(3), _SURFACE)

    @property
    def _rim(self) -> Array:
        """The point (3,) of the plate's rim that cameras see [m]."""
        return 4.0 * self._radius(0) * np.array([0.64, -0.77, 0.0])

    @property
    def _boom_radius(self) -> float:
        """Of the links that bend [m]."""
        arm = self.system.arm
        shapes = [arm.base_shape if arm.base_flexures else None]
        shapes += [link.shape for link in arm.links if link.flexures]
        return max((k.radius for shape in shapes for k in shape or ()), default=0.1)

    def _radius(self, i: int) -> float:
        arm = self.system.arm
        span = arm.span_of(min(i, arm.n - 1))
        links, i = arm.links[span], i - span.start
        boom = max((k + 1 for k, link in enumerate(links) if link.flexures), default=0)
        if i < boom:  # as thick as the members between its joints
            return self._boom_radius
        size = float(sum(math.hypot(k.a, k.d) for k in links[boom:]))
        return 0.045 * size * (1 - 0.45 * (i - boom) / (len(links) - boom))

    # ------------------------------------------------------------------ frames

    def pose(self, y: Array, q: Array, u: Array | None = None) -> None:
        """Put the structure there.

        At base pose (6,), joint angles (n,) [rad] and u (p + c + m,) deflections of the arm's
        flexures [rad], of what a satellite carries, then internal modes; None: links are
        straight.
        """
        motors, passive, followers = places(self.system.arm)
        bends = self.system.arm.bends
        self.data.qpos[TO_Y] = y
        self.data.qpos[motors] = q
        for at, follower in zip(followers, self.system.arm.followers or (), strict=True):
            self.data.qpos[at] = np.dot(follower.ratios, q)
        if bends:
            self.data.qpos[passive[-bends:]] = 0.0 if u is None else u[:bends]
        carried = 0 if self.feet is not None else len(self.system.base.carried)
        if carried:
            first = 6 + len(motors) + len(passive)
            at = 0.0 if u is None else u[bends : bends + carried]
            self.data.qpos[first : first + carried] = at
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def beam(self, y: Array, u: Array | None = None) -> Array | None:
        """Bent centreline (..., k, 3) [m] at base poses (..., 6), None of a system without a
        beam.

        u (..., p + m) are deflections of the arm, then internal modes; None: these rest on the
        flange.
        """
        if self.rest_beam is None:
            return None
        bent = self.rest_beam + np.tensordot(y, self.bend, 1)
        if u is not None and self.system.base.m:
            u = u[..., self.system.arm.bends :]
            bent = bent + np.tensordot(u - self.system.base.attached(y), self.ripple, 1)
        return np.asarray(bent, dtype=np.float64)

    def legs(self, y: Array) -> Array | None:
        """Foot and head of every leg (..., 6, 2, 3) [m]; origin: the platform top at home."""
        if self.feet is None:
            return None
        top = np.array(self.system.emulator_settings.stewart.top)
        head = top @ np.swapaxes(rotation(y), -1, -2) + y[..., None, :3]
        return np.stack([np.broadcast_to(self.feet, head.shape), head], axis=-2)

    def add_support(self, y: Array, extent: float, u: Array | None = None) -> None:
        """Add what carries the arm and is no rigid body, see `pose`: the bent beam, or the
        legs; `extent` is the size of what the camera sees [m]."""
        legs, centreline = self.legs(y), self.beam(y, u)
        if legs is not None:
            for foot, head in legs:
                middle = foot + 0.55 * (head - foot)
                self.connect("CAPSULE", foot, middle, 0.05, _DARK)
                self.connect("CAPSULE", middle, head, 0.028, _METAL)
        elif centreline is not None:
            radius = max(self.thick / 2, 0.004 * extent)
            for a, b in itertools.pairwise(self.rest_beam):
                self.connect("CAPSULE", a, b, 0.5 * radius, _GHOST)
            for a, b in itertools.pairwise(centreline):
                self.connect("CAPSULE", a, b, radius, _BEAM)

    def add_payload(self, pose: Array) -> None:
        """Add the payload as the surfaces that the tool meets, or a box; its grip as a ball.

        Its pose (7,): place of its origin [m], unit quaternion.
        """
        payload, contact = self.system.payload, self.system.contact
        if payload is None:
            return
        place, turn = pose[:3], to_matrix(pose[3:])
        size = 0.12  # of the grip
        if contact is not None and contact.on == "payload":
            size = 0.03
            for shape in contact.target:
                for solid in solids(shape, place, turn):
                    self._show(*solid, _PAYLOAD)
        else:
            middle = place + turn @ np.array(payload.inertial.com)
            self._show(mujoco.mjtGeom.mjGEOM_BOX, payload.edges / 2, middle, turn, _PAYLOAD)
        grip = place + turn @ np.array(payload.grip.position)
        self.ball(grip, size * float(payload.edges.min()), _TOOL)

    def add_path(self, poses: Array, extent: float) -> None:
        """Add the path of a point on the plate's rim at base poses (N, 6) up to now; see
        `add_support`."""
        stride = max(1, (len(poses) - 1) // 60)
        poses = poses[::-stride][::-1]  # ends at the last
        points = poses[:, :3] + rotation(poses) @ self._rim
        for i, (a, b) in enumerate(itertools.pairwise(points)):
            fade = (*PATH[:3], 0.15 + 0.85 * (i + 1) / len(points))
            self.connect("CAPSULE", a, b, 0.005 * extent, fade)

    def add_wrench(self, y: Array, w: Array, most: tuple[float, float], longest: float) -> None:
        """Add force and moment (6,) on a base at a pose (6,), of which `most` ([N], [N m]) are
        drawn as long as `longest` [m].

        They begin on the plate's rim: at its centre the arm would hide them.
        """
        turn = rotation(y)
        origin = y[:3] + turn @ self._rim
        for part, largest, rgba in zip((w[:3], w[3:]), most, (FORCE, MOMENT), strict=True):
            arrow = longest * (turn @ part) / max(largest, 1e-12)
            if np.linalg.norm(arrow) > 0.02:
                self.connect("ARROW", origin, origin + arrow, 0.025, rgba)

    def _show(self, form: Any, size: Array, at: Array, axes: Array, rgba: Any) -> Any:
        """Add a shape to this frame."""
        geom, colour = self.scene.geoms[self.scene.ngeom], np.array(rgba, np.float32)
        mujoco.mjv_initGeom(geom, form, np.ascontiguousarray(size), at, axes.flatten(), colour)
        self.scene.ngeom += 1
        return geom

    def connect(self, kind: str, a: Array, b: Array, radius: float, rgba: Any) -> None:
        """Add a shape, by name of MuJoCo's geom type like CAPSULE, from a to b (3,) with a
        radius [m] and a colour, each from 0 to 1, to this frame; none where they coincide."""
        if np.linalg.norm(b - a) > 1e-9:
            form = getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
            geom = self._show(form, np.zeros(3), np.zeros(3), np.eye(3), rgba)
            mujoco.mjv_connector(geom, form, radius, a, b)

    def ball(self, at: Array, radius: float, rgba: Any) -> None:
        """Add a sphere around (3,) [m] to this frame."""
        form = mujoco.mjtGeom.mjGEOM_SPHERE
        self._show(form, np.full(3, radius), at, np.eye(3), rgba)

    # ------------------------------------------------------------------ cameras

    def camera(
        self, points: Array, margin: float, azimuth: float, elevation: float, aspect: float
    ) -> Any:
        """Return MuJoCo's camera that frames all the points (N, 3), with a margin [m] around
        them, seen in a direction [deg]; `aspect` is width over height."""
        az, el = math.radians(azimuth), math.radians(elevation)
        ahead = np.array(
            [math.cos(az) * math.cos(el), math.sin(az) * math.cos(el), math.sin(el)]
        )
        sideways = np.array([math.sin(az), -math.cos(az), 0.0])
        axes = np.stack([sideways, np.cross(sideways, ahead)])
        flat = points @ axes.T
        at = axes.T @ ((flat.min(axis=0) + flat.max(axis=0)) / 2)
        tangent = math.tan(math.radians(self.model.vis.global_.fovy) / 2)
        offset = points - at
        need = (np.abs(offset @ axes.T) + margin) / (tangent * np.array([aspect, 1.0]))
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = at
        camera.distance = float((need.max(axis=1) - offset @ ahead).max())
        camera.azimuth, camera.elevation = azimuth, elevation
        return camera

    def framing(self, arm: Array) -> tuple[Array, float]:
        """Points (m, 3) of arm (N, 3) and vehicle at rest, and the room that they need around
        them [m]."""
        base, margin, home = self.system.base, 0.6, np.zeros(6)
        legs, centreline = self.legs(home), self.beam(home)
        support = centreline if legs is None else legs.reshape(-1, 3)
        if support is not None or base.body is None:
            return (arm if support is None else np.vstack([arm, support])), margin
        points = [arm, np.array([base.body.com])]
        for part in base.carried:
            if isinstance(part, Appendage) and part.body.mass > LEAST:
                half, axes = part.body.box()
                points.append(np.array(part.body.com) + (_CORNERS * half) @ axes.T)
        return np.vstack(points), margin + float(base.body.box()[0].max())


def _add(body: Any, kind: str, rgba: Any, **options: Any) -> None:
    """A shape that is only seen: no mass, no contact."""
    shape = getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    options = {k: v if isinstance(v, str) else np.asarray(v, float).tolist()
               for k, v in options.items()}  # fmt: skip
    body.add_geom(type=shape, rgba=rgba, contype=0, conaffinity=0, mass=0, **options)


def _add_meshes(
    spec: Any,
    body: Any,
    files: tuple[MeshFile, ...] | None,
    R: Array = _UPRIGHT,
    p: Array = _ORIGIN,
) -> bool:
    """Add the meshes of a frame at R (3, 3), p (3,) in a body's; False where there are none."""
    meshes = meshes_of(files)
    for points, faces in meshes:
        name = f"mesh_{len(spec.meshes)}"
        spec.add_mesh(
            name=name,
            uservert=(points @ R.T + p).ravel().tolist(),
            userface=faces.ravel().tolist(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        _add(body, "MESH", _PALE, meshname=name)
    return bool(meshes)


def _rod(body: Any, kind: str, a: Any, b: Any, radius: float, rgba: Any) -> None:
    _add(body, kind, rgba, size=[radius, 0, 0], fromto=[*a, *b])


def _box(body: Any, at: Any, half: Array, axes: Array, rgba: Any) -> None:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    _add(body, "BOX", rgba, size=half, pos=at, quat=quat)


def _frame_along(x: Array) -> Array:
    """(3, 3) rotation whose first column is the unit vector x."""
    helper = np.eye(3)[int(np.abs(x).argmin())]
    y = np.cross(helper, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)
