"""Columns of measured data as people write them: nothing is lost, nothing exchanged."""

import numpy as np
import pytest
import scipy

from ves_gym._util.params import ParameterError
from ves_gym._util.recordings import read_columns, read_recording

NAMES = ("t", "q_1", "q_2", "tau_1")
DATA = np.column_stack(
    [0.01 * np.arange(60), *np.random.default_rng(0).normal(size=(3, 60))]
).round(6)


def table(mark=",", comma=False, names=NAMES, before="", after="", end=""):
    """The data as text."""
    rows = [mark.join(f"{x:.6f}".replace(".", "," if comma else ".") for x in k) for k in DATA]
    heads = [mark.join(names)] if names else []
    return before + "\n".join(f"{row}{end}" for row in [*heads, *rows]) + after


WRITTEN = {
    "plain": table(),
    "semicolons": table(";"),
    "tabs": table("\t"),
    "bars": table("|"),
    "spaces": table(" "),
    "spaces after commas": table(", "),
    "decimal commas": table(";", comma=True),
    "decimal commas and tabs": table("\t", comma=True),
    "lines of Windows": table().replace("\n", "\r\n"),
    "an empty line at the end": table(after="\n\n"),
    "marks at the ends": table(end=","),
    "comments": table(before="# robot A\n% 100 Hz\n"),
    "names in a comment": table(before="# "),
    "a title": table(before="Robot A; log 7\n"),
    "quotes": table(names=[f'"{k}"' for k in NAMES]),
}


@pytest.mark.parametrize("how", WRITTEN)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_one_table_however_it_is_written(tmp_path, how, encoding):
    for name in ("log.csv", "LOG.CSV", "log.txt"):
        (tmp_path / name).write_bytes(WRITTEN[how].encode(encoding))
        got = read_recording(tmp_path / name)
        assert tuple(got.columns) == NAMES
        np.testing.assert_array_equal(np.column_stack([*got.columns.values()]), DATA)
        title = "left out above the names: Robot A; log 7"
        assert got.notes == ((title,) if how == "a title" else ())


def test_two_columns_with_decimal_commas(tmp_path):
    (tmp_path / "log.csv").write_text("t;q\n0,5;1,5\n1,5;2,5\n")
    assert {k: x.tolist() for k, x in read_columns(tmp_path / "log.csv").items()} == {
        "t": [0.5, 1.5],
        "q": [1.5, 2.5],
    }


def test_a_row_of_units_is_no_sample(tmp_path):
    head, rows = table().split("\n", 1)
    (tmp_path / "log.csv").write_text(f"{head}\ns,rad,rad,N m\n{rows}")
    got = read_recording(tmp_path / "log.csv")
    assert got.units == dict(zip(NAMES, ("s", "rad", "rad", "N m"), strict=True))
    assert len(got.columns["t"]) == len(DATA)


def test_the_first_row_is_a_sample_where_nothing_has_a_name(tmp_path):
    (tmp_path / "log.csv").write_text(table(names=()))
    got = read_recording(tmp_path / "log.csv")
    np.testing.assert_array_equal(np.column_stack([*got.columns.values()]), DATA)
    assert list(got.columns) == ["column_1", "column_2", "column_3", "column_4"]
    assert got.notes == ("no line of names: columns are called column_1 to column_4",)


def test_a_name_that_stands_again_hides_nothing(tmp_path):
    (tmp_path / "log.csv").write_text("t,q,q,t\n0,1,2,0\n1,3,4,1\n")
    got = read_recording(tmp_path / "log.csv")
    assert {k: x.tolist() for k, x in got.columns.items()} == {
        "t": [0, 1],
        "q": [1, 3],
        "q@3": [2, 4],
    }
    other, same = got.notes
    assert "q stands again in column 3, with other numbers: there it is q@3" in other
    assert "t stands again in column 4, with the same numbers" in same


