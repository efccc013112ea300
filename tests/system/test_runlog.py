"""The run log: exact round trips, faults named by file, row and column, whole files."""

from __future__ import annotations

import copy
import errno
import json
import math
import os
import tempfile
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ves_gym._util import optional
from ves_gym.system.runlog import OPTIONAL, QUANTITIES, RunLog, RunLogError
from ves_gym.system.runlog_files import BODY, JOINT, MODE, ONE, POSE, WHEEL

JOINTS = 3
META = {
    "format": "ves-run/1",
    "system": {"arm": {"mass": [1.0, 2.5]}, "gravity": 0},
    "controller": {"kp": [1.0] * JOINTS, "kd": [0.1] * JOINTS},
    "initial": {"q": [0.0] * JOINTS, "v": [0.0] * JOINTS, "y": [0.0] * 6, "yd": [0.0] * 6},
    "noise_std": {"q": 1e-4},
    "note": "ω is 1 Hz",
}
needs_pyarrow = pytest.mark.skipif(find_spec("pyarrow") is None, reason="needs pyarrow")
PARQUET = pytest.param("parquet", marks=needs_pyarrow)


def make(n: int = JOINTS, samples: int = 5, optional: Any = OPTIONAL, **changes: Any) -> RunLog:
    rng = np.random.default_rng(n * samples)
    sizes = {JOINT: n, POSE: 6, MODE: 4, WHEEL: 2, ONE: 1, BODY: 7}
    wanted = {k: sizes[j] for k, (j, must) in QUANTITIES.items() if must or k in optional}
    columns = {k: rng.standard_normal((samples, size)) for k, size in wanted.items()}
    meta = META if n == JOINTS else {"format": "ves-run/1"}
    return RunLog(**{"t": 0.1 * np.arange(samples), "meta": meta} | columns | changes)


def parts(log: RunLog) -> dict[str, Any]:
    return {f.name: getattr(log, f.name) for f in fields(log)}


def assert_same(a: RunLog, b: RunLog) -> None:
    """Bit for bit, so that -0.0 is not 0.0."""
    assert list(a.columns()) == list(b.columns())
    for name, column in a.columns().items():
        assert column.tobytes() == b.columns()[name].tobytes(), name
    assert a.meta == b.meta
    assert a.digest == b.digest


def write_csv(folder: Path, rows: list[str], meta: Any = META) -> Path:
    (folder / "run.json").write_text(meta if isinstance(meta, str) else json.dumps(meta))
    path = folder / "run.csv"
    path.write_bytes("".join(row + "\n" for row in rows).encode("latin-1"))
    return path


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "run.csv"
    make().save(path)
    return path


def cells(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()]


def put(path: Path, table: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in table))


def refuses(path: Path, *said: str) -> None:
    """Loading fails with one line that begins with the file's name and says all this."""
    with pytest.raises(RunLogError) as caught:
        RunLog.load(path)
    message = str(caught.value)
    assert message.startswith(str(path.parent)), message
    assert "\n" not in message
    for text in said:
        assert text in message, message


# -------------------------------------------------------------------- round trips


FLOATS = st.floats(allow_nan=False, allow_infinity=False, width=64) | st.sampled_from(
    [-0.0, 5e-324, -5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 0.1, 1 / 3]
)


@st.composite
def logs(draw: st.DrawFn) -> RunLog:
    n, samples = draw(st.integers(1, 7)), draw(st.integers(2, 50))
    optional = draw(st.sets(st.sampled_from(OPTIONAL)))
    values: dict[str, Any] = {}
    for name, (axis, required) in QUANTITIES.items():
        if required or name in optional:
            shape = (samples, {JOINT: n, POSE: 6, MODE: 4, WHEEL: 2, ONE: 1, BODY: 7}[axis])
            values[name] = draw(arrays(np.float64, shape, elements=FLOATS))
    t = draw(st.lists(FLOATS, min_size=samples, max_size=samples, unique=True))
    note = draw(st.text(max_size=20))
    extra = draw(st.dictionaries(st.text(max_size=5), FLOATS | st.integers() | st.none()))
    meta = {"format": "ves-run/1", "note": note, "system": extra}
    return RunLog(t=np.array(sorted(t)), meta=meta, **values)


@pytest.mark.parametrize("suffix", ["csv", PARQUET])
@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(log=logs())
def test_a_saved_log_comes_back_bit_for_bit(suffix: str, log: RunLog) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run.{suffix}"
        log.save(path)
        assert_same(RunLog.load(path), log)


