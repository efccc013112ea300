"""`ves-gym leaderboard`: bundles that prove a result, their verification, and the board."""

from __future__ import annotations

import argparse
import hashlib
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from ves_gym._util.one_line import on_one_line
from ves_gym._util.params import ParameterError
from ves_gym.cli.common import progress, write_json
from ves_gym.cli.leaderboard_render import add_render

_NEGATIVE = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "Bundles that prove a result, their verification, and the board. Problems, scores and"
        " rules: docs/leaderboard.md. To check a row of the board: ves-gym leaderboard verify"
        " docs/leaderboard/entries/FILE.json. To enter one: run, then verify the bundle."
    )
    actions = parser.add_subparsers(dest="action_name", metavar="ACTION", required=True)
    _add_run(actions)
    _add_verify(actions)
    _add_sign(actions)
    _add_import(actions)
    add_render(actions)
    for action in actions.choices.values():  # what every command takes, after the action too
        for option, name in (("--json", "FILE"), ("--out", "DIR")):
            action.add_argument(
                option, metavar=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )


def run(args: argparse.Namespace) -> int:
    """Carry out the action."""
    status: int = args.action(args)
    return status


def _add_run(actions: Any) -> None:
    parser = actions.add_parser(
        "run",
        help="answer a problem and write the bundle",
        description="Answers a problem and writes the bundle that proves it. A first try of a"
        " tenth of the questions: ves-gym leaderboard run paths reach100-2s-quick direct",
    )
    parser.add_argument("track", help="paths, policies, tasks, damping or discrepancy")
    parser.add_argument(
        "problem", help="of the track, such as reach100-2s (docs/leaderboard.md)"
    )
    parser.add_argument(
        "method",
        nargs="+",
        help="a built-in planner, controller, tuner or selector, or policies: .json files, a"
        " folder of ves-gym train, or the name of a released one",
    )
    parser.add_argument(
        "--bundle", metavar="PATH", help="to write: a new folder or a .zip file (in --out)"
    )
    parser.add_argument(
        "--seeds", metavar="A,B", default="0", help="of the method: 0,1,... (0)"
    )
    parser.add_argument("--name", help="on the board; default the method's")
    parser.add_argument("--author", default="", help="on the board")
    parser.add_argument("--salt", metavar="FILE", help="the maintainer's, of official seeds")
    parser.add_argument(
        "--training", metavar="KEY=VALUE", action="append", default=[],
        help="what the method took to make, told on the board; repeatable",
    )  # fmt: skip
    _add_blind(parser)
    parser.set_defaults(action=_run)


def _add_verify(actions: Any) -> None:
    parser = actions.add_parser(
        "verify",
        help="check a bundle; exit status 1: refused",
        description="Believes nothing of a bundle that can be computed, and runs nothing that"
        " is in it. Level replayed simulates what was recorded (seconds to a minute); level"
        " reproduced runs the method itself again too, as long as it took to make the bundle,"
        " and of track discrepancy half an hour of one core.",
    )
    parser.add_argument(
        "bundle", help="folder or .zip file; or an entry of the board: entries/....json"
    )
    parser.add_argument(
        "--level", metavar="L", help="replayed (default; of an entry: its own) or reproduced"
    )
    parser.add_argument(
        "--seconds", type=float, metavar="S",
        help="that verifying may take; then it is ended and the bundle refused (too-long)",
    )  # fmt: skip
    parser.add_argument("--salt", metavar="FILE", help="the maintainer's, of official seeds")
    parser.add_argument("--digest", metavar="SHA256", help="that the manifest must have")
    parser.add_argument(
        "--board", metavar="ENTRIES", help="folder of the board to add the entry to"
    )
    parser.add_argument(
        "--publish", action="store_true",
        help="with --board: the bundle too, beside the entries, if it is below 2 MB",
    )  # fmt: skip
    parser.add_argument(
        "--adopt", action="store_true",
        help="the maintainer's: the author's unsigned entries on the board are the signer's",
    )  # fmt: skip
    _add_blind(parser)
    parser.set_defaults(action=_verify)


def _add_sign(actions: Any) -> None:
    parser = actions.add_parser(
        "sign",
        help="sign a bundle with an SSH key: its author's name is then that key's",
        description="Uses the program ssh-keygen. `ssh-keygen -t ed25519` makes a key.",
    )
    parser.add_argument("bundle", help="folder or .zip file")
    parser.add_argument("--key", metavar="FILE", required=True, help="private Ed25519 key")
    parser.set_defaults(action=_sign)


