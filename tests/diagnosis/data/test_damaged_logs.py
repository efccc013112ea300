"""Damaged logs: each is read, with what was lost told, or refused by one sentence."""

import numpy as np
import pytest

from tests import ros_logs
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
    "infinity": (H + with_cell(30, 5, "inf"), "tau_1: no number in 1 of 600 rows"),
    "half of a joint is gone": (H + with_column(1, GONE), "q_1: no number in 299 of 600 rows"),
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
                               "* t: uneven steps of 7 to 13 ms"),
    "rows turned round": (H + rows()[::-1], "a clock: say the step"),
    "names exchanged": (exchanged(), "v_1 is not the rate of q_1, by"),
    "a rate of the other sign": (H + with_column(4, -DATA[:, 4]), "v_2 is not the rate of q_2"),
    "a rate in other units": (H + with_column(4, 7 * DATA[:, 4]), "v_2 is not the rate of q_2"),
    "an angle that sticks": (H + with_column(1, np.where(T > 3, 0.14, DATA[:, 1])),
                             "v_1 is not the rate of q_1"),
    "an angle that jumps by a turn": (H + with_column(2, np.mod(3 * DATA[:, 2], 2 * np.pi)),
                                      "v_2 is not the rate of q_2"),
    "9999 for none": (H + with_cell(30, 2, "9999"), "q_2 leaps away and back, 1 times"),
    "a position without a name": (named("t", "q_1", "", "v_1", "v_2", "tau_1", "tau_2"),
                                  "no position has their name: v_2, tau_2"),
    "a title": ([["log"] + [""] * 6, *H, *rows()], "left out above the names: log"),
    "a comment half way": (H + rows()[:300] + [["# stop"]] + rows()[300:], "1 comments among"),
    "the last number torn": (H + rows()[:-1] + [[*rows()[-1][:-1], "0.1"]],
                             "row 601, the last, may be cut off in its last number '0.1'"),
    "dates": ([H[0], *([f"2026-01-01T12:00:{t:09.6f}Z", *r[1:]]
               for t, r in zip(T, rows(), strict=True))], "even steps of 10 ms"),
    "degrees": (H + with_column(1, np.rad2deg(DATA[:, 1])), "* q_1: -57.3 to 57.3: degrees?"),
    "one row": (H + rows()[:1], "no column looks like"),
    "nothing": ([], "expected a line of names and rows of numbers"),
}  # fmt: skip


def answer(path, folder, capsys):
    """The mapping that is described, or the one line on standard error."""
    status = main(["diagnose", str(path), "--describe", "--out", str(folder)])
    out, err = capsys.readouterr()
    if status:
        assert status == 2 and err.startswith("ves-gym: error: ") and err.count("\n") == 1
        return err
    assert out.endswith("mapping.toml\n")
    return (folder / "mapping.toml").read_text()


@pytest.mark.parametrize("damage", DAMAGED)
def test_no_damage_is_silent(damage, tmp_path, capsys):
    """Every column is used, or named with the reason; what cannot be read is one sentence."""
    table, said = DAMAGED[damage]
    (tmp_path / "log.csv").write_text("\n".join(",".join(row) for row in table))
    text = answer(tmp_path / "log.csv", tmp_path, capsys)
    assert said in text
    if text.startswith("ves-gym: error"):
        assert said
        return
    for name in filter(None, (table[0] if table[0][0].isalpha() else NAMES)):
        assert f'"{name}"' in text or name in text.split("schema")[0], name


def joints(topic="/joint_states", t=T, names=("1", "2"), data=DATA, start=0):
    return ros_logs.joints(topic, t, names, data[:, 1:3], data[:, 3:5], data[:, 5:7])


def changed(change):
    """Messages of joints with one field of the 301st changed."""
    for k, (topic, stamp, message) in enumerate(joints()):
        if k == 300:
            change(message)
        yield topic, stamp, message


def words(n=600):
    text = ros_logs.store().types["std_msgs/msg/String"]
    return (("/chat", 1_700_000_000 * 10**9 + k, text(data="go")) for k in range(n))


def put(field, value):
    return lambda message: setattr(message, field, value)


def stamp(seconds):
    return lambda message: setattr(message.header.stamp, "sec", seconds)


def bytes_of(change):
    def damage(path):
        path.write_bytes(change(path.read_bytes()))

    return damage


CUT = bytes_of(lambda x: x[: len(x) // 2])
MISSING = DATA.copy()
MISSING[30, 1] = np.nan
BAGS = {  # messages, what is done to the file, what must be said
    "cut off": (joints, CUT, "is cut off"),
    "the last bytes cut off": (joints, bytes_of(lambda x: x[:-20]), "is cut off"),
    "an empty file": (joints, bytes_of(lambda x: b""), "cannot be read"),
    "text": (joints, bytes_of(lambda x: b"t,q_1\n0,1\n" * 99), "cannot be read"),
    "zeros in the middle": (
        joints,
        bytes_of(lambda x: x[: len(x) // 2] + bytes(500) + x[len(x) // 2 + 500 :]),
        "cannot be read",
    ),
    "another type's name": (
        joints,
        bytes_of(lambda x: x.replace(b"msg/JointState", b"msg/JointStats")),
        "no message of JointState",
    ),
    "no joints": (words, None, "no message of JointState"),
    "a topic of words": (lambda: [*joints(), *words()], None, "left out: /chat (std_msgs"),
    "nan": (lambda: joints(data=MISSING), None, "1_position: no number in 1 of 600 rows"),
    "too few numbers": (
        lambda: changed(put("position", np.zeros(1))), None, "has 1 x position for 2 joints"
    ),
    "a joint twice": (lambda: changed(put("name", ["1", "1"])), None, "names a joint twice"),
    "no names": (lambda: changed(put("name", [])), None, "has 2 x position for 0 joints"),
    "names swapped": (lambda: changed(put("name", ["2", "3"])), None, "1_position: no number"),
    "rates are missing": (
        lambda: changed(put("velocity", np.zeros(0))), None, "1_velocity: no number in 1"
    ),
    "the clock jumps back": (lambda: changed(stamp(1_600_000_000)), None, "runs forward"),
    "the clock jumps ahead": (lambda: changed(stamp(1_700_000_900)), None, "runs forward"),
    "no stamp": (lambda: changed(stamp(0)), None, "runs forward"),
    "a gap": (lambda: joints(t=T + (T > 2)), None, "is 1.01 s after the one before"),
    "two topics": (lambda: [*joints(), *joints("/wanted")], None, "is in several of"),
    "one message": (lambda: list(joints())[:1], None, "no column looks like"),
}  # fmt: skip


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("damage", BAGS)
def test_no_damage_of_a_ros_log_is_silent(damage, storage, tmp_path, capsys):
    messages, spoil, said = BAGS[damage]
    file = ros_logs.write(tmp_path / "bag", messages(), storage=storage)
    if spoil is not None:
        spoil(file)
    for path in (file, tmp_path / "bag"):
        folder = tmp_path / path.name.partition(".")[2]
        assert said in answer(path, folder, capsys), path.name
