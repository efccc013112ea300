"""Command line of trial 2: `python -m benchmarks.trial2 --help`."""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from benchmarks.trial2 import machines, nominal, scoring
from benchmarks.trial2.detectability import detectability
from benchmarks.trial2.publish import published
from benchmarks.trial2.report import every_case, goals, set_by_set
from benchmarks.trial2.seal import check, seal
from benchmarks.trial2.targets import targets
from benchmarks.trial2.write import write_case

PUBLIC = "trial 2, development"


def secret_of(args: argparse.Namespace) -> str:
    """Return the secret of the set: public for `dev`, else the salt in a file."""
    if args.set == "dev":
        return PUBLIC
    if args.salt is None:
        raise SystemExit("--salt FILE is needed for a sealed set")
    salt = args.salt.read_text("utf-8").strip()
    if len(salt) < 16:
        raise SystemExit(f"--salt: got {len(salt)} characters, expected at least 16")
    return str(salt)


def read_labels(folder: Path) -> list[dict[str, Any]]:
    """Labels of a set, in order."""
    return [json.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*.json"))]


def write(args: argparse.Namespace) -> None:
    """Write cases to OUT/cases, their labels to OUT/labels; what is there already stays."""
    first, _, last = args.cases.partition(":")
    (args.out / "labels").mkdir(parents=True, exist_ok=True)
    for index in range(int(first), int(last or int(first) + 1)):
        path = args.out / "labels" / f"{index:03d}.json"
        if path.exists():
            continue
        began = time.process_time()
        label = write_case(secret_of(args), index, args.out / "cases" / f"{index:03d}")
        path.write_text(json.dumps(label, indent=1), "utf-8")
        print(
            f"case {index}: {time.process_time() - began:.0f} s of processor time", flush=True
        )


def close(args: argparse.Namespace) -> None:
    """Print the seal of a set, or what differs from a published one."""
    labels, salt = read_labels(args.out / "labels"), secret_of(args)
    if args.check is None:
        print(json.dumps(seal(labels, salt)))
        return
    wrong = check(json.loads(args.check.read_text("utf-8")), labels, salt)
    print("as sealed" if not wrong else "not as sealed: " + ", ".join(wrong))
    raise SystemExit(bool(wrong))


def answer(args: argparse.Namespace) -> None:
    """Diagnose every case that has no answer yet."""
    (args.out / "answers").mkdir(exist_ok=True)
    for folder in sorted((args.out / "cases").iterdir()):
        path = args.out / "answers" / f"{folder.name}.json"
        if not path.exists():
            given = scoring.answer(folder, args.out / "diagnoses" / folder.name)
            path.write_text(json.dumps(given, indent=1), "utf-8")
            print(f"{folder.name}: {given['verdict']}", flush=True)


def trial(args: argparse.Namespace) -> None:
    """Write and answer one case after another until the time is up; goes on where it was."""
    for name in ("cases", "labels", "answers"):
        (args.out / name).mkdir(parents=True, exist_ok=True)
    first, _, last = args.cases.partition(":")
    for index in range(int(first), int(last or int(first) + 1)):
        if args.until and time.strftime("%H:%M", time.gmtime()) >= args.until:
            break
        label, given = (args.out / k / f"{index:03d}.json" for k in ("labels", "answers"))
        folder = args.out / "cases" / f"{index:03d}"
        if not label.exists():
            written = write_case(secret_of(args), index, folder)
            label.write_text(json.dumps(written, indent=1), "utf-8")
        if not given.exists():
            result = scoring.answer(folder, args.out / "diagnoses" / f"{index:03d}")
            given.write_text(json.dumps(result, indent=1), "utf-8")
        print(f"case {index}: answered", flush=True)


def score(args: argparse.Namespace) -> None:
    """Print the table of answers, and each case's line."""
    labels = read_labels(args.out / "labels")
    answers = {
        int(path.stem): json.loads(path.read_text("utf-8"))
        for path in sorted((args.out / "answers").glob("*.json"))
    }
    print(targets(labels, answers) + "\n\n" + scoring.table(labels, answers))
    for label in labels:
        given = answers.get(label["index"])
        if given:
            truth = ", ".join(f"{e['kind']}@{e['slot']}" for e in label["effects"]) or "nothing"
            names = ", ".join(f"{n['kind']}@{n['slot']}" for n in given.get("names") or [])
            print(
                f"{label['index']:3d} {scoring.judge(label, given):8s} {label['mode']:8s} "
                f"{label['vehicle']} {label['arm']} {label['noise']} x{label['factor']:g}: "
                f"{truth} | {given['verdict']}: {names or given.get('error', '')}"
            )


def publish(args: argparse.Namespace) -> None:
    """Print the labels opened and the answers as one file."""
    print(json.dumps(published(args.out, gaps=args.gaps), indent=1))


def report(args: argparse.Namespace) -> None:
    """Print the goals over published sets, and every case of one, or the sets of several."""
    print(goals(args.sets))
    several = len(args.sets) > 1
    print("\n" + (set_by_set(args.sets) if several else every_case(args.sets[0])))


def limit(args: argparse.Namespace) -> None:
    """Print by how much each hidden effect stands out for the best reader there could be."""
    first, _, last = args.cases.partition(":")
    for label in read_labels(args.out / "labels"):
        if int(first) <= label["index"] < int(last or int(first) + 1):
            rows = detectability(secret_of(args), label)
            for effect, row in zip(label["effects"], rows, strict=True):
                print(
                    f"case {label['index']}: {effect['kind']} {effect['slot'] or ''}: deviance "
                    f"{row.noise:.4g} over noise alone, {row.tolerances:.4g} beside "
                    f"{row.unknown} tolerances, {row.most:.4g} at most in any runs",
                    flush=True,
                )


def agreement(args: argparse.Namespace) -> None:
    """Print differences from `ves-gym simulate` in units of noise, machine by machine."""
    for arm in machines.SERVOS:
        for vehicle in machines.VEHICLES:
            for mode, platform in (
                ("ideal", "pose"),
                ("emulated", "pose"),
                ("emulated", "legs"),
            ):
                if mode == "ideal" or vehicle in machines.EMULATED:
                    units = nominal.in_units_of_noise(vehicle, arm, mode, platform)
                    text = "  ".join(f"{name} {value:.1e}" for name, value in units.items())
                    print(f"{arm} {vehicle} {mode} {platform}: {text}", flush=True)


def main() -> None:
    """Run a command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trial2", description=__doc__)
    commands = parser.add_subparsers(required=True)
    for name, action in (
        ("write", write),
        ("seal", close),
        ("answer", answer),
        ("trial", trial),
        ("score", score),
        ("publish", publish),
        ("report", report),
        ("limit", limit),
        ("nominal", agreement),
    ):
        command = commands.add_parser(name, help=(action.__doc__ or "").splitlines()[0])
        command.set_defaults(action=action)
        if name == "nominal":
            continue
        if name == "report":
            command.add_argument(
                "sets", type=Path, nargs="+", metavar="SET", help="docs/trial2/set-NN"
            )
            continue
        command.add_argument("out", type=Path, metavar="DIR", help="folder of the set")
        if name == "publish":
            command.add_argument(
                "--gaps", action="store_true", help="go on behind a gap in the numbers"
            )
        if name in ("write", "seal", "trial", "limit"):
            command.add_argument("--set", choices=("dev", "sealed"), default="dev")
            command.add_argument(
                "--salt", type=Path, help="file with the secret of a sealed set"
            )
        if name == "trial":
            command.add_argument("--until", help="begin no case after this time, UTC (02:40)")
        if name in ("write", "trial", "limit"):
            command.add_argument("--cases", default="0:30", help="FIRST:LAST (0:30)")
        if name == "seal":
            command.add_argument("--check", type=Path, help="a published seal to compare with")
    args = parser.parse_args()
    args.action(args)


if __name__ == "__main__":
    main()
