"""The front doors as text: every verb's signature, every command's table.

`python -m tests.cli.test_tables` writes it anew; the difference is what users will see.
"""

import importlib
import inspect
from pathlib import Path

import pytest

import ves_gym as vg
from ves_gym import api
from ves_gym.cli.files import PICTURES
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.main import COMMANDS, main

PAGE = Path(__file__).with_name("tables.txt")
VERBS = [name for name in vg.__all__ if inspect.isfunction(getattr(api, name, None))]


def tables():
    """Commands and actions: (name, flags, function)."""
    for name in COMMANDS:
        module = importlib.import_module(f"ves_gym.cli.{name.replace('-', '_')}")
        for action, (_, flags, run) in getattr(module, "ACTIONS", {}).items():
            yield f"{name} {action}", flags, run
        if hasattr(module, "FLAGS"):
            yield name, module.FLAGS, module.run


def page():
    lines = []
    for name in VERBS:
        parameters = inspect.signature(getattr(vg, name)).parameters
        lines.append(f"vg.{name}({', '.join(map(str, parameters))})")
    for name, flags, _ in tables():
        lines.append(f"ves-gym {name}")
        for flag in flags:
            to = flag.parameter
            own = flag.name.lstrip("-").replace("-", "_").lower()
            lines.append(
                f"  {flag.name} {flag.form}".rstrip() + (f" -> {to}" if to != own else "")
            )
    return "\n".join(lines) + "\n"


def test_the_front_doors_are_as_written():
    assert PAGE.read_text("utf-8") == page()


def test_every_flag_has_a_parameter_and_help():
    for name, flags, run in tables():
        taken = inspect.signature(run).parameters
        rest = any(p.kind is p.VAR_KEYWORD for p in taken.values())
        for flag in flags:
            assert flag.help, (name, flag.name)
            main_s = flag in MACHINE or flag in PICTURES
            assert main_s or flag.parameter in taken or rest, (name, flag.name)
        if rest and name not in ("plan", "studio", "map", "view", "calibrate", "structure"):
            assert "progress" in taken, name  # it is not among the rest


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)])
def test_help_exits_0(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert end.value.code == 0 and "usage: ves-gym" in out
    if command and command[0] in ("simulate", "plan", "evaluate", "diagnose", "train"):
        assert "joint/coulomb:torque=3,0,0" in out


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