@pytest.mark.parametrize("empty", ["", "nan", "NaN", "NA", "null", "-"])
def test_missing_numbers_are_counted(tmp_path, empty):
    (tmp_path / "log.csv").write_text(f"t,q\n0,1\n1,{empty}\n2,3\n")
    got = read_recording(tmp_path / "log.csv")
    np.testing.assert_array_equal(got.columns["q"], [1, np.nan, 3])
    assert got.notes == ("q: no number in 1 of 3 rows",)


def test_columns_of_words_are_named(tmp_path):
    (tmp_path / "log.csv").write_text("t,mode,q\n0,idle,1\n1,run,2\n")
    got = read_recording(tmp_path / "log.csv")
    assert {k: x.tolist() for k, x in got.columns.items()} == {"t": [0, 1], "q": [1, 2]}
    assert got.notes == ("columns of words left out: mode",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,q\n0,1\n1,2,3\n2,3\n", "row 3: expected 2 numbers, got 3"),
        ("t,q\n0,1\n1,x\n", "row 3: q must be a number, got 'x'"),
        ("t,q\n", "expected a line of names and rows of numbers"),
        ("", "expected a line of names and rows of numbers"),
        (
            "t,q,v\n0,1\n1,2\n",
            "row 1: the line of names has 3 cells, the rows of numbers have 2",
        ),
        ("t\0q\n\xff", "it is no text"),
    ],
)
def test_what_is_no_table_is_named_with_its_row(tmp_path, text, said):
    (tmp_path / "log.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(ParameterError, match=rf"log\.csv: .*{said}"):
        read_columns(tmp_path / "log.csv")


# ---------------------------------------------------------------------------- matrices

ARRAYS = {"t": DATA[:, 0], "q": DATA[:, 1:3], "tau": DATA[:, 3], "gain": 2.0}


def same_as_the_data(columns, before=""):
    got = [columns[before + k] for k in ("t", "q_1", "q_2", "tau")]
    np.testing.assert_array_equal(np.column_stack(got), DATA)
    assert columns[f"{before}gain"].tolist() == [2.0]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("struct", [False, True])
def test_a_matrix_is_a_column_per_signal(tmp_path, turned, struct):
    arrays = {**ARRAYS, "q": ARRAYS["q"].T} if turned else ARRAYS
    scipy.io.savemat(tmp_path / "log.mat", {"log": arrays} if struct else arrays)
    got = read_recording(tmp_path / "log.mat")
    before = "log." if struct else ""
    same_as_the_data(got.columns, before)
    assert f"{before}q is a matrix" in got.notes[0]


def test_matlab_of_version_7_3_is_hdf5(tmp_path):
    """MATLAB writes by columns: a 60 x 2 matrix is a data set of 2 x 60."""
    h5py = pytest.importorskip("h5py")
    for name in ("log.mat", "log.h5"):
        with h5py.File(tmp_path / name, "w", userblock_size=512) as file:
            for key, value in ARRAYS.items():
                file[key] = np.atleast_2d(value)
            file["note"] = np.array([[104, 105]], "u2")
            file["note"].attrs["MATLAB_class"] = b"char"
        with open(tmp_path / name, "r+b") as file:  # as MATLAB begins it
            file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
        got = read_recording(tmp_path / name)
        same_as_the_data(got.columns)
        assert "note" not in got.columns


def test_columns_of_parquet(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    words = pa.array(["a"] * len(DATA))
    columns = {**dict(zip(NAMES, DATA.T, strict=True)), "n": pa.array(range(60)), "s": words}
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
    got = read_columns(tmp_path / "log.parquet")
    np.testing.assert_array_equal(np.column_stack([got[k] for k in NAMES]), DATA)
    assert got["n"].tolist() == list(range(60)) and "s" not in got


def test_what_is_no_signal_is_named(tmp_path):
    scipy.io.savemat(tmp_path / "log.mat", {**ARRAYS, "K": np.eye(3)})
    got = read_recording(tmp_path / "log.mat")
    assert "left out: K of shape (3, 3), the data have 60 samples" in got.notes
