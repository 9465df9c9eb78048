"""Atomic writes; strict parsing of untrusted JSON."""

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

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
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        write(temporary)
        sync(temporary)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    temporary.replace(path)
    sync_names(path.parent)


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file as `replace` does."""
    # Dictionaries make floats slower to write and larger.
    few = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    replace(
        path,
        lambda to: pq.write_table(table, to, use_dictionary=few, compression="zstd"),
    )


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
