"""`ves-gym COMMAND`: parse, run, and turn bad input into one line and exit status 2."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from ves_gym._util.one_line import on_one_line
from ves_gym._util.optional import explain, lacking
from ves_gym._util.own import CALLED, IMPORTED, import_own
from ves_gym._util.params import write_text
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.version import __version__
from ves_gym.cli.flags import FILES, Answer, Context, Flag, Place, integer, say, values
from ves_gym.report.figures import write_figures

COMMANDS = {  # name -> its module, loaded when it is asked for, and what it does
    "benchmark": ("planning", "planners x queries x durations: table, figures, HTML report"),
    "simulate": ("simulate", "play one motion on one system and record a run log"),
    "plan": ("planning", "find one path with one planner"),
    "studio": ("planning", "draw a path in a page, and the energy of the base follows"),
    "map": ("checks", "coupling-map pictures and arrays"),
    "train": ("learning", "learn policies for an environment, by PPO or from a controller"),
    "evaluate": ("learning", "controllers and policies side by side on the same episodes"),
    "dataset": ("learning", "episodes as Minari data sets: made from recipes and replayed"),
    "policy": ("learning", "policies as ONNX for other engines, and their model cards"),
    "leaderboard": ("leaderboard", "entries that anybody can repeat, checked, and the board"),
    "sweep": ("sweeps", "many units of work, here or on a cluster; resumes where it stopped"),
    "matrix": ("sweeps", "methods x machines x tasks x seeds: a page with intervals; resumes"),
    "search": ("sweeps", "the settings of a sweep that do best, found with Optuna"),
    "merge": ("sweeps", "one table of the results of sweeps"),
    "pped": ("checks", "joint gains that take vibration out of the base (thesis 4.3)"),
    "diagnose": ("diagnose", "where logs and description disagree, and what is missing"),
    "calibrate": ("checks", "gravity parameters and sensor matrix from a log of poses"),
    "structure": ("checks", "a vehicle file from M and K of a finite-element model"),
    "emulation-check": ("checks", "stability and fidelity of an emulation, before it runs"),
    "list": ("list", "what exists: vehicles, planners, suites, effects"),
    "doctor": ("doctor", "what is broken on this machine"),
    "completion": ("doctor", "the script that completes these commands in a shell"),
    "view": ("watch", "watch a run log: window, page, GIF, MP4, or rerun"),
    "export": ("export", "a run as MCAP, a machine as an FMU, for the tools of others"),
    "teleop": ("watch", "drive the arm from the keyboard while the base reacts"),
}
EMULATED = ("emulation-check", "list")  # mode of their machine where nothing says it
DONE, NEGATIVE, BAD_INPUT = 0, 1, 2
EXAMPLES = Path(__file__).with_name("examples.txt")  # scripts/examples.py ran them


def _registered_from(name: str, place: Place) -> str:
    import_own(name)
    return name


EVERY = (  # options of every command
    *FILES,
    Flag("--seed", "N", integer(), "default 0"),
    Flag("--import", "MODULE", _registered_from,
         "a module or .py file of your own, first: what it registers then goes by its name;"
         " repeatable", many=True),
)  # fmt: skip


class UsageError(ValueError):
    """A command line that cannot be carried out."""


class _Help(argparse.HelpFormatter):
    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Keep the lines of an example."""
        return text if text.startswith("$ ") else super()._fill_text(text, width, indent)


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
        if extra:
            unknown = next((k.partition("=")[0] for k in extra if k.startswith("--")), "")
            hint = did_you_mean(unknown, self._option_string_actions)
            if all(k.lstrip("-.")[:1].isdigit() for k in extra):
                hint = "; the numbers of one option are written with commas, as 0,30,-20"
            self.error(f"unrecognized arguments: {' '.join(extra)}{hint}")
        return out, extra


