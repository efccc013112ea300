"""Functions of configurations and states, compiled, for many of them at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.compiled_function import CompiledFunction, lanes, unlane
from ves_gym.engine.kernel.numbers import geometry, parameters, structure, symbolic_model
from ves_gym.engine.kernel.symbolic import column, symbols
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_arrays import Chain, LinkBodies
from ves_gym.mechanics.dynamics import newton_euler
from ves_gym.mechanics.equations import base_energy
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench, minimal_model
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.modes import jacobi_sweep, natural_modes, reduced
from ves_gym.mechanics.spatial import rotation
from ves_gym.system.system import System

if TYPE_CHECKING:
    import casadi


def _traced(name: str, subject: System | Arm) -> Callable[[], casadi.Function]:
    """A graph of `trace`, which is loaded for what is in no store yet."""
    return lambda: getattr(import_module("ves_gym.engine.kernel.trace"), name)(subject)


def coupling_matrices(system: System, q: Array) -> Array:
    """Return Q(q) of many configurations.

    Q is of the vehicle, so of the ideal system where an emulated one is given: the emulated
    mode's graph has no M, D and K.

    Args:
        system: arm and vehicle, which carries no appendage: the graph knows none.
        q: (N, n) joint angles [rad].

    Returns:
        (N, n, n) [J/rad^2].
    """
    system, n = system.ideal(), system.arm.n
    return system_function("coupling", system)(q, parameters(system)[1]).reshape(-1, n, n)


@lru_cache(maxsize=128)
def system_function(name: str, system: System) -> CompiledFunction:
    """Return a function of `trace` by its name, such as `contact`, for a system's structure."""
    return CompiledFunction(f"{name} {structure(system)}", _traced(name, system))


@lru_cache(maxsize=64)
def weight_function(arm: Arm) -> CompiledFunction:
    """(q, y, mass, P) -> wrench of the arm's weight on the platform (`gravity.gravity_wrench`).

    In platform axes [N, N m], of the pose y, the arm's mass (1) [kg] and its minimal
    parameters P [kg m].
    """

    def weight(q: Array, y: Array, mass: Array, P: Array) -> Array:
        return gravity_wrench(arm, q, gravity_vector(y), mass[:, 0], P)

    size = minimal_model(arm).size
    return CompiledFunction.of(f"weight {geometry(arm)}", weight, arm.n, 6, 1, size)


def motion_loads(
    arm: Arm, q: Array, v: Array, a: Array, spin: Array, turn: Array, accel: Array
) -> tuple[Array, Array]:
    """Return what `dynamics.newton_euler` does, of many instants (...) with leading axes alike.

    Masses, centres, inertias and rotors are numbers, so that arms that differ in them share
    the code.
    """
    n, count, key = arm.n, len(arm.joints) + 1, f"load {geometry(arm)}"

    def load(*rows: Array) -> tuple[Array, Array]:
        *motion, numbers = (row[0] for row in rows)
        mass, com, moments, rotors = np.split(numbers, np.cumsum([1, 3, 6]) * count)
        square = moments.reshape(count, 6)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        bodies = LinkBodies(mass, com.reshape(count, 3), square, rotors)
        chain = Chain(arm.joints, arm.roots, bodies, arm.coupling)
        q, v, a, spin, turn, accel = motion
        return newton_euler(chain, q, v, a, spin=spin, turn=turn, accel=accel)

    mass, com, inertia, rotors = arm.bodies
    moments = inertia[:, *np.triu_indices(3)]
    numbers = np.concatenate([mass, com.ravel(), moments.ravel(), rotors])
    function = CompiledFunction.of(key, load, n, n, n, 3, 3, 3, len(numbers))
    out = function(q, v, a, spin, turn, accel, numbers)
    return out[..., :n], out[..., n:]


