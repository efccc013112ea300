"""A user's structure from files: every format gives the same one, wrong ones are refused."""

import gzip

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.flexible_base import Polyline
from ves_gym.mechanics.matrix_files import read_matrices
from ves_gym.mechanics.structure import (
    UNITS,
    Structure,
    frequencies,
    read_structure,
    vehicle_of,
)
from ves_gym.mechanics.vehicle import BENT_THESIS

MASS, STIFF = map(scipy.sparse.csc_array, Polyline.of(BENT_THESIS).frame(4).matrices())
TIP, CLAMP = tuple(range(48, 54)), tuple(range(6))
TRUE = reduce(MASS, STIFF, TIP, 4, held=CLAMP)


def label(freedom):
    """Node (from 101) and component, as a finite-element program numbers them."""
    return 101 + freedom // 6, freedom % 6 + 1


def short(text):
    """A number in 16 places: NASTRAN's D for the exponent, ten digits."""
    return f"{float(text):.9E}".replace("E", "D")


def dmig(matrices, style="wide"):
    """A punch file of symmetric matrices, the lower triangle by columns."""
    lines = ["$TITLE   = BENT_THESIS BEAM", "GRID         101        -8.0     0.0    -8.0"]
    for name, matrix in matrices.items():
        if style == "comma":
            lines.append(f"DMIG,{name},0,6,2,0,,,,")
        else:
            lines.append(f"DMIG    {name:<8}       0       6       2       0")
        columns = scipy.sparse.tril(matrix).tocsc()
        for j in range(columns.shape[1]):
            part = slice(columns.indptr[j], columns.indptr[j + 1])
            node, component = label(j)
            terms = [
                (*label(i), f"{v:.12E}")
                for i, v in zip(columns.indices[part], columns.data[part], strict=True)
            ]
            if not terms:
                continue
            if style == "wide":
                lines.append(f"DMIG*   {name:<16}{node:16d}{component:16d}")
                lines += [f"*       {n:16d}{c:16d}{short(v):>16}" for n, c, v in terms]
            else:
                lines.append(f"DMIG,{name},{node},{component},")
                lines += [f",{n},{c},{v.replace('E', 'D')}" for n, c, v in terms]
    return "\n".join([*lines, "ENDDATA", ""])


def mixed(matrices):
    """A punch file whose symmetric entries stand on either side, some on both."""
    lines, side = [], np.random.default_rng(0)
    for name, matrix in matrices.items():
        lines.append(f"DMIG    {name:<8}       0       6       2       0")
        part = scipy.sparse.tril(matrix).tocoo()
        for i, j, v in zip(part.row, part.col, part.data, strict=True):
            ends = {0: [(i, j)], 1: [(j, i)], 2: [(i, j), (j, i)]}[int(side.integers(3))]
            for row, column in ends[: 1 + (i != j)]:
                (n, c), (m, d) = label(row), label(column)
                lines.append(f"DMIG,{name},{m},{d},,{n},{c},{v:.16E}")
    return "\n".join(lines)


def op4(matrices, style="dense"):
    """Text OP4 with 16 digits: dense columns, or sparse ones (big: two-number heads)."""
    lines = []
    for name, matrix in matrices.items():
        full = matrix.toarray()
        size = len(full)
        rows = -size if style == "big" else size
        lines.append(f"{size:8d}{rows:8d}{6:8d}{2:8d}{name:<8}1P,3E23.16")
        for j, column in enumerate(full.T):
            (used,) = np.nonzero(column)
            if not len(used):
                continue
            if style == "dense":
                first, values = used[0], column[used[0] : used[-1] + 1]
                lines += [f"{j + 1:8d}{first + 1:8d}{2 * len(values):8d}", *reals(values)]
                continue
            runs = np.split(used, np.nonzero(np.diff(used) > 1)[0] + 1)
            lines.append(f"{j + 1:8d}{0:8d}{sum(2 * len(r) + 2 for r in runs):8d}")
            for run in runs:
                words = 2 * len(run) + 1
                if style == "big":
                    lines.append(f"{words:8d}{run[0] + 1:8d}")
                else:
                    lines.append(f"{run[0] + 1 + 65536 * words:12d}")
                lines += reals(column[run])
        lines += [f"{size + 1:8d}{1:8d}{1:8d}", " 1.0000000000000000E+00"]
    return "\n".join([*lines, ""])


