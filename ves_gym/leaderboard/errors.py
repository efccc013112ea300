"""Why a bundle is refused: one code per reason."""

from __future__ import annotations

from enum import Enum


class Code(Enum):
    """Faults of a bundle; the text is the meaning (docs/leaderboard.md)."""

    UNSAFE_ARCHIVE = "a link, a path, a name or a size that no bundle has, or no archive at all"
    MISSING_MEMBER = "a file that the bundle needs is not in it"
    EXTRA_MEMBER = "a file that does not belong to the bundle is in it"
    MALFORMED_MANIFEST = "manifest.json is no canonical JSON of the schema"
    HASH_MISMATCH = "a file or the manifest is not what its digest says"
    BAD_SIGNATURE = "the signature is none, of other contents, or by a key of another kind"
    OLD_PROTOCOL = "made for another version of the track's rules"
    UNKNOWN_PROBLEM = "no such track, problem or kind of method"
    OLD_ENVIRONMENT = "made for another version or other settings of the environment"
    SYSTEM_MISMATCH = "made on another system: arm, vehicle, mode, effects or steps"
    EVALUATOR_MISMATCH = "made by another version of the evaluator, or by one that is not known"
    EVALUATOR_CHANGED = (
        "the code here does not compute what its version does: the probe is named"
    )
    WRONG_SEEDS = "not the seeds of the problem"
    MISSING_EPISODE = "an episode, query or case has no row"
    REPEATED_GROUP = "two trainings or seeds do the same: one would count twice"
    EXTRA_EPISODE = "a row is of no episode, query or case of the problem, or there twice"
    EPISODE_LENGTH = "actions, control points or answers are more or fewer than the rows need"
    BAD_ACTION = (
        "an action, motion, gain or answer is not finite, out of bounds or no such thing"
    )
    UNKNOWN_ARCHITECTURE = "a policy that is not of the closed list of architectures"
    BAD_WEIGHTS = "weights that cannot be read, are not finite or do not fit"
    BELOW_FLOOR = "better than physics permits"
    LEDGER_RESIDUAL = "energy comes from nowhere: the simulation is not to be believed"
    SCORE_DIFFERS = "a row is not what the replay gives"
    NOT_REPRODUCED = "the method, run again, does something else"
    TOO_LONG = "verifying takes longer than the time it is given"
    NOT_REPRODUCIBLE = "there is nothing to run again: only replaying can prove it"

    @property
    def slug(self) -> str:
        """The code as it is printed, such as `hash-mismatch`."""
        return self.name.lower().replace("_", "-")


class BundleError(Exception):
    """A bundle that is refused."""

    def __init__(self, code: Code, why: str) -> None:
        super().__init__(f"{code.slug}: {' '.join(why.split())}")
        self.code, self.why = code, why

    def __reduce__(self) -> tuple[type[BundleError], tuple[Code, str]]:
        """Return what makes it again in another process."""
        return BundleError, (self.code, self.why)