def examples() -> list[str]:
    """Return an example of every command, each with what it printed."""
    return EXAMPLES.read_text("utf-8").rstrip().split("\n\n")


def build_parser(*requested: str) -> argparse.ArgumentParser:
    """Return the parser; only modules of the requested commands are imported."""
    parser = _Parser(
        prog="ves-gym",
        description="A PUMA 560 on a long flexible beam in micro-gravity, judged by the"
        " energy transferred to the base.",
        epilog="exit status: 0 done, 1 negative verdict, 2 bad input",
    )
    parser.add_argument("--version", action="version", version=f"ves-gym {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (_, text) in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name not in requested:
            continue
        table = table_of(name)
        if name in table:
            _add(sub, name, *table[name])
            continue
        actions = sub.add_subparsers(dest="action", metavar="ACTION", required=True)
        for words, (run, flags) in table.items():
            help = " ".join(str(run.__doc__).split()).rstrip(".")
            help = help[0].lower() + help[1:]
            action = actions.add_parser(words.split()[1], help=help, description=help)
            _add(action, words, run, flags)
    return parser


def table_of(command: str) -> dict[str, tuple[Callable[..., Answer], tuple[Flag, ...]]]:
    """Return what a command, or each of its actions, runs, and its options."""
    table = importlib.import_module(f"ves_gym.cli.{COMMANDS[command][0]}").TABLE
    return {words: row for words, row in table.items() if words.split()[0] == command}


def _add(
    parser: argparse.ArgumentParser,
    words: str,
    run: Callable[..., Answer],
    flags: Sequence[Flag],
) -> None:
    """Add the options of a table, those that every command has, and the example."""
    parser.set_defaults(flags=flags, run=run)
    parser.formatter_class = _Help
    start = f"$ ves-gym {words}"
    parser.epilog = next(
        (k for k in examples() if f"{k} ".startswith((f"{start} ", f"{start}\n"))), ""
    )
    places: dict[str, Any] = {"": parser}  # headings, and options that exclude each other
    for flag in (*flags, *EVERY):
        if flag.group not in places:
            places[flag.group] = parser.add_argument_group(flag.group)
        place = places[flag.group]
        if flag.against and flag.against not in places:
            places[flag.against] = place.add_mutually_exclusive_group()
        place = places[flag.against] if flag.against else place
        options: dict[str, Any] = {"help": flag.help.replace("%", "%%")}
        if not flag.name.startswith("-"):
            count = ("*" if flag.optional else "+") if flag.many else "?"
            options |= {"nargs": count} if flag.many or flag.optional else {}
            place.add_argument(flag.parameter, metavar=flag.name, **options)
            continue
        options |= {"dest": flag.parameter, "required": flag.required}
        if not flag.form:
            options["action"] = "store_true"
        else:
            options |= {"metavar": flag.form, "action": "append" if flag.many else "store"}
            options |= {"nargs": "+"} if flag.row else {}
        place.add_argument(flag.name, **options)


def _carry_out(args: argparse.Namespace) -> int:
    """Pass a command what it takes, and print its answer."""
    texts, flags = vars(args), args.flags
    every = values(EVERY, texts, None)
    IMPORTED[:] = every.pop("import", ())
    CALLED.clear()
    with ExitStack() as bars:
        at, arm = Context(progress=Bars(args.command, bars), **every), None
        if any(flag.name == "--case" for flag in flags):
            from ves_gym.cli.machine import MACHINE, case_from

            machine = values([flag for flag in flags if flag in MACHINE], texts, None)
            flags = [flag for flag in flags if flag not in MACHINE]
            mode = "emulated" if args.command in EMULATED else "ideal"
            case = case_from(machine, mode, every.get("seed"))
            at, arm = replace(at, case=case, machine=machine), case.system.arm
        taken = values(flags, texts, arm)
        form = taken.pop("format", "png")
        at = replace(at, pictures=not taken.pop("no_figures", False))
        answer = args.run(at, **taken)
        if answer.figures is not None and at.pictures:
            if missing := lacking("drawing", "matplotlib"):
                answer = replace(answer, text=f"{answer.text}\nno pictures: {missing}")
            else:
                named = {answer.folder / name: k for name, k in answer.figures().items()}
                drawn = write_figures(named, form)
                answer = replace(answer, files=[*answer.files, *drawn])
    return _print(answer, at.json)


def _print(answer: Answer, file: str | None) -> int:
    """Write an answer as JSON and print it; the exit status."""
    files = [str(path) for path in answer.files] + ([file] if file not in (None, "-") else [])
    lines = [str(answer.text)] if str(answer.text) else []
    if answer.files:
        lines.append(f"written: {'  '.join(files)}")
    imports = [word for name in IMPORTED for word in ("--import", name)]
    lines += [f"next: {shlex.join(['ves-gym', *map(str, k), *imports])}" for k in answer.then]
    if file is not None and answer.plain is not None:
        plain = {**answer.plain, "files": files} if answer.files else answer.plain
        text = json.dumps(plain, indent=1, allow_nan=False)
        if file == "-":
            lines = [text]
        else:
            write_text(file, text + "\n")
    for line in lines if file != "-" or answer.plain is not None else ():
        print(line)
    return NEGATIVE if answer.negative else DONE


class Bars:
    """Progress bars, which verbs take as `progress`: the last number is the fraction done.

    What stands before the fraction names a bar of its own, what is after it stands beside it.
    Bars are for a terminal; a pipe gets nothing.
    """

    def __init__(self, command: str, stack: ExitStack) -> None:
        self.command, self.stack = command, stack  # which ends the bars
        self.bars: Any = None  # none before the first call
        self.tasks: dict[str, Any] = {}

    def __call__(self, *words: Any) -> None:
        if not sys.stderr.isatty():
            return
        at = max(k for k, word in enumerate(words) if isinstance(word, (int, float)))
        name = " ".join(map(str, (self.command, *words[:at])))
        note = " ".join(map(str, words[at + 1 :]))
        if self.bars is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TimeRemainingColumn

            percent, notes = "{task.percentage:3.0f} %", "{task.fields[note]}"
            columns = "{task.description}", BarColumn(), percent, TimeRemainingColumn(), notes
            bars = Progress(*columns, console=Console(stderr=True), transient=True)
            self.bars = self.stack.enter_context(bars)
        if name not in self.tasks:
            self.tasks[name] = self.bars.add_task(name, total=1.0, note=note)
        self.bars.update(self.tasks[name], completed=words[at], note=note)


def _show_warning(message: Warning | str, category: type[Warning], *where: Any) -> None:
    """A warning of the package as one line; others name their category."""
    kind = "" if category.__module__.startswith("ves_gym") else f"{category.__name__}: "
    print(f"ves-gym: warning: {kind}{' '.join(str(message).split())}", file=sys.stderr)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    command = next((w for w in words if w in COMMANDS), "")
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    try:
        status = _carry_out(build_parser(command).parse_args(words))
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader went away (`| head`): nothing left to say
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        _, flags = table_of(command).get(command, (None, ())) if command else (None, ())
        resumes = any(flag.name == "--resume" for flag in flags)
        hint = "; with --resume the same command goes on" if resumes else ""
        print(f"ves-gym: interrupted{hint}", file=sys.stderr)
        return 130
    except OSError as error:  # of a file, no room for one among them
        named = error.filename is not None and error.strerror is not None
        sentence = f"{error.filename}: {error.strerror}" if named else str(error)
    except (ValueError, ArithmeticError) as error:
        # parameters, limits, logs and runs that diverge: all say what is wrong
        sentence = str(error)
    except ImportError as error:
        if not (explained := explain(error)):
            raise  # no optional package: ours to repair
        sentence = explained
    say(on_one_line(sentence), "error")
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