def reals(values):
    texts = [f"{v:23.16E}" for v in values]
    return ["".join(texts[k : k + 3]) for k in range(0, len(texts), 3)]


def harwell_boeing(matrix):
    """As HBMAT of Ansys: the lower triangle, D for the exponent, a right-hand side behind."""
    half = scipy.sparse.tril(matrix).tocsc()
    half.sort_indices()
    pointers, rows = ([f"{k + 1:14d}" for k in x] for x in (half.indptr, half.indices))
    values = [f"{v:25.16E}".replace("E", "D") for v in half.data]
    n, loads = matrix.shape[0], [f"{0.0:25.16E}"] * matrix.shape[0]
    sizes = (len(pointers), len(rows), len(values), n)
    head = [
        f"{'BENT BEAM':<72}{'K':<8}",
        "".join(f"{k:14d}" for k in (sum(sizes), *sizes)),
        f"RSA{'':11}{n:14d}{n:14d}{len(values):14d}{0:14d}",
        f"{'(1I14)':<16}{'(1I14)':<16}{'(1P,1D25.16)':<20}{'(1D25.16)':<20}",
        f"F{'':13}{1:14d}{0:14d}",
    ]
    return "\n".join([*head, *pointers, *rows, *values, *loads, ""])


def mapping(size):
    """As it names the rows beside it."""
    names = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    rows = [f"{k + 1:12d}{label(k)[0]:12d}   {names[k % 6]}" for k in range(size)]
    return "\n".join(["  Matrix Eqn        Node   DOF", *rows, ""])


def write(folder, kind):
    """Write both matrices in a format: what `read_structure` takes for `files`."""
    if kind == "npy":
        np.save(folder / "M.npy", MASS.toarray())
        np.save(folder / "K.npy", STIFF.toarray())
        return {"M": folder / "M.npy", "K": folder / "K.npy"}
    if kind == "npz":
        np.savez(folder / "both.npz", mass=MASS.toarray(), stiffness=STIFF.toarray())
        return folder / "both.npz"
    if kind == "sparse npz":
        scipy.sparse.save_npz(folder / "M.npz", MASS)
        scipy.sparse.save_npz(folder / "K.npz", STIFF)
        return {"M": folder / "M.npz", "K": folder / "K.npz"}
    if kind == "Matrix Market":
        scipy.io.mmwrite(folder / "M.mtx", MASS, symmetry="symmetric", precision=17)
        with gzip.open(folder / "K.mtx.gz", "wb") as file:
            scipy.io.mmwrite(file, STIFF, symmetry="general", precision=17)
        return {"M": folder / "M.mtx", "K": folder / "K.mtx.gz"}
    if kind == "CalculiX":
        for name, matrix in (("mas", MASS), ("sti", STIFF)):
            part = scipy.sparse.triu(matrix).tocoo()
            lines = [
                f"{i + 1} {j + 1} {v:.16e}"
                for i, j, v in zip(part.row, part.col, part.data, strict=True)
            ]
            (folder / f"job.{name}").write_text("\n".join(lines))
        dof = [f"{n}.{c}" for n, c in map(label, range(MASS.shape[0]))]
        (folder / "job.dof").write_text("\n".join(dof))
        return {"M": folder / "job.mas", "K": folder / "job.sti"}
    if kind.startswith("DMIG"):
        path = folder / "beam.pch"
        text = dmig({"MAAX": MASS, "KAAX": STIFF}, kind.split()[1])
        if kind == "DMIG mixed":  # each node's freedoms against all: a side here, one there
            text = mixed({"MAAX": MASS, "KAAX": STIFF})
        path.write_text(text)
        return path
    if kind == "Abaqus":
        for name, matrix in (("M", MASS), ("K", STIFF)):
            part = scipy.sparse.tril(matrix).tocoo()
            ends = [[label(k) for k in side] for side in (part.row, part.col)]
            lines = [
                f"{n},{c}, {m},{d}, {v:.16e}"
                for (n, c), (m, d), v in zip(*ends, part.data, strict=True)
            ]
            (folder / f"{name}.mtx").write_text("\n".join(lines))
        return {"M": folder / "M.mtx", "K": folder / "K.mtx"}
    if kind == "Harwell-Boeing":
        for name, matrix in (("M", MASS), ("K", STIFF)):
            (folder / f"{name}.matrix").write_text(harwell_boeing(matrix))
            (folder / f"{name}.mapping").write_text(mapping(matrix.shape[0]))
        return {"M": folder / "M.matrix", "K": folder / "K.matrix"}
    path = folder / "beam.op4"
    if kind.startswith("OP4 by pyyeti"):
        writer = pytest.importorskip("pyyeti.nastran").op4
        *_, how, style = kind.split()
        parts = {"MAA": MASS.toarray(), "KAA": STIFF.toarray()}
        writer.write(path, parts, binary=how == "binary", digits=16, sparse=style)
        return path
    path.write_text(op4({"MAA": MASS, "KAA": STIFF}, kind.split()[1]))
    return path


