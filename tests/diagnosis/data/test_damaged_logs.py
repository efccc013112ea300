"""Thirty damaged logs: each is read, with what was lost told, or refused by one sentence."""

import numpy as np
import pytest

from ves_gym.cli.main import main

NAMES = ("t", "q_1", "q_2", "v_1", "v_2", "tau_1", "tau_2")
T = 0.01 * np.arange(600)
DATA = np.column_stack(
    [T, np.sin(T), np.cos(2 * T), np.cos(T), -2 * np.sin(2 * T), np.cos(3 * T), np.sin(5 * T)]
)


def rows(data=DATA):
    return [[f"{x:.6f}" for x in row] for row in data]


def with_cell(row, column, text):
    out = rows()
    out[row][column] = text
    return out


def with_column(column, values):
    data = DATA.copy()
    data[:, column] = values
    return rows(data)


def named(*names):
    return [list(names), *rows()]


def exchanged():
    names = list(NAMES)
    names[1], names[5] = names[5], names[1]
    return named(*names)


H = [list(NAMES)]
WORDS = [["on"] if k % 2 else ["off"] for k in range(len(T))]
NO, GONE = "nan", np.where(T > 3, np.nan, DATA[:, 1])
# what the file holds, and what must be said of it: an error, or lines of the answer
DAMAGED = {
    "one cell is nan": (H + with_cell(30, 1, NO), "q_1: no number in 1 of 600"),
    "one cell is empty": (H + with_cell(30, 4, ""), "v_2: no number in 1 of 600"),
    "a word": (H + with_cell(300, 2, "ERR"), "row 302: q_2 must be a number"),
    "a number cut short": (H + with_cell(99, 2, "0.1e"), "row 101: q_2 must be a number"),
    "a cell too many": (H + [[*r, "9"] if k == 40 else r for k, r in enumerate(rows())],
                        "row 42: expected 7 numbers, got 8"),
    "a cell too few": (H + [r[:-1] if k == 40 else r for k, r in enumerate(rows())],
                       "row 42: expected 7 numbers, got 6"),
    "the end torn off": (H + rows()[:-1] + [["5.99", "0.3"]], "row 601: expected 7 numbers"),
    "infinity": (H + with_cell(30, 5, "inf"), "tau_1"),
    "half of a joint is gone": (H + with_column(1, GONE), "q_1"),
    "a column of nothing": (H + with_column(1, np.nan), "q_1 left out: 0 numbers in 600 rows"),
    "two columns of one name": (named("t", "q_1", "q_1", "v_1", "v_2", "tau_1", "tau_2"),
                                "q_1 stands again in column 3, with other numbers"),
    "a name is missing": (named("t", "", "q_2", "v_1", "v_2", "tau_1", "tau_2"), "column_2"),
    "no names": (rows(), "say what they are, by place"),
    "names too few": ([list(NAMES[:-1]), *rows()], "line of names has 6 cells"),
    "names twice": (H + H + rows(), ""),
    "names half way": (H + rows()[:300] + H + rows()[300:], "row 302: t must be a number"),
    "a column of words": ([a + b for a, b in zip(H + rows(), [["state"], *WORDS], strict=True)],
                          "columns of words left out: state"),
    "a line of units": ([*H, ["s", "rad", "rad", "rad/s", "rad/s", "Nm", "Nm"], *rows()], ""),
    "the clock stands": (H + with_column(0, np.where(T[50] == T, T[49], T)), "runs forward"),
    "the clock jumps back": (H + with_column(0, np.where(T[50] == T, 0.2, T)), "runs forward"),
    "the clock restarts": (H + with_column(0, T % 3), "runs forward"),
    "a gap": (H + with_column(0, T + (T > 2)), "is 1.01 s after the one before"),
    "no clock": ([r[1:] for r in named(*NAMES)], "a clock: say the step"),
    "the clock is all zero": (H + with_column(0, 0.0), "a clock: say the step"),
    "a clock without numbers": (H + with_column(0, np.nan), "t left out: 0 numbers"),
    "samples in alternation": (H + with_column(0, T + 0.003 * (np.arange(600) % 2)),
                               "uneven steps of 7 to 13 ms"),
    "rows turned round": (H + rows()[::-1], "a clock: say the step"),
    "names exchanged": (exchanged(), ""),
    "degrees": (H + with_column(1, np.rad2deg(DATA[:, 1])), "degrees?"),
    "one row": (H + rows()[:1], "no column looks like"),
    "nothing": ([], "expected a line of names and rows of numbers"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGED)
def test_no_damage_is_silent(damage, tmp_path, capsys):
    """Every column is used, or named with the reason; what cannot be read is one sentence."""
    table, said = DAMAGED[damage]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in table))
    status = main(["diagnose", str(tmp_path / "log.csv"), "--describe", "--out", str(tmp_path)])
    out, err = capsys.readouterr()
    if status:
        assert status == 2 and err.startswith("ves-gym: error: ") and err.count("\n") == 1
        assert said and said in err
        return
    text = (tmp_path / "mapping.toml").read_text()
    assert said in text and out.endswith("mapping.toml\n")
    for name in filter(None, (table[0] if table[0][0].isalpha() else NAMES)):
        assert f'"{name}"' in text or name in text.split("schema")[0], name
