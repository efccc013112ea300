"""Command line of the trial: `python -m benchmarks.trial --help`."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from benchmarks.trial import frozen, machines, nominal, scoring
from benchmarks.trial.detectability import detectability
from benchmarks.trial.targets import Cases, each_case, targets
from benchmarks.trial.write import write_case

FOLDERS = ("cases", "labels", "answers")


def indices(args: argparse.Namespace) -> range:
    """Return the numbers of `--cases FIRST:LAST`, or of one case."""
    first, _, last = args.cases.partition(":")
    return range(int(first), int(last or int(first) + 1))


def read(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the JSON files of a folder by their names, in order."""
    paths = sorted(folder.glob("*.json"))
    return {path.stem: json.loads(path.read_text("utf-8")) for path in paths}


def answered(out: Path) -> Cases:
    """Return label and answer of every case that has both."""
    labels, answers = read(out / "labels"), read(out / "answers")
    return [(labels[name], answers[name]) for name in labels if name in answers]


def run(args: argparse.Namespace) -> None:
    """Write and diagnose one case after another; what is there already stays."""
    for name in FOLDERS:
        (args.out / name).mkdir(parents=True, exist_ok=True)
    for index in indices(args):
        if args.until and time.strftime("%H:%M", time.gmtime()) >= args.until:
            break
        name = f"{index:03d}"
        label, given = (args.out / kind / f"{name}.json" for kind in ("labels", "answers"))
        folder = args.out / "cases" / name
        if not label.exists():
            written = write_case(args.secret, index, folder)
            label.write_text(json.dumps(written, indent=1), "utf-8")
        if not given.exists():
            result = scoring.answer(folder, args.out / "diagnoses" / name)
            given.write_text(json.dumps(result, indent=1), "utf-8")
            print(f"case {index}: {result['verdict']}", flush=True)


def score(args: argparse.Namespace) -> None:
    """Print the rows of the goals, the counts of answers, and each case's line."""
    cases = answered(args.out)
    print("\n\n".join((targets(cases), scoring.table(cases), each_case(cases))))


def limit(args: argparse.Namespace) -> None:
    """Print by how much each hidden effect stands out for the best reader there could be."""
    wanted = set(indices(args))
    for label in read(args.out / "labels").values():
        if label["index"] in wanted:
            rows = detectability(args.secret, label)
            for effect, row in zip(label["effects"], rows, strict=True):
                print(
                    f"case {label['index']}: {effect['kind']} {effect['slot'] or ''}: deviance "
                    f"{row.noise:.4g} over noise alone, {row.tolerances:.4g} beside "
                    f"{row.unknown} tolerances, {row.most:.4g} at most in any runs",
                    flush=True,
                )


def check(args: argparse.Namespace) -> None:
    """Make stored cases again, and print what differs from the answers stored."""
    for name in args.names or frozen.stored()["cases"]:
        told = frozen.check(name)
        print(f"{name}: " + ("as stored" if not told else "\n  ".join(["", *told])), flush=True)


def record(args: argparse.Namespace) -> None:
    """Store the answers of now to cases of the sets whose secrets are stored."""
    for name in args.names:
        frozen.record(name)
        print(name, flush=True)


def agreement(args: argparse.Namespace) -> None:
    """Print differences from `ves-gym simulate` in units of noise, machine by machine."""
    for arm in machines.SERVOS:
        for vehicle in machines.VEHICLES:
            for mode, platform in nominal.MODES:
                if mode == "ideal" or vehicle in machines.EMULATED:
                    units = nominal.in_units_of_noise(vehicle, arm, mode, platform)
                    text = "  ".join(f"{name} {value:.1e}" for name, value in units.items())
                    print(f"{arm} {vehicle} {mode} {platform}: {text}", flush=True)


def main() -> None:
    """Run a command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trial", description=__doc__)
    commands = parser.add_subparsers(required=True)
    for name, action in (
        ("run", run),
        ("score", score),
        ("limit", limit),
        ("check", check),
        ("record", record),
        ("nominal", agreement),
    ):
        command = commands.add_parser(name, help=(action.__doc__ or "").splitlines()[0])
        command.set_defaults(action=action)
        if name == "nominal":
            continue
        if name in ("check", "record"):
            command.add_argument("names", nargs="*", metavar="CASE", help="17-012 (check: all)")
            continue
        command.add_argument("out", type=Path, metavar="DIR", help="folder of the cases")
        if name == "score":
            continue
        command.add_argument(
            "--secret", default="development", help="text that decides what is drawn"
        )
        command.add_argument("--cases", default="0:30", help="FIRST:LAST (0:30)")
        if name == "run":
            command.add_argument("--until", help="begin no case after this time, UTC (02:40)")
    args = parser.parse_args()
    args.action(args)


if __name__ == "__main__":
    main()
