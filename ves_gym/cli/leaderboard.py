"""`ves-gym leaderboard ACTION`: what there is to do with entries and their journal."""

from __future__ import annotations

import argparse

from ves_gym.cli.leaderboard_render import add_render


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Actions and their arguments."""
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    add_render(actions)
    for action in actions.choices.values():  # what every command takes, after the action too
        for option, name in (("--json", "FILE"), ("--out", "DIR")):
            action.add_argument(
                option, metavar=name, default=argparse.SUPPRESS, help=argparse.SUPPRESS
            )


def run(args: argparse.Namespace) -> int:
    """Do what was asked for."""
    status: int = args.action(args)
    return status