def points(*parts: tuple[npt.ArrayLike, int, str]) -> Array:
    """Values (..., width) with their widths and names, side by side: (..., all widths).

    Leading axes broadcast; a single number stands for all of its width.

    Raises:
        ParameterError: another width, axes that do not broadcast, or a value not finite.
    """
    arrays = []
    for value, width, name in parts:
        array = np.asarray(value, float)
        array = np.full(width, array) if array.ndim == 0 else array
        if array.shape[-1] != width:
            raise ParameterError(f"{name} must have shape (..., {width}), got {array.shape}")
        if not np.isfinite(array).all():
            raise ParameterError(f"{name} must be finite, got {array.tolist()}")
        arrays.append(array)
    try:
        batch = np.broadcast_shapes(*(k.shape[:-1] for k in arrays))
    except ValueError:
        got = ", ".join(f"{k[2]} {a.shape}" for k, a in zip(parts, arrays, strict=True))
        raise ParameterError(f"leading axes must broadcast, got {got}") from None
    wide = [np.broadcast_to(k, (*batch, k.shape[-1])) for k in arrays]
    return np.concatenate(wide, axis=-1)


# -------------------------------- inverse dynamics as a matrix times the inertial numbers
#
# It is linear in mass, first moment and inertia about the frame of each body, so the derivative
# of the traced Newton-Euler equations is the regressor. `mechanics/gravity.py` keeps the fewest
# combinations of these numbers that the weight shows.


