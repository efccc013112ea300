"""Weight of the arm on its base, and the fewest numbers that predict it (thesis 3.4, App. C).

The weight's force is M_total g, its moment c(q) x g with the arm's first moment of mass c.
c is linear in masses and first moments of the links, but only some combinations of these
show: the minimal parameters P, nine for the PUMA 560. Platform frame, linear part first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, Vector, finite, require_positive, unit
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import frames, joint_values
from ves_gym.mechanics.spatial import cross, numbers, room

GRAVITY = 9.81  # m/s^2; thesis: 919 N for 93.7 kg


def gravity_vector(y: npt.ArrayLike) -> Array:
    """(..., 6) base pose -> (..., 3) free fall in platform axes [m/s^2] (thesis eq. 3.4)."""
    pose = numbers(y)
    out = np.zeros_like(pose, shape=(*pose.shape[:-1], 3))
    cos_y = np.cos(pose[..., 4])
    out[..., 0] = GRAVITY * np.sin(pose[..., 4])
    out[..., 1] = -GRAVITY * np.sin(pose[..., 3]) * cos_y
    out[..., 2] = -GRAVITY * np.cos(pose[..., 3]) * cos_y
    return out


# --------------------------------------------------------------- all mass parameters


def mass_parameters(arm: Arm) -> Array:
    """(3 (n + 1) + n,) m0 r0x, m0 r0y, ..., mn rnz [kg m], then the links' masses [kg]."""
    bodies = [arm.base, *(link.inertial for link in arm.links)]
    moments = [body.mass * x for body in bodies for x in body.com]
    return np.array(moments + [body.mass for body in bodies[1:]])


def moment_regressor(arm: Arm, q: npt.ArrayLike) -> Array:
    """Return W (..., 3, 3 (n + 1) + n) with c(q) = W `mass_parameters(arm)` [kg m] at q (...,
    n).

    c is the first moment of base and links about the platform origin. The thesis's matrix of
    eq. 3.8 is that of c x g.
    """
    n, at = arm.n, frames(arm, joint_values(arm, q))
    out = np.zeros((*at.position.shape[:-2], 3, 3 * (n + 1) + n))
    out[..., :3] = np.eye(3)
    for i in range(n):
        out[..., 3 * (i + 1) : 3 * (i + 2)] = at.rotation[..., i, :, :]
    out[..., 3 * (n + 1) :] = np.swapaxes(at.position, -1, -2)
    return out


# ---------------------------------------------------------------- minimal parameters


@dataclass(frozen=True, eq=False, kw_only=True)
class MinimalModel:
    """The combinations P of mass parameters on which the weight's moment depends.

    Each revolute joint adds two to the base's three. Of a link's three directions one, the
    axis of the joint that moves it, also belongs to the body before.
    """

    arm: Arm
    directions: tuple[tuple[int, int], ...]  # (body, axis) of each P; body 0 is the base
    combination: Array  # (size, 3 (n + 1) + n): P = combination @ mass_parameters
    names: tuple[str, ...]  # what leads each P: "m0 r0x", ...
    descriptions: tuple[str, ...]  # all of it: "m2 r2x + (m2 + m3) a2"

    @property
    def size(self) -> int:
        """Number of minimal parameters, 3 + 2 n."""
        return len(self.directions)

    def parameters(self, arm: Arm | None = None) -> Array:
        """(size,) P [kg m] from the masses of `arm` (of the same lengths; default its own)."""
        arm = self.arm if arm is None else arm
        if not np.array_equal(minimal_model(arm).combination, self.combination):
            raise ParameterError(f"{arm.name} has not the geometry of {self.arm.name}")
        return self.combination @ mass_parameters(arm)

    def regressor(self, q: npt.ArrayLike) -> Array:
        """(..., 3, size) C with c(q) = C P [kg m]."""
        return np.ascontiguousarray(np.swapaxes(self._columns(q), -1, -2))

    def G(self, q: npt.ArrayLike, g: npt.ArrayLike) -> Array:
        """Return G (..., 3, size) with moment = G P (thesis eq. 3.9) at q (..., n) [rad],
        gravity g (..., 3) in platform axes [m/s^2]."""
        C, gravity = self.regressor(q), np.asarray(g, float)[..., None]
        return np.cross(C, gravity, axis=-2)

    def first_moment(self, q: npt.ArrayLike, P: npt.ArrayLike) -> Array:
        """Return c(q) = C P (..., 3) [kg m] of parameters P (..., size) [kg m]."""
        moment: Array = (self._columns(q) * numbers(P)[..., None]).sum(axis=-2)
        return moment

    def _columns(self, q: npt.ArrayLike) -> Array:
        """(..., size, 3) the directions in platform axes."""
        rotation = frames(self.arm, joint_values(self.arm, q)).rotation
        out = room(rotation, *rotation.shape[:-3], self.size, 3)
        for k, (body, axis) in enumerate(self.directions):
            out[..., k, :] = rotation[..., body - 1, :, axis] if body else np.eye(3)[axis]
        return out


