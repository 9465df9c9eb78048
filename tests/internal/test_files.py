"""Files that several processes write."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from torch_iac.internal.files import FolderLock, remove_temporary, replace

HOLD = """
import sys
from pathlib import Path
from torch_iac.internal.files import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of a folder."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_who_has_a_lock_is_named_and_a_killed_process_has_none(
    tmp_path: Path, other: subprocess.Popen[str]
) -> None:
    with pytest.raises(BlockingIOError, match=rf"is in use: process {other.pid} on .* writes"):
        FolderLock(tmp_path)
    other.send_signal(signal.SIGKILL)
    other.wait()
    lock = FolderLock(tmp_path)
    with pytest.raises(BlockingIOError, match=rf"process {os.getpid()} on"):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    FolderLock(tmp_path).release()


def test_without_locks_nothing_is_kept_from_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    locks = [FolderLock(tmp_path), FolderLock(tmp_path), FolderLock(tmp_path / "not there")]
    for lock in locks:
        lock.release()


def test_two_processes_that_write_a_file_at_once_do_not_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"

    def write(temporary: Path) -> None:
        temporary.write_text("mine")
        if not path.exists():
            with monkeypatch.context() as elsewhere:
                elsewhere.setattr(os, "getpid", lambda: 1)
                replace(path, lambda other: other.write_text("theirs"))

    replace(path, write)
    assert path.read_text() == "mine"
    assert [of.name for of in tmp_path.iterdir()] == ["a"]


def test_what_a_killed_process_was_writing_is_removed(tmp_path: Path) -> None:
    for name in (".a.17.tmp", "a.tmp", ".a"):
        (tmp_path / name).touch()
    (tmp_path / ".000000000001.tmp").mkdir()
    remove_temporary(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".000000000001.tmp", ".a", "a.tmp"]
