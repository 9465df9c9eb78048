"""Does a run of a million decisions stay as quick and as small as it was?

    python -m scripts.stress.soak

Lets `torch-iac train` carry it out and watches its process and its folder from outside. Whenever
as many more decisions as `every` says are on disk, prints a line of Markdown: processor
milliseconds a decision since the last line; memory of the process, less what it had at the first
line, beside the raw numbers of the examples since then; sizes in the folder.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow.parquet as pq
import tyro

from torch_iac.runs.reader import load_run
from torch_iac.runs.schema import CHECKPOINTS, EVENTS, REGIONS, STEPS

COMMAND = "import sys; from torch_iac.cli.main import main; main(sys.argv[1:])"
MIB = 2**20
LOOK_EVERY = 0.5  # s


@dataclass(frozen=True)
class Soak:
    """How long, and in which world."""

    steps: int = 1_000_000
    """How many decisions the robot takes."""
    every: int = 100_000
    """How many decisions lie between two lines."""
    world: str = "kinematic"
    """Where it lives."""
    seed: int = 0
    """Its seed."""
    out: Path = Path("runs/soak")
    """Its run folder."""


@dataclass(frozen=True)
class Look:
    """What was seen of a run at a moment.

    Attributes:
        n_decisions: How many decisions are on disk.
        seconds: Of the processor, since the process began.
        memory: Bytes that the process has in memory.
    """

    n_decisions: int
    seconds: float
    memory: int


def main(soak: Soak) -> None:
    """Watch a run and print how it goes."""
    words = ["--world", soak.world, "--steps", soak.steps, "--seed", soak.seed, "--out", soak.out]
    command = [sys.executable, "-c", COMMAND, "train", *map(str, words)]
    with subprocess.Popen(command) as process:
        print(
            "| decisions | ms each | memory grown MiB | raw numbers MiB | TensorBoard MiB "
            "| steps MiB | regions MiB | checkpoints MiB |"
        )
        print("|---" * 8 + "|", flush=True)
        first = last = None
        for look in looks(process, soak):
            first, last = first or look, last or Look(0, 0.0, 0)
            print(line(soak.out, first, last, look), flush=True)
            last = look
    if process.returncode:
        raise SystemExit(f"the run ended with exit code {process.returncode}")


def looks(process: subprocess.Popen[bytes], soak: Soak) -> Iterator[Look]:
    """Look at a run whenever enough decisions have been added, until it ends."""
    due = soak.every
    while process.poll() is None:
        time.sleep(LOOK_EVERY)
        n_decisions = on_disk(soak.out)
        if n_decisions < due:
            continue
        due = (n_decisions // soak.every + 1) * soak.every
        yield Look(n_decisions, *consumed(process.pid))


def consumed(process: int) -> tuple[float, int]:
    """Return a process' seconds of the processor, and how many bytes it has in memory; on Linux."""
    of = Path(f"/proc/{process}")
    user, system = (of / "stat").read_text().rpartition(")")[2].split()[11:13]
    pages = int((of / "statm").read_text().split()[1])
    ticks = int(user) + int(system)
    return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE")


def on_disk(folder: Path) -> int:
    """Return how many decisions a run has written."""
    parts = sorted((folder / STEPS).glob("part-*.parquet"))
    if not parts:
        return 0
    n_rows = pq.read_metadata(parts[0]).num_rows
    return int((len(parts) - 1) * n_rows + pq.read_metadata(parts[-1]).num_rows)


def line(folder: Path, first: Look, last: Look, look: Look) -> str:
    """Return a row of the table."""
    each = 1000 * (look.seconds - last.seconds) / (look.n_decisions - last.n_decisions)
    numbers = len(load_run(folder).space.situation) + len(load_run(folder).space.outcomes)
    raw = 4 * numbers * (look.n_decisions - first.n_decisions)
    sizes = [size(folder, name) for name in (EVENTS, f"{STEPS}/*", REGIONS, f"{CHECKPOINTS}/**/*")]
    cells = [f"{look.n_decisions:,}", f"{each:.2f}"]
    cells += [f"{of / MIB:.1f}" for of in (look.memory - first.memory, raw, *sizes)]
    return f"| {' | '.join(cells)} |"


def size(folder: Path, pattern: str) -> int:
    """Return how many bytes some files of a folder have."""
    return sum(path.stat().st_size for path in folder.glob(pattern) if path.is_file())


if __name__ == "__main__":
    main(tyro.cli(Soak, description=__doc__))
