"""An arm on a base that gives way, over a force plate, as a machine.

What the plate reads follows from the motion of joints and base alone (no motor torque is
needed): the rate of momentum of all that stands on it, by Pinocchio. The base gives way like
springs and dampers between plate and base, without mass of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array, ParameterError, require_positive, unit
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.machines.base import WRENCH, Nuisance, Port
from ves_gym.diagnosis.machines.joint_changes import CarriedBody
from ves_gym.diagnosis.machines.plant import (
    Effects,
    PlantEffect,
    PlantMachine,
    Size,
    candidate_of,
    of_kind,
    plant_effect,
)
from ves_gym.diagnosis.machines.static_poses import BIAS, WrenchBias, WrenchGain, wrench_gain
from ves_gym.mechanics.body_numbers import PARAMETER_UNITS, PARAMETERS
from ves_gym.mechanics.spatial import AXES

_PAYLOAD = {"kg": (1.0, 0.0, 50.0), "kg m": (0.1, -20.0, 20.0), "kg m^2": (0.02, -10.0, 10.0)}
_LARGE = 1e3  # usual size of the wrench at rest in N, N m: nobody knows it


@plant_effect("plate/payload")
@dataclass(frozen=True)
class PlatePayload(PlantEffect):
    """A body fixed to the last link, by the numbers of `CarriedBody`."""

    mass: float
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = (0.0,) * 6

    @property
    def parameters(self) -> Array:
        """(10,) as of `CarriedBody`."""
        return CarriedBody(self.mass, self.moment, self.inertia).parameters


@plant_effect("mount/stiffness")
@dataclass(frozen=True)
class MountStiffness(PlantEffect):
    """The base along one axis stiffer than described."""

    axis: int
    error: float  # relative


@plant_effect("mount/damping")
@dataclass(frozen=True)
class MountDamping(PlantEffect):
    """The base along one axis damped otherwise than described."""

    axis: int
    added: float  # N s/m, N m s/rad


@dataclass(frozen=True)
class RestWrench(PlantEffect):
    """Load of plate and springs in the pose that counts as zero, in a run."""

    kind = "mount/rest"
    run: str
    wrench: tuple[float, ...]


@dataclass(frozen=True)
class PlateTolerance:
    """Usual errors of an arm over a force plate, standard deviations."""

    inertia: float = unit("1", default=0.006)
    gain: float = unit("1", default=0.002)  # of the plate
    stiffness: float = unit("1", default=0.002)
    zero: float = unit("N", default=0.1)  # of the plate; a tenth of it in N m
    unexplained: float = unit("1", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "inertia", "gain", "stiffness", "zero")


@dataclass(frozen=True)
class HeavierLink(PlantEffect):
    """A link whose mass and inertia are larger."""

    kind = "plate/heavier"
    link: int
    error: float  # relative


class ForcePlateArm(PlantMachine):
    """Ports `plate` (joints, base -> reading) and `mount` (base -> reading).

    Args:
        name: of the machine.
        path: URDF of the arm, its root link what stands on the springs.
        joints: names, in the order of the columns.
        stiffness, damping: (6, 6) of the springs [N/m, N m/rad; per rate], base axes; without
            them there is no port `mount`.
        tolerance: of the description.
        effects: that the description has.
        known: sizes of single tolerances.

    Raises:
        ParameterError: the file, joints that it lacks or has besides.
    """

    effects = (PlatePayload, WrenchBias, WrenchGain, MountStiffness, MountDamping)

    def __init__(
        self,
        name: str,
        path: Path,
        joints: Sequence[str],
        stiffness: Array | None = None,
        damping: Array | None = None,
        tolerance: PlateTolerance | None = None,
        effects: Sequence[PlantEffect] = (),
        known: Mapping[str, float] | None = None,
    ) -> None:
        import pinocchio as pin

        self._pin, self.tolerance = pin, tolerance or PlateTolerance()
        super().__init__(name, effects, known, self.tolerance.unexplained)
        try:
            self._model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
        except (ValueError, RuntimeError) as error:
            raise ParameterError(f"model {path}: cannot be read: {error}") from None
        names = list(self._model.names)[2:]
        if sorted(names) != sorted(joints):
            raise ParameterError(
                f"the model has joints {', '.join(names)}; columns are of {', '.join(joints)}"
            )
        ids = [self._model.getJointId(j) for j in joints]
        self._at_q = [self._model.joints[i].idx_q for i in ids]
        self._at_v = [self._model.joints[i].idx_v for i in ids]
        self._data = self._model.createData()
        self._last = max(
            range(1, self._model.njoints), key=lambda i: len(self._model.supports[i])
        )
        self.stiffness, self.damping = stiffness, damping
        units = ("N",) * 3 + ("N m",) * 3
        title = "reading of the plate less what the motion above it takes"
        needs = ("q", "y", "plate")
        self.ports = (Port("plate", title, tuple(WRENCH), units, needs, signal="plate"),)
        if stiffness is not None:
            title = "reading of the plate less what springs and dampers under the base give"
            port = Port("mount", title, tuple(WRENCH), units, ("y", "plate"), signal="plate")
            self.ports = (*self.ports, port)

    def tolerances(self) -> list[Nuisance]:
        """Return errors of links, plate and springs."""
        allowed, both = self.tolerance, tuple(p.name for p in self.ports)
        out = []
        for i in range(1, self._model.njoints):
            model = self.model([HeavierLink(i, 0.01)])
            name = "inertia of the base" if i == 1 else f"inertia behind {self._model.names[i]}"
            out.append(Nuisance(name, ("plate",), model, 0.01, allowed.inertia))
        for k, axis in enumerate(WRENCH):
            std = allowed.zero * (1.0 if k < 3 else 0.1)
            zero = self.model([WrenchBias(tuple((0.1 * np.eye(6)[k]).tolist()))])
            out.append(Nuisance(f"zero of {axis}", both, zero, 0.1, std))
            gain = self.model([WrenchGain(k, 0.01)])
            out.append(Nuisance(f"gain of {axis}", both, gain, 0.01, allowed.gain))
            if self.stiffness is not None:
                softer = self.model([MountStiffness(k, 0.01)])
                name = f"stiffness of {AXES[k]}"
                out.append(Nuisance(name, ("mount",), softer, 0.01, allowed.stiffness))
        return out

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return what springs carry at rest, axis by axis: poses are counted from anywhere."""
        if self.stiffness is None:
            return ()
        return [
            Nuisance(
                f"{axis} at rest in {run.name}",
                ("mount",),
                self.model([RestWrench(run.name, tuple((_LARGE * np.eye(6)[k]).tolist()))]),
                1.0,
                1.0,
            )
            for k, axis in enumerate(WRENCH)
        ]

    def candidates(self) -> tuple[Candidate, ...]:
        """Return payload, bias and gains of the plate, stiffness and damping per axis."""
        both = tuple(p.name for p in self.ports)
        ranges = [_PAYLOAD[u] for u in PARAMETER_UNITS]
        numbers = [
            Size(name, symbol, *limits)
            for name, symbol, limits in zip(PARAMETERS, PARAMETER_UNITS, ranges, strict=True)
        ]
        out = [
            candidate_of(PlatePayload, ("plate",), numbers, _payload, sparse=True),
            candidate_of(
                WrenchBias,
                both,
                BIAS,
                lambda x: WrenchBias(tuple(float(k) for k in x)),
                sparse=True,
            ),
        ]
        error = Size("error", "1", 0.05, -0.9, 10.0)
        for k, axis in enumerate(WRENCH):
            out.append(candidate_of(WrenchGain, both, [error], partial(wrench_gain, k), axis))
        if self.stiffness is None:
            return tuple(out)
        for k, axis in enumerate(AXES):
            symbol = "N s/m" if k < 3 else "N m s/rad"
            usual = float(0.1 * self.damping[k, k]) if self.damping is not None else 0.0
            added = Size("added", symbol, usual or 1.0, -1e6, 1e6)
            out += [
                candidate_of(
                    MountStiffness,
                    ("mount",),
                    [error],
                    partial(_stiffer, k),
                    axis,
                ),
                candidate_of(
                    MountDamping,
                    ("mount",),
                    [added],
                    partial(_damped, k),
                    axis,
                ),
            ]
        return tuple(out)

    def residual(self, run: Run, port: str, effects: Effects) -> Array:
        """Return the reading less what it should have been, (..., T, 6)."""
        modelled = self._needed(run, effects) if port == "plate" else self._sprung(run, effects)
        for e in of_kind(effects, WrenchGain):
            modelled = modelled * (1 + e.error * np.eye(6)[e.axis])
        for e in of_kind(effects, WrenchBias):
            modelled = modelled + np.array(e.bias)
        return np.asarray(run["plate"] - modelled)

    def _sprung(self, run: Run, effects: Effects) -> Array:
        """Wrench (..., T, 6) on the base by springs and dampers, in the axes of the world."""
        assert self.stiffness is not None
        K = self.stiffness.copy()
        D = np.zeros((6, 6)) if self.damping is None else self.damping.copy()
        for e in of_kind(effects, MountStiffness):
            K[e.axis] = K[e.axis] * (1 + e.error)
        for e in of_kind(effects, MountDamping):
            D[e.axis, e.axis] += e.added
        out = -(run.base.x @ K.T + run.base.v @ D.T)
        lever = np.cross(run.base.x[..., :3], out[..., :3])  # they act where the base is
        out = out + np.concatenate([np.zeros_like(lever), lever], axis=-1)
        for e in of_kind(effects, RestWrench):
            if e.run == run.name:
                out = out + np.array(e.wrench)
        return out

    def _needed(self, run: Run, effects: Effects) -> Array:
        """Wrench (..., T, 6) that the motion takes, about the world's origin and axes."""
        out = self._columns(run, None)
        for e in of_kind(effects, HeavierLink):
            link = self._columns(run, e.link)
            link_parameters = self._model.inertias[e.link].toDynamicParameters()
            out = out + e.error * (link @ link_parameters)
        carried = [e.parameters for e in of_kind(effects, PlatePayload)]
        if carried:
            out = out + self._columns(run, self._last) @ sum(carried)
        return out

    def _columns(self, run: Run, link: int | None) -> Array:
        """Wrench (..., T, 6) of all bodies, or (..., T, 6, 10) per parameter of one link."""
        key = ("plate", link)
        if key not in run.memory:
            pin, model, data = self._pin, self._model, self._data
            shape = run["q"].shape[:-1]
            joints, base = run.joints, run.base
            n = int(np.prod(shape))
            moves = [np.asarray(x).reshape(n, -1) for x in (*joints, *base)]
            q, v, a, place, rate, rise = moves
            rows = []
            for k in range(n):
                Q, V, A = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
                turn = Rotation.from_rotvec(place[k, 3:])
                R = turn.as_matrix()
                Q[:3], Q[3:7] = place[k, :3], turn.as_quat()
                V[:6], A[:6] = _body_motion(R, place[k, 3:], rate[k], rise[k])
                Q[self._at_q], V[self._at_v], A[self._at_v] = q[k], v[k], a[k]
                world = _to_world(R, place[k, :3])
                if link is None:
                    rows.append(world @ pin.rnea(model, data, Q, V, A)[:6])
                else:
                    full = pin.computeJointTorqueRegressor(model, data, Q, V, A)
                    rows.append(world @ full[:6, 10 * (link - 1) : 10 * link])
            run.memory[key] = np.array(rows).reshape(*shape, *rows[0].shape)
        return np.asarray(run.memory[key])