@lru_cache(maxsize=64)
def minimal_model(arm: Arm) -> MinimalModel:
    """The minimal moment parameters of an arm, or of several, from base to tips in closed form.

    Joint i's axis z' (z of body i - 1) is a sum of body i's x, y and z, without x where
    there is no beta. One of the three is expressed by the other two and z': the one that z'
    determines best. Link i's far end moves everything beyond it by d z' + a x', x' being
    body i's x before beta turns it.
    """
    arm.require_uncoupled("the model of a weight's moment")
    width = 3 * (arm.n + 1) + arm.n
    chosen = [(0, 0), (0, 1), (0, 2)]
    rows = [np.zeros(width) for _ in chosen]
    terms: list[list[str]] = [[] for _ in chosen]

    def lump(where: dict[int, float], column: int, factor: float, text: str) -> None:
        """Add factor * (mass parameter `column`), which points along `where`, to P."""
        for j, part in where.items():
            rows[j][column] += factor * part
            terms[j].append(_term(part, text))

    def extend(where: dict[int, float], length: float, first: int, name: str) -> None:
        """Let a limb's bodies from `first` on lie further away, by `length` along `where`."""
        last = arm.span_of(first - 1).stop
        beyond = [f"m{j}" for j in range(first, last + 1)]
        weight = f"({' + '.join(beyond)})" if len(beyond) > 1 else beyond[0]
        for j, part in where.items():
            rows[j][3 * arm.n + 2 + first : 3 * (arm.n + 1) + last] += length * part
            terms[j].append(_term(part, f"{weight} {name}"))

    for k in range(3):
        lump({k: 1.0}, k, 1.0, f"m0 r0{'xyz'[k]}")
    feet = {foot.first: foot for foot in arm.feet}
    for i, link in enumerate(arm.links, start=1):
        if i - 1 in feet:
            foot = feet[i - 1]
            z = {k: part for k, part in enumerate(foot.rotation[:, 2].tolist()) if part}
            for k, length in enumerate(foot.position.tolist()):
                if length:
                    extend({k: 1.0}, length, i, f"{'xyz'[k]}{i - 1}")
        far = link.far_end[0]
        axis = far[2].tolist()  # z' in body i
        lost = max((2, 1, 0), key=lambda k: abs(axis[k]))
        others = [k for k in range(3) if k != lost]
        number = {k: len(chosen) + j for j, k in enumerate(others)}
        chosen += [(i, k) for k in others]
        rows += [np.zeros(width), np.zeros(width)]
        terms += [[], []]
        remainder = {j: part / axis[lost] for j, part in z.items()}
        remainder |= {number[k]: -axis[k] / axis[lost] for k in others if axis[k]}
        along = [remainder if k == lost else {number[k]: 1.0} for k in range(3)]
        for k in range(3):
            lump(along[k], 3 * i + k, 1.0, f"m{i} r{i}{'xyz'[k]}")
        for length, name, where in ((link.d, "d", z), (link.a, "a", _mix(far[0], along))):
            if length:
                extend(where, length, i, f"{name}{i}")
        z = along[2]
    names = tuple(f"m{body} r{body}{'xyz'[axis]}" for body, axis in chosen)
    described = tuple(" ".join(t).removeprefix("+ ") for t in terms)
    combination = np.array(rows)
    combination.flags.writeable = False
    return MinimalModel(
        arm=arm,
        directions=tuple(chosen),
        combination=combination,
        names=names,
        descriptions=described,
    )


def _mix(parts: Array, along: list[dict[int, float]]) -> dict[int, float]:
    """Return the sum of directions times `parts` (3,), each by kept directions."""
    out: dict[int, float] = {}
    for part, where in zip(parts.tolist(), along, strict=True):
        for j, k in where.items():
            if part:
                out[j] = out.get(j, 0.0) + part * k
    return out


def _term(part: float, text: str) -> str:
    size = "" if abs(part) == 1 else f"{abs(part):.6g} "
    return f"{'-' if part < 0 else '+'} {size}{text}"


# --------------------------------------------------------------------------- weight


def gravity_wrench(
    arm: Arm, q: npt.ArrayLike, g_b: npt.ArrayLike, mass: npt.ArrayLike, P: npt.ArrayLike
) -> Array:
    """Weight (..., 6) [N, N m] of the arm on its base at the platform origin (thesis eq. 3.3a,
    3.9).

    At q (..., n) [rad], free fall g_b (..., 3) in platform axes [m/s^2], of total mass (...)
    [kg] and parameters P (..., size) [kg m] as in `minimal_model(arm)`; leading axes broadcast.
    """
    model = minimal_model(arm)
    joints, g, m, values = (numbers(k) for k in (q, g_b, mass, P))
    if values.shape[-1:] != (model.size,):
        raise ParameterError(
            f"P must have {model.size} entries for {arm.name}, got shape {values.shape}"
        )
    force, moment = m[..., None] * g, cross(model.first_moment(joints, values), g)
    shape = np.broadcast_shapes(force.shape, moment.shape)
    out = np.zeros_like(moment, shape=(*shape[:-1], 6))
    out[..., :3], out[..., 3:] = force, moment
    return out


@dataclass(frozen=True, kw_only=True)
class GravityModel:
    """Mass parameters that the gravity compensation goes by: M_total and P (thesis 3.4)."""

    mass: float = unit("kg")
    P: Vector = unit("kg m")  # in the order of minimal_model(arm).names
    source: str = "user"

    def __post_init__(self) -> None:
        require_positive(self, "mass")
        finite(self.P, (len(self.P),), "GravityModel.P")

    @staticmethod
    def of(arm: Arm) -> GravityModel:
        """The exact model of an arm."""
        P = minimal_model(arm).parameters()
        return GravityModel(mass=arm.mass, P=tuple(P.tolist()), source=f"masses of {arm.name}")

    def wrench(self, arm: Arm, q: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the estimated weight (..., 6) on the base at the platform-top origin, platform
        axes [N, N m], at q (..., n) [rad] and pose y (..., 6)."""
        return gravity_wrench(arm, q, gravity_vector(y), self.mass, self.P)
