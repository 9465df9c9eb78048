"""The file of events that TensorBoard reads."""

import os
import time
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_file_loader import EventFileLoader
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary

from torch_iac.runs.event_file import EventFile
from torch_iac.runs.schema import EVENTS


def written(folder: Path) -> list[Event]:
    """Return all events of a folder in the order in which TensorBoard reads them."""
    return [
        event for path in sorted(folder.glob(EVENTS)) for event in EventFileLoader(str(path)).Load()
    ]


def write(folder: Path, step: int) -> None:
    events = EventFile(folder)
    for number in range(step, step + 3):
        events.add_summary(Summary(value=[Summary.Value(tag="a", simple_value=1.0)]), number)
    events.close()


@pytest.mark.parametrize("later", [0.0, 0.3, 86_400.0, -0.3, -86_400.0, -2e9])
def test_what_is_written_later_is_read_later_whatever_the_clock_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, later: float
) -> None:
    for part in range(3):
        now = 1.7e9 + part * later
        monkeypatch.setattr(time, "time", lambda now=now: now)
        write(tmp_path, step=3 * part)
        for path in tmp_path.glob(EVENTS):
            os.utime(path, (now, now))
    events = written(tmp_path)
    assert [event.step for event in events if event.summary.value] == list(range(9))
    times = [event.wall_time for event in events]
    assert times == sorted(times)
    assert len(list(tmp_path.glob(EVENTS))) == 3


def test_what_is_not_closed_is_whole_once_it_is_dropped(tmp_path: Path) -> None:
    events = EventFile(tmp_path)
    events.add_event(Event(), step=7)
    del events
    assert [event.step for event in written(tmp_path)] == [0, 7]
