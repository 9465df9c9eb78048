"""Atomic writes; locks between processes; strict parsing of untrusted JSON."""

import errno
import json
import math
import os
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any
from weakref import finalize

import pyarrow as pa
import pyarrow.parquet as pq

LOCK = ".lock"
"""What the file is called by which a folder is locked."""

LOCKED_BYTE = 2**20
"""On Windows a byte is locked, beyond what others must read: who has locked it."""

MOST_NESTED = 100
"""Deepest nesting of JSON, far below Python's own limit."""

_TOO_DEEP = f"JSON must be nested at most {MOST_NESTED} deep, got more"


def replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file so that, at every moment, its name holds the old content or the new, whole.

    If writing fails, nothing is left of it.

    Args:
        path: The file.
        write: Writes the content to the path that it is given.

    Raises:
        OSError: The disk refuses it.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")  # others may write it too
    try:
        write(temporary)
        sync(temporary)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    temporary.replace(path)
    sync_names(path.parent)


def remove_temporary(folder: Path) -> None:
    """Remove what `replace` was writing in a folder when its process was killed."""
    for path in folder.glob(".*.tmp"):
        if path.is_file():
            path.unlink(missing_ok=True)


class FolderLock:
    """Keeps other processes from writing into a folder, until it is released or the process dies.

    Where the file system has no locks, nothing is kept from anything.

    Args:
        folder: Which is there.

    Attributes:
        release: Lets others have the lock; calling it twice is allowed.

    Raises:
        BlockingIOError: Another process has the lock; the message names it.
    """

    def __init__(self, folder: Path) -> None:
        try:
            file = (folder / LOCK).open("a+", encoding="utf-8")
        except OSError:  # such as a folder that is read-only, which refuses the first file itself
            self.release: Callable[[], object] = lambda: None
            return
        self.release = finalize(self, file.close)
        if not lock(file):
            file.seek(0)
            who = file.read(200).strip() or "another process"
            self.release()
            raise BlockingIOError(f"{folder} is in use: {who} writes into it; wait until it ends")
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()


def lock(file: IO[str]) -> bool:
    """Lock an open file until it is closed; return whether no other process has locked it.

    Where there are no locks, none has.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(LOCKED_BYTE)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK)
    return True


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file as `replace` does."""
    # Dictionaries make floats slower to write and larger.
    few = [field.name for field in table.schema if not pa.types.is_floating(field.type)]

    def write(to: Path) -> None:
        with pa.OSFile(os.fsencode(to), "wb") as file:  # PyArrow takes names in UTF-8 only
            pq.write_table(table, file, use_dictionary=few, compression="zstd")

    replace(path, write)


def open_table(path: Path) -> pq.ParquetFile:
    """Open a Parquet file, whatever bytes its name is made of.

    Raises:
        ValueError: It cannot be read.
    """
    try:
        return pq.ParquetFile(pa.OSFile(os.fsencode(path), "rb"))
    except (OSError, pa.ArrowException) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_names(folder: Path) -> None:
    """Wait until the names in a folder are on disk."""
    if os.name == "posix":  # elsewhere a folder cannot be opened
        sync(folder)


def parse_json(data: bytes) -> Any:
    """Return the content of untrusted JSON.

    Raises:
        ValueError: It is not JSON, is nested too deep, names something twice, or holds a number
            that is not finite.
    """
    try:
        content = json.loads(
            data.decode(),
            object_pairs_hook=_once,
            parse_float=_finite,
            parse_constant=_finite,
        )
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except ValueError as error:
        raise ValueError(f"JSON must be whole and strict: {error}") from None
    _check_depth(content)
    return content


def dump_json(content: Any) -> bytes:
    """Return JSON as this library writes it, which `parse_json` reads.

    Raises:
        ValueError: A number is not finite, or it is nested too deep.
    """
    _check_depth(content)
    return (json.dumps(content, indent=2, allow_nan=False) + "\n").encode()


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"a name must stand once, got {name[:80]!r} again")
        content[name] = value
    return content


def _check_depth(content: Any) -> None:
    level = [content]
    for _ in range(MOST_NESTED):
        dicts = (part.values() for part in level if isinstance(part, Mapping))
        lists = (part for part in level if isinstance(part, (list, tuple)))
        level = [part for parts in (*dicts, *lists) for part in parts]
    if level:
        raise ValueError(_TOO_DEEP)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"a number must be finite, got {text[:80]}")
    return number
