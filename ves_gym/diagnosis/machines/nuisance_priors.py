"""Tolerances of a `System`: the small errors that any careful description has."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.machines.base import WRENCH, Nuisance
from ves_gym.effects import (
    BaseDamping,
    BaseExtraMode,
    BaseStiffness,
    BaseVirtualMass,
    GravityMass,
    GravityMoment,
    JointCoulomb,
    JointDriveGain,
    JointRotorInertia,
    JointTorqueOffset,
    JointViscous,
    PlatformBandwidth,
    PlatformDamping,
    SensorBias,
    SensorCalibration,
    SensorLag,
)
from ves_gym.mechanics.gravity import GravityModel, minimal_model
from ves_gym.mechanics.vehicle import Satellite, altered
from ves_gym.system.effect import Effect
from ves_gym.system.system import System

# Standard deviations: 0.6 of the bound one would state.
_MASS, _INERTIA, GAIN, _FILTER = 0.0006, 0.006, 0.0006, 0.006  # relative
_COM, _FRICTION, _OFFSET = 1.2e-4, 0.03, 0.018  # m; N m; N, N m
_WEIGHT, _MOMENT = 0.03, 0.006  # kg, kg m, of the weight estimate
_INNER, _RESIDUAL = (8.0, 8.5, 9.5), 0.7  # Hz, kg: modes that the vehicle's model leaves out
_BASE, _LOSS = 0.0012, 0.006  # relative, of the base's mass and stiffness; of its damping
_BIAS = 50.0  # N, N m: an effect's bound, which an arm described in grams would pass
_SEEN = 24.0  # Hz: twice the band, below which inner modes show


def system_nuisances(system: System) -> Iterator[Nuisance]:
    """Yield the small errors of any description of such a machine; each model is a `System`.

    Those that would do nothing in it are left out: joints that follow a prescribed motion rub
    in vain, and a satellite has no spring.
    """
    yield from (k for k in _nuisances(system) if k is not None)


def _nuisances(system: System) -> Iterator[Nuisance | None]:
    arm = system.arm
    both = ("joint", "wrench")

    def heavier(i: int, **changes: Any) -> System:
        links = list(arm.links)
        inertial = dataclasses.replace(links[i].inertial, **changes)
        links[i] = dataclasses.replace(links[i], inertial=inertial)
        return system.replace(arm=dataclasses.replace(arm, links=tuple(links)))

    def effect(
        name: str, ports: str, step: float, std: float, *effects: Effect
    ) -> Nuisance | None:
        try:
            model = system.replace(effects=(*system.effects, *effects))
        except ParameterError:
            return None
        return Nuisance(name, tuple(ports.split()), model, step, std)

    for i, link in enumerate(arm.links):
        body, where = link.inertial, f"of link {i + 1}"
        heavier_link = heavier(i, mass=1.01 * body.mass)
        yield Nuisance(f"mass {where}", both, heavier_link, 0.01, _MASS)
        moments = np.array(body.inertia) * 1.1
        grown = heavier(i, inertia=tuple(map(tuple, moments.tolist())))
        yield Nuisance(f"inertia {where}", both, grown, 0.1, _INERTIA)
        for k, axis in enumerate("xyz"):
            com = list(body.com)
            com[k] += 1e-3
            shifted = heavier(i, com=tuple(com))
            yield Nuisance(f"centre of mass {axis} {where}", both, shifted, 1e-3, _COM)

        def at_joint(value: float, i: int = i) -> tuple[float, ...]:
            return tuple(value if k == i else 0.0 for k in range(arm.n))

        where, joint = f"of joint {i + 1}", "joint"
        small = 0.1 * link.rotor_inertia + 1e-3
        yield effect(
            f"rotor {where}",
            joint,
            small,
            _INERTIA * link.rotor_inertia + 1e-6,
            JointRotorInertia(added=at_joint(small)),
        )
        yield effect(f"gain {where}", joint, 0.01, GAIN, JointDriveGain(error=at_joint(0.01)))
        yield effect(
            f"friction {where}", joint, 0.1, _FRICTION, JointCoulomb(torque=at_joint(0.1))
        )
        yield effect(
            f"damping {where}", joint, 0.1, _FRICTION, JointViscous(damping=at_joint(0.1))
        )
        yield effect(
            f"zero {where}", joint, 0.1, _FRICTION, JointTorqueOffset(torque=at_joint(0.1))
        )
    base = dataclasses.replace(arm.base, mass=1.01 * arm.base.mass)
    heavier_foot = system.replace(arm=dataclasses.replace(arm, base=base))
    yield Nuisance("mass of the arm's foot", ("wrench",), heavier_foot, 0.01, _MASS)
    for k, axis in enumerate("xyz"):
        com = list(arm.base.com)
        com[k] += 1e-3
        base = dataclasses.replace(arm.base, com=tuple(com))
        shifted_foot = system.replace(arm=dataclasses.replace(arm, base=base))
        name = f"centre of mass {axis} of the arm's foot"
        yield Nuisance(name, ("wrench",), shifted_foot, 1e-3, _COM)
    if system.mode == "emulated":
        yield from _of_the_laboratory(system, effect)
    # a vehicle of six coordinates has no inner modes
    for k, axis in enumerate("" if isinstance(system.vehicle, Satellite) else "xyz"):
        way = tuple(float(i == k) for i in range(3))
        for rate in _INNER:
            mode = BaseExtraMode(mass=1.0, frequency=rate, direction=way)
            name = f"inner mode along {axis} near {rate:g} Hz"
            tolerance = effect(name, _at_base(system), 1.0, _RESIDUAL, mode)
            if tolerance is not None and system.mode == "ideal":
                inner = altered(system.vehicle, mode.base(system.base))
                tolerance = dataclasses.replace(tolerance, model=system.replace(vehicle=inner))
            yield tolerance
    modal = not isinstance(system.vehicle, Satellite)
    if modal:
        yield from _of_the_modes(system)
    for what, kind in (
        ("stiffness", BaseStiffness),
        ("mass", BaseVirtualMass),
        ("damping", BaseDamping),
    ):
        if modal and what != "mass" and system.mode == "ideal":
            continue
        std = _BASE if what != "damping" else _LOSS
        yield effect(f"{what} of the base", _at_base(system), 0.01, std, kind(error=0.01))


def _of_the_modes(system: System) -> Iterator[Nuisance]:
    """Yield errors of stiffness and damping, those of each mode of the base by themselves.

    Six modes are those of the interface; of inner ones the slow count. The laboratory computes
    its own exactly, unless `known` states otherwise.
    """
    base = system.base
    M, D, K = (base.M, base.D, base.K) if base.carried else base.full()
    rates, ways = scipy.linalg.eigh(K, M)
    hertz = np.sqrt(np.maximum(rates, 0.0)) / (2 * np.pi)
    for i in range(max(6, int(np.sum(hertz < _SEEN)))):
        way = M @ ways[:, i]
        stiffness = rates[i] * np.outer(way, way)
        damping = float(ways[:, i] @ D @ ways[:, i]) * np.outer(way, way)
        for what, std, changed in (
            ("stiffness", _BASE, (D, K + 0.01 * stiffness)),
            ("damping", _LOSS, (D + 0.01 * damping, K)),
        ):
            other = system.replace(vehicle=altered(system.vehicle, base.with_full(*changed)))
            name = f"{what} of the base at {hertz[i]:.3g} Hz"
            usual = std if system.mode == "ideal" else 0.0
            yield Nuisance(name, tuple(_at_base(system).split()), other, 0.01, usual)


def _at_base(system: System) -> str:
    """Ports at which a vehicle's errors show; in space its pose is judged at `wrench`, too."""
    return "base wrench" if system.mode == "ideal" else "admittance"


