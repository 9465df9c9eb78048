"""How long do the command and the library take to start?

    python -m scripts.benchmarks.startup OLDER NEWER

starts each of some commands with the source in each of these folders (copies of this repository;
this one by default), several times and taking turns, so that what else the machine does meets all
alike. Times are seconds of the processor: on a machine that does nothing else, the user waits about
as long. What a command writes is thrown away.
"""

import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

STARTS = {
    "`torch-iac --help`": "--help",
    "`torch-iac --version`": "--version",
    "a mistyped command": "trian",
    "a mistyped option of `train`": "train --step 3",
    "a refused value of `train`": "train --steps 0",
    "`torch-iac figures --help`": "figures --help",
    "`import torch_iac`": None,
    "`import torch`": None,
}
"""What is started: words of the command, or code."""

COMMAND = """
import importlib, sys
for name in ("torch_iac.main", "torch_iac.cli.main", "torch_iac.cli"):  # at one time or another
    try:
        main = importlib.import_module(name).main
        break
    except ImportError:
        pass
main(sys.argv[1:])
"""


@dataclass(frozen=True)
class Study:
    """What is compared, and how often."""

    folders: tyro.conf.Positional[tuple[Path, ...]] = (Path(),)
    """Where the source is."""
    repeats: int = 7
    """How often each is started."""


def main(study: Study) -> None:
    """Start everything in turns, and print the least times: what else goes on only adds to them."""
    print(f"| least of {study.repeats}, s |", *(f" {folder} |" for folder in study.folders))
    print("|---|", "---|" * len(study.folders), sep="")
    for what, words in STARTS.items():
        seconds: dict[Path, list[float]] = {folder: [] for folder in study.folders}
        for _ in range(study.repeats):
            for folder, taken in seconds.items():
                taken.append(_seconds(folder.absolute(), what.strip("`"), words))
        print(f"| {what} |", *(f" {min(taken):.2f} |" for taken in seconds.values()))


def _seconds(source: Path, what: str, words: str | None) -> float:
    """Return how long a fresh Python has the processor, in a folder that is thrown away."""
    code = what if words is None else COMMAND
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-c", code, *(words or "").split()],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (source, source / "envs")))},
            capture_output=True,
            check=False,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main(tyro.cli(Study))
