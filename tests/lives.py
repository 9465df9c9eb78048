"""What tests let workers do instead of training; workers import it by its name."""

import os
import signal
import sys

from torch_iac.compare.plan import Job
from torch_iac.runs.schema import SUMMARY


def live(job: Job) -> None:
    """End well, badly, suddenly or not at all, as the variant's name says."""
    sys.stdout.write("it has begun\n")
    if job.content["end"] == "fail":
        raise RuntimeError("no luck\nat all")
    if job.content["end"] == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if job.content["end"] == "exit":
        sys.exit(3)
    if job.content["end"] == "stop":
        raise KeyboardInterrupt
    job.folder.mkdir(parents=True)
    (job.folder / SUMMARY).write_text("{}")