def _of_the_laboratory(
    system: System, effect: Callable[..., Nuisance | None]
) -> Iterator[Nuisance | None]:
    weight = GravityModel.of(system.arm).wrench(system.arm, np.zeros(system.arm.n), np.zeros(6))
    resting = system.emulator_settings.sensor.frame @ weight
    for i in range(6):

        def six(value: float, i: int = i) -> dict[str, tuple[float, ...]]:
            out = [value if k == i else 0.0 for k in range(6)]
            return {"force": tuple(out[:3]), "moment": tuple(out[3:])}

        axis = WRENCH[i]
        yield effect(f"zero of {axis}", "wrench", 0.1, _OFFSET, SensorBias(**six(0.1)))
        error = np.zeros((6, 6))
        error[i, i] = 0.01
        gain = SensorCalibration(error=tuple(map(tuple, error.tolist())))
        off = float(np.clip(-0.01 * resting[i], -_BIAS, _BIAS))  # it was zeroed under the arm
        zero = SensorBias(**six(off))
        yield effect(f"gain of {axis}", "wrench", 0.01, GAIN, gain, zero)
    yield effect("sensor filter", "wrench", 0.01, _FILTER, SensorLag(error=0.01))
    if system.emulator_settings.operation == "microgravity":
        yield effect("weight estimate", "gravity", 0.1, _WEIGHT, GravityMass(error=0.1))
        minimal = minimal_model(system.arm)
        for k, name in enumerate(minimal.names):
            moment = tuple(0.1 if i == k else 0.0 for i in range(minimal.size))
            yield effect(
                f"moment {name} of the estimate",
                "gravity",
                0.1,
                _MOMENT,
                GravityMoment(error=moment),
            )
    for kind, name in ((PlatformBandwidth, "bandwidth"), (PlatformDamping, "damping")):
        yield effect(f"platform {name}", "platform wrench", 0.01, _FILTER, kind(error=0.01))
