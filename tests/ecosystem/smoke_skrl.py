# /// script
# dependencies = ["skrl", "torch"]
# ///
"""skrl: its example of docs/training.md, on a fiftieth of the decisions."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "training"))
import skrl_ppo

DECISIONS = 20_480  # two updates; 1,000,000 solve the task


def main() -> str:
    """Train; return what was run."""
    share = skrl_ppo.main(DECISIONS)
    assert 0 <= share <= 1
    return f"examples/training/skrl_ppo.py: {DECISIONS:,} decisions of PumaDamp"


if __name__ == "__main__":
    print("ran:", main())
