"""What tests let workers do instead of training; workers import it by its name."""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from torch_iac.runs.schema import SUMMARY


def live(words: Sequence[str], folder: Path) -> None:
    """End well, badly, suddenly or not at all, as the first word says."""
    sys.stdout.write("it has begun\n")
    if words[0] == "fail":
        raise RuntimeError("no luck\nat all")
    if words[0] == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if words[0] == "exit":
        sys.exit(3)
    if words[0] == "stop":
        raise KeyboardInterrupt
    folder.mkdir(parents=True)
    (folder / SUMMARY).write_text("{}")