KINDS = {  # with the digits that they keep
    "npy": 1e-9,
    "npz": 1e-9,
    "sparse npz": 1e-9,
    "Matrix Market": 1e-9,
    "CalculiX": 1e-9,
    "DMIG wide": 1e-4,  # ten digits of a stiffness that spans 1e6
    "DMIG comma": 1e-6,
    "DMIG mixed": 1e-9,
    "Abaqus": 1e-9,
    "OP4 dense": 1e-9,
    "OP4 sparse": 1e-9,
    "OP4 big": 1e-9,
    **{
        f"OP4 by pyyeti, {how} {style}": 1e-9
        for how in ("binary", "text")
        for style in ("dense", "bigmat", "nonbigmat")
    },
    "Harwell-Boeing": 1e-9,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_same_structure(kind, tmp_path):
    files = write(tmp_path, kind)
    numbered = kind.startswith(("DMIG", "CalculiX", "Abaqus", "Harwell"))
    interface = 109 if numbered else TIP
    found = read_structure(files, interface=interface, held=CLAMP, units="m-kg-s").reduce(4)
    for name in ("K", "M", "coupling", "omega"):
        expected = getattr(TRUE, name)
        error = np.abs(getattr(found, name) - expected).max() / np.abs(expected).max()
        assert error < KINDS[kind], name
    alone = [frequencies(k, np.zeros((6, 6))) for k in (found, TRUE)]
    assert alone[0] == pytest.approx(alone[1], rel=3e-5 if kind == "DMIG wide" else 1e-6)


def test_a_full_file_of_ansys():
    """The beam that comes with its reader, whose documentation prints these frequencies."""
    examples = pytest.importorskip("ansys.mapdl.reader.examples")
    found = read_matrices(examples.fullfile)
    K, M = (found[k].values.toarray() for k in "KM")
    assert len(K) == len(found["K"].labels) == 900  # 63 of 963 freedoms are held
    squares = scipy.linalg.eigh(K, M, eigvals_only=True, subset_by_index=(0, 3))
    printed = (1283.200, 1283.200, 5781.975, 6919.399)  # Hz
    assert np.sqrt(squares) / (2 * np.pi) == pytest.approx(printed, rel=1e-6)


def test_small_fields_and_numbers_without_an_e(tmp_path):
    """DMIG in fields of 8: two terms on each following line, 1.5+3 and 2.-1."""
    lines = [
        "DMIG    K              0       1       1       0",
        "DMIG    K              7       1               7       1   1.5+3",
        "               7       2    2.-1               8       0   -3.25",
        "DMIG    K              7       2               7       1     0.2",
        "DMIG    K              8       0               7       1   -3.25",
    ]
    (tmp_path / "small.dmig").write_text("\n".join(lines))
    matrix = read_matrices(tmp_path / "small.dmig")["K"]
    assert matrix.labels == ((7, 1), (7, 2), (8, 0))
    assert matrix.values.toarray().tolist() == [
        [1500.0, 0.2, -3.25],
        [0.2, 0.0, 0.0],
        [-3.25, 0.0, 0.0],
    ]


def test_mass_may_lack_freedoms_that_have_none(tmp_path):
    """Freedoms are matched by node and component, in whatever order the files have them."""
    heavy = MASS.toarray()
    heavy[24:30], heavy[:, 24:30] = 0.0, 0.0  # a massless elbow
    path = tmp_path / "beam.pch"
    path.write_text(dmig({"KAAX": STIFF, "MAAX": scipy.sparse.csc_array(heavy)}, "comma"))
    found = read_structure(path, interface=109, held=CLAMP, units="m-kg-s").reduce(4)
    expected = reduce(heavy, STIFF, TIP, 4, held=CLAMP)
    assert found.omega == pytest.approx(expected.omega, rel=1e-6)


@pytest.mark.parametrize("units", UNITS)
def test_units_of_the_file_are_not_those_of_the_result(units):
    length, mass, time = UNITS[units]
    way = scipy.sparse.diags_array(np.where(np.arange(MASS.shape[0]) % 6 < 3, length, 1.0))
    energy = mass * length**2 / time**2
    M, K = way @ MASS @ way / (energy * time**2), way @ STIFF @ way / energy
    found = Structure(M, K, None, TIP, CLAMP, units).reduce(4)
    for name in ("K", "M", "coupling", "omega"):
        expected = getattr(TRUE, name)
        assert np.abs(getattr(found, name) - expected).max() < 1e-7 * np.abs(expected).max()


def test_a_free_structure_has_exactly_no_stiffness(tmp_path):
    files = write(tmp_path, "npz")
    found = read_structure(files, interface=TIP, units="m-kg-s", rigid_modes=6).reduce(3)
    assert not found.K.any()
    assert found.M[0, 0] == pytest.approx(BENT_THESIS.mass)


def skewed(M, K):
    i, j = np.unravel_index(np.abs(np.triu(K, 1)).argmax(), K.shape)
    K[i, j] *= 1.01


def lighter(M, K):
    M[20, 20] = -5.0


def softer(M, K):
    K[30, 30] -= 1e9


def torn(M, K):
    K[9] = K[:, 9] = 0.0


def spoiled(folder, change):
    M, K = MASS.toarray(), STIFF.toarray()
    if change is not None:
        change(M, K)
    np.savez(folder / "both.npz", mass=M, stiffness=K)
    return folder / "both.npz"


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (skewed, {}, r"K must be symmetric, got \[\d+,\d+\] = .* and"),
        (lighter, {}, "M must be positive semidefinite, got an eigenvalue -"),
        (softer, {}, "must not move freely, got an eigenvalue -"),
        (torn, {}, "must not move freely"),
        (None, {"held": ()}, "must have 0 rigid motions .* got more"),
        (None, {"rigid_modes": 6}, "with 6 rigid motions, got the frequ"),
        (None, {"interface": TIP[::-1], "held": (), "rigid_modes": 6}, "order"),
        (None, {"units": "mm"}, "units must be one of m-kg-s"),
        (None, {"interface": 109}, "do not number nodes"),
        (None, {"names": {"M": "MGG"}}, "no matrix 'MGG'; known: mass, stiff"),
    ],
)
def test_what_is_no_structure_is_refused_with_its_number(change, options, message, tmp_path):
    everything = {"interface": TIP, "held": CLAMP, "units": "m-kg-s", **options}
    with pytest.raises(ParameterError, match=message):
        read_structure(spoiled(tmp_path, change), **everything)


