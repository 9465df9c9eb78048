"""The streams of a command: those that are not there, and readers that have gone."""

import codecs
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper

from torch_iac.cli.exits import leave, one_line

BROKEN_PIPE = 128 + 13
"""Exit code of a program that SIGPIPE ends."""

STREAMS = {"stdin": "r", "stdout": "w", "stderr": "w"}
"""Python's streams, in the order of their numbers for the operating system."""


def prepare() -> None:
    """Make the three streams such that a command can answer, whatever it has to say."""
    _open_missing()
    codecs.register_error("answer", _as_it_can_be)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="answer")


def _as_it_can_be(error: UnicodeError) -> tuple[bytes, int]:
    """Return how characters are written that the locale has not, for Python's encoder.

    Bytes of a path that are no text in it are written as they are, all others are escaped.
    """
    assert isinstance(error, UnicodeEncodeError)  # noqa: S101 - nothing is decoded
    written = b""
    for character in error.object[error.start : error.end]:
        is_byte = "\udc80" <= character <= "\udcff"
        written += character.encode("ascii", "surrogateescape" if is_byte else "backslashreplace")
    return written, error.end


def _open_missing() -> None:
    """Open those of the three streams that the program was started without, to nowhere.

    Otherwise the next file that is opened would get the number of such a stream, and what other
    code writes to the stream would go into that file.
    """
    for number, (name, mode) in enumerate(STREAMS.items()):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
            os.set_inheritable(opened, True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


@contextmanager
def answering() -> Iterator[None]:
    """Let the answer of a command be written before the program ends.

    Once nobody reads it any more, as after `| head -1`, the program ends quietly, as programs do
    that a broken pipe ends.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _discard()
        sys.exit(BROKEN_PIPE)
    except OSError as error:  # such as a full disk
        _discard()
        leave(2, f"the answer cannot be written: {one_line(error)}")


def _discard() -> None:
    """Send what is still to be written to nowhere: Python tries once more when it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(nowhere, stream.fileno())