@needs_pyarrow
def test_both_formats_give_one_digest_and_one_column_order(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    log = make()
    for suffix in ("csv", "parquet"):
        log.save(tmp_path / f"a.{suffix}")
    assert {RunLog.load(tmp_path / f"a.{s}").digest for s in ("csv", "parquet")} == {log.digest}
    names = cells(tmp_path / "a.csv")[0]
    assert names == list(log.columns()) == pq.read_schema(tmp_path / "a.parquet").names
    assert names[:5] == ["t", "q_cmd_1", "q_cmd_2", "q_cmd_3", "v_cmd_1"]
    assert [k for k in names if k.endswith("_1")] == [f"{k}_1" for k in QUANTITIES]
    assert pq.read_schema(tmp_path / "a.parquet").metadata[b"ves_gym"]


def test_the_digest_sees_every_value_and_the_metadata() -> None:
    log = make()
    seen = {log.digest}
    for name, value in parts(log).items():
        if name != "meta":
            changed = value.copy()
            changed.flat[-1] = np.nextafter(changed.flat[-1], np.inf)
            seen.add(replace(log, **{name: changed}).digest)
    seen.add(replace(log, meta=META | {"note": "other"}).digest)
    seen.add(replace(log, w=None, wg=None).digest)
    seen.add(replace(log, w=None).digest)
    assert len(seen) == 1 + len(parts(log)) + 2
    assert replace(log, meta=dict(reversed(META.items()))).digest == log.digest


def test_columns_in_another_order_windows_lines_and_quoted_names_are_read(saved: Path) -> None:
    before = RunLog.load(saved)
    table = [row[::-1] for row in cells(saved)]
    table[0] = [f'"{name}"' for name in table[0]]
    saved.write_bytes("".join(",".join(row) + "\r\n" for row in table).encode())
    assert_same(RunLog.load(saved), before)


# ------------------------------------------------------------------- construction


def test_a_log_owns_read_only_copies() -> None:
    t, meta = 0.1 * np.arange(5), copy.deepcopy(META)
    log = make(t=t, meta=meta)
    t[0], meta["system"]["gravity"] = -1.0, 9.81
    assert log.t[0] == 0.0 and log.meta["system"]["gravity"] == 0
    for name, value in parts(log).items():
        if name != "meta":
            assert value.dtype == np.float64
            with pytest.raises(ValueError, match="read-only"):
                value.flat[0] = 1.0
    with pytest.raises(AttributeError):
        log.t = t  # type: ignore[misc]


def test_size_duration_and_summary() -> None:
    log = make(optional=("tau",))
    assert (len(log), log.n_joints, log.duration) == (5, 3, 0.4)
    assert log.summary() in repr(log)
    for text in ("5 samples", "0.4 s", "0.1 s", "3 joints", "with tau", META["note"]):
        assert str(text) in log.summary()
    assert "no optional columns" in make(optional=()).summary()


def spoiled(name: str, row: int, column: int | None, value: float) -> dict[str, Any]:
    array = parts(make())[name].copy()
    array[(row,) if column is None else (row, column)] = value
    return {name: array}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (spoiled("q", 3, 1, math.nan), "row 4, column q_2: expected a finite number, got nan"),
        (spoiled("t", 2, None, math.nan), "row 3, column t: expected a finite number, got nan"),
        (spoiled("t", 2, None, 0.1), "row 3, column t: expected more than 0.1 s (row 2), got"),
        ({"q": np.zeros((5, 2))}, "q_cmd: expected shape (5, 2), got (5, 3)"),
        ({"q": np.zeros((5, 0))}, "q: expected shape (N, n) with n >= 1 joints, got (5, 0)"),
        ({"yd": np.zeros((5, 3))}, "yd: expected shape (5, 6), got (5, 3)"),
        ({"t": [0.0]}, "t: expected shape (N,) with N >= 2 samples, got (1,)"),
        ({"t": [True] * 5}, "t: expected an array of numbers, got list of bool"),
        ({"y": [[0.0], [0.0, 1.0]]}, "y: expected an array of numbers, got ragged rows"),
    ],
)
def test_bad_columns_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(RunLogError) as caught:
        make(**changes)
    assert message in str(caught.value)


