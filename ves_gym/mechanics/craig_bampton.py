"""Reduction of a structure to one interface and m internal modes (Craig and Bampton, 1968).

The inner freedoms move as the interface carries them in statics, and in the modes that they
have with the interface held: u_i = Psi Y + Phi eta. Over (Y, eta)

    K_z = [[K, 0], [0, diag(omega^2)]]        M_z = [[M, P], [P^T, 1]],

K the static stiffness, M the mass in static shapes (Guyan's), P = (M_ib^T + Psi^T M_ii) Phi.
The coordinates u = eta + P^T Y of the modes (`absolute`) decouple the mass: M - P P^T beside 1.
A mode that is left out follows the interface in statics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.mechanics.modes import modal_damping

_DENSE = 1500  # inner freedoms up to which all modes come from one dense solve
_ALIKE = 1e-9  # relative distance of frequencies whose modes have no axes of their own
_REFINED = 3  # rounds of iterative refinement of the static shapes


@dataclass(frozen=True)
class Reduction:
    """A structure over (Y, eta): interface pose (6) and m modes with the interface held."""

    K: Array  # (6, 6) static stiffness at the interface [N/m, N, N m]
    M: Array  # (6, 6) mass in static shapes [kg, kg m, kg m^2]
    coupling: Array  # (6, m) P [kg^(1/2), kg^(1/2) m]
    omega: Array  # (m,) ascending [rad/s]
    static: Array  # (n, 6) way of every freedom per Y; identity at the interface
    shapes: Array  # (n, m) way of every freedom per eta; zero at the interface
    damping: Array | None = None  # (6 + m, 6 + m) over (Y', eta'), where the structure has one

    @property
    def m(self) -> int:
        """Number of modes."""
        return len(self.omega)

    def matrices(self) -> tuple[Array, Array]:
        """Return M_z and K_z over (Y, eta), two (6 + m, 6 + m)."""
        m = self.m
        mass = np.block([[self.M, self.coupling], [self.coupling.T, np.eye(m)]])
        stiffness = np.zeros((6 + m, 6 + m))
        stiffness[:6, :6] = self.K
        stiffness[range(6, 6 + m), range(6, 6 + m)] = self.omega**2
        return mass, stiffness

    def truncated(self, modes: int) -> Reduction:
        """Return the reduction with its slowest modes only; the others become static."""
        m = min(modes, self.m)
        return replace(
            self,
            coupling=self.coupling[:, :m],
            omega=self.omega[:m],
            shapes=self.shapes[:, :m],
            damping=None if self.damping is None else self.damping[: 6 + m, : 6 + m],
        )

    def within(self, fastest: float) -> Reduction:
        """Return the reduction without the modes faster than this [rad/s]."""
        return self.truncated(int(np.searchsorted(self.omega, fastest, side="right")))

    def modal_damping(self, ratios: float | Array) -> Array:
        """Return the damping (6 + m, 6 + m) over (Y', eta') that gives the whole, its interface
        free, these ratios: one for all, or (6 + m,) of the modes of (K_z, M_z), slowest first
        [1]."""
        return modal_damping(*self.matrices(), ratios)

    def absolute(self, damping: Array) -> tuple[Array, Array]:
        """Return M - P P^T (6, 6), the mass beside the modes, and a damping (6 + m, 6 + m)
        given over (Y', eta') over (Y', u'), u = eta + P^T Y."""
        mass = self.M - self.coupling @ self.coupling.T
        change = np.eye(6 + self.m)
        change[6:, :6] = -self.coupling.T
        return (mass + mass.T) / 2, change.T @ damping @ change

    def rescaled(self, length: float, mass: float, time: float) -> Reduction:
        """Return the reduction in SI of a structure whose units are `length` m, `mass` kg and
        `time` s."""
        m = self.m
        way = np.r_[np.full(3, length), np.ones(3)]  # of Y
        modal = np.full(m, length * np.sqrt(mass))  # of eta
        energy = mass * length**2 / time**2
        both = np.r_[way, modal]
        damping = self.damping
        if damping is not None:
            damping = damping * energy * time / np.outer(both, both)
        return replace(
            self,
            K=self.K * energy / np.outer(way, way),
            M=self.M * energy * time**2 / np.outer(way, way),
            coupling=self.coupling * energy * time**2 / np.outer(way, modal),
            omega=self.omega / time,
            static=self.static * length / way,
            shapes=self.shapes * length / modal,
            damping=damping,
        )

    def turned(self, axes: Array) -> Reduction:
        """Return the reduction in other interface axes (3, 3), their x, y, z as columns."""
        turn = np.kron(np.eye(2), axes)  # new components -> old
        damping = self.damping
        if damping is not None:
            both = np.eye(6 + self.m)
            both[:6, :6] = turn
            damping = both.T @ damping @ both
        return replace(
            self,
            K=turn.T @ self.K @ turn,
            M=turn.T @ self.M @ turn,
            coupling=turn.T @ self.coupling,
            static=self.static @ turn,
            damping=damping,
        )


def reduce(
    mass: Any,
    stiffness: Any,
    interface: npt.ArrayLike,
    modes: int,
    damping: Any = None,
    held: npt.ArrayLike = (),
) -> Reduction:
    """Reduce a structure to the six freedoms of one node and its slowest internal modes.

    Rows of the result's `static` and `shapes` are all n freedoms, held ones zero.

    Args:
        mass, stiffness: (n, n) dense or sparse, symmetric; SI units, or `rescaled` after.
        interface: (6,) freedoms of the node in order x, y, z, phi_x, phi_y, phi_z.
        modes: to keep.
        damping: (n, n), if the structure has one.
        held: freedoms that do not move (a clamp).
    """
    M, K, D = (_held_as(k) for k in (mass, stiffness, damping))
    size = K.shape[0]
    b, fixed = np.asarray(interface, int), np.asarray(held, int)
    _check_freedoms(b, fixed, size)
    moving = np.setdiff1d(np.arange(size), np.r_[b, fixed])
    Kii, Mii = K[moving][:, moving], M[moving][:, moving]
    Kib, Mib = (_array(k[moving][:, b]) for k in (K, M))
    if not 0 <= modes <= len(moving):
        raise ParameterError(f"modes must be 0 to {len(moving)}, got {modes}")

    psi = _static_shapes(Kii, Kib)
    static, shapes = np.zeros((size, 6)), np.zeros((size, modes))
    static[b], static[moving] = np.eye(6), psi
    K_b = static.T @ (K @ static)
    M_b = static.T @ (M @ static)
    carried = Mib + Mii @ psi  # momentum of the inner freedoms per Y'
    omega, phi, P = np.zeros(0), np.zeros((len(moving), 0)), np.zeros((6, 0))
    if modes:
        omega, phi = _held_modes(Mii, Kii, modes)
        P = carried.T @ phi
        phi, P = _own_axes(omega, phi, P)
    shapes[moving] = phi
    lost = None
    if D is not None:
        both = np.hstack([static, shapes])
        lost = both.T @ (D @ both)
        lost = (lost + lost.T) / 2
    return Reduction((K_b + K_b.T) / 2, (M_b + M_b.T) / 2, P, omega, static, shapes, lost)


def with_residual(
    reduced: Reduction, mass: Array, stiffness: Array, interface: Index, held: Any = ()
) -> Reduction:
    """Return a reduction with all modes that it leaves out as six more.

    They carry the same mass A = sum P P^T and, in the next order of a slow motion, the same
    B = sum P P^T / omega^2: P_r P_r^T = A, P_r omega_r^-2 P_r^T = B. The flange keeps what no
    mode carries, its own, so that an impulse finds it as it does with all modes.

    Args:
        reduced: its modes are exact; one without modes that are left out stays as it is.
        mass, stiffness, interface, held: of the structure, as `reduce` takes them.
    """
    moving = np.setdiff1d(np.arange(len(mass)), np.r_[interface, held])
    inner, stiff = mass[np.ix_(moving, moving)], stiffness[np.ix_(moving, moving)]
    carried = mass[moving] @ reduced.static
    P = reduced.coupling
    A = carried.T @ np.linalg.solve(inner, carried) - P @ P.T
    B = carried.T @ np.linalg.solve(stiff, carried) - P / reduced.omega**2 @ P.T
    square, V = scipy.linalg.eigh((A + A.T) / 2, (B + B.T) / 2)  # V^T B V = 1, V^T A V omega^2
    omega, shapes = np.sqrt(square), np.zeros((len(mass), 6))
    ways = np.linalg.solve(stiff, carried)  # ways under what the flange's acceleration asks
    shapes[moving] = (ways - reduced.shapes[moving] / reduced.omega**2 @ P.T) @ V * omega
    return replace(
        reduced,
        coupling=np.hstack([P, B @ V * omega]),
        omega=np.r_[reduced.omega, omega],
        shapes=np.hstack([reduced.shapes, shapes]),
    )


def _held_as(values: Any) -> Any:
    """A matrix as an array where it is small: NumPy suffices, and SciPy is slow to load."""
    if values is None:
        return None
    if not isinstance(values, np.ndarray):
        values = scipy.sparse.csc_array(values, dtype=np.float64)
        return values.toarray() if values.shape[0] <= _DENSE else values
    if len(values) <= _DENSE:
        return np.asarray(values, dtype=np.float64)
    return scipy.sparse.csc_array(values, dtype=np.float64)


def _array(values: Any) -> Array:
    return values if isinstance(values, np.ndarray) else values.toarray()


def _check_freedoms(interface: Any, held: Any, size: int) -> None:
    named = np.r_[interface, held]
    if interface.shape != (6,):
        raise ParameterError(f"interface must be 6 freedoms, got {interface.tolist()}")
    if named.size and not (named.min() >= 0 and named.max() < size):
        worst = named[(named < 0) | (named >= size)][0]
        raise ParameterError(f"the structure has freedoms 0 to {size - 1}, got {worst}")
    values, counts = np.unique(named, return_counts=True)
    if (counts > 1).any():
        raise ParameterError(
            f"interface and held freedoms must differ, got {values[counts > 1][0]} twice"
        )


def _static_shapes(Kii: Any, Kib: Array) -> Array:
    """-K_ii^-1 K_ib (n, 6), refined: a slender frame is badly conditioned."""
    if not len(Kib):
        return np.zeros((0, 6))
    solve = _solver(Kii)
    psi: Array = -solve(Kib)
    for _ in range(_REFINED):
        psi -= solve(Kii @ psi + Kib)
    return psi


def _solver(Kii: Any) -> Callable[[Array], Array]:
    """K_ii^-1 of a right-hand side; refused where K_ii is not positive definite."""
    if isinstance(Kii, np.ndarray):
        try:
            np.linalg.cholesky(Kii)
        except np.linalg.LinAlgError:
            _refuse("an eigenvalue", float(np.linalg.eigvalsh(Kii)[0]))
        return partial(np.linalg.solve, Kii)
    try:  # pivots on the diagonal alone: they are all positive where K_ii is definite
        factor = scipy.sparse.linalg.splu(
            Kii,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # SuperLU: exactly singular
        _refuse("a pivot", 0.0)
    lowest = float(factor.U.diagonal().min())
    if lowest <= 0 or not np.array_equal(factor.perm_r, factor.perm_c):
        _refuse("a pivot", min(lowest, 0.0))
    solve: Callable[[Array], Array] = factor.solve
    return solve


def _refuse(what: str, number: float) -> NoReturn:
    raise ParameterError(
        "with its interface held the structure must not move freely, got"
        f" {what} {number:.6g} of K_ii"
    )


def _held_modes(Mii: Any, Kii: Any, modes: int) -> tuple[Array, Array]:
    """omega (m,) and mass-normalised shapes (n, m) of the slowest modes."""
    if isinstance(Kii, np.ndarray):
        # M x = omega^-2 K x: the slow ones come out best, and M may be singular
        root = np.linalg.cholesky(Kii)
        half = np.linalg.solve(root, Mii)
        inverse, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
        inverse = inverse[::-1][:modes]
        phi = np.linalg.solve(root.T, vectors[:, ::-1][:, :modes])
    else:
        start = np.random.default_rng(0).standard_normal(Kii.shape[0])  # the same every time
        squares, phi = scipy.sparse.linalg.eigsh(Kii, k=modes, M=Mii, sigma=0.0, v0=start)
        order = np.argsort(squares)
        inverse, phi = 1 / squares[order], phi[:, order]
    masses = np.sum(inverse > 1e-14 * inverse[0])  # eigenvalues of a massless freedom vanish
    if masses < modes:
        raise ParameterError(f"the structure has {masses} modes of its own, got modes {modes}")
    phi = phi / np.sqrt(np.sum(phi * (Mii @ phi), axis=0))
    return 1 / np.sqrt(inverse), phi


def _own_axes(omega: Array, phi: Array, P: Array) -> tuple[Array, Array]:
    """Modes with a sign, and of equal frequencies with axes, that no solver chose.

    A round beam bends alike in both planes: which two shapes a solver returns is rounding.
    Of such modes each carries the first of the interface's axes that is left.
    """
    phi, P = phi.copy(), P.copy()
    first = 0
    while first < len(omega):
        last = first + 1
        while last < len(omega) and omega[last] - omega[first] <= _ALIKE * omega[first]:
            last += 1
        if last - first > 1:
            turn = _axes_of(P[:, first:last])
            phi[:, first:last] = phi[:, first:last] @ turn
            P[:, first:last] = P[:, first:last] @ turn
        first = last
    for k in range(len(omega)):
        leading = P[:, k] if np.abs(P[:, k]).max() > 0 else phi[:, k]
        if leading[np.abs(leading).argmax()] < 0:
            phi[:, k] *= -1
            P[:, k] *= -1
    return phi, P


def _axes_of(P: Array) -> Array:
    """(c, c) rotation after which each of c modes carries the first axis that is left."""
    remaining, size = P.T.copy(), float(np.abs(P).max())
    turn = np.zeros((len(remaining), 0))
    while turn.shape[1] < len(remaining):
        norms = np.linalg.norm(remaining, axis=0)
        if norms.max() <= 1e-9 * size:  # the rest carries nothing: any axes do
            basis = np.linalg.qr(np.hstack([turn, np.eye(len(remaining))]))[0]
            return np.hstack([turn, basis[:, turn.shape[1] :]])
        axis = int(np.argmax(norms >= (1 - 1e-6) * norms.max()))  # the first of equal ones
        direction = remaining[:, axis] / norms[axis]
        turn = np.column_stack([turn, direction])
        remaining -= np.outer(direction, direction @ remaining)
    return turn
