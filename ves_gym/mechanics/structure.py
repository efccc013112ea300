"""A user's structure: mass and stiffness with units, interface and support, checked.

What an arm stands on can come from any finite-element program as M, K and D over its
freedoms. `read_structure` refuses what cannot be a structure and says which number is
wrong; `Structure.reduce` gives interface and internal modes in SI units.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import Array, ParameterError, finite, require_one_of
from ves_gym._util.tables import table
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.craig_bampton import Reduction, reduce
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import FlexibleBase, Reduced
from ves_gym.mechanics.matrix_files import Label, NamedMatrix, read_matrices
from ves_gym.mechanics.modes import natural_modes

_POUND = 4.4482216152605  # N
UNITS: dict[str, tuple[float, float, float]] = {  # length [m], mass [kg], time [s] of one unit
    "m-kg-s": (1.0, 1.0, 1.0),
    "mm-t-s": (1e-3, 1e3, 1.0),
    "mm-kg-ms": (1e-3, 1.0, 1e-3),
    "mm-kg-s": (1e-3, 1.0, 1.0),
    "cm-kg-s": (1e-2, 1.0, 1.0),
    "in-lbf-s": (0.0254, _POUND / 0.0254, 1.0),
    "ft-lbf-s": (0.3048, _POUND / 0.3048, 1.0),
}
NAMES = {  # what files call the matrices; NASTRAN's own and with a suffix, CalculiX's
    "M": ("m", "mass", "maa", "maax", "mgg", "m2gg", "mas"),
    "K": ("k", "stiffness", "kaa", "kaax", "kgg", "k2gg", "sti"),
    "D": ("d", "damping", "baa", "baax", "bgg", "b2gg", "c"),
}

_SYMMETRIC = 1e-6  # of the largest entry: what text files of seven digits keep
_INDEFINITE = 1e-9  # an eigenvalue of M may be negative by this part of the largest entry
_RIGID = 1e-4  # omega^2 of a rigid motion over that of the first mode, interface held
_ELASTIC = 1e-8  # the least that counts as strain
_SLOWEST = 1.0  # rad/s: the fastest freedom of any structure, all others held, is faster
_SIZES = (1e-3, 1e3)  # m
_DENSITIES = (1e-8, 1e8)  # kg/m^3: mass over the cube of the size; beams have 1e-5 and more
_DENSE = 1500


@dataclass(frozen=True)
class Structure:
    """Symmetric M, K, D over n freedoms, in a system of units of their own."""

    mass: Any  # (n, n) sparse
    stiffness: Any  # (n, n) sparse
    damping: Any | None  # (n, n) sparse
    interface: tuple[
        int, ...
    ]  # (6,) freedoms x, y, z, phi_x, phi_y, phi_z where the arm stands
    held: tuple[int, ...] = ()  # freedoms that do not move
    units: str = "m-kg-s"  # of `UNITS`
    rigid_modes: int = 0  # motions without strain: 0 clamped, 6 free
    labels: tuple[Label, ...] | None = None  # (n,) node and component
    source: str = "user"

    def reduce(self, modes: int) -> Reduction:
        """Return interface and internal modes in SI units, rigid motions without stiffness.

        Refused: what moves freely is not what `rigid_modes` says, or the mass is no
        structure's.
        """
        with_one = reduce(
            self.mass,
            self.stiffness,
            self.interface,
            max(modes, 1),
            damping=self.damping,
            held=self.held,
        )
        reduction = with_one.rescaled(*UNITS[self.units])
        return _without_rigid_stiffness(reduction, self.rigid_modes).truncated(modes)

    def reduced(
        self,
        modes: int,
        axes: Array | None = None,
        centreline: Array | None = None,
        nodes: Sequence[int] = (),
        diameter: float | None = None,
    ) -> Reduced:
        """Return the structure of a `FlexibleBase` with so many modes, in axes (3, 3) whose
        columns are the platform's x, y, z.

        Drawn with a diameter [m] along a centreline (k, 3) from the platform-top origin in
        platform axes [m], whose nodes (k,) have these numbers in the files.
        """
        turn = np.eye(3) if axes is None else finite(axes, (3, 3), "axes")
        if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-9 or np.linalg.det(turn) < 0:
            raise ParameterError(f"axes must be a rotation, got {turn.tolist()}")
        reduced = self.reduce(modes).turned(turn)
        line = None
        if centreline is not None:
            at = finite(centreline, (len(nodes), 3), "centreline")
            rows = np.array([_of_node(self.labels, node)[:3] for node in nodes], int)
            static, shapes = (
                np.einsum("ij,kic->kjc", turn, k[rows]).reshape(3 * len(rows), -1)
                for k in (reduced.static, reduced.shapes)
            )
            line = at, static, shapes
        return Reduced.of(reduced, line, diameter)


def read_structure(
    files: str | os.PathLike[str] | Mapping[str, str | os.PathLike[str]],
    *,
    interface: int | Sequence[int],
    units: str,
    rigid_modes: int = 0,
    held: Sequence[int] = (),
    names: Mapping[str, str] | None = None,
) -> Structure:
    """Read mass, stiffness and perhaps damping of a structure from files.

    Args:
        files: one file with all matrices, or {"M": file, "K": file, "D": file}.
        interface: number of the node where the arm stands, where the files number nodes;
            otherwise its six freedoms, counted from 0, in order x, y, z, phi_x, phi_y, phi_z.
        units: of the matrices, one of `UNITS`; length, mass (or force) and time.
        rigid_modes: motions without strain that the structure must have: 0 clamped, 6 free.
        held: freedoms that do not move, counted from 0, where the files contain a clamp.
        names: of the matrices in the files, {"M": ..., "K": ..., "D": ...}, where they are
            none of `NAMES`.

    Returns:
        The structure, its matrices symmetric.

    Raises:
        ParameterError: names the file and the number that is wrong.
    """
    require_one_of("units", units, UNITS)
    if rigid_modes not in range(7):
        raise ParameterError(f"rigid_modes must be 0 to 6, got {rigid_modes!r}")
    matrices, source = _find(files, names or {})
    parts, labels = _aligned(matrices)
    checked = {name: _symmetric(values, name) for name, values in parts.items()}
    size = checked["K"].shape[0]
    _require_fast_enough(checked["M"], checked["K"], units)
    for name in checked:
        if checked[name].shape != checked["K"].shape:
            raise ParameterError(
                f"{name} and K must be of one size, got {checked[name].shape[0]} and {size}"
            )
    lowest, largest = _lowest(checked["M"]), abs(checked["M"]).max()
    if lowest < -_INDEFINITE * largest:
        raise ParameterError(f"M must be positive semidefinite, got an eigenvalue {lowest:.6g}")
    if isinstance(interface, int | np.integer):
        freedoms = _of_node(labels, int(interface))
    else:
        freedoms = tuple(int(k) for k in interface)
    structure = Structure(
        checked["M"],
        checked["K"],
        checked.get("D"),
        freedoms,
        tuple(held),
        units,
        rigid_modes,
        labels,
        source,
    )
    _require_size(structure.reduce(1), structure)  # refuses what does not stand or hangs loose
    return structure


def _find(
    files: str | os.PathLike[str] | Mapping[str, str | os.PathLike[str]],
    names: Mapping[str, str],
) -> tuple[dict[str, NamedMatrix], str]:
    """Matrices by M, K, D, and the files they came from."""
    if isinstance(files, Mapping):
        unknown = [key for key in files if key not in NAMES]
        if unknown:
            raise ParameterError(f"files must be named M, K, D, got {unknown[0]!r}")
        out = {}
        for key, path in files.items():
            matrices = read_matrices(path)
            if len(matrices) == 1:
                out[key] = next(iter(matrices.values()))
            else:
                named = _named(matrices, key, names)
                if named is None:
                    raise ParameterError(
                        f"{path}: which one is {key}? Got {', '.join(matrices)}"
                    )
                out[key] = named
        source = ", ".join(os.path.basename(os.fspath(path)) for path in files.values())
    else:
        matrices = read_matrices(files)
        every = {key: _named(matrices, key, names) for key in NAMES}
        out = {key: matrix for key, matrix in every.items() if matrix is not None}
        source = os.path.basename(os.fspath(files))
        if "M" not in out or "K" not in out:
            raise ParameterError(
                f"{source}: expected a mass and a stiffness matrix (M=FILE K=FILE where each"
                " has a file; --names M=...,K=..., in Python names=, where names do not tell),"
                f" got {', '.join(matrices)}{' alone: is the file cut off?' if out else ''}"
                + "".join(f"; left: {text}" for text in next(iter(matrices.values())).left)
            )
    for key in "MK":
        if key not in out:
            raise ParameterError(f"files must hold M and K, got {', '.join(out)}")
    refused = dict.fromkeys(text for matrix in out.values() for text in matrix.left)
    return out, source + (f" (left: {'; '.join(refused)})" if refused else "")


def _named(
    matrices: dict[str, NamedMatrix], key: str, names: Mapping[str, str]
) -> NamedMatrix | None:
    if key in names:
        if names[key] not in matrices:
            raise ParameterError(
                f"names: no matrix {names[key]!r}; known: {', '.join(matrices)}"
            )
        return matrices[names[key]]
    alike = [name for name in matrices if name.lower() in NAMES[key]]
    return matrices[alike[0]] if len(alike) == 1 else None


def _aligned(
    matrices: dict[str, NamedMatrix],
) -> tuple[dict[str, Any], tuple[Label, ...] | None]:
    """Matrices over the same freedoms: files may leave out those without mass or damping."""
    if any(k.labels is None for k in matrices.values()):
        return {name: k.values for name, k in matrices.items()}, None
    labels = sorted({k for part in matrices.values() for k in part.labels or ()})
    index = {label: i for i, label in enumerate(labels)}
    out = {}
    for name, part in matrices.items():
        at = np.array([index[k] for k in part.labels or ()])
        entries = part.values.tocoo()
        out[name] = scipy.sparse.coo_array(
            (entries.data, (at[entries.row], at[entries.col])), shape=(len(labels),) * 2
        ).tocsc()
    return out, tuple(labels)


def _of_node(labels: tuple[Label, ...] | None, node: int) -> tuple[int, ...]:
    if labels is None:
        raise ParameterError(
            "these files do not number nodes: give the places of six freedoms, of x, y, z and"
            f" the turns about them (6,7,8,9,10,11: the second node's six), got node {node}"
        )
    index = {label: i for i, label in enumerate(labels)}
    missing = [k for k in range(1, 7) if (node, k) not in index]
    if missing:
        nodes = sorted({n for n, _ in labels})
        raise ParameterError(
            f"node {node} must have the components 1 to 6, {missing} are not in the files;"
            f" they have nodes {nodes[0]} to {nodes[-1]}"
        )
    return tuple(index[node, k] for k in range(1, 7))


def _symmetric(values: Any, name: str) -> Any:
    gap = scipy.sparse.coo_array(abs(values - values.T))
    size = abs(values).max()
    if size == 0:
        raise ParameterError(f"{name} must not vanish")
    if gap.nnz and gap.data.max() > _SYMMETRIC * size:
        k = int(gap.data.argmax())
        i, j = int(gap.row[k]), int(gap.col[k])
        raise ParameterError(
            f"{name} must be symmetric, got [{i},{j}] = {values[i, j]:.6g} and [{j},{i}] ="
            f" {values[j, i]:.6g}"
        )
    return scipy.sparse.csc_array((values + values.T) / 2)


def _require_fast_enough(mass: Any, stiffness: Any, units: str) -> None:
    """Refuse a structure of which no freedom by itself is faster than 1 rad/s."""
    M, K = mass.diagonal(), stiffness.diagonal()
    if M.shape != K.shape or not (M > 0).any():
        return  # other sentences say so
    fastest = float(np.sqrt(max((K[M > 0] / M[M > 0]).max(), 0.0))) / UNITS[units][2]
    if fastest < _SLOWEST:
        raise ParameterError(
            f"no freedom of this structure is faster than {fastest / (2 * np.pi):.3g} Hz: are M"
            f" and K exchanged, or units other than {units}?"
        )


def _require_size(reduction: Reduction, structure: Structure) -> None:
    """Refuse what is of another size or mass than anything an arm stands on: other units."""
    if structure.rigid_modes not in (0, 6):
        return
    clamped = structure.rigid_modes == 0
    matrix = np.linalg.inv(reduction.K) if clamped else reduction.M
    moved, turned = (np.linalg.eigvalsh(matrix[k : k + 3, k : k + 3])[-1] for k in (0, 3))
    # of a cantilever compliances give L/sqrt(3), of a rod about its end inertias the same
    size = float(np.sqrt(moved / turned if clamped else turned / moved))
    mass = float(np.trace(reduction.M[:3, :3])) / 3
    least, most = (k * size**3 for k in _DENSITIES)
    if not (_SIZES[0] <= size <= _SIZES[1] and least <= mass <= most):
        raise ParameterError(
            f"by its {'stiffness' if clamped else 'mass'} this structure of {mass:.4g} kg"
            f" measures some {size:.2g} m: are its units other than {structure.units}?"
        )


def _lowest(values: Any) -> float:
    if values.shape[0] <= _DENSE:
        return float(np.linalg.eigvalsh(values.toarray())[0])
    start = np.random.default_rng(0).standard_normal(values.shape[0])
    values = scipy.sparse.linalg.eigsh(
        values, k=1, which="SA", v0=start, tol=1e-3, return_eigenvectors=False
    )
    return float(values[0])


def _without_rigid_stiffness(reduction: Reduction, expected: int) -> Reduction:
    """The reduction with K exactly zero along its rigid motions, which must be as expected."""
    try:
        squares, shapes = scipy.linalg.eigh(reduction.K, reduction.M)
        np.linalg.cholesky(reduction.matrices()[0])
    except np.linalg.LinAlgError:
        lowest = float(np.linalg.eigvalsh(reduction.matrices()[0])[0])
        raise ParameterError(
            "the mass at the interface must be positive definite, got an eigenvalue"
            f" {lowest:.6g}: where rotations have no mass, give the node the inertia of its"
            " flange, or the beams coupled masses (NASTRAN: PARAM,COUPMASS,1)"
        ) from None
    ratio = squares / reduction.omega[0] ** 2
    text = ", ".join(_hertz(k) for k in squares)
    if np.abs(ratio[:expected]).max(initial=0.0) > _RIGID or ratio[0] < -_RIGID:
        raise ParameterError(
            f"K must be positive semidefinite with {expected} rigid motions, got the"
            f" frequencies {text} Hz at the interface"
        )
    if expected < 6 and ratio[expected] < _ELASTIC:
        raise ParameterError(
            f"the structure must have {expected} rigid motions (0 clamped, 6 free), got more:"
            f" frequencies {text} Hz at the interface"
        )
    if expected == 6:
        _require_rigid_body(reduction.M)
    half = reduction.M @ shapes
    squares[:expected] = 0.0
    K = (half * squares) @ half.T
    return replace(reduction, K=(K + K.T) / 2) if expected else reduction


def _hertz(square: float) -> str:
    root = np.sqrt(abs(square)) / (2 * np.pi)
    return f"{root:.3g}" if square >= 0 else f"{root:.3g}i"


def _require_rigid_body(M: Array) -> None:
    """M of a free structure is that of a rigid body: m 1, a skew block, inertia."""
    mass = float(np.trace(M[:3, :3])) / 3
    off = np.abs(M[:3, :3] - mass * np.eye(3)).max()
    if off > 1e-3 * mass:
        raise ParameterError(
            "a free structure weighs the same in x, y and z (are the interface's freedoms in"
            f" order x, y, z, phi_x, phi_y, phi_z?), got {np.diag(M)[:3].tolist()} kg"
        )
    lever = M[:3, 3:]
    even = np.abs(lever + lever.T).max()
    if even > 1e-3 * max(np.abs(lever).max(), mass * 1e-3):
        raise ParameterError(
            "a free structure's static moment must be skew (are the interface's axes those of a"
            f" right-handed frame?), got {lever.tolist()} kg m"
        )


# ------------------------------------------- as a vehicle: how many modes, and frequencies
#
# Modes are counted by the frequencies of the structure with the arm on it: all below a band
# must be as with many modes.

BAND = 20.0  # Hz
ERROR = 0.01  # of a frequency
FINE = 40  # modes that stand for all of them

SCHEMA = "ves-structure/1"
_POSES = 20  # of the arm in which frequencies must be right
_LISTED = 12  # frequencies printed


@dataclass(frozen=True, eq=False)
class StructureSummary:
    """The vehicle of a model, and its natural frequencies [Hz]; `vehicle_of` makes it."""

    vehicle: FlexibleBase
    arm: str  # its name
    freedoms: int  # of the model
    alone: Array
    loaded: Array  # with the arm on it, in the middle of its range
    model: Array  # (2, 6 + m) alone and with the arm, of all `FINE` modes of the model

    @property
    def fixed(self) -> Array:
        """Frequencies of the internal modes, the interface held."""
        return self.vehicle.reduction().omega / (2 * np.pi)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        reduced = self.vehicle.reduction()
        return {
            "schema": SCHEMA,
            "source": self.vehicle.source,
            "freedoms": self.freedoms,
            "modes": reduced.m,
            "frequencies": self.alone.tolist(),
            "frequencies_with_arm": self.loaded.tolist(),
            "frequencies_held": self.fixed.tolist(),
            "frequencies_of_model": self.model[0].tolist(),
            "frequencies_of_model_with_arm": self.model[1].tolist(),
            "mass": float(reduced.M[0, 0]),
        }

    def __str__(self) -> str:
        reduced, fixed = self.vehicle.reduction(), self.fixed
        rows, missed = [], False
        for k in range(min(len(self.alone), _LISTED)):
            cells = [str(k + 1)]
            for kept, true in zip(
                (self.alone[k], self.loaded[k]), self.model[:, k], strict=True
            ):
                wrong = abs(kept - true) > ERROR * max(true, 1e-3)
                missed = missed or wrong
                cells.append(f"{kept:.4g}" + (f" ({true:.4g})" if wrong else ""))
            rows.append([*cells, f"{fixed[k]:.4g}" if k < len(fixed) else ""])
        head = ("mode", "alone", f"with {self.arm}", "interface held")
        note = (
            f"\n(in parentheses: of the whole model, from which {reduced.m} modes are more than"
            f" {100 * ERROR:g} % off; --modes N keeps more, held up to"
            f" {self.vehicle.fastest / (2 * np.pi):.4g} Hz)"
        )
        return (
            f"{self.vehicle.source}: {self.freedoms} freedoms, {reduced.M[0, 0]:.4g} kg felt at"
            f" the interface; {reduced.m} internal modes retained\n"
            + table(head, rows, title="natural frequencies [Hz]", left=())
            + (note if missed else "")
        )


def vehicle_of(
    structure: Structure,
    arm: Arm,
    *,
    modes: int | None = None,
    damping: float | None = None,
    line: npt.ArrayLike | None = None,
    nodes: Sequence[int] = (),
    diameter: float | None = None,
) -> StructureSummary:
    """Reduce a model to its interface and as many internal modes as the arm on it asks for.

    Args:
        modes: to keep; None: so many that frequencies with the arm are right.
        damping: ratio of every mode; None: the model's own matrix.
        line: (k, 3) points to draw it by, from the interface [m]; `nodes` are theirs.
        diameter: to draw it with [m].
    """
    if damping is None and structure.damping is None:
        raise ParameterError(
            "the files hold no damping: --damping must give a ratio, like 0.01"
        )
    if damping is not None and not 0 <= damping < 1:
        raise ParameterError(f"damping must be a ratio, 0.02 for 2 %, got {damping:g}")
    low, high = arm.column("q_min"), arm.column("q_max")
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, arm.n))
    poses[0] = (low + high) / 2
    stood = inertia(arm, poses)[:, :6, :6]
    outside = np.r_[structure.interface, structure.held].astype(int)
    heavy = np.delete(structure.mass.diagonal(), outside)
    most = int((heavy > 1e-9 * heavy.max(initial=0.0)).sum())
    fine = structure.reduce(max(min(FINE, most), modes or 0))
    modes = modes_needed(fine, stood) if modes is None else modes
    drawn = None if line is None else np.asarray(line, float)
    reduced = structure.reduced(modes, centreline=drawn, nodes=nodes, diameter=diameter)
    base = FlexibleBase(
        structure=reduced,
        modes=len(reduced.omega),
        damping_ratio=damping,
        source=structure.source,
    )
    reductions, stands = (base.reduction(), fine), (np.zeros((6, 6)), stood[0])
    (alone, loaded), model = ([frequencies(k, H) for H in stands] for k in reductions)
    size, most = int(structure.stiffness.shape[0]), len(alone)
    return StructureSummary(base, arm.name, size, alone, loaded, np.array(model)[:, :most])


def modes_needed(
    fine: Reduction, inertia: Array, *, band: float = BAND, error: float = ERROR
) -> int:
    """Return the fewest internal modes of a fine reduction with which every frequency up to
    `band` [Hz] is right to `error` of it, under inertia (poses, 6, 6) on the interface."""
    exact = [frequencies(fine, H) for H in inertia]
    for m in range(fine.m):
        coarse = [frequencies(fine.truncated(m), H) for H in inertia]
        pairs = zip(coarse, exact, strict=True)
        if all(_agree(a, b, band, error) for a, b in pairs):
            return m
    return fine.m


def frequencies(reduction: Reduction, inertia: Array) -> Array:
    """Natural frequencies (6 + m,) [Hz], slowest first, with inertia (6, 6) on the interface
    (zeros: nothing stands there)."""
    mass, stiffness = reduction.matrices()
    mass = mass.copy()
    mass[:6, :6] += inertia
    return natural_modes(stiffness, mass).omega / (2 * np.pi)


def _agree(coarse: Array, exact: Array, band: float, error: float) -> bool:
    inside = exact[exact < band]
    if len(coarse) < len(inside):
        return False
    gap = np.abs(coarse[: len(inside)] - inside)
    return bool((gap <= error * np.maximum(inside, 1e-9)).all())