def test_nothing_in_a_file_is_executed(tmp_path):
    """A pickle inside .npy or .npz is refused, never loaded."""
    np.save(tmp_path / "M.npy", np.array([print], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "all.npz", mass=np.array([print], dtype=object))
    for name in ("M.npy", "all.npz"):
        with pytest.raises(ParameterError, match=r"cannot be read .*allow_pickle"):
            read_matrices(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.op4", "\0\0\0\x18", "cannot be read as .op4|pip install 'ves-gym.nastran.'"),
        ("a.full", "\0\0\0\x18", "cannot be read as .full|pip install 'ves-gym.ansys.'"),
        ("a.matrix", "no matrix", "cannot be read as .matrix"),
        ("a.op4", f"{2:8d}{2:8d}{6:8d}{4:8d}KAA     1P,3E23.16\n", "must be real"),
        ("a.op4", op4({"KAA": STIFF})[:3000], "cannot be read as .op4"),
        ("a.bdf", "CBAR,11,1,1,2,1.,0.,0.", "bulk data without DMIG.*EXTSEOUT.*DMIGPCH"),
        ("a.pch", "DMIG    K              0       6       4       0", "must be real"),
        ("a.pch", "DMIG    K              0       9       2       0", "must be square"),
        ("a.pch", "DMIG    K              1       1", "must begin with its header"),
        ("a.mtx", "no matrix", "cannot be read as .mtx"),
        ("a.mat", "", "expected one of .npy, .npz"),
        ("a.mtx", "%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1", "a pattern"),
        (
            "a.mtx",
            "%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 2 1.0\n2 1 1.0",
            "on both sides of the diagonal",
        ),
    ],
)
def test_files_that_are_not_what_they_say_are_refused(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterError, match=message):
        read_matrices(tmp_path / name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda text: text.replace(first(text), f"{'NaN':>16}", 1),
            r"line 5: .*got '101 1 NaN'",
        ),
        (
            lambda text: text.replace(first(text), f"{'NaN':>17}", 1),
            r"line 5: .*got '101 1 Na N'",
        ),
        (lambda text: text[: text.index("MAAX") - 30], r"line \d+: .*is it cut off\?"),
        (
            lambda text: text[: text.index("DMIG    MAAX")],
            ".*got KAAX alone: is the file cut off",
        ),
    ],
)
def test_a_spoiled_punch_file_is_refused_by_its_line(change, message, tmp_path):
    """A number that is none, one a column off, a file that ends within a number or a matrix."""
    (tmp_path / "a.pch").write_text(change(dmig({"KAAX": STIFF, "MAAX": MASS})))
    with pytest.raises(ParameterError, match=rf"a\.pch: {message}"):
        read_structure(tmp_path / "a.pch", interface=109, held=CLAMP, units="m-kg-s")