CIRCULAR: dict[str, Any] = {"format": "ves-run/1"}
CIRCULAR["system"] = CIRCULAR
NOT_JSON = ".a: expected JSON data (number, text, list, table), got"


@pytest.mark.parametrize(
    ("meta", "message"),
    [  # what follows "metadata"
        ([], ": expected a table, got list"),
        (META | {"format": "ves-run/2"}, ".format: expected 'ves-run/1', got 'ves-run/2'"),
        (META | {"system": None}, ".system: expected a table, got None"),
        (META | {"controller": {"kp": [1, 2]}}, ".controller.kp: expected 3 numbers, got [1,"),
        (META | {"initial": {"yd": [True] * 6}}, ".initial.yd: expected 6 numbers, got [True"),
        (META | {"note": 3}, ".note: expected text, got 3"),
        (META | {"duration": 10**400}, ".duration: expected seconds >= 0, got 1000"),
        (META | {"a": {"k": [0, math.nan]}}, ".a.k[1]: expected a finite number, got nan"),
        (META | {"system": {1: 2}}, ".system: expected keys that are text, got 1"),
        (META | {"a": np.zeros(2)}, f"{NOT_JSON} ndarray"),
        (CIRCULAR, ": expected what JSON can hold, got "),
    ],
)  # fmt: skip
def test_bad_metadata_is_refused(meta: Any, message: str) -> None:
    with pytest.raises(RunLogError) as caught:
        make(meta=meta)
    assert f"metadata{message}" in str(caught.value)


# -------------------------------------------------------------------------- slice


def test_a_slice_keeps_clock_and_window_and_starts_where_it_starts() -> None:
    log = make(meta=META | {"duration": 0.3})
    cut = log.slice(0.1, float(log.t[3]))
    np.testing.assert_array_equal(cut.t, log.t[1:4])
    np.testing.assert_array_equal(cut.wg, log.wg[1:4])
    assert cut.meta["initial"] == {
        k: getattr(log, k)[1].tolist() for k in ("q", "v", "y", "yd")
    }
    assert cut.meta["duration"] == pytest.approx(0.2)
    assert cut.meta["system"] == log.meta["system"]
    assert set(make(optional=()).slice(0.1, 1).meta["initial"]) == {"q", "y"}
    assert_same(log.slice(-math.inf, math.inf), log)


@pytest.mark.parametrize("window", [(0.05, 0.15), (math.nan, 1)])
def test_a_slice_without_two_samples_is_refused(window: tuple[float, float]) -> None:
    with pytest.raises(RunLogError, match=r"slice: expected at least 2 samples in .* got [01]"):
        make().slice(*window)


# --------------------------------------------------------------------- faulty files


def test_an_unknown_suffix_names_the_known_ones(tmp_path: Path) -> None:
    for act in (make().save, RunLog.load):
        with pytest.raises(RunLogError, match=r"run.CSV: expected a name ending in .parq"):
            act(tmp_path / "run.CSV")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("row", "column", "text"),
    [(3, "q_2", "nan"), (2, "y_1", ""), (4, "tau_3", "1_0"), (2, "v_1", "1.0#"),
     (5, "wg_6", "1e"), (1, "q_1", "\N{MICRO SIGN}"), (1, "q_1", "\0")],
)  # fmt: skip
def test_a_bad_cell_is_named(row: int, column: str, text: str, saved: Path) -> None:
    table = cells(saved)
    table[row][table[0].index(column)] = text
    saved.write_bytes("".join(",".join(k) + "\n" for k in table).encode("latin-1"))
    refuses(
        saved, f"run.csv: row {row}, column {column}: expected a finite number, got {text!r}"
    )


def test_rows_of_the_wrong_length_are_named(saved: Path) -> None:
    table = cells(saved)
    width, cut = len(table[0]), table[0].index("v_2")
    for row, spoil, where, got in (
        (5, table[5][:cut], "v_2", cut),
        (2, [*table[2], "0.0"], "contact_energy_1", width + 1),
        (2, [""], "q_cmd_1", 1),
        (6, [""], "q_cmd_1", 1),
    ):
        put(saved, [*table[:row], spoil, *table[row + 1 :]])
        refuses(saved, f"run.csv: row {row}, column {where}: expected {width} cells, got {got}")


def test_a_file_cut_off_inside_a_number_is_named(saved: Path) -> None:
    """The cut number would read as another number; the missing line end gives it away."""
    saved.write_bytes(saved.read_bytes()[:-3])
    refuses(
        saved,
        "run.csv: row 5, column contact_energy_1: expected a line end after every row",
        "cut off",
    )


