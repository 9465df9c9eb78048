"""Is a run that was killed and resumed the run that would have been?

    python -m scripts.stress.kills

Robots of many kinds (both worlds, nearest neighbours and networks, every drive) take a few hundred
decisions, with checkpoints and parts as often as can be. Then the same runs are killed (`kill -9`)
at random moments, resumed in a new process, killed again, and so on; when one has come to its end
it is compared with the one that was never killed: decisions, regions and windows, what the agents
know (weights and all), and every value that TensorBoard shows. Prints what differed, and how many
kills fell into the writing of a checkpoint or of a part.
"""

import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import tyro
from tqdm import tqdm

from tests.same_run import differences
from torch_iac.kinds import DRIVES
from torch_iac.runs.schema import CHECKPOINTS

WORLDS = {"toyroom": ("--agents", "1"), "kinematic": ("--agents", "2")}
EXPERTS = ("knn", "mlp")
OFTEN = {"max-examples": 30, "window": 10, "delay": 10, "log-every": 10, "checkpoint-every": 5}

# Checkpoints and parts as often as asked for, whatever they cost.
COMMAND = """
import math, sys
from torch_iac.cli import main as cli
from torch_iac.runs import buffer
from torch_iac import training
training.SHARE_FOR_CHECKPOINTS = math.inf
buffer.DECISIONS_PER_PART = 7
cli.main(sys.argv[1:])
"""


@dataclass(frozen=True)
class Kills:
    """How much is killed."""

    kills: int = 100
    """How many times a run is killed."""
    steps: int = 200
    """How many decisions a run takes."""
    seed: int = 0
    """Draws the runs and the moments."""
    out: Path = Path("runs/kills")
    """Where the run folders go; it is emptied first."""


def main(kills: Kills) -> None:
    """Kill, resume, compare, and say what came of it."""
    shutil.rmtree(kills.out, ignore_errors=True)
    kinds = list(product(WORLDS, EXPERTS, DRIVES))
    chance = random.Random(kills.seed)
    chance.shuffle(kinds)
    while_writing: Counter[str] = Counter()
    n_kills, n_runs, differing = 0, 0, []
    bar = tqdm(total=kills.kills, unit="kill", disable=None)
    while n_kills < kills.kills:
        world, experts, drive = kinds[n_runs % len(kinds)]
        folder = kills.out / f"{n_runs:03d}-{world}-{experts}-{drive}"
        words = ["train", "--world", world, *WORLDS[world], "--experts", experts, "--drive", drive]
        words += ["--steps", str(kills.steps), "--seed", str(n_runs)]
        words += [word for name, value in OFTEN.items() for word in (f"--{name}", str(value))]
        run(words, folder / "whole").wait()
        killed = folder / "killed"
        process = run(words, killed)
        while n_kills < kills.kills and not has_ended(process, killed, chance, kills.steps):
            n_kills += 1
            bar.update()
            while_writing.update(interrupted(killed))
            process = resume(killed) if killed.exists() else run(words, killed)
        process.wait()
        n_runs += 1
        differing += [f"{folder.name}: {what}" for what in differences(folder / "whole", killed)]
    bar.close()
    print(
        f"{n_kills} kills of {n_runs} runs, {while_writing['a checkpoint']} of them while a "
        f"checkpoint was written and {while_writing['a part']} while a part or a table was."
    )
    print("\n".join(differing) or "All resumed runs are those that would have been.")
    sys.exit(1 if differing else 0)


def run(words: list[str], folder: Path) -> "subprocess.Popen[bytes]":
    """Begin a run."""
    return start([*words, "--out", str(folder)])


def resume(folder: Path) -> "subprocess.Popen[bytes]":
    """Go on with a run."""
    return start(["resume", str(folder)])


def start(words: list[str]) -> "subprocess.Popen[bytes]":
    """Start the command in a process of its own."""
    folder = Path(words[-1])
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f"{folder.name}.log").open("ab") as log:
        return subprocess.Popen([sys.executable, "-c", COMMAND, *words], stdout=log, stderr=log)


def has_ended(
    process: "subprocess.Popen[bytes]", folder: Path, chance: random.Random, n_steps: int
) -> bool:
    """Kill a run some time after it began to write; return whether it ended before."""
    before = len(list(folder.glob("steps/*")))
    while process.poll() is None and len(list(folder.glob("steps/*"))) == before:
        time.sleep(0.001)
    deadline = time.monotonic() + chance.uniform(0, 0.01 * n_steps)
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.0005)
    if process.poll() is not None:
        return True
    process.send_signal(signal.SIGKILL)
    process.wait()
    return False


def interrupted(folder: Path) -> set[str]:
    """Return what was being written when a run was killed, going by what it left behind."""
    found = set()
    if any((folder / CHECKPOINTS).glob(".*.tmp")):
        found.add("a checkpoint")
    if any(folder.glob("*/.part-*.tmp")) or any(folder.glob(".*.tmp")):
        found.add("a part")
    return found


if __name__ == "__main__":
    main(tyro.cli(Kills, description=__doc__))