def _body_motion(R: Array, turn: Array, rate: Array, rise: Array) -> tuple[Array, Array]:
    """Twist and its rate (6,) in body axes from rates of position and rotation vector.

    Pinocchio's acceleration is that of the twist in the moving frame: for the linear part the
    derivative of R^T x', that is R^T x'' - w x (R^T x').
    """
    J, dJ = _rotation_rate(turn, rate[3:])
    w = J @ rate[3:]
    dw = J @ rise[3:] + dJ @ rate[3:]
    linear = R.T @ rate[:3]
    return (
        np.concatenate([linear, w]),
        np.concatenate([R.T @ rise[:3] - np.cross(w, linear), dw]),
    )


def _rotation_rate(r: Array, rate: Array) -> tuple[Array, Array]:
    """Right Jacobian (3, 3) of a rotation vector, body rate = J r', and its rate."""

    def jacobian(x: Array) -> Array:
        angle = float(np.linalg.norm(x))
        S = np.cross(np.eye(3), x)  # S y = x x y
        if angle < 1e-6:
            return np.asarray(np.eye(3) - S / 2 + S @ S / 6)
        a = (1 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
        return np.asarray(np.eye(3) - a * S + b * S @ S)

    h = 1e-5
    later, sooner = jacobian(r + h * rate), jacobian(r - h * rate)
    return jacobian(r), (later - sooner) / (2 * h)


def _to_world(R: Array, place: Array) -> Array:
    """(6, 6) that takes a wrench of the body's frame to the world's axes and origin."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    out[3:, :3] = np.cross(np.eye(3), place) @ R
    return out


def _payload(x: Array) -> PlatePayload:
    m, a, b, c, *inertia = (float(k) for k in x)
    return PlatePayload(m, (a, b, c), tuple(inertia))


def _stiffer(axis: int, x: Array) -> MountStiffness:
    return MountStiffness(axis, float(x[0]))


def _damped(axis: int, x: Array) -> MountDamping:
    return MountDamping(axis, float(x[0]))
