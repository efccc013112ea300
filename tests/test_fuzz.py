"""Damaged files and bad values: one sentence each, whatever is read and whichever option."""

from __future__ import annotations

import pytest

from tests.fuzz import faults
from ves_gym.cli import main as cli
from ves_gym.cli.flags import Answer


@pytest.mark.parametrize("count", [1_000, pytest.param(20_000, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_in_a_sentence(count):
    """Claim: of 20,000 seeded damages of 26 kinds of files, each is read or refused in one
    sentence within 12 s; none ends a process, none is a traceback."""
    assert list(faults(count, seed=4)) == []


BAD = (
    "", " ", "-1", "0", "1.5", "nan", "inf", "-inf", "1e308", "99999999999999999999", "x", "é",
    "1,2,x", "1,,2", "a=b", "=", "{}", "no/such/file.toml", "../..", "module:Name",
)  # fmt: skip
ROWS = [(name, words) for name in cli.COMMANDS for words in cli.table_of(name)]


@pytest.mark.parametrize("values", [BAD[::6], pytest.param(BAD, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("command", "words"), ROWS, ids=[words for _, words in ROWS])
def test_a_bad_value_of_any_option_is_a_sentence(
    command, words, values, monkeypatch, capsys, tmp_path
):
    """Claim: every option of every command takes each of twenty bad values or refuses it with
    exit status 2 and one line."""
    monkeypatch.chdir(tmp_path)
    real = cli.table_of(command)
    flags = real[words][1]

    def nothing(*args, **kwargs):
        return Answer(text="done")

    monkeypatch.setattr(
        cli, "table_of", lambda name: {k: (nothing, row[1]) for k, row in real.items()}
    )
    needed = []
    for flag in flags:
        if flag.required or not (flag.name.startswith("-") or flag.optional):
            needed.append((flag.name, "x"))
    for flag in (*flags, *cli.EVERY):
        if flag.name.startswith("-") and not flag.form:
            continue
        for bad in values:
            argv = words.split()
            others = [(name, value) for name, value in needed if name != flag.name]
            for name, value in (*others, (flag.name, bad)):
                argv += [f"{name}={value}"] if name.startswith("-") else [value]
            status = cli.main(argv)
            _, error = capsys.readouterr()
            assert status in (0, 2), (argv, status)
            assert (status == 2) == bool(error.strip()), (argv, error)
            assert "Traceback" not in error and len(error.strip().splitlines()) <= 8, argv
