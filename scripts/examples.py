"""Write ves_gym/cli/examples.txt, what `--help` shows of every command, from runs of them.

    python scripts/examples.py [COMMAND ...]

All run in one folder, so that later ones have the files of earlier ones; with names, those
commands alone are run again. tests/cli/test_tables.py reads every line as the parser does.
"""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import ves_gym as vg
from ves_gym.cli.main import EXAMPLES, examples

ROOT = Path(__file__).parents[1]
MOST, WIDE = 9, 80  # lines of what a command prints, and columns
LINES = """
plan --goal 60,40,-30 --out .
simulate --case case.toml --log run.csv
benchmark --first 2 --durations 2 --planners straight,calm --no-figures
studio --goal 60,40,-30 --out studio
map --points 8
train PumaDamp-v0 --steps 4096 --seeds 0
evaluate PumaDamp-v0 --controller zero,pped --episodes 10
dataset list
dataset make PumaDamp-v0/random-v0 --episodes 4 --out sets
dataset check sets/ves/PumaDamp-v0/random-v0
policy export out/train/PumaDamp-ppo/seed-0/best.json --onnx
policy card out/train/PumaDamp-ppo/seed-0/best.json --episodes 10
leaderboard run paths thesis straight --author me
leaderboard verify out/leaderboard/paths_thesis_me_straight --board entries
leaderboard render entries
sweep sweep.toml --part 1/8
merge out/sweep/sweep
matrix matrix.toml --episodes 1 --seeds 1
search search.toml
pped --no-figures
diagnose log-1.csv log-2.csv log-3.csv --system described.toml
calibrate poses.csv
structure mast.pch --interface 4 --units m-kg-s --damping 0.02 --rigid-modes 0
emulation-check --no-search --no-figures
list vehicles
doctor
completion bash
view run.csv --gif run.gif
export mcap run.csv
export fmu
teleop --keys keys.txt --duration 1
"""


def prepare() -> None:
    """What examples start from."""
    machine = vg.System(mode="emulated")
    q, y = vg.simulation.calibration_poses(machine.arm, 47)
    vg.simulation.weigh_poses(machine, q, y).save("poses.csv")
    for name in ("mast.pch", "sweep.toml", "matrix.toml", "search.toml"):
        shutil.copy(ROOT / "examples" / name, name)
    vg.System().save("described.toml")
    machine = vg.System(effects=[vg.effects.JointCoulomb(torque=(0, 0, 3))])
    for k, motion in enumerate(vg.excitation(3)):
        vg.simulate(motion, machine, settle=1.0, record_dt=0.0125).save(f"log-{k + 1}.csv")
    Path("keys.txt").write_text("0.2 q\n")


def shown(line: str) -> str:
    """The command, and what it prints."""
    run = [sys.executable, "-m", "ves_gym.cli.main", *shlex.split(line)]
    sized = {**os.environ, "COLUMNS": str(WIDE)}
    done = subprocess.run(run, capture_output=True, text=True, env=sized)
    text = (done.stdout if done.returncode in (0, 1) else done.stderr).rstrip().splitlines()
    text = [k.rstrip() for k in text if k.strip() and not k.startswith("# ")]
    if len(text) > MOST:
        text = [*text[: MOST - 1], "..."]
    text = [k if len(k) <= WIDE else f"{k[: WIDE - 3]}..." for k in text]
    return "\n".join([f"$ ves-gym {line}", *text])


def main(commands: list[str]) -> None:
    """Run them, write the file."""
    out, stored = [], examples()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        prepare()
        for line in LINES.split("\n")[1:-1]:
            known = next((k for k in stored if k.startswith(f"$ ves-gym {line}\n")), None)
            again = not commands or any(line.startswith(k) for k in commands)
            out.append(shown(line) if again or known is None else known)
            print(out[-1], end="\n\n", flush=True)
    EXAMPLES.write_text("\n\n".join(out) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