def _add_import(actions: Any) -> None:
    parser = actions.add_parser(
        "import-sb3",
        help="a Stable-Baselines3 zip as a policy in the safe format",
        description="A Stable-Baselines3 zip is a pickle: reading it runs whatever code its"
        " author put there. Nothing else of the leaderboard does so.",
    )
    parser.add_argument("zip", metavar="FILE", help="saved by Stable-Baselines3")
    parser.add_argument("policy", metavar="POLICY.json", help="to write; weights beside it")
    parser.add_argument("--algorithm", default="PPO", help="PPO (default) or SAC")
    parser.add_argument(
        "--trust", action="store_true",
        help="you made the zip, or would run a program from where it comes",
    )  # fmt: skip
    parser.add_argument(
        "--hold", type=int, default=1, metavar="N", help="periods that an action is held (1)"
    )
    parser.set_defaults(action=_import)


def _add_blind(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--blind", metavar="DIR", help="logs and labels of track discrepancy")
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        metavar="N",
        help="processes of track paths or discrepancy (1)",
    )


# ------------------------------------------------------------------------------ actions


def _run(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.bundle import digest
    from ves_gym.leaderboard.protocol import get_problem
    from ves_gym.leaderboard.run import make_bundle
    from ves_gym.leaderboard.verify import bundle_manifest

    problem = get_problem(args.track, args.problem)
    method = _method(args.method, problem.environment)
    path = _place(args, method)
    with progress() as on_progress:
        make_bundle(
            path,
            args.track,
            args.problem,
            method,
            name=args.name,
            author=args.author,
            seeds=_seeds(args.seeds),
            salt=_salt(args.salt),
            training=_training(args.training),
            folder=_blind(args),
            workers=_workers(args),
            progress=on_progress,
        )
    manifest, data = bundle_manifest(path)
    write_json(
        args.json,
        {"schema": "ves-leaderboard-run/1", "bundle": str(path), "sha256": digest(data),
         "rows": manifest["rows"]},
    )  # fmt: skip
    print(f"{manifest['name']} on {args.problem}: {_summary(manifest['rows'])}")
    print(f"written {path}, manifest {digest(data)}")
    return 0


def _verify(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.errors import BundleError
    from ves_gym.leaderboard.journal import append
    from ves_gym.leaderboard.published import publish
    from ves_gym.leaderboard.time_limit import within
    from ves_gym.leaderboard.verify import verify

    for option in ("adopt", "publish"):
        if getattr(args, option) and args.board is None:
            raise ParameterError(f"--{option} is of the board: give --board ENTRIES")
    if args.publish and args.salt is not None:
        raise ParameterError("bundles of official seeds are published when their season ends")
    if args.bundle.endswith(".json"):
        return _verify_entry(args)
    try:
        with _telling(args) as told:
            entry = within(
                args.seconds,
                verify,
                args.bundle,
                level=args.level or "replayed",
                salt=_salt(args.salt),
                expect=args.digest,
                folder=_blind(args),
                workers=_workers(args),
                **told,
            )
    except BundleError as refused:
        return _rejected(refused)
    record = None
    if args.board is not None:
        record = append(args.board, entry.shortened(), adopt=args.adopt)
    write_json(args.json, entry.to_dict())
    print(f"{entry.level}: {entry.name} on {entry.problem}: {_summary(entry.rows)}")
    print(f"manifest {entry.bundle}")
    print(f"signed by {entry.about['key']}" if "key" in entry.about else "not signed")
    if record is not None:
        print(f"written {Path(args.board) / record.name}")
        place = publish(args.board, record, Path(args.bundle)) if args.publish else None
        if args.publish:
            print(f"written {place}" if place else "its bundle is too large to be published")
    return 0


@contextmanager
def _telling(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Show how far verifying is; not where it runs in a process that can be ended."""
    if args.seconds is not None:
        yield {}
        return
    with progress() as on_progress:
        yield {"progress": on_progress}


def _rejected(refused: Exception) -> int:
    print(f"ves-gym: rejected: {on_one_line(str(refused))}", file=sys.stderr)
    return _NEGATIVE


def _verify_entry(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.errors import BundleError
    from ves_gym.leaderboard.published import reverify
    from ves_gym.leaderboard.time_limit import within

    if args.board is not None or args.salt is not None or args.digest is not None:
        raise ParameterError("an entry takes no --board, --salt or --digest: it is there")
    try:
        with _telling(args) as told:
            done = within(
                args.seconds, reverify, args.bundle, level=args.level, folder=_blind(args),
                workers=_workers(args), **told,
            )  # fmt: skip
    except BundleError as refused:
        return _rejected(refused)
    here = done.here
    write_json(args.json, {**here.to_dict(), "alike": done.alike, "again": done.again})
    how = "answered again" if done.again else here.level
    print(f"{how}: {here.name} on {here.problem}: {_summary(here.rows)}")
    print(f"{done.alike:.0%} of {len(here.rows)} rows as on the board")
    return 0


def _sign(args: argparse.Namespace) -> int:
    from ves_gym.leaderboard.errors import BundleError
    from ves_gym.leaderboard.signature import sign_bundle

    try:
        key = sign_bundle(args.bundle, args.key)
    except BundleError as refused:
        return _rejected(refused)
    write_json(
        args.json, {"schema": "ves-leaderboard-sign/1", "bundle": args.bundle, "key": key}
    )
    print(f"signed {args.bundle} by {key}")
    return 0


def _import(args: argparse.Namespace) -> int:
    from ves_gym.baselines.policy import read_sb3_zip, save_policy

    try:
        data = Path(args.zip).read_bytes()
    except OSError as error:
        raise ParameterError(f"{args.zip}: cannot be read: {error.strerror}") from None
    policy = read_sb3_zip(args.zip, args.algorithm, trusted=args.trust)
    source = hashlib.sha256(data).hexdigest()
    print(f"trusted {args.zip}: its pickles were run (SHA-256 {source})")
    policy.network = replace(policy.network, hold=args.hold)
    policy.about = {**policy.about, "algorithm": args.algorithm.lower(), "source": source}
    print(f"written {save_policy(policy, args.policy)}")
    return 0


# ---------------------------------------------------------------------------- arguments


def _method(words: Sequence[str], id: str | None) -> Any:
    """A name of what is built in, or the files of policies."""
    if id is None:
        if len(words) > 1:
            raise ParameterError(f"expected one method, got {' '.join(words)}")
        return words[0]
    from ves_gym.baselines.comparison import policy_files
    from ves_gym.baselines.registry import CONTROLLERS

    if len(words) == 1 and words[0] in CONTROLLERS:
        return words[0]
    return [file for word in words for file in policy_files(word, id)]


def _place(args: argparse.Namespace, method: Any) -> Path:
    """The bundle's place: --bundle, --out if it is a .zip file, or one in the folder --out."""
    if args.bundle is not None:
        return Path(args.bundle)
    if args.out is not None and args.out.endswith(".zip"):
        return Path(args.out)
    label = args.name or (method if isinstance(method, str) else Path(method[0]).stem)
    stem = "-".join([args.track, args.problem, label])
    safe = "".join(c if c.isalnum() or c in "-_." else "-" for c in stem)
    return Path(args.out or "out/leaderboard") / f"{safe}.zip"


def _seeds(text: str) -> tuple[int, ...]:
    try:
        seeds = tuple(int(k) for k in text.split(","))
    except ValueError:
        seeds = ()
    if not seeds or min(seeds) < 0:
        raise ParameterError(f"--seeds must be whole numbers >= 0 like 0,1,2, got {text!r}")
    return seeds


def _salt(path: str | None) -> str | None:
    from ves_gym.leaderboard.protocol import read_salt

    return None if path is None else read_salt(path)


def _training(pairs: Sequence[str]) -> dict[str, str] | None:
    out = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (key and equals):
            raise ParameterError(f"--training must be KEY=VALUE, got {pair!r}")
        out[key] = value
    return out or None


def _blind(args: argparse.Namespace) -> Path | None:
    return None if args.blind is None else Path(args.blind)


def _workers(args: argparse.Namespace) -> int:
    if args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    workers: int = args.workers
    return workers


def _summary(rows: Sequence[Mapping[str, Any]]) -> str:
    scores = [row["score"] for row in rows if row["score"] is not None]
    middle = f"median score {statistics.median(scores):.4g}, " if scores else ""
    return f"{middle}{len(scores)} of {len(rows)} rows with a score"