def test_the_summary_has_the_models_own_frequency_where_the_modes_retained_miss_it():
    """Reference: scipy's eigenvalues of all freedoms that are not clamped."""
    structure = Structure(MASS, STIFF, None, TIP, CLAMP)
    summary = vehicle_of(structure, PUMA_560, modes=1, damping=0.01)
    squares = scipy.linalg.eigh(STIFF.toarray()[6:, 6:], MASS.toarray()[6:, 6:])[0]
    true = np.sqrt(squares[:7]) / (2 * np.pi)
    assert summary.model[0] == pytest.approx(true, rel=1e-4)
    rows = [row.split("│")[2] for row in str(summary).splitlines() if "│" in row]
    off = np.abs(summary.alone / true - 1) > 0.01
    assert 0 < off.sum() < 7
    for row, value, wrong in zip(rows, true, off, strict=True):
        assert (f"({value:.4g})" in row) == wrong == ("(" in row)
    assert "from which 1 modes are more than 1 % off; --modes N keeps more" in str(summary)
    assert "(" not in str(vehicle_of(structure, PUMA_560, modes=40, damping=0.01)).split("]")[1]


def first(text):
    """The number of a punch file's first term, in its field of 16."""
    return text.splitlines()[4][40:]


def test_a_large_structure_is_judged_by_the_sparse_solver(tmp_path, monkeypatch):
    files = spoiled(tmp_path, None)
    monkeypatch.setattr("ves_gym.mechanics.structure._DENSE", 0)
    monkeypatch.setattr("ves_gym.mechanics.craig_bampton._DENSE", 0)
    structure = read_structure(files, interface=TIP, held=CLAMP, units="m-kg-s")
    assert structure.reduce(4).omega == pytest.approx(TRUE.omega, rel=1e-6)
    with pytest.raises(ParameterError, match="an eigenvalue -"):
        files = spoiled(tmp_path, lighter)
        read_structure(files, interface=TIP, held=CLAMP, units="m-kg-s")


