"""How commands end: stop signals, and errors in one line."""

import sys
from typing import NoReturn


class StoppedBySignalError(Exception):
    """A command was stopped by a signal; the message says how to go on.

    Attributes:
        signal: The number of the signal that asked.
    """

    def __init__(self, number: int, sentence: str) -> None:
        super().__init__(sentence)
        self.signal = number


def one_line(error: Exception) -> str:
    """Return what an error says, and its notes, in one line, without the system's error number."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    if "mujoco" in text.lower() and "not installed" in text:
        text += ", or pip install 'torch_iac[mujoco]'"
    return " ".join("; ".join([text, *getattr(error, "__notes__", ())]).split())


def leave(code: int, sentence: str) -> NoReturn:
    """End the program with a sentence on stderr and an exit code."""
    print(f"torch-iac: {sentence}", file=sys.stderr)  # noqa: T201 - the command's answer
    sys.exit(code)
