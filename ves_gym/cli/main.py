"""`ves-gym COMMAND`: parse, run, and turn bad input into one line and exit status 2."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from ves_gym._util.one_line import on_one_line
from ves_gym._util.optional import explain
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.version import __version__

COMMANDS = {  # name -> what it does; the module of the same name is loaded when asked for
    "benchmark": "planners x queries x durations: table, figures, HTML report",
    "simulate": "play one motion on one system and record a run log",
    "plan": "find one path with one planner",
    "studio": "draw a path in a page, and the energy of the base follows",
    "map": "coupling-map pictures and arrays",
    "train": "learn policies for an environment with PPO or SAC",
    "evaluate": "controllers and policies side by side on the same episodes",
    "dataset": "episodes as Minari data sets: made from recipes, checked, replayed",
    "policy": "policies as ONNX for other engines, and their model cards",
    "leaderboard": "entries that anybody can repeat, their verification, and the board",
    "sweep": "many units of work, on this machine or a cluster; goes on where it stopped",
    "matrix": "methods x machines x tasks x seeds: one page with intervals; goes on",
    "search": "the settings of a sweep that do best, found with Optuna",
    "merge": "one table of the results of sweeps",
    "pped": "joint gains that take vibration out of the base (thesis 4.3)",
    "diagnose": "where logs and description disagree, and what is missing",
    "calibrate": "gravity parameters and sensor matrix from a log of poses",
    "structure": "a vehicle file from M and K of a finite-element model",
    "emulation-check": "is an emulation stable, and how true, before it runs",
    "list": "what exists: vehicles, planners, suites, effects",
    "doctor": "what is broken on this machine",
    "view": "watch a run log: window, GIF or MP4",
    "teleop": "drive the arm from the keyboard while the base reacts",
}
DONE, NEGATIVE, BAD_INPUT = 0, 1, 2


class UsageError(ValueError):
    """A command line that cannot be carried out."""


class _Parser(argparse.ArgumentParser):
    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        # `--goal -30,40,0`: a list that begins with a negative number is no option
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a COMMAND or ACTION that there is not, as every unknown name is refused."""
        if action.choices is not None and value not in action.choices:
            names = [str(k) for k in action.choices]
            self.error(
                f"{action.metavar or action.dest} must be one of {', '.join(names)}, got"
                f" {value!r}{did_you_mean(value, names)}"
            )

    def parse_known_args(  # type: ignore[override]
        self, args: Any = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; an unknown option of a command is refused beside the closest known one."""
        out, extra = super().parse_known_args(args, namespace)
        unknown = next((k.partition("=")[0] for k in extra if k.startswith("--")), None)
        if unknown is not None:
            hint = did_you_mean(unknown, self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(extra)}{hint}")
        return out, extra


def build_parser(command: str | None) -> argparse.ArgumentParser:
    """The parser; only the asked command's module is imported for its arguments."""
    parser = _Parser(
        prog="ves-gym",
        description="A PUMA 560 on a long flexible beam in micro-gravity, judged by the"
        " energy transferred to the base.",
        epilog="exit status: 0 done, 1 negative verdict, 2 bad input",
    )
    parser.add_argument("--version", action="version", version=f"ves-gym {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name == command:
            module = importlib.import_module(f"ves_gym.cli.{name.replace('-', '_')}")
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
            sub.add_argument("--json", metavar="FILE", help="write the result as JSON")
            sub.add_argument("--out", metavar="DIR", help="folder for files this command makes")
            sub.add_argument("--seed", type=_seed, default=0, metavar="N", help="default 0")
    return parser


def _seed(text: str) -> int:
    try:
        seed = int(text)
    except ValueError:
        seed = -1
    if seed < 0:
        raise argparse.ArgumentTypeError(f"expected a whole number >= 0, got {text!r}")
    return seed


def _show_warning(message: Warning | str, category: type[Warning], *where: Any) -> None:
    """A warning of the package as one line; others name their category."""
    kind = "" if category.__module__.startswith("ves_gym") else f"{category.__name__}: "
    print(f"ves-gym: warning: {kind}{' '.join(str(message).split())}", file=sys.stderr)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    command = next((w for w in words if w in COMMANDS), None)
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    try:
        args = build_parser(command).parse_args(words)
        status: int = args.run(args)
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader went away (`| head`): nothing left to say
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        print("ves-gym: interrupted", file=sys.stderr)
        return 130
    except (ValueError, OSError, ArithmeticError) as error:
        # parameters, limits, logs, files and runs that diverge: all say what is wrong
        return _refuse(str(error))
    except ImportError as error:
        sentence = explain(error)
        if sentence is None:
            raise  # no optional package: ours to repair
        return _refuse(sentence)


def _refuse(sentence: str) -> int:
    print(f"ves-gym: error: {on_one_line(sentence)}", file=sys.stderr)
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