def test_names_given_twice_are_no_names(tmp_path):
    """CalculiX names the freedoms of a beam's knots twice: they go by their place."""
    files = write(tmp_path, "CalculiX")
    dof = (tmp_path / "job.dof").read_text().split()
    (tmp_path / "job.dof").write_text("\n".join([dof[0], *dof[:-1]]))
    found = read_structure(files, interface=TIP, held=CLAMP, units="m-kg-s").reduce(4)
    assert found.omega == pytest.approx(TRUE.omega, rel=1e-9)
    with pytest.raises(ParameterError, match="do not number nodes"):
        read_structure(files, interface=109, held=CLAMP, units="m-kg-s")


def test_what_stands_beside_the_matrices_is_left_and_named(tmp_path):
    """Load vectors of a punch file, a table of nodes and a word of an .npz."""
    text = dmig({"MAAX": MASS, "KAAX": STIFF})
    load = "DMIG    PAX            0       9       1       0                       1\n"
    load += f"DMIG*   PAX     {1:16d}{0:16d}\n*       {109:16d}{1:16d} 1.000000000D+00\n"
    (tmp_path / "beam.pch").write_text(text.replace("ENDDATA", load))
    found = read_structure(tmp_path / "beam.pch", interface=109, held=CLAMP, units="m-kg-s")
    assert found.source == "beam.pch (left: PAX must be square (form 1 or 6), got 9)"
    assert found.reduce(4).omega == pytest.approx(TRUE.omega, rel=1e-3)
    tables = {"mass": MASS.toarray(), "stiffness": STIFF.toarray(), "nodes": np.eye(3, 4)}
    np.savez(tmp_path / "beam.npz", **tables, unit="kg", one=np.ones(3))
    found = read_structure(tmp_path / "beam.npz", interface=TIP, held=CLAMP, units="m-kg-s")
    assert all(k in found.source for k in ("nodes must be square", "unit is no", "one is no"))
    assert found.reduce(4).omega == pytest.approx(TRUE.omega, rel=1e-9)


@pytest.mark.parametrize("units", ["m-kg-s", "mm-t-s"])
def test_mass_and_stiffness_exchanged_are_asked_about(units, tmp_path):
    np.savez(tmp_path / "both.npz", mass=STIFF.toarray(), stiffness=MASS.toarray())
    with pytest.raises(ParameterError, match="are M and K exchanged, or units other than"):
        read_structure(tmp_path / "both.npz", interface=TIP, held=CLAMP, units=units)


def test_a_mass_that_no_size_has_is_asked_about(tmp_path):
    """In metres and kilograms, said to be in millimetres and tonnes: 1000 times denser."""
    np.savez(tmp_path / "both.npz", mass=MASS.toarray(), stiffness=STIFF.toarray())
    with pytest.raises(
        ParameterError, match=r"e\+0\d kg measures some 0\.0.* m: are its units"
    ):
        read_structure(tmp_path / "both.npz", interface=TIP, held=CLAMP, units="mm-t-s")


@pytest.mark.parametrize("rigid", [0, 6])
@pytest.mark.parametrize("units", UNITS)
def test_a_length_in_another_unit_is_asked_about(units, rigid, tmp_path):
    """The beam in millimetres said to be in metres is 16 km long; metres and feet pass."""
    way = scipy.sparse.diags_array(np.where(np.arange(MASS.shape[0]) % 6 < 3, 1e-3, 1.0))
    M, K = (1e3 * (way @ k @ way).toarray() for k in (MASS, STIFF))  # mm-t-s
    np.savez(tmp_path / "both.npz", mass=M, stiffness=K)
    how = {"interface": TIP, "held": () if rigid else CLAMP, "rigid_modes": rigid}
    if UNITS[units][0] < 0.03:  # 400 m in inches
        read_structure(tmp_path / "both.npz", units=units, **how)
        return
    with pytest.raises(ParameterError, match=f"some .* m: are its units other than {units}"):
        read_structure(tmp_path / "both.npz", units=units, **how)
