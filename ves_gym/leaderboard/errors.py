"""Why an entry is refused: one code per reason."""

from __future__ import annotations

from enum import Enum


class Code(Enum):
    """Faults of an entry; the text is the meaning (docs/leaderboard.md)."""

    UNSAFE_FILE = "a link, a name or a size that no file of an entry has"
    MALFORMED_ENTRY = "entry.json is no JSON of the schema"
    UNKNOWN_PROBLEM = "no such track, problem or kind of method"
    WRONG_SEEDS = "not the seeds of the problem, or of the method"
    WRONG_LENGTH = "results, actions, control points or gains are more or fewer than asked"
    BAD_RECORDING = "an action, motion or gain is not finite, out of bounds or no such thing"
    BAD_SETTINGS = "settings of the environment that are not the method's to choose"
    BAD_POLICY = "a policy that cannot be read, does not fit or is not the one that is named"
    REPEATED_GROUP = "two trainings or seeds do the same: one would count twice"
    LEDGER_RESIDUAL = "energy comes from nowhere: the simulation is not to be believed"
    SCORE_DIFFERS = "results are claimed that are better than those found here"
    NOT_REPRODUCIBLE = "there is neither a recording nor a method that could answer again"

    @property
    def slug(self) -> str:
        """The code as it is printed, such as `score-differs`."""
        return self.name.lower().replace("_", "-")


class Refused(Exception):
    """An entry that is refused."""

    def __init__(self, code: Code, why: str) -> None:
        super().__init__(f"{code.slug}: {' '.join(why.split())[:300]}")
        self.code = code
