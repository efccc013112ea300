"""The front doors as text: every verb's signature, every command's table.

`python -m tests.cli.test_tables` writes it anew; the difference is what users will see.
"""

import inspect
import shlex
import subprocess
from pathlib import Path

import pytest

import ves_gym as vg
from ves_gym import api
from ves_gym.cli.flags import PICTURES
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.main import COMMANDS, build_parser, examples, main, table_of

PAGE = Path(__file__).with_name("tables.txt")
TABLES = {words: row for name in COMMANDS for words, row in table_of(name).items()}


def line(title, flags):
    texts = []
    for flag in flags:
        own = flag.name.lstrip("-").replace("-", "_").lower()
        to = "" if flag.parameter == own else f"-> {flag.parameter}"
        texts.append(" ".join(filter(None, (flag.name, flag.form, to))))
    return f"{title}: {', '.join(texts)}"


def page():
    lines = []
    for name in vg.__all__:
        if inspect.isfunction(getattr(api, name, None)):
            parameters = inspect.signature(getattr(vg, name)).parameters
            lines.append(f"vg.{name}({', '.join(map(str, parameters))})")
    lines.append(line("options of a machine", MACHINE))
    for words, (_, flags) in TABLES.items():
        named = {flag.name for flag in flags}
        rest = [flag for flag in flags if flag not in MACHINE]
        machine = " of a machine" * ({flag.name for flag in MACHINE} <= named)
        lines.append(line(f"ves-gym {words}{machine}", rest))
    return "\n".join(lines) + "\n"


def test_the_front_doors_are_as_written():
    assert PAGE.read_text("utf-8") == page()


def test_every_flag_has_a_parameter_and_help():
    for words, (run, flags) in TABLES.items():
        taken = inspect.signature(run).parameters
        rest = any(p.kind is p.VAR_KEYWORD for p in taken.values())
        for flag in flags:
            assert flag.help, (words, flag.name)
            main_s = flag in MACHINE or flag.name in {k.name for k in PICTURES}
            assert main_s or flag.parameter in taken or rest, (words, flag.name)


@pytest.mark.parametrize(
    "words", [(), *{(k,) for k in COMMANDS}, *(k.split() for k in TABLES if " " in k)]
)
def test_help_exits_0(words, capsys):
    with pytest.raises(SystemExit) as end:
        main([*words, "--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert end.value.code == 0 and "usage: ves-gym" in out
    assert ("$ ves-gym " in out) == (" ".join(words) in TABLES)
    if words and words[0] in ("simulate", "plan", "evaluate", "diagnose", "train"):
        assert "joint/coulomb:torque=3,0,0" in out


def test_every_example_is_a_command_line_and_has_succeeded():
    found = set()
    for example in examples():
        line, _, printed = example.partition("\n")
        words = shlex.split(line.removeprefix("$ ves-gym "))
        args = build_parser(words[0]).parse_args(words)
        found.add(next(k for k, (run, _) in TABLES.items() if run is args.run))
        assert printed and "error:" not in printed, line
    assert found == set(TABLES)


def test_bash_completes_commands_actions_and_options(tmp_path, capsys):
    pytest.importorskip("shtab")
    assert main(["completion", "bash"]) == 0
    (tmp_path / "lines").write_text(capsys.readouterr().out)

    def completed(*words):
        script = (
            'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1));'
            ' $(complete -p ves-gym | sed "s/.*-F //; s/ .*//"); echo "${COMPREPLY[@]}"'
        )
        run = ["bash", "--norc", "-c", script, tmp_path / "lines", "ves-gym", *words]
        return subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()

    assert completed("ben") == ["benchmark"]
    assert completed("leaderboard", "") == ["run", "verify", "render"]
    assert completed("plan", "--go") == ["--goal"]


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
