"""The physics engine pybullet, imported without the line that it prints.

Raises:
    gymnasium.error.DependencyNotInstalled: It is not installed.
"""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

from gymnasium.error import DependencyNotInstalled

__all__ = ["pybullet"]

STREAMS = 1, 2
"""The numbers of stdout and stderr for the operating system."""


@contextmanager
def _mute() -> Iterator[None]:
    """Discard what C code writes to stdout and stderr."""
    c = ctypes.CDLL(None)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    kept = {stream: os.dup(stream) for stream in STREAMS if _is_open(stream)}
    c.fflush(None)  # C buffers its output, and would write it later
    for stream in kept:
        os.dup2(nowhere, stream)
    try:
        yield
    finally:
        c.fflush(None)
        for stream, copy in kept.items():
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def _is_open(stream: int) -> bool:
    try:
        os.fstat(stream)
    except OSError:
        return False
    return True


try:
    with _mute():
        import pybullet
except ModuleNotFoundError as error:
    raise DependencyNotInstalled(
        "the toy room needs pybullet: pip install pybullet, or pybullet-arm64 for Python 3.12 and "
        "later"
    ) from error
