"""The file of events that TensorBoard reads, in order whatever the clock does.

TensorBoard reads the files of a run by their names, which begin with the time. Where the clock has
gone back since the run began, a new file would come before the older ones.
"""

import os
import socket
import time
from pathlib import Path
from weakref import finalize

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from torch_iac.runs.schema import EVENTS

SECONDS_TO_FLUSH = 30.0
"""Seconds after which what was written is flushed, so that TensorBoard shows it."""


class EventFile:
    """A new file of events, later than those in its folder by name and by all its times.

    Args:
        folder: Where it is made.

    Attributes:
        close: Closes the file; nothing can be written any more.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        older = [(_begun(path.name), path.stat().st_mtime) for path in folder.glob(EVENTS)]
        self._last_time = max((time for times in older for time in times), default=0.0)
        begun = max(int(time.time()), 1 + max((begun for begun, _ in older), default=0))
        name = EVENTS.replace("*", f"{begun:010d}.{socket.gethostname()}.{os.getpid()}.0")
        self._file = (folder / name).open("wb")
        self.close = finalize(self, self._file.close)
        self._records = RecordWriter(self._file)
        self._flushed = time.monotonic()
        self.add_event(Event(file_version="brain.Event:2"))
        self.flush()

    def add_summary(self, summary: Summary, step: int | None = None) -> None:
        """Write values at a step."""
        self.add_event(Event(summary=summary), step)

    def add_event(self, event: Event, step: int | None = None) -> None:
        """Write an event; its time is now, or that of the last one where the clock is behind."""
        event.wall_time = self._last_time = max(time.time(), self._last_time)
        if step is not None:
            event.step = step
        self._records.write(event.SerializeToString())
        if time.monotonic() - self._flushed > SECONDS_TO_FLUSH:
            self.flush()

    def flush(self) -> None:
        """Let readers see all that was written."""
        self._file.flush()
        self._flushed = time.monotonic()


def _begun(name: str) -> int:
    """Return the time in the name of a file of events; 0 if there is none."""
    stamp = name.removeprefix(EVENTS.rstrip("*")).partition(".")[0]
    return int(stamp) if stamp.isdecimal() else 0