HEADER = list(make(optional=("w",)).columns())


def header(**renamed: str) -> list[str]:
    return [renamed.get(name, name) for name in HEADER]


FAULTY_HEADERS = [
    (header(q_2="q_4"), "column q_cmd_4: missing; expected q_cmd_1..4, got 3 of them"),
    (header(q_cmd_3="speed"), "column 'speed': unknown; expected t, q_cmd_1..n, v_cmd_1..n"),
    ([k for k in HEADER if k != "t"], "column t: missing"),
    ([k for k in HEADER if k != "q_2"], "column q_2: missing; expected q_1..3, got 2 of them"),
    ([k for k in HEADER if k != "w_6"], "column w_6: missing; expected w_1..6, got 5 of them"),
    ([*HEADER, "tau_1"], "column tau_2: missing; expected tau_1..3, got 1 of them"),
    ([*HEADER, "q_3"], "column q_3: expected once, got it more than once"),
    ([*HEADER, "t"], "column t: expected once, got it more than once"),
    (header(w_6="w_7"), "column 'w_7': unknown"),
    (header(q_1="q_0"), "column 'q_0': unknown"),
    (header(q_1="q_999999"), "column q_cmd_4: missing; expected q_cmd_1..999999"),
]


@pytest.mark.parametrize(("names", "message"), FAULTY_HEADERS)
@pytest.mark.parametrize("suffix", ["csv", PARQUET])
def test_a_faulty_header_is_named(
    suffix: str, names: list[str], message: str, tmp_path: Path
) -> None:
    rows = [[0.1 * i] * len(names) for i in range(3)]
    path = write_csv(tmp_path, [",".join(k) for k in [names, *[map(repr, r) for r in rows]]])
    if suffix == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = tmp_path / "run.parquet"
        table = pa.Table.from_arrays(list(map(pa.array, np.array(rows).T)), names=names)
        pq.write_table(table.replace_schema_metadata({"ves_gym": json.dumps(META)}), path)
    refuses(path, f"run.{suffix}: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected part of a run log, got an empty file"),
        ("{", "metadata: expected JSON, got "),
        ("\xff", "metadata: expected JSON, got "),
        ("[" * 100_000, "metadata: expected JSON, got "),
        ('{"format": "ves-run/1", "a": NaN}', "metadata: expected JSON, got NaN"),
        ('{"format": "ves-run/1", "a": 1e999}', "metadata.a: expected a finite number, got"),
        ('{"format": "ves-run/1", "format": "x"}', "a key more than once among ['format',"),
        ('{"note": "no format"}', "metadata.format: expected 'ves-run/1', got none"),
    ],
)
def test_a_faulty_companion_is_named(text: str, message: str, saved: Path) -> None:
    saved.with_suffix(".json").write_bytes(text.encode("latin-1"))
    refuses(saved, message)


def test_missing_files_are_named(saved: Path, tmp_path: Path) -> None:
    saved.with_suffix(".json").unlink()
    refuses(saved, "run.json: expected a readable file, got No such file or directory")
    refuses(tmp_path / "none.csv", "none.csv: expected a readable file, got No such file")