def inertia_regressor(arm: Arm, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> Array:
    """Inverse dynamics on a base at rest, without gravity, per inertial number of the arm.

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].

    Returns:
        (..., 6 + n, 10 (n + 1) + n): wrench that the arm exerts on its base at the
        platform-top origin [N, N m] and joint torques [N m], as in
        `dynamics.inverse_dynamics`, per number of each body, base first
        (`body_numbers.numbers_of_body`), and per rotor inertia. Leading axes broadcast.

    Raises:
        ParameterError: wrong shapes, or numbers that are not finite.
    """
    n = arm.n
    at = points((q, n, "q"), (v, n, "v"), (a, n, "a"))
    jacobian = _regressor(arm)(at).reshape(*at.shape[:-1], 10 * (n + 1) + n, 6 + n)
    return np.swapaxes(jacobian, -1, -2)


@lru_cache(maxsize=16)
def _regressor(arm: Arm) -> CompiledFunction:
    return CompiledFunction(f"regressor {geometry(arm)}", _traced("regressor", arm))


# ---------------------------------- what an environment asks of every state, over and over


@lru_cache(maxsize=64)
def scene_function(system: System) -> CompiledFunction:
    """(z, z', measured pose, modes, their rates, p) -> E, strain energy, tool twice (8).

    Energy of the base [J] and place of the tool in space [m] (`system.energy`,
    `kinematics.frames`), with the base at its pose and at the measured one. Modes are the arm's
    flexures and what the base has, where there are any.
    """
    return CompiledFunction(f"scene {structure(system)}", partial(_scene, system))


@lru_cache(maxsize=64)
def torque_function(system: System) -> CompiledFunction:
    """((angles, rates, accelerations), p) -> joint torque on a base that stands still [N m]."""
    return CompiledFunction(f"torque {structure(system)}", partial(_torque, system))


def _scene(system: System) -> casadi.Function:
    import casadi as ca

    model, _, p = symbolic_model(system)
    size, bends = 6 + system.arm.n, system.arm.bends
    hidden = bends + system.base.hidden
    sizes = {"z": size, "zd": size, "measured": 6}
    sizes |= {"u": hidden, "ud": hidden} if hidden else {}
    x = [symbols(name, (k,)) for name, k in sizes.items()]
    z, zd, measured, *modes = x
    u, ud = modes or (z[:0], z[:0])
    energies = base_energy(model, z, zd, u, ud)
    arm, joints = model.arm, z[6:]
    if bends:
        arm, joints = model.chain, model.along(joints, u[:bends])
    reach = frames(arm, joints).position[-1]
    tools = [y[:3] + rotation(y) @ reach for y in (z[:6], measured)]
    out = column(*energies, *tools)
    return ca.Function("scene", [column(k) for k in (*x, p)], [ca.cse(out)])


def _torque(system: System) -> casadi.Function:
    import casadi as ca

    model, _, p = symbolic_model(system)
    x = symbols("x", (3, system.arm.n))
    torque, _ = newton_euler(model.arm, *x)
    return ca.Function("torque", [column(x), column(p)], [ca.cse(column(torque))])


# ------------------------------- natural modes: Jacobi's rotations, a system per lane

# sweeps over all pairs of axes: in the worst of 1e5 matrices of six axes, near-equal ones among
# them, six leave 2e-11 of the largest entry beside the diagonal and seven 2e-22; seven leave
# 2e-17 of eight axes, nine 5e-26 of twelve
_SWEEPS = {8: 7, 12: 9}  # up to so many axes
_MOST = max(_SWEEPS)  # axes: code grows by their cube


def pushed_modes(K: Array, M: Array, b: Array) -> tuple[Array, Array]:
    """Return the modes of K x = omega^2 M x for many M, and how vectors push them.

    They are those of `mechanics.modes.natural_modes`, but for the order of the modes and the
    signs of their shapes; by that function where k is above 12.

    Args:
        K: (k, k) stiffness, symmetric.
        M: (m, k, k) mass, symmetric positive definite.
        b: (m, k, columns) vectors.

    Returns:
        omega (m, k) [rad/s], and shapes^T b (m, k, columns), shapes^T M shapes = 1.
    """
    k, lower = len(K), np.tril_indices(len(K))
    if k > _MOST:
        omega, shapes = natural_modes(K, M)
        return omega, np.swapaxes(shapes, -1, -2) @ b
    reduction, sweep = _mode_functions(k, b.shape[2])
    rows = lanes(reduction(M[:, *lower], K[lower], b.reshape(len(b), -1)))
    run = sweep.piece(rows, rows)
    for _ in range(next(count for most, count in _SWEEPS.items() if k <= most)):
        run(0, len(rows))
    out = unlane(rows, len(b))
    diagonal = np.cumsum(np.arange(1, k + 1)) - 1  # among the lower entries
    return np.sqrt(np.maximum(out[:, diagonal], 0.0)), out[:, len(lower[0]) :].reshape(b.shape)


@lru_cache(maxsize=16)
def _mode_functions(k: int, columns: int) -> tuple[CompiledFunction, CompiledFunction]:
    """Reduction and sweep for k coordinates and so many vectors."""
    key, entries, vectors = f"{k} {columns}", k * (k + 1) // 2, k * columns
    widths = entries, entries, vectors
    return (
        CompiledFunction.of(f"reduce {key}", partial(_reduction, k), *widths),
        CompiledFunction.of(
            f"sweep {key}", partial(_sweep, k), entries + vectors, in_place=True
        ),
    )


def _reduction(k: int, M: Array, K: Array, b: Array) -> Array:
    """`modes.reduced`; lower triangles of M, K and the result, whose vectors follow."""
    A, vectors = reduced(_symmetric(K, k), _symmetric(M, k), b.reshape(len(b), k, -1))
    return _packed(A, vectors)


def _sweep(k: int, row: Array) -> Array:
    """`modes.jacobi_sweep` of what `_reduction` gives."""
    A, b = np.split(row, [k * (k + 1) // 2], axis=1)
    return _packed(*jacobi_sweep(_symmetric(A, k), b.reshape(len(b), k, -1)))


def _packed(A: Array, b: Array) -> Array:
    """Lower triangles of A (n, k, k), then the entries of b."""
    lower = A[:, *np.tril_indices(A.shape[-1])]
    return np.concatenate([lower, b.reshape(len(b), -1)], axis=1)


def _symmetric(lower: Array, k: int) -> Array:
    """Matrices (n, k, k) from their lower triangles, row by row."""
    i, j = np.indices((k, k))
    high, low = np.maximum(i, j), np.minimum(i, j)
    return lower[:, high * (high + 1) // 2 + low]