@needs_pyarrow
def test_faulty_parquet_is_named(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "run.parquet"
    refuses(path, "run.parquet: expected a readable file, got No such file")
    make().save(path)
    whole, table = path.read_bytes(), pq.read_table(path)
    at = table.schema.names.index("q_2")

    for data, message in (
        (b"t,q_1\n", "expected a Parquet file, got 6 bytes"),
        (whole[:-1], f"expected a Parquet file, got {len(whole) - 1} bytes"),
    ):
        path.write_bytes(data)
        refuses(path, "run.parquet: " + message)

    def q_2(values: list[Any]) -> Any:
        return table.set_column(at, "q_2", pa.array(values))

    keyed = table.replace_schema_metadata
    for spoiled, message in (
        (q_2(list("abcde")), "column q_2: expected type double, got string"),
        (q_2([1, 2, 3, 4, 5]), "column q_2: expected type double, got int64"),
        (q_2([0.0, None, 0.0, 0.0, 0.0]), "row 2, column q_2: expected a finite number, got"),
        (table.slice(0, 0), "t: expected shape (N,) with N >= 2 samples, got (0,)"),
        (table.slice(0, 4), "expected contents with the digest"),
        (keyed(None), "expected metadata under the schema key 'ves_gym', got none"),
        (keyed({"ves_gym": "{"}), "metadata: expected JSON, got "),
    ):
        pq.write_table(spoiled, path)
        refuses(path, "run.parquet: " + message)


def test_without_pyarrow_the_message_says_what_to_do(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(optional, "installed", lambda module: module != "pyarrow")
    for act in (make().save, RunLog.load):
        with pytest.raises(RunLogError) as caught:
            act(tmp_path / "run.parquet")
        assert str(caught.value).endswith(
            "run.parquet: Parquet needs the package pyarrow: pip install 'ves-gym[parquet]';"
            " or save as .csv"
        )
    make().save(tmp_path / "run.csv")
    assert_same(RunLog.load(tmp_path / "run.csv"), make())


# ----------------------------------------------------------------------- atomicity


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.parametrize("old", [True, False])
@pytest.mark.parametrize(
    ("call", "suffix"), [("replace", "csv"), ("replace", "json"), ("fsync", "csv")]
)
def test_a_failed_save_leaves_the_folder_as_it_was(
    call: str, suffix: str, old: bool, tmp_path: Path, monkeypatch: Any
) -> None:
    path = tmp_path / f"run.{suffix.replace('json', 'csv')}"
    if old:
        make().save(path)
    before, real = contents(tmp_path), os.replace

    def replace_fails(source: Any, target: Any) -> None:
        if (
            Path(target) == tmp_path / f"run.{suffix}"
        ):  # the last step, not the staging before it
            raise OSError(errno.ENOSPC, "no space left on device")
        real(source, target)

    def fsync_fails(handle: int) -> None:
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(os, call, replace_fails if call == "replace" else fsync_fails)
    with pytest.raises(OSError, match="no space"):
        make(samples=9).save(path)
    monkeypatch.undo()
    assert contents(tmp_path) == before
    make(samples=9).save(path)  # and the detector stays quiet
    assert len(RunLog.load(path)) == 9


# ---------------------------------------------------------------------------- fuzz


@pytest.mark.parametrize("suffix", ["csv", PARQUET])
@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_damaged_file_is_refused_or_read_as_a_valid_log(
    suffix: str, data: st.DataObject
) -> None:
    """No other exception; damaged Parquet is refused or did not matter (checksums)."""
    log = make(optional=("tau", "w"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run.{suffix}"
        log.save(path)
        damaged = bytearray(path.read_bytes())
        flips = st.tuples(st.integers(0, len(damaged) - 1), st.integers(0, 255))
        for at, value in data.draw(st.lists(flips, max_size=4)):
            damaged[at] = value
        if data.draw(st.booleans()):
            damaged = damaged[: data.draw(st.integers(0, len(damaged)))]
        path.write_bytes(damaged)
        try:
            read = RunLog.load(path)
        except RunLogError as error:
            assert str(error).startswith(folder)
            return
        if suffix == "parquet":
            assert_same(read, log)
        assert_same(RunLog(**parts(read)), read)
        read.save(path)
        assert_same(RunLog.load(path), read)


# ------------------------------------------------------------------------ as tables of others


def test_a_table_of_pandas_is_the_file(tmp_path):
    """pandas reads the same numbers from the CSV file."""
    pd = pytest.importorskip("pandas")
    log = make()
    log.save(tmp_path / "run.csv")
    frame = log.to_dataframe()
    read = pd.read_csv(tmp_path / "run.csv", index_col="t")
    pd.testing.assert_frame_equal(frame, read, rtol=1e-15)
    assert frame.attrs["meta"] == log.meta
    assert "t" in log.columns()


def test_a_data_set_of_xarray_has_joints_and_axes():
    pytest.importorskip("xarray")
    log = make()
    data = log.to_xarray()
    assert set(data.data_vars) == set(QUANTITIES)
    assert data.q.dims == ("t", "joint") and data.y.dims == ("t", "axis")
    assert data.propellant.dims == ("t",) and data.p.dims == ("t", "payload")
    np.testing.assert_array_equal(data.w.sel(axis="phi_y"), log.w[:, 4])
    np.testing.assert_array_equal(data.q.sel(joint=2), log.q[:, 1])
    np.testing.assert_array_equal(data.t, log.t)
    assert json.loads(data.attrs["ves_gym"]) == log.meta
